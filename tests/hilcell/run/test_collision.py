"""The arm keeps clear of the cell's volumes, in plans and before every motion."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.cell.file import Cell, KeepOut, Pose
from hilcell.cell.surroundings import Surroundings, posture
from hilcell.geometry.clearance import Proof, placed_mm
from hilcell.journal.journal import Record
from hilcell.model.point import PointId
from hilcell.ports import Array, DeviceError, RobotReading
from hilcell.run import mover
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import (
    RESERVE_MM,
    UpcomingPoses,
    check_planned_path,
    check_poses,
    check_slide_travel,
    check_sweep,
    check_volumes_known,
    clear,
    clear_poses,
    leaves_cube,
    waypoints,
)
from hilcell.run.interlocks import Blocked
from procedures.base_frame import sweep
from procedures.plan import joints_for
from procedures.repeatability import Repeatability
from tests.hilcell.run.bed import CELL, PLAN, Bed, Live, until
from tests.hilcell.run.rig import Points, procedure

S1100 = CELL.station_named("S1100")
SAFE = np.radians(CELL.robot.safe_deg)
HOME = np.radians(CELL.robot.home_deg)
LEFT, RIGHT = (HOME + np.radians([side, 0, 0, 0, 0, 0]) for side in (-60.0, 60.0))
OUT = HOME + np.radians([0.0, 10.0, -20.0, 0.0, 0.0, 0.0])


def bare(cell: Cell) -> Cell:
    """The same cell, which states nothing of its volumes."""
    robot = msgspec.structs.replace(cell.robot, envelope=None)
    return msgspec.structs.replace(cell, robot=robot, keep_out=[])


def with_box(
    cell: Cell, x_mm: float, y_mm: float, z_mm: float, size_mm: tuple[float, float, float]
) -> Cell:
    """The cell with one more volume, a part, in {W}."""
    part = KeepOut(name="part", centre=Pose(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm), size_mm=size_mm)
    return msgspec.structs.replace(cell, keep_out=[*cell.keep_out, part])


# A post 1.5 m in front of the robot at S1100: the arm cannot turn past it, but it can draw back.
POST = with_box(CELL, -350.0, 0.0, 1500.0, (60.0, 60.0, 4000.0))


def test_a_way_through_a_volume_is_refused_with_all_that_matters() -> None:
    assert clear(POST, S1100, LEFT[None], RIGHT[None]).tolist() == [False]
    with pytest.raises(Blocked) as caught:
        check_planned_path(POST, S1100, LEFT, RIGHT, "sweep of axis 1")
    error = caught.value
    assert (error.code, error.operation) == ("HC-B34", "sweep of axis 1")
    assert error.fields["keep_out"] == "part"
    assert error.fields["link"] == 4
    assert float(str(error.fields["clearance_mm"])) < 0.0


def test_a_pose_too_near_says_how_near() -> None:
    with pytest.raises(Blocked) as caught:
        check_poses(wall_beside(HOME, 43.0), S1100, np.array([SAFE, HOME, HOME]), "place at S1100")
    assert caught.value.fields["link"] == 6
    assert "58 mm" in caught.value.found


def test_the_volumes_are_where_the_rail_leaves_them() -> None:
    far = CELL.station_named("S1900")
    assert clear(POST, far, LEFT[None], (LEFT + 0.1)[None]).tolist() == [True]
    shifted = with_box(CELL, -350.0, 800.0, 1500.0, (60.0, 60.0, 4000.0))
    assert clear(shifted, far, LEFT[None], RIGHT[None]).tolist() == [False]


def test_a_way_from_nowhere_is_refused() -> None:
    for axis in range(6):
        joints = HOME.copy()
        joints[axis] = np.nan
        for cell in (CELL, bare(CELL)):
            assert clear(cell, S1100, joints[None], HOME[None]).tolist() == [False]
            assert clear(cell, S1100, HOME[None], joints[None]).tolist() == [False]
            assert clear_poses(cell, S1100, joints[None]).tolist() == [False]
        with pytest.raises(Blocked):
            check_planned_path(CELL, S1100, joints, HOME, "a way")
        with pytest.raises(Blocked):
            check_poses(CELL, S1100, joints[None], "a pose")


def test_a_plan_is_stricter_than_the_interlock() -> None:
    """A wall that leaves the clearance, and 5 mm: enough now, too little for a plan."""
    around = CELL.surroundings
    assert around is not None
    for gap_mm, planned, now in ((55.0, False, True), (65.0, True, True), (45.0, False, False)):
        cell = wall_beside(HOME, gap_mm)
        assert clear(cell, S1100, HOME[None], HOME[None]).tolist() == [planned]
        assert (len(way(cell, HOME, HOME)) > 0) == now


def reach_mm(joints_rad: Array) -> float:
    """How far the arm's shape reaches from axis 1, along x of {B}."""
    around = CELL.surroundings
    assert around is not None
    capsules = around._body.capsules
    ends = placed_mm(around._body.arm, capsules, joints_rad[None])[0]
    return float((ends[..., 0].max(axis=1) + capsules.radius_mm).max())


