"""How far off a calibration really is: judged by the truth of the simulated cell, on this side.

No engine sees any of it. A calibration's commands are handed to a machine of the same seed, without
noise, and where its tool comes to is compared with the targets, in the {W} of the true nests.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.cell_truth import CellTruth
from fakes.truth.rail_truth import RailTruth, _Shape
from hilcell.calibration.file import compensate_targets, read_calibration
from hilcell.calibration.frames import world_from_tracker
from hilcell.calibration.grid import grid_of
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse, matrix, poses_from_zyx, zyx_from_pose
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array

TARGETS = 60
MARGIN_MM = 30.0  # targets keep within the cube as a disturbed frame places it
FROM_BELOW = np.ones(6)


@dataclass
class Truth:
    """A machine, on which a test may do what a disturbance did for good."""

    cell_truth: CellTruth
    strip_jump_mm: float = 0.0


def machine(cell: Cell, seed: int) -> Truth:
    return Truth(CellTruth(cell, seed, CellTime(), Faults()))


def true_errors_mm(calibration: Path, cell: Cell, truth: Truth) -> dict[str, Array]:
    """Return by station how far (N,) the tool comes from targets, corrected by a calibration."""
    found, cell_truth = read_calibration(calibration), truth.cell_truth
    nests_mm = np.array([cell_truth._floor_nests[nest.name] for nest in cell.layout.floor])
    world = world_from_tracker(cell, nests_mm)
    robot, places = cell.robot.nominal(), _in_cube(cell)
    errors = {}
    for station in cell.station:
        slide_mm = _slide_mm(cell_truth, station.strip_mm - truth.strip_jump_mm)
        slide = _shape(cell_truth).pose(slide_mm) @ cell_truth._T_S_R
        targets = world @ slide @ cell_truth.arm.ideal_base @ places
        names = [str(n) for n in range(len(targets))]
        sent = poses_from_zyx(
            compensate_targets(found, station.name, zyx_from_pose(targets), names)
        )
        in_base = inverse(np.array(found.stations[station.name].T_W_B)) @ sent
        arm = cell_truth.arm.pose(robot.joints_for(in_base), FROM_BELOW, np.zeros(6))
        at_mm = apply(world @ slide, arm[:, :3, 3])
        errors[station.name] = lengths_mm(at_mm - targets[:, :3, 3])
    return errors


def _in_cube(cell: Cell) -> Array:
    """Return targets (N, 4, 4) in {B}, the same for every run."""
    low_mm, size_mm = grid_of(cell).origin_mm + MARGIN_MM, np.array(cell.grid.size_mm)
    at_mm = low_mm + np.random.default_rng(2013).uniform(size=(TARGETS, 3)) * (
        size_mm - 2 * MARGIN_MM
    )
    return matrix(cell.grid.centre.matrix()[:3, :3], at_mm)


def _slide_mm(cell_truth: CellTruth, strip_mm: float) -> float:
    """Return where the slide stands when the strip reads ``strip_mm``."""
    slide_mm = strip_mm
    for _ in range(10):
        slide_mm += strip_mm - _shape(cell_truth).strip_mm(slide_mm)
    return slide_mm


def _shape(cell_truth: CellTruth) -> _Shape:
    """Return what the seed fixes of the rail."""
    assert isinstance(cell_truth.rail, RailTruth)
    return cell_truth.rail._shape
