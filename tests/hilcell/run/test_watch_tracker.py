"""Nests that are swapped or wrong are refused; a tracker that was bumped is noticed and mended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.geometry.frames import apply, from_rotvec, inverse, matrix
from hilcell.model.point import PointId
from hilcell.ports import Array, DeviceError, NoReading, TrackerReading
from hilcell.run.cell_session import CellSession
from hilcell.run.meter import Meter
from hilcell.run.watch import Watch, check_distances, check_places
from tests.hilcell.run.bed import CELL, PLAN, Bed, Live, until
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import BASE, base_at

NESTS_MM = np.array([nest.xyz_mm for nest in CELL.layout.floor])
SEEN_MM = apply(inverse(CELL.tracker.pose.matrix()), NESTS_MM)
STEP = [PointId("six", nest=nest.name) for nest in CELL.layout.floor]
S1100, HOME_RAD = CELL.station_named("S1100"), np.radians(CELL.robot.home_deg)
FLANGE_MM = 500.0  # from all nests: where the flange is
Act = Callable[[CellSession, int], None]


def test_the_nests_of_the_cell_file_are_accepted() -> None:
    check_distances(CELL, NESTS_MM + 0.3)


@pytest.mark.parametrize(
    "measured_mm",
    [NESTS_MM[[1, 0, 2]], NESTS_MM / 1000.0, NESTS_MM * 1000.0, NESTS_MM + np.diag([0, np.nan, 0])],
    ids=["swapped", "in metres", "in micrometres", "not a number"],
)
def test_other_distances_are_refused(measured_mm: Array) -> None:
    with pytest.raises(DeviceError) as raised:
        check_distances(CELL, measured_mm)
    assert raised.value.code == "HC-T32"


def test_nests_that_changed_places_are_seen_by_their_places() -> None:
    """F2 and F3 lie equally far from F1: no distance changes, but {W} would be mirrored."""
    seen_mm = SEEN_MM + 3.0
    check_places(CELL, seen_mm)
    check_distances(CELL, seen_mm[[0, 2, 1]])
    with pytest.raises(DeviceError, match=r"F2 .*F3") as raised:
        check_places(CELL, seen_mm[[0, 2, 1]])
    assert raised.value.code == "HC-T32"
    with pytest.raises(DeviceError):
        check_places(CELL, seen_mm + np.diag([0.0, np.nan, 0.0]))


class Floor:
    """A tracker that sees the floor nests from where it stands now, ``T`` (4, 4) in its first
    frame; a nest may be lifted by ``lifted_mm`` (3, 3). ``bumps`` move the tracker after so many
    readings more.
    """

    def __init__(self, bed: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock, self.T, self.lifted_mm = bed.clock, np.eye(4), np.zeros((3, 3))
        self.bumps: list[tuple[int, Array]] = []
        self.missed = 0  # readings of which the next ones fail
        self.std_mm = [0.005] * 3  # of single readings, by nest
        monkeypatch.setattr(bed.tracker, "measure", self.measure)

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        if self.missed:
            self.missed -= 1
            raise NoReading("HC-T10", "Tracker", "measure", "beam broken")
        seen_mm = apply(inverse(self.T), SEEN_MM + self.lifted_mm)
        away_mm = np.linalg.norm(seen_mm - near_mm, axis=1)
        nearest = near_mm if away_mm.min() > FLANGE_MM else seen_mm[np.argmin(away_mm)]
        std_mm = np.full(3, self.std_mm[int(np.argmin(away_mm))])
        self.bumps = [(left - 1, T) for left, T in self.bumps]
        self.T = next((T for left, T in self.bumps if left == 0), self.T)
        return TrackerReading(nearest, std_mm, samples, reflector, None, self.clock.pc_s())


def moved(x_mm: float, turn_rad: float = 0.0) -> Array:
    return matrix(from_rotvec(np.array([0.0, 0.0, turn_rad])), np.array([x_mm, 0.0, 0.0]))


def measured_step(session: CellSession) -> None:
    for id, nest in zip(STEP, CELL.layout.floor, strict=True):
        session.floor_nest_point(id, nest)


def struck(strike: Callable[[], None]) -> Act:
    """Return a step of which something happens between its last point and its end."""

    def act(session: CellSession, number: int) -> None:
        measured_step(session)
        strike()
        session.close_step()

    return act


def performed(bed: Bed, act: Act) -> dict[str, Any]:
    def whole(session: CellSession, number: int) -> None:
        session.reach("reference")
        session.frame_world()
        act(session, number)

    bed.run(procedure(Points(1, whole)))
    end = bed.log().end
    return {} if end is None else msgspec.to_builtins(end)


@pytest.mark.parametrize("lifted_mm", [0.12, 5.0])
def test_a_nest_that_is_lifted_is_not_taken_for_a_tracker_that_was_bumped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lifted_mm: float
) -> None:
    """The distances of three nests do not change where one rises out of their plane."""
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        floor.lifted_mm[0, 2] = lifted_mm

    assert performed(bed, struck(strike))["exit"] == 3
    assert f"F1 moved by {lifted_mm:.3f} mm" in bed.log().fault
    assert not bed.events("tracker moved")


def test_readings_that_agree_by_chance_are_as_uncertain_as_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a coarse instrument, whose noise two or five readings do not always show."""
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)
    floor.std_mm = [0.005, 0.6, 0.6]

    def strike() -> None:
        floor.lifted_mm[0, 2] = 0.3

    assert performed(bed, struck(strike))["exit"] == 0, bed.log().fault
    assert bed.events("tracker proven")[-1]["off_mm"] == pytest.approx([0.3, 0.0, 0.0])


