"""Interlocks open only on fresh, finite readings of the right kind."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.journal.journal import Record
from hilcell.ports import Clock, RailReading, RobotReading
from hilcell.run.cell_session import CellSession
from hilcell.run.control import Interlock
from hilcell.run.device_status import CellMonitor
from hilcell.run.interlocks import (
    Blocked,
    check_joint_limits,
    check_rail_may_move,
    check_robot_may_move,
    check_strip,
    fresh_reading,
)
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, desk, procedure

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


# -- readings that admit a motion: an old one is read again ----------------------------------------


LIMIT_S = 0.5
TRIES = 5
CLOCK = DrivenClock()
NO_WAITS = {"settle.robot_s": "0.0", "settle.rail_s": "0.0"}


def aged(ages_s: Iterator[float], clock: Clock = CLOCK) -> Callable[[], RailReading]:
    def read() -> RailReading:
        taken_s = clock.pc_s() - next(ages_s)
        return RailReading(1100.0, 1100.0, 0.0, True, False, taken_s)

    return read


def age_s(reading: RailReading) -> float:
    return -reading.taken_s


def test_a_young_reading_is_taken_at_once() -> None:
    assert age_s(fresh_reading(aged(iter([0.0])), CLOCK, LIMIT_S)) < LIMIT_S


def test_an_old_one_is_read_again() -> None:
    assert age_s(fresh_reading(aged(iter([9.0, 9.0, 0.0])), CLOCK, LIMIT_S)) < LIMIT_S


def test_a_young_one_that_is_at_hand_is_not_read_again() -> None:
    at_hand = aged(iter([0.0]))()
    assert fresh_reading(aged(iter([])), CLOCK, LIMIT_S, at_hand) is at_hand


@pytest.mark.parametrize("age", [9.0, float("nan")])
def test_what_stays_old_is_left_to_the_interlocks(age: float) -> None:
    reads = iter([age] * TRIES + [0.0])
    reading = fresh_reading(aged(reads), CLOCK, LIMIT_S)
    assert not age_s(reading) <= LIMIT_S
    assert next(reads) == 0.0


@pytest.mark.parametrize(("late", "code"), [(2, 0), (TRIES, 3)])
def test_a_pc_that_is_late_now_and_then_moves_on(bed: Bed, late: int, code: int) -> None:
    ages_s = iter([9.0] * late + [0.0] * 100)

    def act(session: CellSession, number: int) -> None:
        bed.rail.read = aged(ages_s, bed.clock)  # type: ignore[method-assign]  # a PC that is late
        session.robot_to(np.radians(bed.cell.robot.home_deg), "p")

    assert bed.run(procedure(Points(1, act))) == code


STALL_S, AGE_S = 0.6, 0.5


def stalled(tmp_path: Path, act: Callable[[CellSession], None], **later: float) -> list[str]:
    """Return what was done in a run whose disk stalls at every intent, and how it ended.

    ``later``: how old the readings of a device are once the disk has stalled.
    """
    bed = Bed(tmp_path, cell=load_cell("paper", {**NO_WAITS, "settle.reading_age_s": str(AGE_S)}))
    done: list[str] = []

    def noting(device: Any, name: str, kind: str) -> None:
        real = getattr(device, name)

        def call(*words: Any) -> Any:
            done.append(f"{kind} {name}")
            found = real(*words)
            if name == "read" and "commit" in done:
                found = replace(found, taken_s=found.taken_s - later.get(kind, 0.0))
            return found

        setattr(device, name, call)

    def stall(record: Record) -> None:
        if record.kind == "intent":
            done.append("commit")
            bed.clock.pc_at_s += STALL_S

    for name in ("read", "home", "move_to"):
        noting(bed.rail, name, "rail")
    for name in ("read", "move_to"):
        noting(bed.robot, name, "robot")
    runner = bed.runner(procedure(Points(1, lambda session, _: act(session))))
    bed.journal.listen(stall)
    done.append(str(runner.run()))
    bed.journal.close()
    return done[done.index("commit") :]


def to_home(session: CellSession) -> None:
    session.robot_to(np.radians(session.cell.robot.home_deg), "p")


def park(session: CellSession) -> None:
    session.devices.robot.move_to(np.radians(session.cell.robot.home_deg), 10.0)
    session.park_robot()


def home(session: CellSession) -> None:
    session.home_rail()


@pytest.mark.parametrize("act", [to_home, park])
def test_after_a_commit_that_took_long_the_robot_moves_by_new_readings(
    tmp_path: Path, act: Callable[[CellSession], None]
) -> None:
    did = stalled(tmp_path, act)
    before = did[: did.index("robot move_to")]
    assert {*before} == {"commit", "rail read", "robot read"}
    assert did[-1] == "0"


@pytest.mark.parametrize("act", [to_home, park])
def test_after_a_commit_that_took_long_no_robot_moves_by_old_ones(
    tmp_path: Path, act: Callable[[CellSession], None]
) -> None:
    did = stalled(tmp_path, act, rail=9.0)
    assert "robot move_to" not in did
    assert did[-1] == "3"


def test_after_a_commit_that_took_long_the_slide_moves_by_new_readings(tmp_path: Path) -> None:
    did = stalled(tmp_path, home)
    assert {*did[: did.index("rail home")]} == {"commit", "robot read"}


def test_after_a_commit_that_took_long_no_slide_moves_by_old_ones(tmp_path: Path) -> None:
    did = stalled(tmp_path, home, robot=9.0)
    assert "rail home" not in did
    assert did[-1] == "3"


def test_the_slide_rests_after_homing_before_anything_is_measured(bed: Bed) -> None:
    rested_s: list[float] = []

    def wait(duration_s: float) -> None:
        rested_s.append(duration_s)

    def act(session: CellSession, number: int) -> None:
        session.clock.wait = wait  # type: ignore[method-assign]  # no time passes
        session.home_rail()

    assert bed.run(procedure(Points(1, act))) == 0
    assert bed.cell.settle.rail_s in rested_s
