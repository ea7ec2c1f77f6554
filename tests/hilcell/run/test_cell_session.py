"""What a session believes of a measurement, and from which side every axis comes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.model.point import PointId
from hilcell.ports import Array, DeviceError, RailReading, RobotReading, TrackerReading
from hilcell.run.cell_session import CellSession
from hilcell.run.mover import StraightApproach
from tests.hilcell.run.bed import CELL, Bed, broken_beam
from tests.hilcell.verdicts import base_at

HOME_RAD = np.radians(CELL.robot.home_deg)
POSE = PointId("flange", target="pose")
S300, S1100 = CELL.station_named("S300"), CELL.station_named("S1100")


def flange(session: CellSession, number: int) -> None:
    session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
    session.flange_point(PointId("flange", target=str(number)), S1100, HOME_RAD)


def nothing(session: CellSession, number: int) -> None:
    """Leave the robot where it is: the floor nest alone is measured."""


@pytest.mark.parametrize("late_s", [10.0, np.nan])
def test_an_answer_to_an_earlier_request_is_refused(
    bed: Bed, monkeypatch: pytest.MonkeyPatch, late_s: float
) -> None:
    measure = bed.tracker.measure

    def replayed(near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        reading = measure(near_mm, reflector, samples)
        return replace(reading, taken_s=reading.taken_s - late_s)

    monkeypatch.setattr(bed.tracker, "measure", replayed)
    assert bed.fault_of(nothing) == "HC-T31"


@pytest.mark.parametrize(("off_mm", "code"), [(0.5, ""), (15.0, "HC-T17"), (np.nan, "HC-T17")])
def test_a_reflector_far_from_its_place_is_refused(bed: Bed, off_mm: float, code: str) -> None:
    bed.tracker.off_mm = np.array([0.0, off_mm, 0.0])
    assert bed.fault_of(flange) == code


def test_a_point_is_not_kept_where_the_slide_crept_meanwhile(bed: Bed) -> None:
    def creep() -> None:
        bed.rail.position_mm += 0.05

    bed.tracker.answer = creep
    assert bed.fault_of(flange) == "HC-S05"
    assert not bed.log().points


def test_a_point_is_measured_once_in_a_run_s_life(bed: Bed) -> None:
    def twice(session: CellSession, number: int) -> None:
        flange(session, 0)
        flange(session, 0)

    assert bed.fault_of(twice) == ""
    assert bed.tracker.measured == 2  # the flange, and the floor nest of `Points`
    assert list(bed.log().points) == ["flange/0", "p/0"]


def test_a_point_keeps_when_its_readings_were_taken(bed: Bed) -> None:
    assert bed.fault_of(flange) == ""
    for key, at_rest in (("flange/0", True), ("p/0", False)):
        times = bed.log().points[key].readings
        assert times is not None
        assert (times.robot is not None) == at_rest
        assert (times.began is not None) == at_rest
        known = [each for each in (times.tracker, times.rail, times.robot) if each is not None]
        assert all(0.0 <= each.age_s < 10.0 for each in known)
        assert len({round(each.taken_s + each.age_s, 6) for each in known}) == 1  # used at once
        assert times.settled_s is not None
        assert times.settled_s >= 0.0


def test_a_point_may_have_no_air(bed: Bed) -> None:
    bed.tracker.air = None
    assert bed.fault_of(flange) == ""
    point = bed.log().points["flange/0"]
    assert (point.air, point.temperature_c, bed.log().temperatures_c()) == (None, None, [])
    assert bed.records("point")[0].body["pressure_mbar"] is None


@pytest.mark.parametrize(("side", "sign"), [(0, 1.0), (1, -1.0)])
def test_every_axis_comes_from_below_or_where_asked_from_above(
    bed: Bed, side: int, sign: float
) -> None:
    def sided(session: CellSession, number: int) -> None:
        session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
        session.flange_point(PointId("flange", target="1", side=side), S1100, HOME_RAD)

    assert bed.fault_of(sided) == ""
    before_rad, there_rad = bed.robot.targets
    assert np.array_equal(there_rad, HOME_RAD)
    assert there_rad - before_rad == pytest.approx(sign * np.radians(CELL.robot.approach_deg))


@pytest.mark.parametrize("there", [True, False])
def test_a_pose_of_a_cycle_is_approached_directly_from_the_one_before_it(
    bed: Bed, there: bool
) -> None:
    """A robot that stands elsewhere, as after a stop, goes to the pose before it first."""
    before_rad = HOME_RAD + np.radians([3.0, 2.0, -2.0, 0.0, 1.0, 0.0])

    def straight(session: CellSession, number: int) -> None:
        session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
        session.hold_station(S1100)
        if there:
            session.robot_to(before_rad, "before")
        bed.robot.targets.clear()
        how = StraightApproach(before_rad, 80.0)
        session.flange_point(PointId("flange", target="1"), S1100, HOME_RAD, straight=how)

    assert bed.fault_of(straight) == ""
    below_rad = before_rad - np.radians(CELL.robot.approach_deg)
    wanted = [HOME_RAD] if there else [below_rad, before_rad, HOME_RAD]
    np.testing.assert_allclose(bed.robot.targets, wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("slip_mm", "agrees"), [(0.0, True), (1.9, True), (2.1, False), (-2.1, False), (np.nan, False)]
)
def test_a_reference_is_proven_by_drive_and_strip(
    bed: Bed, monkeypatch: pytest.MonkeyPatch, slip_mm: float, agrees: bool
) -> None:
    read, proven = bed.rail.read, list[bool]()

    def slipped() -> RailReading:
        reading = read()
        return replace(reading, strip_mm=reading.position_mm + slip_mm)

    def look(session: CellSession, number: int) -> None:
        monkeypatch.setattr(bed.rail, "read", slipped)
        proven.append(session.rail_referenced())
        monkeypatch.setattr(bed.rail, "read", read)

    assert bed.fault_of(look) == ""
    assert proven == [agrees]


@pytest.mark.parametrize(("off_deg", "moves"), [(0.0, 0), (1.0, 1), (-1.0, 1)])
def test_a_robot_that_is_not_parked_is_parked(bed: Bed, off_deg: float, moves: int) -> None:
    def park(session: CellSession, number: int) -> None:
        bed.robot.joints_rad = np.radians(np.add(CELL.robot.safe_deg, [0, 0, off_deg, 0, 0, 0]))
        session.park_robot()

    assert bed.fault_of(park) == ""
    assert bed.robot.moves == moves
    np.testing.assert_allclose(np.degrees(bed.robot.joints_rad), CELL.robot.safe_deg)


def test_a_pause_that_was_asked_for_comes_before_the_robot_parks(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves_before = []

    def park(session: CellSession, number: int) -> None:
        bed.robot.joints_rad = HOME_RAD
        monkeypatch.setattr(session, "checkpoint", lambda: moves_before.append(bed.robot.moves))
        session.park_robot()

    assert bed.fault_of(park) == ""
    assert moves_before[:1] == [0]
    assert bed.robot.moves == 1


def test_the_rail_stays_where_the_robot_does_not_park(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The interlock judges the robot's reading, not that it was told to park."""
    bed.robot.joints_rad = HOME_RAD
    monkeypatch.setattr(bed.robot, "move_to", lambda *_: bed.robot.read())
    assert bed.fault_of(lambda session, number: session.rail_to(500.0)) == "HC-B32"
    assert bed.rail.position_mm == 1100.0
    assert not bed.rail.powered