@pytest.mark.parametrize("T", [moved(-3.0), moved(0.0, 1e-3)], ids=str)
def test_a_step_of_a_tracker_that_was_bumped_is_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, T: Array
) -> None:
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        if not bed.events("tracker moved"):
            floor.T = T

    assert performed(bed, struck(strike))["exit"] == 0, bed.log().fault
    (event,) = bed.events("tracker moved")
    assert event["invalid"] == [id.key for id in STEP]
    assert bed.events("tracker proven")[-1]["off_mm"] == pytest.approx([0.0] * 3, abs=1e-6)
    log = bed.log()
    assert log.set_ups.number == 1
    for id, seen_mm in zip(STEP, SEEN_MM, strict=True):
        point = log.point(id)
        assert point.set_up == 1
        np.testing.assert_allclose(point.xyz_mm, seen_mm, atol=1e-6)  # as from the first set-up
        taken = [r.body["xyz_mm"] for r in bed.records("point") if r.key == id.key]
        assert len(taken) == 2  # the journal keeps both, raw
        np.testing.assert_allclose(apply(T, taken[1:]), [seen_mm], atol=1e-6)


@pytest.mark.parametrize(
    ("bumps", "set_ups"),
    [
        ([(1, moved(0.5))], 1),
        ([(2, moved(0.0, 1e-3))], 1),
        ([(1, moved(0.5)), (7, moved(1.5))], 2),  # and while {W} is framed again
    ],
)
def test_a_bump_between_two_nests_is_not_blamed_on_a_nest(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    bumps: list[tuple[int, Array]],
    set_ups: int,
) -> None:
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        if not bed.events("tracker moved"):
            floor.bumps = bumps

    assert performed(bed, struck(strike))["exit"] == 0, bed.log().fault
    assert len(bed.events("tracker moved")) == bed.log().set_ups.number == set_ups
    for id, seen_mm in zip(STEP, SEEN_MM, strict=True):
        point = bed.log().point(id)
        assert point.set_up == set_ups
        np.testing.assert_allclose(point.xyz_mm, seen_mm, atol=1e-6)


@pytest.mark.parametrize("lift_mm", [0.2, -0.2, np.nan])
def test_a_nest_that_moved_alone_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lift_mm: float
) -> None:
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        floor.lifted_mm[1, :] = lift_mm

    end = performed(bed, struck(strike))
    assert end["error"]["code"] in ("HC-T33", "HC-J12")  # a NaN is stopped by the journal
    assert not bed.events("tracker moved")


