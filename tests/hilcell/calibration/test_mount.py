"""A mount that is not where the cell file says, as instruments of two classes see it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.diagnosis import mount_offset
from hilcell.calibration.position_errors import position_errors
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log, commanded_rad
from hilcell.model.frame import MeasuredBase
from hilcell.ports import Array

SIDEWAYS = np.array([0.0, 1.0, 0.0])  # in the tool's frame: what a turn of {B} about z looks like
COARSE = {"tracker_limit_mm": 0.3, "tracker_limit_um_m": 2.5}  # as the manual has a total station
COARSE_MM, COARSE_UM_M = 0.6, 4.85  # of one reading
SAMPLES = 16
FALSE_MM = 3.161  # of an undisturbed cell
SIGMA_MM = 2.82  # sideways: the mount's own 1, and what six points on a circle leave open


@pytest.fixture
def coarse(log: Log) -> Log:
    """The same run, had its readings been a total station's."""
    for point in [*log.points.values()]:
        range_mm = float(np.linalg.norm(point.xyz_mm))
        along = np.array(point.xyz_mm) / range_mm
        across_mm = COARSE_UM_M * 1e-6 * range_mm
        std_mm = np.sqrt((COARSE_MM * along) ** 2 + across_mm**2 * (1.0 - along**2))
        seen: Any = std_mm.tolist()
        log.points[point.key] = msgspec.structs.replace(point, std_mm=seen, samples=SAMPLES)
    table: dict[str, Any] = log.inputs.cell
    cell = table | {"uncertainty": table.get("uncertainty", {}) | COARSE}
    log.plan = msgspec.structs.replace(log.inputs, cell=cell)
    return log


def off(log: Log, in_tool_mm: Array) -> Log:
    """Let the grid's mean error in the tool's frame be ``in_tool_mm`` (3,)."""
    points, R = log.select("grid"), log.matrix("base")[:3, :3]
    in_world = R @ forward(log.cell.robot.arm(), commanded_rad(points))[:, :3, :3]
    errors_mm = position_errors(log, points).error_mm
    there_mm = np.einsum("nji,nj->ni", in_world, errors_mm).mean(axis=0)
    for point, turn in zip(points, log.matrix("world")[:3, :3].T @ in_world, strict=True):
        at: Any = (np.array(point.xyz_mm) + turn @ (in_tool_mm - there_mm)).tolist()
        log.points[point.key] = msgspec.structs.replace(point, xyz_mm=at)
    return log


def wide(log: Log, by_mm: float) -> Log:
    """Let the circle of axis 6 be wider than that of the stated mount."""
    log.frame(MeasuredBase, "base").radius_mm[1] = 98.0 + by_mm
    return log


def test_an_undisturbed_mount_seen_by_a_coarse_instrument_is_not_suspected(coarse: Log) -> None:
    assert mount_offset(off(coarse, FALSE_MM * SIDEWAYS)) is None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_slip_of_five_sigma_is_seen_by_a_coarse_instrument(coarse: Log, sign: float) -> None:
    found = mount_offset(off(coarse, sign * 5.0 * SIGMA_MM * SIDEWAYS))
    assert found is not None
    assert (found.cause, found.noticed_by) == ("mount offset", "constant error in the tool's frame")
    assert found.size == pytest.approx(5.0 * SIGMA_MM, abs=0.001)
    assert mount_offset(off(coarse, 3.1 * SIGMA_MM * SIDEWAYS)) is not None
    assert mount_offset(off(coarse, 2.9 * SIGMA_MM * SIDEWAYS)) is None


@pytest.mark.parametrize("axis", [0, 2])
def test_only_the_direction_that_is_seen_badly_has_a_wider_limit(coarse: Log, axis: int) -> None:
    assert mount_offset(off(coarse, 3.3 * np.eye(3)[axis])) is not None
    assert mount_offset(off(coarse, 3.0 * np.eye(3)[axis])) is None


@pytest.mark.parametrize("axis", [0, 1])
def test_a_fine_instrument_has_the_limit_of_the_robot_and_its_mount(log: Log, axis: int) -> None:
    assert mount_offset(off(log, 3.1 * np.eye(3)[axis])) is not None
    assert mount_offset(off(log, 2.99 * np.eye(3)[axis])) is None


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_circle_of_axis_6_shows_a_radius_that_is_not_stated(log: Log, sign: float) -> None:
    found = mount_offset(wide(log, 2.01 * sign))
    assert found is not None
    assert found.size == pytest.approx(2.01)
    assert found.noticed_by == "circle of axis 6"
    assert mount_offset(wide(log, 1.99 * sign)) is None