def wall_beside(joints_rad: Array, gap_mm: float) -> Cell:
    """The cell with a wall in front of the arm, so far from it."""
    face_mm = CELL.layout.base.x_mm + reach_mm(joints_rad) + gap_mm
    return with_box(CELL, face_mm + 500.0, 0.0, 1500.0, (1000.0, 9000.0, 9000.0))


def way(cell: Cell, start: Array, end: Array) -> list[Array]:
    try:
        return waypoints(cell, S1100.rail_mm, start, end, "now")
    except Blocked:
        return []


# The arm reaches it as it turns at home, but not at its safe pose, which is drawn back.
FAR_MM = CELL.layout.base.x_mm + reach_mm(SAFE) + 100.0
FAR_POST = with_box(CELL, FAR_MM + 30.0, 0.0, 1500.0, (60.0, 60.0, 4000.0))


def test_the_robot_goes_by_its_safe_pose_where_it_must() -> None:
    below = RIGHT - np.radians(CELL.robot.approach_deg)
    np.testing.assert_array_equal(way(CELL, LEFT, RIGHT), [below, RIGHT])
    np.testing.assert_array_equal(way(FAR_POST, LEFT, RIGHT), [SAFE, below, RIGHT])
    assert way(POST, LEFT, RIGHT) == []
    check_poses(FAR_POST, S1100, np.array([LEFT, RIGHT]), "a pose")
    assert clear_poses(FAR_POST, S1100, np.array([LEFT, HOME, RIGHT])).tolist() == [
        True,
        False,
        True,
    ]


@pytest.mark.parametrize(("start", "end"), [(HOME, RIGHT), (RIGHT, HOME)])
def test_no_part_of_the_way_by_the_safe_pose_is_left_out(start: Array, end: Array) -> None:
    """At home the arm is in the post: it may neither come from there nor go there."""
    assert way(FAR_POST, start, end) == []


def test_poses_in_the_cube_and_on_the_circles_are_stated() -> None:
    cube = joints_for(CELL, Repeatability.places_mm(CELL))
    assert not leaves_cube(CELL, cube).any()
    for axis in (1, 6):
        assert not leaves_cube(CELL, sweep(CELL, axis)).any()
    assert leaves_cube(CELL, np.array([OUT, SAFE])).all()
    turned = cube[:1] + np.radians([0, 0, 0, 0, 0, 3.0])
    assert leaves_cube(CELL, turned).all()
    assert leaves_cube(CELL, np.full((1, 6), np.nan)).all()


def test_a_cell_without_volumes_stays_where_it_was_stated() -> None:
    cell = bare(CELL)
    cube = joints_for(cell, Repeatability.places_mm(cell))
    check_poses(cell, S1100, cube, "a place")
    assert clear_poses(cell, S1100, np.vstack([cube, OUT])).tolist() == [True] * 3 + [False]
    check_poses(CELL, S1100, OUT[None], "a free pose")
    for refused in (
        lambda: check_poses(cell, S1100, OUT[None], "a free pose"),
        lambda: check_sweep(cell, S1100, cube[0], cube[0], "sweep of axis 1"),
        lambda: check_volumes_known(cell, "sweep"),
    ):
        with pytest.raises(Blocked) as caught:
            refused()
        assert caught.value.code == "HC-B35"


def test_the_slide_rides_with_a_safe_pose_that_is_clear_everywhere() -> None:
    check_slide_travel(CELL)
    check_slide_travel(bare(CELL))
    with pytest.raises(Blocked, match="part"):
        check_slide_travel(with_box(CELL, -350.0, 1500.0, 1500.0, (300.0, 60.0, 4000.0)))