def test_a_nest_that_moved_while_the_tracker_was_bumped_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All nests seem to have moved, and none stands beside the others."""
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        floor.T = moved(2.0)
        floor.lifted_mm[0, :2] = -0.5

    assert performed(bed, struck(strike))["exit"] == 3
    assert "F1" in bed.log().fault
    assert not bed.events("tracker moved")


def test_the_tracker_is_proven_after_a_question_before_the_point_that_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """I16: the one who cleared the beam may have bumped the tracker."""
    bed = Bed(tmp_path, unattended=False)
    floor = Floor(bed, monkeypatch)
    proofs: list[int] = []

    def act(session: CellSession, number: int) -> None:
        session.reach("reference")
        session.frame_world()
        session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
        floor.missed = Meter.TRIES
        proofs.append(len(bed.events("tracker proven")))
        session.flange_point(PointId("grid", vertex=(0, 0, 0)), S1100, HOME_RAD)
        proofs.append(len(bed.events("tracker proven")))

    with Live(bed, procedure(Points(1, act))) as live:
        live.until("state", "suspended")
        until(lambda: live.runner.answer() == "")
    assert live.code == 0, bed.log().fault
    assert proofs == [0, 1]


def test_a_tracker_that_moves_again_and_again_ends_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def strike() -> None:
        floor.T = moved(0.2) @ floor.T

    end = performed(bed, struck(strike))
    (suspicion,) = end["result"]["suspicions"]
    assert suspicion["cause"] == "tracker moved"
    assert suspicion["size"] == pytest.approx(0.2, abs=0.05)
    assert bed.log().set_ups.number == Watch.MOST_SET_UPS


def test_a_resumed_run_measures_again_what_was_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tracker was bumped while the engine was dead."""
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def dies(session: CellSession, number: int) -> None:
        measured_step(session)
        raise DeviceError("HC-T02", "Tracker", "measure", "gone")

    assert performed(bed, dies)["exit"] == 3
    floor.T = moved(2.0)

    def act(session: CellSession, number: int) -> None:
        measured_step(session)
        session.close_step()

    assert performed(bed, act)["exit"] == 0, bed.log().fault
    assert [bed.log().point(id).set_up for id in STEP] == [1, 1, 1]


def test_the_tracker_is_proven_after_a_pause_and_after_many_points(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    Floor(bed, monkeypatch)

    def act(session: CellSession, number: int) -> None:
        watch, journal = session, session._journal
        until(lambda: session.log.state == "running")  # another thread writes that
        watch.verify_tracker_if_due()
        proofs = len(bed.events("tracker proven"))
        measured_step(session)
        watch.verify_tracker_if_due()
        assert len(bed.events("tracker proven")) == proofs  # neither
        journal.append("state", "", {"machine": "run", "from": "running", "to": "paused"})
        watch.verify_tracker_if_due()
        assert len(bed.events("tracker proven")) == proofs + 1
        journal.append("state", "", {"machine": "run", "from": "running", "to": "paused"})
        watch.verify_tracker_if_due()  # though nothing was measured since
        assert len(bed.events("tracker proven")) == proofs + 2
        journal.append("state", "", {"machine": "run", "from": "paused", "to": "running"})
        for n in range(CELL.plan.prove_every):
            session.floor_nest_point(PointId("six", nest=str(n)), CELL.layout.floor[0])
        watch.verify_tracker_if_due()
        assert len(bed.events("tracker proven")) == proofs + 3

    assert performed(bed, act)["exit"] == 0, bed.log().fault


@pytest.mark.parametrize(("lifted_mm", "code"), [(0.05, 0), (4.0, 3)])
def test_a_nest_that_moved_since_the_current_calibration_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lifted_mm: float, code: int
) -> None:
    """The reproduction: 4 mm, within the cell file's tolerance, moved every point by 2 to 4 mm."""
    nests = {nest.name: xyz.tolist() for nest, xyz in zip(CELL.layout.floor, SEEN_MM, strict=True)}
    before = {"run": "c1", "nests_mm": nests, "temperature_c": 20.0}
    monkeypatch.setitem(PLAN, "floor_before", before)
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)
    floor.lifted_mm[0] = lifted_mm / np.sqrt(3.0)
    end = performed(bed, lambda session, number: None)
    assert end["exit"] == code, bed.log().fault
    if code:
        assert end["error"]["code"] == "HC-T32"
        assert "c1" in bed.log().fault
        assert not bed.log().frames


def test_what_rests_on_unproven_points_is_not_mended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed = Bed(tmp_path)
    floor = Floor(bed, monkeypatch)

    def act(session: CellSession, number: int) -> None:
        session.floor_nest_point(PointId("base", axis=1, number=0), CELL.layout.floor[0])
        session.frame("base", BASE)
        floor.T = moved(1.0)
        session.close_step()

    end = performed(bed, act)
    assert end["error"]["code"] == "HC-T33"
