"""A nest that is not where the cell file says: its place is taken, and the distances are judged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.cell.tables import Pose
from hilcell.geometry.frames import apply, inverse, unit
from hilcell.ports import Array, NoReading, TrackerReading
from hilcell.run.cell_session import CellSession
from procedures.world_frame import WorldFrame
from tests.hilcell.run.bed import CELL, PLAN, Bed, Live
from tests.hilcell.run.rig import DeskTracker, Points, procedure
from tests.procedures.results import result_of

RADIUS_MM = CELL.tracker.find_radius_mm
NOMINAL_MM = np.array([nest.xyz_mm for nest in CELL.layout.fixed_nests])  # floor, then bar
NAMES = [nest.name for nest in CELL.layout.floor]


class HallTracker(DeskTracker):
    """Sees reflectors where they really are, (N, 3) in its frame; a person aims it at ``beam_on``.

    Satisfies `hilcell.ports.Aims`.
    """

    def __init__(self, desk: DeskTracker, nests_mm: Array) -> None:
        super().__init__(desk.clock)
        self.nests_mm = nests_mm
        self.beam_on: int | None = None
        self.asked: list[str] = []

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        return self._caught(near_mm, samples, RADIUS_MM)

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        self.asked.append(f"search {radius_mm:g}")
        return self._caught(near_mm, samples, radius_mm)

    def release_beam(self) -> None:
        self.asked.append("release")

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        self.asked.append("aimed")
        if self.beam_on is None:
            raise NoReading("HC-T11", "Tracker", "measure", "no reflector is locked")
        return self._reading(self.nests_mm[self.beam_on], samples)

    def _caught(self, near_mm: Array, samples: int, radius_mm: float) -> TrackerReading:
        off_mm = np.linalg.norm(self.nests_mm - near_mm, axis=1)
        if not off_mm.min() <= radius_mm:
            beam = (near_mm / np.linalg.norm(near_mm)).tolist()
            fields = {"searched_mm": radius_mm, "beam": beam}
            raise NoReading("HC-T11", "Tracker", "find", "nothing there", fields=fields)
        return self._reading(self.nests_mm[off_mm.argmin()], samples)

    def _reading(self, at_mm: Array, samples: int) -> TrackerReading:
        found = super().measure(at_mm, CELL.tracker.reflector, samples)
        return replace(found, xyz_mm=at_mm.copy())


@pytest.fixture(autouse=True)
def _frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the journal have the cell, of which the result is computed."""
    monkeypatch.setitem(PLAN, "cell", msgspec.to_builtins(CELL))


def frame(session: CellSession, number: int) -> None:
    session.reach("reference")
    WorldFrame().perform(session)


FRAME = procedure(Points(1, frame))


def hall(folder: Path, world_mm: Array, pose: Pose = CELL.tracker.pose) -> tuple[Bed, HallTracker]:
    """Return a bed of a hall with nests (N, 3) in {W} and a tracker at a pose."""
    bed = Bed(folder, unattended=False)
    tracker = HallTracker(bed.tracker, apply(inverse(pose.matrix()), world_mm))
    bed.devices = replace(bed.devices, tracker=tracker)
    return bed, tracker


def turned(a_deg: float, x_mm: float) -> Pose:
    """Return the tracker's pose of the cell file, turned and shifted."""
    pose = CELL.tracker.pose
    return Pose(x_mm=pose.x_mm + x_mm, y_mm=pose.y_mm, z_mm=pose.z_mm, a_deg=pose.a_deg + a_deg)


