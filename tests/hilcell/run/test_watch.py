"""A run verifies between its points: the tracker, the slide's hold, the ambient temperature."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.diagnosis import temperature_change
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import apply, from_rotvec, inverse, matrix
from hilcell.model.frame import Frame
from hilcell.model.point import PointId
from hilcell.model.records import Ended
from hilcell.ports import Air, Array, DeviceError, NoReading, Stopped, TrackerReading
from hilcell.run.cell_session import CellSession
from hilcell.run.meter import Meter
from hilcell.run.procedure import Procedure
from hilcell.run.watch import Watch, check_distances, check_places
from tests.hilcell.run.bed import CELL, PLAN, QUICK, Bed, Live, until
from tests.hilcell.run.rig import Points, procedure
from tests.hilcell.verdicts import BASE, base_at

T_L_W = inverse(CELL.tracker.pose.matrix())
NESTS_MM = np.array([nest.xyz_mm for nest in CELL.layout.floor])
SEEN_MM = apply(T_L_W, NESTS_MM)
STEP = [PointId("six", nest=nest.name) for nest in CELL.layout.floor]
S300, S1100 = CELL.station_named("S300"), CELL.station_named("S1100")
HOME_RAD = np.radians(CELL.robot.home_deg)
FLANGE_MM = 500.0  # from all nests: where the flange is
Act = Callable[[CellSession], None]


def whole(act: Act) -> Procedure:
    """Return a run that frames {W}, then acts."""

    def perform(session: CellSession, number: int) -> None:
        session.reach("reference")
        session.frame_world()
        act(session)

    return procedure(Points(1, perform))


def performed(bed: Bed, act: Act) -> Ended:
    bed.run(whole(act))
    end = bed.log().end
    assert end is not None
    return end


# -- the floor nests: swapped or wrong ones are refused, a tracker that was bumped is noticed ------


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


@pytest.fixture
def floor(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> Floor:
    return Floor(bed, monkeypatch)


def moved(x_mm: float, turn_rad: float = 0.0) -> Array:
    return matrix(from_rotvec(np.array([0.0, 0.0, turn_rad])), np.array([x_mm, 0.0, 0.0]))


def measured_step(session: CellSession) -> None:
    for id, nest in zip(STEP, CELL.layout.floor, strict=True):
        session.floor_nest_point(id, nest)


def struck(strike: Callable[[], None]) -> Act:
    """Return a step of which something happens between its last point and its end."""

    def act(session: CellSession) -> None:
        measured_step(session)
        strike()
        session.close_step()

    return act


@pytest.mark.parametrize("lifted_mm", [0.12, 5.0])
def test_a_nest_that_is_lifted_is_not_taken_for_a_tracker_that_was_bumped(
    bed: Bed, floor: Floor, lifted_mm: float
) -> None:
    """The distances of three nests do not change where one rises out of their plane."""

    def strike() -> None:
        floor.lifted_mm[0, 2] = lifted_mm

    assert performed(bed, struck(strike)).exit == 3
    assert f"F1 moved by {lifted_mm:.3f} mm" in bed.log().fault
    assert not bed.events("tracker moved")


def test_readings_that_agree_by_chance_are_as_uncertain_as_the_others(
    bed: Bed, floor: Floor
) -> None:
    """Of a coarse instrument, whose noise two or five readings do not always show."""
    floor.std_mm = [0.005, 0.6, 0.6]

    def strike() -> None:
        floor.lifted_mm[0, 2] = 0.3

    assert performed(bed, struck(strike)).exit == 0, bed.log().fault
    assert bed.events("tracker proven")[-1]["off_mm"] == pytest.approx([0.3, 0.0, 0.0])


@pytest.mark.parametrize("T", [moved(-3.0), moved(0.0, 1e-3)], ids=str)
def test_a_step_of_a_tracker_that_was_bumped_is_measured_again(
    bed: Bed, floor: Floor, T: Array
) -> None:

    def strike() -> None:
        if not bed.events("tracker moved"):
            floor.T = T

    assert performed(bed, struck(strike)).exit == 0, bed.log().fault
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
    bed: Bed, floor: Floor, bumps: list[tuple[int, Array]], set_ups: int
) -> None:

    def strike() -> None:
        if not bed.events("tracker moved"):
            floor.bumps = bumps

    assert performed(bed, struck(strike)).exit == 0, bed.log().fault
    assert len(bed.events("tracker moved")) == bed.log().set_ups.number == set_ups
    for id, seen_mm in zip(STEP, SEEN_MM, strict=True):
        point = bed.log().point(id)
        assert point.set_up == set_ups
        np.testing.assert_allclose(point.xyz_mm, seen_mm, atol=1e-6)


@pytest.mark.parametrize("lift_mm", [0.2, -0.2, np.nan])
def test_a_nest_that_moved_alone_ends_the_run(bed: Bed, floor: Floor, lift_mm: float) -> None:

    def strike() -> None:
        floor.lifted_mm[1, :] = lift_mm

    end = performed(bed, struck(strike))
    assert end.error["code"] in ("HC-T33", "HC-J12")  # a NaN is stopped by the journal
    assert not bed.events("tracker moved")


def test_a_nest_that_moved_while_the_tracker_was_bumped_ends_the_run(
    bed: Bed, floor: Floor
) -> None:
    """All nests seem to have moved, and none stands beside the others."""

    def strike() -> None:
        floor.T = moved(2.0)
        floor.lifted_mm[0, :2] = -0.5

    assert performed(bed, struck(strike)).exit == 3
    assert "F1" in bed.log().fault
    assert not bed.events("tracker moved")


def test_the_tracker_is_proven_after_a_question_before_the_point_that_asked(
    bed: Bed, floor: Floor
) -> None:
    """I16: the one who cleared the beam may have bumped the tracker."""
    bed.unattended = False
    proofs: list[int] = []

    def act(session: CellSession) -> None:
        session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
        floor.missed = Meter.TRIES
        proofs.append(len(bed.events("tracker proven")))
        session.flange_point(PointId("grid", vertex=(0, 0, 0)), S1100, HOME_RAD)
        proofs.append(len(bed.events("tracker proven")))

    with Live(bed, whole(act)) as live:
        live.until("state", "suspended")
        until(lambda: live.runner.answer() == "")
    assert live.code == 0, bed.log().fault
    assert proofs == [0, 1]


def test_a_tracker_that_moves_again_and_again_ends_the_run(bed: Bed, floor: Floor) -> None:

    def strike() -> None:
        floor.T = moved(0.2) @ floor.T

    end = performed(bed, struck(strike))
    (suspicion,) = end.result["suspicions"]
    assert suspicion["cause"] == "tracker moved"
    assert suspicion["size"] == pytest.approx(0.2, abs=0.05)
    assert bed.log().set_ups.number == Watch.MOST_SET_UPS


def test_a_resumed_run_measures_again_what_was_not_proven(bed: Bed, floor: Floor) -> None:
    """The tracker was bumped while the engine was dead."""

    def dies(session: CellSession) -> None:
        measured_step(session)
        raise DeviceError("HC-T02", "Tracker", "measure", "gone")

    assert performed(bed, dies).exit == 3
    floor.T = moved(2.0)

    def act(session: CellSession) -> None:
        measured_step(session)
        session.close_step()

    assert performed(bed, act).exit == 0, bed.log().fault
    assert [bed.log().point(id).set_up for id in STEP] == [1, 1, 1]


def test_the_tracker_is_proven_after_a_pause_and_after_many_points(bed: Bed, floor: Floor) -> None:

    def act(session: CellSession) -> None:
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

    assert performed(bed, act).exit == 0, bed.log().fault


@pytest.mark.parametrize(("lifted_mm", "code"), [(0.05, 0), (4.0, 3)])
def test_a_nest_that_moved_since_the_current_calibration_is_refused(
    bed: Bed, floor: Floor, monkeypatch: pytest.MonkeyPatch, lifted_mm: float, code: int
) -> None:
    """The reproduction: 4 mm, within the cell file's tolerance, moved every point by 2 to 4 mm."""
    nests = {nest.name: xyz.tolist() for nest, xyz in zip(CELL.layout.floor, SEEN_MM, strict=True)}
    before = {"run": "c1", "nests_mm": nests, "temperature_c": 20.0}
    monkeypatch.setitem(PLAN, "floor_before", before)
    floor.lifted_mm[0] = lifted_mm / np.sqrt(3.0)
    end = performed(bed, lambda session: None)
    assert end.exit == code, bed.log().fault
    if code:
        assert end.error["code"] == "HC-T32"
        assert "c1" in bed.log().fault
        assert not bed.log().frames


