"""An unattended run whose readings fail waits for the cause to go, and not for ever."""

from __future__ import annotations

from pathlib import Path

import msgspec

from hilcell.cell.file import Cell
from hilcell.invariants import check_invariants
from hilcell.journal.journal import read_journal
from hilcell.run.meter import Meter
from hilcell.run.worker import UnattendedPolling
from tests.clocks import DrivenClock
from tests.hilcell.run.bed import CELL, Bed, Live, broken_beam
from tests.hilcell.run.rig import Points, procedure


def looks(wait: UnattendedPolling, clock: DrivenClock) -> list[float]:
    """Return when looks are due until the time is over."""
    found = []
    while not wait.over:
        if wait.poll_due():
            found.append(clock.at_s)
    return found


def test_looks_come_less_and_less_often_and_once_more_at_the_end() -> None:
    clock = DrivenClock()
    assert looks(UnattendedPolling(clock, 900.0), clock) == [10, 30, 70, 150, 310, 610, 900]


def test_all_waits_of_a_session_share_the_time() -> None:
    clock = DrivenClock()
    wait = UnattendedPolling(clock, 100.0)
    while not wait.poll_due():
        pass
    clock.at_s = 50.0  # measuring
    wait.begin()
    assert looks(wait, clock) == [60, 80, 120, 140]
    assert wait.over


def test_a_cause_that_is_back_at_once_is_looked_at_less_and_less_often() -> None:
    clock = DrivenClock()
    wait, found = UnattendedPolling(clock, 900.0), []
    while not wait.over:
        wait.begin()
        while not wait.poll_due():
            pass
        found.append(clock.at_s)
        clock.at_s += 6.0  # another try
    assert found == [10, 36, 82, 168, 334, 640, 936]


def test_without_time_there_is_no_wait() -> None:
    assert UnattendedPolling(DrivenClock(), 0.0).over


FOR_EVER_S = 1e12


def waiting(limit_s: float) -> Cell:
    plan = msgspec.structs.replace(CELL.plan, unattended_wait_s=limit_s)
    return msgspec.structs.replace(CELL, plan=plan)


def test_it_suspends_and_goes_on_when_the_reading_is_good_again(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(60.0))
    bed.tracker.answer = broken_beam(Meter.TRIES + 2)
    assert bed.run(procedure(Points(2))) == 0
    assert bed.states() == ["checking", "running", "suspended", "running", "finished"]
    went_on = [r.body for r in bed.records("state") if r.body.get("by")]
    assert [body["by"] for body in went_on] == ["look"]
    assert check_invariants(read_journal(bed.path))["I13"].holds


def test_a_cause_that_stays_is_a_fault_with_its_own_code(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(100.0))
    bed.tracker.answer = broken_beam(1000)
    assert bed.run(procedure(Points(1))) == 3
    assert bed.states() == ["checking", "running", "suspended", "faulted"]
    assert bed.log().life[-1].change.error["code"] == "HC-T10"
    assert bed.rail.closed == 1


def test_somebody_who_attends_after_all_may_answer(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(FOR_EVER_S))
    bed.tracker.answer = broken_beam(10**9)
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        assert live.runner.answer()
        bed.tracker.answer = lambda: None
    assert live.code == 0


def test_a_stop_ends_the_wait(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=waiting(FOR_EVER_S))
    bed.tracker.answer = broken_beam(10**9)
    with Live(bed, procedure(Points(1))) as live:
        live.until("state", "suspended")
        live.runner.stop()
    assert live.code == 4