def test_a_turned_tracker_is_measured_by_the_places_that_a_person_shows_it(tmp_path: Path) -> None:
    pose = turned(40.0, 800.0)
    bed, tracker = hall(tmp_path, NOMINAL_MM, pose)
    with Live(bed, FRAME) as live:
        for number, name in enumerate(NAMES):
            live.until("state", "suspended")
            prompt = live.status("prompt")
            assert prompt["place"] == name
            assert [each["name"] for each in prompt["choices"]] == ["release", "here", "wider"]
            assert f"searched {RADIUS_MM:.0f} mm around" in prompt["text"]
            tracker.beam_on = None
            assert live.runner.answer("release") == ""
            assert live.status("state") == "suspended"  # it waits for the beam
            assert "no reflector is locked" in live.runner.answer("here")
            tracker.beam_on = number
            assert live.runner.answer("here") == ""
    assert live.code == 0, bed.log().fault
    log = bed.log()
    assert [*log.taken] == NAMES
    np.testing.assert_allclose(log.matrix("world"), pose.matrix(), atol=1e-3)
    found = result_of(WorldFrame(), log)["tracker"]
    assert found["pose"]["x_mm"] == pytest.approx(pose.x_mm, abs=0.01)
    assert found["pose"]["a_deg"] == pytest.approx(pose.a_deg - 360.0, abs=0.01)
    assert (found["off_mm"], found["off_deg"]) == pytest.approx((800.0, 40.0), abs=0.01)


def test_a_nest_that_was_moved_is_found_by_a_wider_search_and_named(tmp_path: Path) -> None:
    world_mm = NOMINAL_MM.copy()
    world_mm[1] += [120.0, 160.0, 0.0]
    bed, tracker = hall(tmp_path, world_mm)
    with Live(bed, FRAME) as live:
        live.until("state", "suspended")
        assert live.status("prompt")["place"] == NAMES[1]
        assert live.runner.answer("wider") == ""
    assert live.code == 3  # its distances are judged all the same
    assert tracker.asked == ["search 300"]
    (taken,) = bed.events("place taken")
    assert (taken["place"], taken["how"]) == (NAMES[1], "wider")
    assert taken["off_mm"] == pytest.approx(200.0)
    end = bed.log().end
    assert end is not None
    assert (end.error["code"], end.error["fields"]["nest"]) == ("HC-T32", NAMES[1])
    np.testing.assert_allclose(end.error["fields"]["world_mm"], world_mm[1], atol=0.1)


def test_a_place_that_was_taken_is_the_expected_one_from_then_on(tmp_path: Path) -> None:
    bed, tracker = hall(tmp_path, NOMINAL_MM + [150.0, 0.0, 0.0])
    with Live(bed, FRAME) as live:
        for taken in range(len(NAMES)):
            live.until("state", "suspended")
            live.until("points", taken)
            assert live.runner.answer("wider") == ""
    assert live.code == 0, bed.log().fault
    assert tracker.asked == ["search 300"] * len(NAMES)  # each once, though F1 is measured again


def test_an_answer_that_is_no_choice_of_the_prompt_is_refused(tmp_path: Path) -> None:
    bed, _ = hall(tmp_path, NOMINAL_MM + [150.0, 0.0, 0.0])
    with Live(bed, FRAME) as live:
        live.until("state", "suspended")
        assert "expected one of release, here, wider" in live.runner.answer("anywhere")
        live.runner.stop()


def test_an_unattended_run_says_at_once_where_it_has_looked(tmp_path: Path) -> None:
    bed, _ = hall(tmp_path, NOMINAL_MM + [150.0, 0.0, 0.0])
    bed.unattended = True
    assert bed.run(FRAME) == 3
    assert bed.states() == ["checking", "running", "faulted"]
    end = bed.log().end
    assert end is not None
    assert end.error["code"] == "HC-T11"
    assert f"searched {RADIUS_MM:.0f} mm around" in end.error["found"]
    assert end.error["fields"]["searched_mm"] == RADIUS_MM


@pytest.mark.parametrize(("mounted_mm", "shift_mm"), [(6.35, 12.7), (11.1125, 7.94)])
def test_reflectors_of_another_radius_are_named(
    mounted_mm: float, shift_mm: float, tmp_path: Path
) -> None:
    """The tracker is set to 1.5 in; with three nests on the floor those of the bar prove it."""
    bed, tracker = hall(tmp_path, NOMINAL_MM)
    tracker.nests_mm += (mounted_mm - 19.05) * unit(tracker.nests_mm)
    bed.unattended = True
    assert bed.run(FRAME) == 3
    end = bed.log().end
    assert end is not None
    assert end.error["code"] == "HC-T32"
    assert end.error["fields"]["shift_mm"] == pytest.approx(shift_mm, abs=0.2)
    assert "where the tracker is set to 1.5 in" in end.error["found"]