def test_what_rests_on_unproven_points_is_not_mended(bed: Bed, floor: Floor) -> None:

    def act(session: CellSession) -> None:
        session.floor_nest_point(PointId("base", axis=1, number=0), CELL.layout.floor[0])
        session.frame("base", BASE)
        floor.T = moved(1.0)
        session.close_step()

    end = performed(bed, act)
    assert end.error["code"] == "HC-T33"


# -- the slide: held by one of its nests, a strip that has jumped moves nothing unnoticed ----------


ALONG = T_L_W[:3, :3] @ np.array(CELL.layout.rail_direction)
BY_HAND = load_cell("paper", {"layout.reflectors": "by_hand"})


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
        on_floor = np.linalg.norm(SEEN_MM - near_mm, axis=1).min() < 50.0
        along_mm = self.bumped_mm + (0.0 if on_floor else self.off_mm)
        seen_mm = SEEN_MM[np.argmin(np.linalg.norm(SEEN_MM - near_mm, axis=1))]
        self._tracker.off_mm = along_mm * ALONG + (seen_mm - near_mm if on_floor else 0.0)
        return self._measure(near_mm, reflector, samples)


@pytest.fixture
def slide(bed: Bed, monkeypatch: pytest.MonkeyPatch) -> Slide:
    return Slide(bed, monkeypatch)


