"""A strip that does not read suspends a run; it goes on when the strip reads well again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from hilcell.invariants import check_invariants
from hilcell.journal.journal import read_journal
from hilcell.ports import RailReading, StripLost
from hilcell.run.cell_session import CellSession
from hilcell.run.device_status import CellMonitor
from tests.hilcell.run.bed import CELL, Bed, Live, waiting
from tests.hilcell.run.rig import DeskRail, Points, procedure

S1100 = CELL.station_named("S1100")


class DirtyRail(DeskRail):
    """A rail whose strip is in alarm, or frozen, for so many readings."""

    dirty = 0
    frozen_mm: float | None = None

    def read(self) -> RailReading:
        reading = super().read()
        if self.dirty:
            self.dirty -= 1
            raise StripLost("HC-S01", "Rail", "read", "strip sensor: missing magnet")
        if self.frozen_mm is not None:
            return replace(reading, strip_mm=self.frozen_mm)
        return reading


@pytest.fixture
def bed(tmp_path: Path) -> Bed:
    return dirty_bed(tmp_path, 600.0)


def dirty_bed(folder: Path, limit_s: float) -> Bed:
    made = Bed(folder, cell=waiting(limit_s))
    made.devices = replace(made.devices, rail=DirtyRail(made.cell, made.clock))
    return made


def rail_of(bed: Bed) -> DirtyRail:
    assert isinstance(bed.rail, DirtyRail)
    return bed.rail


def striking(bed: Bed, strike: Callable[[DirtyRail], None]) -> Points:
    """Hold a station before each of three points; once before the second the strip fails."""
    struck: list[int] = []

    def act(session: CellSession, number: int) -> None:
        if number == 1 and not struck:
            struck.append(number)
            strike(rail_of(bed))
        session.hold_station(S1100, again=rail_of(bed).frozen_mm is not None)
        with session.admitted():
            pass

    return Points(3, act)


def went_on(bed: Bed) -> list[str]:
    return [r.body["by"] for r in bed.records("state") if r.body.get("by")]


@pytest.mark.parametrize("readings", [1, 4])
def test_an_unattended_run_goes_on_when_the_strip_reads_again(bed: Bed, readings: int) -> None:
    rail = rail_of(bed)
    assert bed.run(procedure(striking(bed, lambda rail: setattr(rail, "dirty", readings)))) == 0
    assert bed.states() == ["checking", "running", "suspended", "running", "finished"]
    assert went_on(bed) == ["look"]
    (asked,) = bed.asked()
    assert asked["error"]["code"] == "HC-S01"
    assert len(bed.events("strip back")) == 1
    assert len(bed.events("station held")) == 2, "hands were at the head: it is held again"
    assert [record.key for record in bed.records("point")] == ["p/0", "p/1", "p/2"]
    assert not rail.powered
    assert check_invariants(read_journal(bed.path))["I13"].holds


def test_while_it_waits_the_slide_is_held_and_an_answer_is_proven(bed: Bed) -> None:
    bed.unattended = False
    with Live(bed, procedure(striking(bed, lambda rail: setattr(rail, "dirty", 10**6)))) as live:
        live.until("state", "suspended")
        assert not rail_of(bed).powered
        assert live.runner.answer()
        assert live.status("devices")["strip"]["state"] == "lost"
        rail_of(bed).dirty = 0
        assert live.runner.answer() == ""
    assert live.code == 0, bed.log().fault
    assert went_on(bed) == ["answer"]


def test_a_strip_that_stays_dirty_is_a_fault_with_its_own_code(bed: Bed) -> None:
    assert bed.run(procedure(striking(bed, lambda rail: setattr(rail, "dirty", 10**6)))) == 3
    assert bed.states() == ["checking", "running", "suspended", "faulted"]
    assert bed.log().life[-1].change.error["code"] == "HC-S01"
    assert bed.rail.closed == 1


@pytest.mark.parametrize("beside_mm", [30.0, -2.1])
def test_a_frozen_strip_is_not_believed_before_it_is_where_the_drive_is(
    bed: Bed, beside_mm: float
) -> None:
    bed.unattended = False
    frozen_mm = S1100.rail_mm + beside_mm
    with Live(
        bed, procedure(striking(bed, lambda rail: setattr(rail, "frozen_mm", frozen_mm)))
    ) as live:
        live.until("state", "suspended")
        assert live.runner.answer()
        rail_of(bed).frozen_mm = None
        assert live.runner.answer() == ""
    assert live.code == 0, bed.log().fault
    (asked,) = bed.asked()
    assert asked["error"]["code"] == "HC-S02"


def test_a_strip_that_is_lost_in_a_pause_is_shown_as_lost(bed: Bed) -> None:
    rail = rail_of(bed)
    monitor = CellMonitor(bed.devices, bed.clock, CELL)
    rail.dirty = 1
    with pytest.raises(StripLost):
        monitor.devices.rail.read()
    assert monitor.status()["strip"].state == "lost"
    assert monitor.status()["rail"].state == "unknown"
    monitor.devices.rail.read()
    assert monitor.status()["strip"].state == "fresh"
