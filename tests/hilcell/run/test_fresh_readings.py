from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.journal.journal import Record
from hilcell.ports import Clock, RailReading
from hilcell.run.cell_session import CellSession
from hilcell.run.interlocks import fresh_reading
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure

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
