"""The strip: a station is approached by it, and a run waits while it does not read."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.invariants import check_invariants
from hilcell.journal.journal import read_journal
from hilcell.ports import DeviceError, Identity, LinkStatistics, RailReading, StripLost
from hilcell.run.cell_session import CellSession
from hilcell.run.device_status import CellMonitor
from hilcell.run.mover import approach_station
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


# -- the closed loop, against a slide with backlash, friction and a strip -----------


class Slide:
    """A rail in memory: the strip sees ``gain`` times the command, plus offset and backlash."""

    def __init__(self, offset_mm: float = 0.3, backlash_mm: float = 0.2, gain: float = 1.0) -> None:
        self.offset_mm, self.backlash_mm, self.gain = offset_mm, backlash_mm, gain
        self.command_mm, self.true_mm = 0.0, 0.0
        self.moves: list[float] = []
        self.frozen = False

    def connect(self) -> list[Identity]:
        return []

    def home(self) -> None: ...

    def move_to(self, position_mm: float) -> None:
        upwards = position_mm > self.command_mm
        self.command_mm = position_mm
        self.moves.append(position_mm)
        ideal = S1100.strip_mm + self.gain * (position_mm - S1100.rail_mm) + self.offset_mm
        self.true_mm = ideal + (0.0 if upwards else self.backlash_mm)

    def settle(self) -> RailReading:
        strip_mm = 1098.0 if self.frozen else round(self.true_mm, 2)
        return RailReading(self.command_mm, strip_mm, 0.0, True, True, 0.0)

    def read(self) -> RailReading:
        return self.settle()

    def hold(self) -> None: ...

    def statistics(self) -> LinkStatistics:
        return LinkStatistics()

    def stop(self) -> None: ...

    def close(self) -> None: ...


@given(offset_mm=st.floats(-0.8, 0.8), backlash_mm=st.floats(0.0, 0.5), gain=st.floats(0.8, 1.2))
def test_it_converges_and_always_comes_from_below(
    offset_mm: float, backlash_mm: float, gain: float
) -> None:
    slide = Slide(offset_mm, backlash_mm, gain)
    approach_station(slide, CELL.rail, S1100)
    assert abs(slide.settle().strip_mm - S1100.strip_mm) <= 0.01 + 1e-9
    for low, high in zip(slide.moves[0::2], slide.moves[1::2], strict=True):
        assert math.isclose(high - low, CELL.rail.back_off_mm)


@pytest.mark.parametrize("offset_mm", [0.3, -0.3])
def test_a_slide_that_does_not_follow_is_refused(offset_mm: float) -> None:
    slide = Slide(offset_mm, gain=-1.0)
    with pytest.raises(DeviceError, match="S1100"):
        approach_station(slide, CELL.rail, S1100)


@pytest.mark.parametrize("slip_mm", [2.5, -2.5])
def test_a_slip_to_either_side_is_refused(slip_mm: float) -> None:
    with pytest.raises(DeviceError, match=f"{1100 + slip_mm:.2f} mm"):
        approach_station(Slide(offset_mm=slip_mm), CELL.rail, S1100)


def test_a_frozen_strip_is_refused() -> None:
    slide = Slide()
    slide.frozen = True
    with pytest.raises(DeviceError, match=r"frozen .*1098\.00 mm"):
        approach_station(slide, CELL.rail, S1100)


def test_a_strip_that_says_nothing_is_refused() -> None:
    with pytest.raises(DeviceError):
        approach_station(Slide(offset_mm=float("nan")), CELL.rail, S1100)
