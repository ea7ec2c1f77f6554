"""The points of SpatialAnalyzer's job: those of the cell's own CSV file, or a lattice.

A person would import a list into the job, and name it in the cell file. In a simulated cell whose
file names none, a lattice over all that the arm and the nests can reach is both.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from fakes.transforms import Array, frame, inverse
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError

PITCH_MM = 145.0
WIDE_MM = 200.0  # around the arm's reach and the nests


def imported(path: Path) -> dict[str, Array]:
    """Return the points (3,) of a CSV file by name; raises `SettingsError`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row and row[0] != "name"]
        return {row[0]: np.array([float(each) for each in row[1:4]]) for row in rows}
    except (OSError, ValueError) as error:
        raise SettingsError(
            str(path), [f"SpatialAnalyzer imports no such list: {error}"]
        ) from error


def lattice(cell: Cell) -> dict[str, Array]:
    """Return points (3,) in the tracker's frame wherever a reflector of the cell can be."""
    nests_mm = np.array([nest.xyz_mm for nest in cell.layout.standing])
    rail, layout = cell.rail, cell.layout
    stops_mm = np.linspace(rail.travel_min_mm, rail.travel_max_mm, 11)
    base_mm = np.array([layout.base.x_mm, layout.base.y_mm, layout.base.z_mm])
    bases_mm = base_mm + np.multiply.outer(stops_mm, np.array(layout.rail_direction))
    reach_mm = sum(math.hypot(joint.a_mm, joint.d_mm) for joint in cell.robot.joint)
    reach_mm += float(np.linalg.norm(cell.robot.smr_mm))
    from_world = inverse(frame(cell.tracker.pose))
    low_mm, high_mm = -cell.tracker.max_range_mm, cell.tracker.max_range_mm
    axis_mm = np.arange(low_mm, high_mm + PITCH_MM, PITCH_MM)
    floor_mm = nests_mm[:, 2].min() - WIDE_MM
    kept: list[Array] = []
    for x_mm in axis_mm:
        at_mm = np.stack(np.meshgrid([x_mm], axis_mm, axis_mm, indexing="ij"), -1).reshape(-1, 3)
        world_mm = (at_mm - from_world[:3, 3]) @ from_world[:3, :3]
        inside = _within(world_mm, bases_mm, reach_mm) & (world_mm[:, 2] >= floor_mm)
        kept += list(at_mm[inside | _within(world_mm, nests_mm, WIDE_MM)])
    return {f"H{n:06d}": at_mm.round(3) for n, at_mm in enumerate(kept, start=1)}


def _within(
    at_mm: Array, of_mm: Array, reach_mm: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which places (N, 3) are within a reach of one of some others (M, 3)."""
    found = np.zeros(len(at_mm), dtype=bool)
    for each_mm in of_mm:
        found |= np.linalg.norm(at_mm - each_mm, axis=1) <= reach_mm
    return found


def write(path: Path, points: dict[str, Array]) -> None:
    """Write the list as a person would name it in the cell file."""
    with path.open("w", encoding="ascii", newline="") as file:
        csv.writer(file).writerows([name, *map(str, at_mm)] for name, at_mm in points.items())