# -- before a motion ------------------------------------------------------------------------------


def go_to(joints_rad: Array) -> Callable[[CellSession, int], None]:
    def go(session: CellSession, number: int) -> None:
        session.robot_to(joints_rad, "a point")

    return go


@pytest.fixture
def post(tmp_path: Path) -> Bed:
    return Bed(tmp_path, cell=POST)


def test_a_motion_through_a_volume_is_not_made(post: Bed) -> None:
    post.robot.joints_rad = LEFT
    at_post = HOME.copy()
    assert post.fault_of(go_to(at_post)) == "HC-B34"
    assert post.robot.moves == 0


def test_a_reading_from_before_a_motion_is_not_where_the_next_one_starts(post: Bed) -> None:
    post.robot.joints_rad = LEFT

    def go(session: CellSession, number: int) -> None:
        session.robot_to(LEFT, "start of a sweep")
        with session.admitted() as sweep:
            sweep.begin(LEFT, "sweep")
        post.robot.joints_rad = RIGHT  # the sweep took it there
        session.robot_to(LEFT, "next")

    assert post.fault_of(go) == "HC-B34"
    assert post.robot.moves == 2


def test_nobody_knows_where_a_motion_that_failed_has_ended(
    post: Bed, monkeypatch: pytest.MonkeyPatch
) -> None:
    post.robot.joints_rad = LEFT

    def lost(joints_rad: Array, speed_percent: float) -> RobotReading:
        post.robot.joints_rad = RIGHT
        raise DeviceError("HC-B01", "Robot", "move", "no answer")

    def go(session: CellSession, number: int) -> None:
        session.robot_to(LEFT, "start")
        with monkeypatch.context() as patch:
            patch.setattr(post.robot, "move_to", lost)
            with pytest.raises(DeviceError):
                session.robot_to(LEFT, "fails")
        session.robot_to(LEFT, "next")

    assert post.fault_of(go) == "HC-B34"
    assert post.robot.moves == 2


def test_a_robot_that_was_moved_while_the_disk_stalled_has_its_way_checked_again(
    post: Bed,
) -> None:
    post.robot.joints_rad = LEFT
    runner = post.runner(procedure(Points(1, go_to(LEFT))))

    def stall(record: Record) -> None:
        if record.kind == "intent":
            post.robot.joints_rad = RIGHT  # jogged there, by hand
            post.clock.pc_at_s += 9.0

    post.journal.listen(stall)
    assert runner.run() == 3
    post.journal.close()
    assert post.log().life[-1].change.error["code"] == "HC-B34"
    assert post.robot.moves == 0


def test_the_last_half_degree_is_a_way_too(tmp_path: Path) -> None:
    """From below the target there is enough room, at the target there is not."""
    cell, below = wall_beside(HOME, 45.0), HOME - np.radians(CELL.robot.approach_deg)
    assert len(way(cell, SAFE, below)) == 2
    bed = Bed(tmp_path, cell=cell)
    assert bed.fault_of(go_to(HOME)) == "HC-B34"
    assert bed.robot.moves == 0


def test_a_robot_drives_by_its_safe_pose(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=FAR_POST)
    bed.robot.joints_rad = LEFT
    assert bed.fault_of(go_to(RIGHT)) == ""
    below = RIGHT - np.radians(CELL.robot.approach_deg)
    np.testing.assert_array_equal(bed.robot.targets, [SAFE, below, RIGHT])


def test_a_robot_that_moves_is_not_sent(post: Bed, monkeypatch: pytest.MonkeyPatch) -> None:
    read = post.robot.read

    def moving() -> RobotReading:
        return replace(read(), still=False)

    monkeypatch.setattr(post.robot, "read", moving)
    assert post.fault_of(go_to(LEFT)) == "HC-B31"
    assert post.robot.moves == 0


def test_a_robot_that_cannot_park_on_a_clear_way_stays(post: Bed) -> None:
    post.robot.joints_rad = HOME  # inside the post
    assert post.fault_of(lambda session, number: session.park_robot()) == "HC-B34"
    assert post.robot.moves == 0