def test_the_slide_jogs_only_with_the_robot_parked(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    bed.robot.joints_rad = HOME_RAD
    monkeypatch.setattr(bed.robot, "move_to", lambda *_: bed.robot.read())

    def jog(session: CellSession, number: int) -> None:
        session.jog_rail("1", 5.0, bound_mm=9.0, speed_mm_s=2.0)

    assert bed.fault_of(jog) == "HC-B32"
    assert bed.rail.jogs == []
    monkeypatch.undo()
    assert bed.fault_of(jog) == ""
    assert bed.rail.jogs == [(5.0, 9.0)]
    assert not bed.rail.powered


def test_joints_beyond_a_limit_are_never_commanded(bed: Bed) -> None:
    far_rad = HOME_RAD + np.radians([0, 0, 0, 0, 0, 400.0])

    def go(session: CellSession, number: int) -> None:
        session.robot_to(far_rad, "a point")

    assert bed.fault_of(go) == "HC-B33"
    assert bed.robot.moves == 0


def test_a_slide_that_slips_when_its_brake_closes_is_not_held(
    bed: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    hold = bed.rail.hold

    def slip() -> None:
        bed.rail.position_mm += 0.05
        hold()

    monkeypatch.setattr(bed.rail, "hold", slip)
    assert bed.fault_of(lambda session, number: session.hold_station(S1100)) == "HC-S05"
    assert not bed.events("station held")


def test_what_has_moved_settles_before_it_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settles = {"settle.robot_s": "0.5", "settle.rail_s": "1.5"}
    bed = Bed(tmp_path, cell=load_cell("paper", settles))
    done: list[object] = []
    move = bed.robot.move_to

    def moved(joints_rad: Array, speed_percent: float) -> RobotReading:
        done.append("move")
        return move(joints_rad, speed_percent)

    def act(session: CellSession, number: int) -> None:
        monkeypatch.setattr(session.clock, "wait", done.append)
        session.hold_station(S1100)
        flange(session, number)

    monkeypatch.setattr(bed.robot, "move_to", moved)
    bed.tracker.answer = lambda: done.append("measure")
    assert bed.fault_of(act) == ""
    assert done == [1.5, "move", "move", 0.5, "measure", "measure"]


@pytest.mark.parametrize(
    ("settings", "std_mm", "waits"),
    [
        ({}, [0.01], [0.3]),
        ({}, [0.09, 0.05, 0.02], [0.3, 0.3, 0.3]),
        ({}, [0.09] * 9, [0.3, 0.3, 0.3, 0.1]),  # a second in all
        ({"plan.quick": "false"}, [0.09], [1.0]),
        ({"tracker.driver": "leica-geocom"}, [0.09], [1.0]),  # it shows no spread
        ({"settle.robot_s": "0.2"}, [0.09], [0.2]),
    ],
)
def test_on_a_quick_plan_the_robot_rests_until_the_tracker_sees_it_rest(
    settings: dict[str, str],
    std_mm: list[float],
    waits: list[float],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bed = Bed(tmp_path, cell=load_cell("paper", {"plan.quick": "true"} | settings))
    found, done = [*std_mm, 0.01], list[float]()

    def act(session: CellSession, number: int) -> None:
        session.hold_station(S1100)
        monkeypatch.setattr(session.clock, "wait", done.append)
        flange(session, number)

    def answer() -> None:
        bed.tracker.std_mm = found.pop(0) if found else 0.01

    bed.tracker.answer = answer
    assert bed.fault_of(act) == ""
    assert done == pytest.approx(waits)


@pytest.mark.parametrize(
    ("act", "rest_s"),
    [
        (lambda session: session.hold_station(S1100), 0.5),
        (lambda session: session.hold_station(S1100, again=True), 2.0),
        (lambda session: session.rail_to(1100.0), 2.0),
        (lambda session: session.robot_to(HOME_RAD, "pose"), 1.0),
        (lambda session: session.pose_points(HOME_RAD, [(POSE, np.zeros(3))]), 1.0),
    ],
    ids=["hold", "hold again", "rail", "robot", "pose"],
)
def test_a_rest_is_short_only_where_the_tracker_shows_it(
    act: Callable[[CellSession], object],
    rest_s: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a hold, in the nest that verifies it; what is measured otherwise waits the whole time."""
    bed, done = Bed(tmp_path, cell=load_cell("paper", {"plan.quick": "true"})), list[float]()

    def run(session: CellSession, number: int) -> None:
        session.hold_station(S300)
        monkeypatch.setattr(session.clock, "wait", done.append)
        act(session)

    assert bed.fault_of(run) == ""
    assert done == [rest_s]


def test_the_robot_does_not_park_from_a_station_that_the_strip_no_longer_reads(bed: Bed) -> None:
    def act(session: CellSession, number: int) -> None:
        session.hold_station(S1100)
        bed.robot.joints_rad = HOME_RAD
        bed.rail.position_mm -= 0.14  # found by disturbance seed 6058
        session.hold_station(S300)

    assert bed.fault_of(act) == "HC-S05"
    assert bed.robot.moves == 0
    assert bed.rail.position_mm == S1100.strip_mm - 0.14


def test_the_robot_does_not_park_while_the_rail_has_power(bed: Bed) -> None:
    bed.robot.joints_rad, bed.rail.powered = HOME_RAD, True
    assert bed.fault_of(lambda session, number: session.park_robot()) == "HC-R42"
    assert bed.robot.moves == 0


@pytest.mark.parametrize(("moved_mm", "found"), [(0.0, 1), (0.5, 0), (-0.5, 0)])
def test_a_resumed_run_proves_its_station_by_the_strip(
    bed: Bed, moved_mm: float, found: int
) -> None:
    def hold(session: CellSession, number: int) -> None:
        session.hold_station(S1100)

    bed.tracker.answer = broken_beam(3)
    assert bed.fault_of(hold) == "HC-T10"
    bed.rail.position_mm += moved_mm
    assert bed.fault_of(hold) == ""
    assert len(bed.events("station found held")) == found
    assert len(bed.events("station held")) == 2 - found


SEATED = load_cell(
    "paper", {"robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"}
)
POSE = PointId("flange", target="0")
TARGET_DEG = np.array([0.0, 75.0, 0.0])


def flange_pose(session: CellSession, number: int) -> None:
    session.frame("base", base_at(session.cell.layout.nominal_base(S1100.rail_mm)))
    session.flange_point(POSE, S1100, HOME_RAD, nominal_deg=TARGET_DEG, seats=True)


def test_all_reflectors_of_a_pose_are_measured_after_one_motion(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=SEATED)
    assert bed.fault_of(flange_pose) == ""
    moves = [record for record in bed.records("intent") if record.key.startswith("flange")]
    assert [record.key for record in moves] == ["flange/0"]
    log = bed.log()
    assert list(log.points) == ["flange/0", "flange/0/seat2", "flange/0/seat3", "p/0"]
    points = [log.point(POSE.at_seat(seat)) for seat in (1, 2, 3)]
    assert [point.nominal_deg for point in points] == [(0.0, 75.0, 0.0), None, None]
    assert [point.smr_mm for point in points] == [*map(tuple, SEATED.robot.seats_mm.tolist())]
    seen_mm = np.array([point.xyz_mm for point in points])
    wanted_mm = SEATED.robot.seats_mm
    for one, other in ((0, 1), (0, 2), (1, 2)):  # where each was looked for
        apart_mm = np.linalg.norm(seen_mm[one] - seen_mm[other])
        assert apart_mm == pytest.approx(np.linalg.norm(wanted_mm[one] - wanted_mm[other]))


def test_a_run_that_ends_between_two_reflectors_measures_the_others_only(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=SEATED)

    def ends() -> None:
        if bed.tracker.measured == 1:
            raise DeviceError("HC-T31", "Tracker", "measure", "it went away")

    bed.tracker.answer = ends
    assert bed.fault_of(flange_pose) == "HC-T31"
    assert list(bed.log().points) == ["flange/0"]
    first = bed.records("point")[0]
    bed.tracker.answer = lambda: None
    assert bed.fault_of(flange_pose) == ""
    keys = [record.key for record in bed.records("point")]
    assert keys == ["flange/0", "flange/0/seat2", "flange/0/seat3", "p/0"]
    assert bed.records("point")[0] == first
    moves = [r.key for r in bed.records("intent") if r.key.startswith("flange")]
    assert moves == ["flange/0", "flange/0/seat2"]  # once more to the pose, for the others
