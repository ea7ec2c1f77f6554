from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from hilcell.ports import RailReading
from hilcell.run.cell_session import CellSession
from hilcell.run.fresh_readings import TRIES, fresh
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure

LIMIT_S = 0.5


def aged(ages_s: Iterator[float]) -> Callable[[], RailReading]:
    def read() -> RailReading:
        taken_s = time.monotonic() - next(ages_s)
        return RailReading(1100.0, 1100.0, 0.0, True, False, taken_s)

    return read


def age_s(reading: RailReading) -> float:
    return time.monotonic() - reading.taken_s


def test_a_young_reading_is_taken_at_once() -> None:
    assert age_s(fresh(aged(iter([0.0])), LIMIT_S)) < LIMIT_S


def test_an_old_one_is_read_again() -> None:
    assert age_s(fresh(aged(iter([9.0, 9.0, 0.0])), LIMIT_S)) < LIMIT_S


def test_a_young_one_that_is_at_hand_is_not_read_again() -> None:
    at_hand = aged(iter([0.0]))()
    assert fresh(aged(iter([])), LIMIT_S, at_hand) is at_hand


@pytest.mark.parametrize("age", [9.0, float("nan")])
def test_what_stays_old_is_left_to_the_interlocks(age: float) -> None:
    reads = iter([age] * TRIES + [0.0])
    reading = fresh(aged(reads), LIMIT_S)
    assert not age_s(reading) <= LIMIT_S
    assert next(reads) == 0.0


@pytest.mark.parametrize(("late", "code"), [(2, 0), (TRIES, 3)])
def test_a_pc_that_is_late_now_and_then_moves_on(tmp_path: Path, late: int, code: int) -> None:
    bed = Bed(tmp_path)
    ages_s = iter([9.0] * late + [0.0] * 100)

    def act(session: CellSession, number: int) -> None:
        bed.rail.read = aged(ages_s)  # type: ignore[method-assign]  # a PC that is late
        session.robot_to(np.radians(bed.cell.robot.home_deg), "p")

    assert bed.run(procedure(Points(1, act))) == code
