"""A held slide is proven by one of its nests: a strip that has jumped moves nothing unnoticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import apply, inverse
from hilcell.model.frame import Frame
from hilcell.ports import Array, Stopped, TrackerReading
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import CELL, Bed, Live
from tests.hilcell.run.rig import Points, procedure

S300, S1100 = CELL.station_named("S300"), CELL.station_named("S1100")
T_L_W = inverse(CELL.tracker.pose.matrix())
ALONG = T_L_W[:3, :3] @ np.array(CELL.layout.rail_direction)
FLOOR_MM = apply(T_L_W, np.array([nest.xyz_mm for nest in CELL.layout.floor]))
BY_HAND = load_cell("paper", {"layout.reflectors": "by_hand"})
Act = Callable[[CellSession], None]


class Slide:
    """A tracker that sees the slide's nests ``off_mm`` beside where the strip says, along the rail;
    a tracker that was ``bumped_mm`` sees everything there.
    """

    def __init__(self, bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
        self.off_mm = self.bumped_mm = 0.0
        self._measure = bed.tracker.measure
        bed.tracker.off_mm = np.zeros(3)
        monkeypatch.setattr(bed.tracker, "measure", self.measure)
        self._tracker = bed.tracker

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        on_floor = np.linalg.norm(FLOOR_MM - near_mm, axis=1).min() < 50.0
        along_mm = self.bumped_mm + (0.0 if on_floor else self.off_mm)
        seen_mm = FLOOR_MM[np.argmin(np.linalg.norm(FLOOR_MM - near_mm, axis=1))]
        self._tracker.off_mm = along_mm * ALONG + (seen_mm - near_mm if on_floor else 0.0)
        return self._measure(near_mm, reflector, samples)


def whole(act: Act) -> Points:
    def perform(session: CellSession, number: int) -> None:
        session.reach("reference")
        session.frame_world()
        act(session)

    return Points(1, perform)


def off_mm(bed: Bed) -> list[float]:
    return [event["off_mm"] for event in bed.events("slide proven")]


@pytest.mark.parametrize("within_mm", [0.0, -0.1])
def test_a_slide_that_comes_back_is_proven_by_one_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, within_mm: float
) -> None:
    bed = Bed(tmp_path)
    slide = Slide(bed, monkeypatch)

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S1100)  # it has not moved since
        session.hold_station(S300)
        slide.off_mm = within_mm
        session.hold_station(S1100)

    assert bed.run(procedure(whole(act))) == 0, bed.log().fault
    assert off_mm(bed) == pytest.approx([0.0, 0.0, within_mm], abs=1e-6)
    keys = [point.key for point in bed.log().select("held")]
    assert keys == ["held/S1100/1-0/P1", "held/S1100/1-1/P1", "held/S300/1-0/P1"]
    assert {point.group for point in bed.log().select("held")} == {"control"}


@pytest.mark.parametrize(("between", "jump_mm"), [(S1100, 1.0), (S1100, -0.3), (S300, 1.0)])
def test_a_strip_that_has_jumped_ends_a_run_that_nobody_attends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, between: object, jump_mm: float
) -> None:
    """At the station itself, or on the first way to another."""
    bed = Bed(tmp_path)
    slide = Slide(bed, monkeypatch)

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S300) if between == S1100 else None
        slide.off_mm = jump_mm
        session.hold_station(S1100 if between == S1100 else S300)
        raise AssertionError("the robot would work there")

    assert bed.run(procedure(whole(act))) == 3
    end = bed.log().end
    assert end is not None
    assert end.error["code"] == "HC-S10"
    fields = end.error["fields"]
    assert fields["cause"] == "strip"
    assert fields["off_mm"] == pytest.approx(jump_mm, abs=1e-6)
    (suspicion,) = end.result["suspicions"]
    assert suspicion.pop("size") == pytest.approx(jump_mm, abs=1e-6)
    place = fields["station"]
    assert suspicion == {"cause": "strip", "unit": "mm", "noticed_by": f"slide nest at {place}"}
    assert max(map(abs, off_mm(bed))) < 1e-6  # what was refused is not proven


def test_a_jump_while_everything_was_dead_is_found_on_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    slide = Slide(bed, monkeypatch)
    for jump_mm, code in ((0.0, 0), (1.0, 3), (0.0, 0)):
        slide.off_mm = jump_mm
        assert bed.run(procedure(whole(lambda session: session.hold_station(S1100)))) == code
    assert len(off_mm(bed)) == 2  # what was refused is nobody's reference


def test_an_attended_run_pauses_and_goes_on_once_the_strip_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path, unattended=False)
    slide = Slide(bed, monkeypatch)

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S300)
        slide.off_mm = 1.0
        session.hold_station(S1100)

    with Live(bed, procedure(whole(act))) as live:
        live.until("state", "paused")
        slide.off_mm = 0.0
        live.runner.post("proceed")
    assert live.code == 0, bed.log().fault
    (paused,) = (r.body for r in bed.records("state") if r.body["to"] == "paused")
    assert "+1.000 mm" in paused["reason"]


def test_a_tracker_that_was_bumped_is_not_taken_for_a_strip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    slide = Slide(bed, monkeypatch)

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        if not bed.events("tracker moved"):
            session.hold_station(S300)
            slide.bumped_mm = 1.0
            session.hold_station(S1100)

    assert bed.run(procedure(whole(act))) == 0, bed.log().fault
    (moved,) = bed.events("tracker moved")
    assert moved["invalid"] == [
        "held/S1100/1-0/P1", "held/S300/1-0/P1", "held/S1100/1-1/P1",
    ]  # fmt: skip


@pytest.mark.parametrize(("cell", "framed"), [(CELL, False), (BY_HAND, True)])
def test_nothing_is_measured_where_nothing_can_be_proven(
    tmp_path: Path, cell: Cell, framed: bool
) -> None:
    bed = Bed(tmp_path, cell=cell)

    def act(session: CellSession, number: int) -> None:
        if framed:
            session.frame("world", Frame(matrix=cell.tracker.pose.matrix().tolist()))
        session.hold_station(S1100)
        assert not session.log.points
        raise Stopped("that was all")

    bed.run(procedure(Points(1, act)))
    assert bed.log().state == "aborted", bed.log().fault