def off_mm(bed: Bed) -> list[float]:
    return [event["off_mm"] for event in bed.events("slide proven")]


@pytest.mark.parametrize("within_mm", [0.0, -0.1])
def test_a_slide_that_comes_back_is_proven_by_one_point(
    bed: Bed, slide: Slide, within_mm: float
) -> None:

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S1100)  # it has not moved since
        session.hold_station(S300)
        slide.off_mm = within_mm
        session.hold_station(S1100)

    assert bed.run(whole(act)) == 0, bed.log().fault
    assert off_mm(bed) == pytest.approx([0.0, 0.0, within_mm], abs=1e-6)
    keys = [point.key for point in bed.log().select("held")]
    assert keys == ["held/S1100/1-0/P1", "held/S1100/1-1/P1", "held/S300/1-0/P1"]
    assert {point.group for point in bed.log().select("held")} == {"control"}


@pytest.mark.parametrize(("between", "jump_mm"), [(S1100, 1.0), (S1100, -0.3), (S300, 1.0)])
def test_a_strip_that_has_jumped_ends_a_run_that_nobody_attends(
    bed: Bed, slide: Slide, between: object, jump_mm: float
) -> None:
    """At the station itself, or on the first way to another."""

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S300) if between == S1100 else None
        slide.off_mm = jump_mm
        session.hold_station(S1100 if between == S1100 else S300)
        raise AssertionError("the robot would work there")

    assert bed.run(whole(act)) == 3
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


def test_a_jump_while_everything_was_dead_is_found_on_resume(bed: Bed, slide: Slide) -> None:
    for jump_mm, code in ((0.0, 0), (1.0, 3), (0.0, 0)):
        slide.off_mm = jump_mm
        assert bed.run(whole(lambda session: session.hold_station(S1100))) == code
    assert len(off_mm(bed)) == 2  # what was refused is nobody's reference