@pytest.mark.parametrize(("cell", "code"), [(POST, "HC-B34"), (bare(CELL), "HC-B35")])
def test_a_sweep_through_a_volume_is_not_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: Cell, code: str
) -> None:
    monkeypatch.setattr(mover, "streaming_tracker", lambda tracker: tracker)
    monkeypatch.setattr(mover, "sweeping_robot", lambda robot: robot)
    bed = Bed(tmp_path, cell=cell)
    bed.robot.joints_rad = LEFT
    order = mover.SweepCommand("s", LEFT, 0, float(RIGHT[0]), 0.02, np.zeros(3), 100.0)

    def go(session: CellSession, number: int) -> None:
        session.sweep(order)

    assert bed.fault_of(go) == code
    assert bed.robot.moves == (2 if code == "HC-B34" else 0)  # to its start


def test_poses_beyond_a_limit_are_refused() -> None:
    beyond = HOME + np.radians([0, 0, 0, 0, 0, 400.0])
    assert clear_poses(CELL, S1100, np.array([HOME, beyond])).tolist() == [True, False]
    with pytest.raises(Blocked) as caught:
        check_poses(CELL, S1100, beyond[None], "a pose")
    assert caught.value.code == "HC-B33"


# -- ways that were proven together: each is clear wherever within the reserve it is driven -------


FARTHER = LEFT - np.radians([5.0, 0, 0, 0, 0, 0])


def around_of(cell: Cell) -> Surroundings:
    assert cell.surroundings is not None
    return cell.surroundings


def least_mm(cell: Cell, start: Array, end: Array) -> float:
    """Return the least clearance that 200 looks at a motion between postures (7,) find."""
    ways = start + np.linspace(0, 1, 200)[:, None] * (end - start)
    body = around_of(cell)._body
    return float(body.clearances_mm(ways, np.full((len(ways), 1), np.inf)).min())


def beside_wall(joints_rad: Array, gap_mm: float) -> Cell:
    """The cell with a wall in front of the arm, so far from it."""
    face_mm, size_mm = 9000.0, (1000.0, 9000.0, 9000.0)
    body = around_of(with_box(CELL, face_mm + 500.0, 0.0, 1500.0, size_mm))._body
    enough = np.full((1, 1), np.inf)
    found = body.clearances_mm(posture(S1100.strip_mm, joints_rad)[None], enough)
    wall = len(body.fixed.half_mm) - 1
    at_mm = face_mm + 500.0 - found[0, :, wall].min() + gap_mm
    return with_box(CELL, at_mm, 0.0, 1500.0, size_mm)


def deviations(rng: np.random.Generator, cell: Cell, start: Array, by_mm: float) -> list[Array]:
    """Return postures (7,) that are off by as much, by the levers: on one axis, and on several."""
    single = [sign * axis for axis in np.eye(7) for sign in (1.0, -1.0)]
    several = [*rng.standard_normal((4, 7))]
    around = around_of(cell)
    offs = [off * 1e-6 for off in (*single, *several)]
    return [start + off * by_mm / around.apart_mm(start, start + off) for off in offs]


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_a_way_within_the_reserve_of_a_proven_one_is_clear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted_mm, rail_mm = around_of(CELL).wanted_mm, S1100.strip_mm
    from_rad, to_rad = HOME + np.radians(rng.uniform(-15.0, 15.0, (2, 6)))
    cell = beside_wall(from_rad, wanted_mm + rng.uniform(0.0, 1.4 * RESERVE_MM))
    coming = UpcomingPoses(cell)
    coming.expect(rail_mm, np.array([from_rad, to_rad]))
    for read in deviations(rng, cell, posture(rail_mm, from_rad), 0.99 * RESERVE_MM):
        if coming.clear(read[0], read[1:], to_rad):
            below = posture(read[0], to_rad - np.radians(cell.robot.approach_deg))
            assert least_mm(cell, read, below) >= wanted_mm
            assert least_mm(cell, below, posture(read[0], to_rad)) >= wanted_mm


def test_a_way_from_beyond_the_reserve_is_proven_by_itself() -> None:
    rng, coming, start = (
        np.random.default_rng(1),
        UpcomingPoses(CELL),
        posture(S1100.strip_mm, LEFT),
    )
    coming.expect(S1100.strip_mm, np.array([LEFT, FARTHER]))
    for share, within in ((0.99, True), (1.01, False)):
        for read in deviations(rng, CELL, start, share * RESERVE_MM):
            assert coming.clear(read[0], read[1:], FARTHER) == within
    assert not coming.clear(S1100.strip_mm, LEFT, FARTHER + 1e-12)


