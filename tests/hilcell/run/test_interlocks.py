"""Interlocks open only on fresh, finite readings of the right kind."""

import math
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.ports import RailReading, RobotReading
from hilcell.run.interlocks import (
    Blocked,
    Sight,
    check_joint_limits,
    check_strip,
    overview,
    rail_may_move,
    robot_may_move,
)

CELL = load_cell("paper")
S1100 = CELL.station_named("S1100")


def robot(**changes: object) -> RobotReading:
    values: dict[str, Any] = {
        "joints_rad": np.radians(CELL.robot.safe_deg),
        "pose": np.eye(4),
        "still": True,
        "taken_s": 10.0,
    }
    return RobotReading(**(values | changes))


def rail(**changes: object) -> RailReading:
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
    rail_may_move(CELL, robot(), 10.1)
    robot_may_move(CELL, rail(), S1100, 10.1)


def off(axis: int, deg: float) -> np.ndarray:
    joints = np.radians(CELL.robot.safe_deg)
    joints[axis] += np.radians(deg)
    return joints


@pytest.mark.parametrize(
    ("changes", "now_s", "part"),
    [
        ({}, 10.6, "600 ms old, wanted <= 500 ms"),
        ({}, 9.0, "-1000 ms old"),
        ({"taken_s": float("nan")}, 10.0, "nan ms old"),
        ({"still": False}, 10.0, "moving"),
        ({"joints_rad": off(1, 0.2)}, 10.0, "not at safe pose, A2 -99.800 deg"),
        ({"joints_rad": off(1, -0.2)}, 10.0, "not at safe pose, A2 -100.200 deg"),
        ({"joints_rad": off(3, float("nan"))}, 10.0, "not at safe pose, A4 nan deg"),
        ({"joints_rad": np.full(6, np.nan)}, 10.0, "not at safe pose"),
    ],
)
def test_the_rail_stays(changes: dict[str, object], now_s: float, part: str) -> None:
    with pytest.raises(Blocked, match=part):
        rail_may_move(CELL, robot(**changes), now_s)


@pytest.mark.parametrize(
    ("changes", "now_s", "part"),
    [
        ({}, 10.51, "510 ms old"),
        ({"still": False, "velocity_mm_s": 0.1}, 10.0, "slide moves at 0.100 mm/s, wanted at rest"),
        ({"still": False, "velocity_mm_s": 0.0}, 10.0, "slide moves at 0.000 mm/s"),
        ({"velocity_mm_s": float("nan")}, 10.0, "slide moves at nan"),
        ({"velocity_mm_s": float("inf")}, 10.0, "slide moves at inf"),
        ({"position_mm": float("nan")}, 10.0, "slide moves at"),
        ({"powered": True}, 10.0, "power to move"),
        ({"powered": True, "velocity_mm_s": 0.0}, 10.0, "power to move"),
        ({"strip_mm": 1100.03}, 10.0, "station S1100 not held: strip 1100.03 mm, wanted 1100.00"),
        ({"strip_mm": 1099.97}, 10.0, "station S1100 not held: strip 1099.97 mm, wanted 1100.00"),
        ({"strip_mm": float("nan")}, 10.0, "slide moves at"),
        ({"strip_mm": float("inf")}, 10.0, "slide moves at"),
    ],
)
def test_the_robot_stays(changes: dict[str, object], now_s: float, part: str) -> None:
    with pytest.raises(Blocked, match=part):
        robot_may_move(CELL, rail(**changes), S1100, now_s)


def test_a_strip_that_says_nothing_proves_no_station() -> None:
    """Also where the slide's standstill was not asked for first: after a measurement."""
    check_strip(CELL, rail(), S1100, "hold")
    with pytest.raises(Blocked, match="strip nan mm"):
        check_strip(CELL, rail(strip_mm=float("nan")), S1100, "hold")


@pytest.mark.parametrize("deg", [-4.0, -141.0, float("nan")])
def test_joint_limits_hold_with_their_margin(deg: float) -> None:
    joints = np.radians(CELL.robot.home_deg)
    joints[1] = np.radians(deg)
    with pytest.raises(Blocked, match="A2"):
        check_joint_limits(CELL, joints, "vertex 3")


def sight(**changes: object) -> Sight:
    values: dict[str, Any] = {
        "rail": rail(),
        "robot": robot(),
        "rail_moves": False,
        "robot_moves": False,
        "station": S1100,
        "now_s": 10.1,
    }
    return Sight(**(values | changes))


def blocked(**changes: object) -> dict[str, str]:
    return {each.name: each.blocked for each in overview(CELL, sight(**changes))}


def test_the_overview_opens_on_good_readings() -> None:
    assert blocked() == {"rail move": "", "robot move": "", "measurement": ""}


def test_a_robot_on_the_floor_has_no_interlocks_of_a_rail() -> None:
    found = overview(load_cell("fixed"), sight(rail=None, station=None))
    assert {each.name: each.blocked for each in found} == {"robot move": "", "measurement": ""}


REST = "the robot is moving, wanted at rest"
AWAY = "robot not at safe pose, A2 -99.800 deg, wanted -100.000 +-0.1 deg"
OLD = "the {} was last read 6 s ago"
NOT_HELD = "station S1100 not held: strip 1100.05 mm, wanted 1100.00 +-0.02 mm"


@pytest.mark.parametrize(
    ("changes", "by_rail", "by_robot", "measure"),
    [
        ({"robot_moves": True}, REST, "", REST),
        ({"robot": robot(still=False)}, REST + " at its safe pose", "", REST),
        ({"robot": robot(joints_rad=off(1, 0.2))}, AWAY, "", ""),
        (
            {"robot": robot(taken_s=4.1)},
            "the robot was last read 6 s ago",
            "",
            "the robot was last read 6 s ago",
        ),
        ({"robot": None}, "the robot was not read yet", "", "the robot was not read yet"),
        ({"rail_moves": True}, "", *["the rail is moving, wanted at rest"] * 2),
        (
            {"rail": rail(velocity_mm_s=3.2, still=False)},
            "",
            *["slide moves at 3.200 mm/s, wanted at rest"] * 2,
        ),
        (
            {"rail": rail(velocity_mm_s=float("nan"))},
            "",
            *["slide moves at nan mm/s, wanted at rest"] * 2,
        ),
        (
            {"rail": rail(powered=True)},
            "",
            *["the drive has power to move, wanted held by the brake"] * 2,
        ),
        ({"rail": rail(strip_mm=1100.05)}, "", NOT_HELD, NOT_HELD),
        ({"rail": rail(strip_mm=1100.05), "station": None}, "", "", ""),
        ({"rail": rail(taken_s=math.nan)}, "", *["the rail was last read nan s ago"] * 2),
        ({"rail": rail(taken_s=4.1)}, "", *[OLD.format("rail")] * 2),
        ({"rail": None}, "", *["the rail was not read yet"] * 2),
    ],
)
def test_the_overview_says_what_blocks(
    changes: dict[str, object], by_rail: str, by_robot: str, measure: str
) -> None:
    assert blocked(**changes) == {
        "rail move": by_rail,
        "robot move": by_robot,
        "measurement": measure,
    }