def test_an_attended_run_pauses_and_goes_on_once_the_strip_is_right(bed: Bed, slide: Slide) -> None:
    bed.unattended = False

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        session.hold_station(S300)
        slide.off_mm = 1.0
        session.hold_station(S1100)

    with Live(bed, whole(act)) as live:
        live.until("state", "paused")
        slide.off_mm = 0.0
        live.runner.post("proceed")
    assert live.code == 0, bed.log().fault
    (paused,) = bed.entered("paused")
    assert "+1.000 mm" in paused["reason"]


def test_a_tracker_that_was_bumped_is_not_taken_for_a_strip(bed: Bed, slide: Slide) -> None:

    def act(session: CellSession) -> None:
        session.hold_station(S1100)
        if not bed.events("tracker moved"):
            session.hold_station(S300)
            slide.bumped_mm = 1.0
            session.hold_station(S1100)

    assert bed.run(whole(act)) == 0, bed.log().fault
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


# -- the ambient temperature: out of its range it suspends a run until it is back ------------------


START_C = 22.0


def grid(session: CellSession, count: int, warmer_k: dict[int, float], bed: Bed) -> None:
    """Measure points of a grid at temperatures that are the start's where none is given."""
    session.reach("reference")
    session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
    for n in range(count):
        bed.tracker.air = Air(START_C + warmer_k.get(n, 0.0), 1013.0, 45.0)
        session.flange_point(PointId("grid", vertex=(n, 0, 0)), S1100, HOME_RAD)


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bed:
    cell = load_cell("paper", QUICK | {"room.steady_s": "0.0"})
    monkeypatch.setitem(PLAN, "cell", msgspec.to_builtins(cell))
    monkeypatch.setattr("hilcell.run.worker.POLL_S", 0.01)
    return Bed(tmp_path, unattended=False, cell=cell)


@pytest.mark.parametrize("off_k", [2.9, -2.9])
def test_a_room_within_its_range_suspends_nothing(room: Bed, off_k: float) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: off_k}, room))
    assert room.run(procedure(act)) == 0, room.log().fault
    assert room.asked() == []
    assert temperature_change(room.log()) is None


@pytest.mark.parametrize("off_k", [3.1, -8.0])
def test_it_goes_on_by_itself_and_measures_the_point_again(room: Bed, off_k: float) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: off_k, 2: off_k}, room))
    with Live(room, procedure(act)) as live:
        live.until("state", "suspended")
        warm_now = room.tracker.air
        until(lambda: live.status("prompt")["age_s"] is not None)  # it has looked, in the warm
        assert live.status("prompt")["ready"] is False
        live.runner.post("proceed")  # the room is still as it was: refused
        assert room.tracker.air is warm_now
        room.tracker.air = Air(START_C + 1.9, 1013.0, 45.0)
    assert live.code == 0, room.log().fault
    (asked,) = room.asked()
    assert asked["error"]["code"] == "HC-V14"
    assert f"{off_k:+.1f} K" in asked["reason"]
    assert len(room.events("room back")) == 1
    log = room.log()
    assert log.points["grid/1-0-0"].temperature_c == START_C + 1.9
    assert [record.key for record in room.records("point")].count("grid/1-0-0") == 2
    assert temperature_change(log) is None


def test_what_was_measured_in_the_warm_and_counts_is_suspected(room: Bed) -> None:
    act = Points(1, lambda session, number: grid(session, 3, {1: 2.0}, room))
    room.run(procedure(act))
    log = room.log()
    late = msgspec.structs.replace(log.points["grid/1-0-0"], temperature_c=START_C - 4.0)
    log.points["grid/1-0-0"] = late
    found = temperature_change(log)
    assert found is not None
    assert (found.cause, found.size, found.unit) == ("temperature", -4.0, "K")


def test_the_band_to_go_on_is_the_smaller() -> None:
    with pytest.raises(SettingsError, match="back_k"):
        load_cell("paper", {"room.back_k": "3.0"})
