"""Interlocks open only on fresh, finite readings of the right kind."""

import math
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.ports import RailReading, RobotReading
from hilcell.run.control import Interlock
from hilcell.run.device_status import CellMonitor
from hilcell.run.interlocks import (
    Blocked,
    check_joint_limits,
    check_rail_may_move,
    check_robot_may_move,
    check_strip,
)
from tests.clocks import DrivenClock
from tests.hilcell.run.rig import desk

CELL = load_cell("paper")
S1100 = CELL.station_named("S1100")


def robot(**changes: Any) -> RobotReading:
    values: dict[str, Any] = {
        "joints_rad": np.radians(CELL.robot.safe_deg),
        "pose": np.eye(4),
        "still": True,
        "taken_s": 10.0,
    }
    return RobotReading(**(values | changes))


def rail(**changes: Any) -> RailReading:
    values: dict[str, Any] = {
        "position_mm": 1100.2,
        "strip_mm": 1100.0,
        "velocity_mm_s": 0.02,
        "still": True,
        "powered": False,
        "taken_s": 10.0,
    }
    return RailReading(**(values | changes))


def test_they_open_on_good_readings() -> None:
    check_rail_may_move(CELL, robot(), 10.1)
    check_robot_may_move(CELL, rail(), S1100, 10.1)


def off(axis: int, deg: float) -> np.ndarray:
    joints = np.radians(CELL.robot.safe_deg)
    joints[axis] += np.radians(deg)
    return joints


@pytest.mark.parametrize(
    ("changes", "now_s", "part"),
    [
        ({}, 10.6, "600 ms"),
        ({}, 9.0, "-1000 ms"),
        ({"taken_s": float("nan")}, 10.0, "nan ms"),
        ({"still": False}, 10.0, "moving"),
        ({"joints_rad": off(1, 0.2)}, 10.0, "A2 -99.800 deg"),
        ({"joints_rad": off(1, -0.2)}, 10.0, "A2 -100.200 deg"),
        ({"joints_rad": off(3, float("nan"))}, 10.0, "A4 nan deg"),
        ({"joints_rad": np.full(6, np.nan)}, 10.0, "nan deg"),
    ],
)
def test_the_rail_stays(changes: dict[str, object], now_s: float, part: str) -> None:
    with pytest.raises(Blocked, match=part):
        check_rail_may_move(CELL, robot(**changes), now_s)


@pytest.mark.parametrize(
    ("changes", "now_s", "part"),
    [
        ({}, 10.51, "510 ms"),
        ({"still": False, "velocity_mm_s": 0.1}, 10.0, "0.100 mm/s"),
        ({"still": False, "velocity_mm_s": 0.0}, 10.0, "0.000 mm/s"),
        ({"velocity_mm_s": float("nan")}, 10.0, "nan"),
        ({"velocity_mm_s": float("inf")}, 10.0, "inf"),
        ({"position_mm": float("nan")}, 10.0, "slide"),
        ({"powered": True}, 10.0, "power"),
        ({"powered": True, "velocity_mm_s": 0.0}, 10.0, "power"),
        ({"strip_mm": 1100.03}, 10.0, "1100.03 mm"),
        ({"strip_mm": 1099.97}, 10.0, "1099.97 mm"),
        ({"strip_mm": float("nan")}, 10.0, "slide"),
        ({"strip_mm": float("inf")}, 10.0, "slide"),
    ],
)
def test_the_robot_stays(changes: dict[str, object], now_s: float, part: str) -> None:
    with pytest.raises(Blocked, match=part):
        check_robot_may_move(CELL, rail(**changes), S1100, now_s)


def test_a_strip_that_says_nothing_proves_no_station() -> None:
    """Also where the slide's standstill was not asked for first: after a measurement."""
    check_strip(CELL, rail(), S1100, "hold")
    with pytest.raises(Blocked, match="nan mm"):
        check_strip(CELL, rail(strip_mm=float("nan")), S1100, "hold")


@pytest.mark.parametrize("deg", [-4.0, -141.0, float("nan")])
def test_joint_limits_hold_with_their_margin(deg: float) -> None:
    joints = np.radians(CELL.robot.home_deg)
    joints[1] = np.radians(deg)
    with pytest.raises(Blocked, match="A2"):
        check_joint_limits(CELL, joints, "vertex 3")


def seen_now(cell: Cell, **changes: Any) -> list[Interlock]:
    values: dict[str, Any] = {"rail": rail(), "robot": robot(), "station": S1100} | changes
    clock = DrivenClock(pc_at_s=10.1)
    monitor = CellMonitor(desk(cell, clock), clock, cell)
    if values["rail"] is not None:
        monitor.take_rail(values["rail"])
    if values["robot"] is not None:
        monitor.take_robot(values["robot"])
    monitor.rail.moving = values.get("rail_moves", False)
    monitor.robot.moving = values.get("robot_moves", False)
    return monitor.interlocks(values["station"])


def blocked(**changes: Any) -> set[str]:
    return {each.name for each in seen_now(CELL, **changes) if each.blocked}


def test_a_robot_on_the_floor_has_no_interlocks_of_a_rail() -> None:
    found = seen_now(load_cell("fixed"), rail=None, station=None)
    assert {each.name: each.blocked for each in found} == {"robot move": "", "measurement": ""}


BY_ROBOT = {"rail move", "measurement"}
BY_RAIL = {"robot move", "measurement"}


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({}, set[str]()),
        ({"robot_moves": True}, BY_ROBOT),
        ({"robot": robot(still=False)}, BY_ROBOT),
        ({"robot": robot(joints_rad=off(1, 0.2))}, {"rail move"}),
        ({"robot": robot(taken_s=4.1)}, BY_ROBOT),
        ({"robot": None}, BY_ROBOT),
        ({"rail_moves": True}, BY_RAIL),
        ({"rail": rail(velocity_mm_s=3.2, still=False)}, BY_RAIL),
        ({"rail": rail(velocity_mm_s=float("nan"))}, BY_RAIL),
        ({"rail": rail(powered=True)}, BY_RAIL),
        ({"rail": rail(strip_mm=1100.05)}, BY_RAIL),
        ({"rail": rail(strip_mm=1100.05), "station": None}, set[str]()),
        ({"rail": rail(taken_s=math.nan)}, BY_RAIL),
        ({"rail": rail(taken_s=4.1)}, BY_RAIL),
        ({"rail": None}, BY_RAIL),
    ],
)
def test_the_overview_says_what_blocks(changes: dict[str, object], what: set[str]) -> None:
    assert blocked(**changes) == what