def test_a_robot_that_stands_nowhere_is_within_no_reserve() -> None:
    coming = UpcomingPoses(CELL)
    coming.expect(S1100.strip_mm, np.array([LEFT, FARTHER]))
    for axis, value in product(range(7), (np.nan, np.inf)):
        read = posture(S1100.strip_mm, LEFT)
        read[axis] = value
        with np.errstate(invalid="ignore"):
            assert not coming.clear(read[0], read[1:], FARTHER)


def test_both_paths_are_proven_with_the_reserve() -> None:
    """To below the pose, and from there: a wall is too near to one end of either."""
    low = HOME - np.radians(CELL.robot.approach_deg)
    for from_rad, to_rad in ((HOME, LEFT), (low, HOME)):
        for more_mm, enough in ((-1.0, False), (RESERVE_MM - 1.0, False), (RESERVE_MM + 1.0, True)):
            cell = beside_wall(HOME, around_of(CELL).wanted_mm + more_mm)
            coming = UpcomingPoses(cell)
            coming.expect(S1100.strip_mm, np.array([from_rad, to_rad]))
            assert coming.clear(S1100.strip_mm, from_rad, to_rad) == enough


def test_a_cell_without_volumes_expects_nothing() -> None:
    coming = UpcomingPoses(bare(CELL))
    coming.expect(S1100.strip_mm, np.array([LEFT, FARTHER]))
    assert not coming.clear(S1100.strip_mm, LEFT, FARTHER)


def test_what_leaves_the_cube_does_so_expected_or_not() -> None:
    cube_rad = CELL.robot.nominal().joints_for(CELL.grid.centre.matrix()[None])
    poses_rad = np.vstack([cube_rad, LEFT])
    for expected in (poses_rad[:0], poses_rad):
        coming = UpcomingPoses(CELL)
        coming.expect(S1100.strip_mm, expected)
        found = [coming.leaves_cube(joints_rad) for joints_rad in poses_rad]
        assert found == leaves_cube(CELL, poses_rad).tolist() == [False, True]


# -- in a run -------------------------------------------------------------------------------------


def visited(bed: Bed, *poses_rad: Array, swept_rad: Array | None = None) -> str:
    """Go to joints (6,) in turn, expected; a sweep comes before the last. Return the fault."""

    def go(session: CellSession, number: int) -> None:
        session.expect(S1100, np.array(poses_rad))
        for joints_rad in poses_rad:
            if joints_rad is poses_rad[-1] and swept_rad is not None:
                with session.admitted() as sweep:
                    sweep.begin(swept_rad, "sweep")
                bed.robot.joints_rad = swept_rad
            session.robot_to(joints_rad, "a point")

    bed.robot.joints_rad = LEFT
    return bed.fault_of(go)


def test_ways_that_come_as_expected_are_proven_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proven, prove = list[int](), Surroundings.prove

    def counted(around: Surroundings, start: Array, end: Array, more_mm: float = 0.0) -> Proof:
        proven.append(len(start))
        return prove(around, start, end, more_mm)

    monkeypatch.setattr(Surroundings, "prove", counted)
    bed = Bed(tmp_path, cell=POST)
    assert visited(bed, LEFT, FARTHER, LEFT + 1e-3) == ""
    assert bed.robot.moves == 6
    assert proven == [6, 2]  # it comes from elsewhere than its safe pose


def test_a_pose_that_is_expected_from_below_is_driven_to_from_above(bed: Bed) -> None:
    def go(session: CellSession, number: int) -> None:
        session.expect(S1100, FARTHER[None])
        id = PointId("reversal", vertex=(0, 0, 0), side=1)
        session.flange_point(id, S1100, FARTHER)

    bed.run(procedure(Points(1, go)))
    beyond = FARTHER + np.radians(CELL.robot.approach_deg)
    np.testing.assert_array_equal(bed.robot.targets[-2:], [beyond, FARTHER])


def test_a_robot_that_comes_from_elsewhere_has_its_way_proven_again(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=POST)
    assert visited(bed, LEFT, FARTHER, swept_rad=RIGHT) == "HC-B34"
    assert bed.robot.moves == 2


# -- where the robot was never driven outside of the cube, it goes slowly, and somebody watches ---


FAR_OUT = HOME + np.radians([20.0, 0.0, 0.0, 0.0, 0.0, 0.0])
CUBE = joints_for(CELL, Repeatability.places_mm(CELL))[0]
SLOW, USUAL = CELL.robot.first_pass_percent, CELL.robot.speed_percent


def pausing(cell: Cell) -> Cell:
    robot = msgspec.structs.replace(cell.robot, first_pass_pause=True)
    return msgspec.structs.replace(cell, robot=robot)


def driven(*poses: Array) -> Callable[[CellSession, int], None]:
    def act(session: CellSession, number: int) -> None:
        for joints in poses:
            session.robot_to(joints, "a pose")

    return act


def performed(bed: Bed, *poses: Array) -> None:
    assert bed.run(procedure(Points(1, driven(*poses)))) == 0


def test_a_pose_outside_is_driven_to_slowly_once(bed: Bed) -> None:
    performed(bed, FAR_OUT, HOME, CUBE, FAR_OUT, FAR_OUT + np.radians(0.5))
    assert bed.robot.speeds == [SLOW] * 4 + [USUAL] * 6
    (event,) = bed.events("first pass")
    assert (event["key"], event["speed_percent"]) == ("a pose", SLOW)


@pytest.mark.parametrize("axis", [0, 5])
def test_another_pose_is_not_known(bed: Bed, axis: int) -> None:
    other = FAR_OUT.copy()
    other[axis] += np.radians(1.5)
    performed(bed, FAR_OUT, other)
    assert bed.robot.speeds == [SLOW] * 4


def test_the_same_pose_at_another_place_is_not_known(bed: Bed) -> None:

    def act(session: CellSession, number: int) -> None:
        for joints in (FAR_OUT, CUBE, FAR_OUT, CUBE):
            session.robot_to(joints, "here")
        bed.rail.position_mm += 6.0
        session.robot_to(FAR_OUT, "there")

    assert bed.run(procedure(Points(1, act))) == 0
    assert bed.robot.speeds == [SLOW] * 2 + [USUAL] * 6 + [SLOW] * 2


def test_a_resumed_run_knows_only_motions_that_came_to_their_end(bed: Bed) -> None:

    def lost(session: CellSession, number: int) -> None:
        session.robot_to(HOME, "arrives")
        session.robot_to(FAR_OUT, "may have arrived")
        raise RuntimeError("the engine dies")

    bed.run(procedure(Points(1, lost)))
    bed.robot.speeds.clear()
    performed(bed, HOME, FAR_OUT)
    assert bed.robot.speeds == [USUAL, USUAL, SLOW, SLOW]


def test_a_finished_run_s_poses_are_known_to_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
    performed(Bed(tmp_path / "first"), FAR_OUT)
    monkeypatch.setitem(PLAN, "driven_by", ["deleted", "first"])
    bed = Bed(tmp_path / "second")
    performed(bed, FAR_OUT, HOME)
    assert bed.robot.speeds == [USUAL, USUAL, SLOW, SLOW]
    (event,) = bed.events("earlier run unreadable")
    assert event["run"] == "deleted"


def test_an_attended_run_pauses_before_the_first_of_them(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL), unattended=False)
    with Live(bed, procedure(Points(1, driven(CUBE, FAR_OUT, HOME)))) as live:
        live.until("state", "paused")
        assert bed.robot.speeds == [USUAL, USUAL]
        live.runner.post("proceed")
        until(lambda: live.code == 0)
    assert bed.robot.speeds == [USUAL] * 2 + [SLOW] * 4
    (paused,) = bed.entered("paused")
    assert "a pose" in paused["reason"]


def test_a_run_that_waits_there_can_be_stopped(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL), unattended=False)
    with Live(bed, procedure(Points(1, driven(FAR_OUT)))) as live:
        live.until("state", "paused")
        live.runner.stop()
    assert bed.robot.speeds == []
    assert bed.states()[-1] == "aborted"


def test_a_run_that_nobody_attends_goes_on(tmp_path: Path) -> None:
    bed = Bed(tmp_path, cell=pausing(CELL))
    performed(bed, FAR_OUT)
    assert bed.robot.speeds == [SLOW, SLOW]
    assert "paused" not in bed.states()
