"""Ways that were proven together: each is clear wherever within the reserve it is driven."""

from itertools import product
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.cell.file import Cell, KeepOut, Pose
from hilcell.cell.surroundings import Surroundings, posture
from hilcell.geometry.clearance import Proof
from hilcell.model.point import PointId
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import RESERVE_MM, UpcomingPoses, leaves_cube
from tests.hilcell.run.bed import CELL, Bed
from tests.hilcell.run.rig import Points, procedure

S1100 = CELL.station_named("S1100")
HOME = np.radians(CELL.robot.home_deg)
LEFT, RIGHT = (HOME + np.radians([side, 0, 0, 0, 0, 0]) for side in (-60.0, 60.0))
FARTHER = LEFT - np.radians([5.0, 0, 0, 0, 0, 0])


def with_box(x_mm: float, y_mm: float, size_mm: tuple[float, float, float]) -> Cell:
    part = KeepOut(name="part", centre=Pose(x_mm=x_mm, y_mm=y_mm, z_mm=1500.0), size_mm=size_mm)
    return msgspec.structs.replace(CELL, keep_out=[*CELL.keep_out, part])


# 1.5 m in front of the robot at S1100: the arm cannot turn past it.
POST = with_box(-350.0, 0.0, (60.0, 60.0, 4000.0))


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
    body = around_of(with_box(face_mm + 500.0, 0.0, size_mm))._body
    enough = np.full((1, 1), np.inf)
    found = body.clearances_mm(posture(S1100.strip_mm, joints_rad)[None], enough)
    wall = len(body.fixed.half_mm) - 1
    return with_box(face_mm + 500.0 - found[0, :, wall].min() + gap_mm, 0.0, size_mm)


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
    for share, clear in ((0.99, True), (1.01, False)):
        for read in deviations(rng, CELL, start, share * RESERVE_MM):
            assert coming.clear(read[0], read[1:], FARTHER) == clear
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
        for more_mm, clear in ((-1.0, False), (RESERVE_MM - 1.0, False), (RESERVE_MM + 1.0, True)):
            cell = beside_wall(HOME, around_of(CELL).wanted_mm + more_mm)
            coming = UpcomingPoses(cell)
            coming.expect(S1100.strip_mm, np.array([from_rad, to_rad]))
            assert coming.clear(S1100.strip_mm, from_rad, to_rad) == clear


def test_a_cell_without_volumes_expects_nothing() -> None:
    robot = msgspec.structs.replace(CELL.robot, envelope=None)
    coming = UpcomingPoses(msgspec.structs.replace(CELL, robot=robot, keep_out=[]))
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


def visit(bed: Bed, *poses_rad: Array, swept_rad: Array | None = None) -> str:
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
    assert visit(bed, LEFT, FARTHER, LEFT + 1e-3) == ""
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
    assert visit(bed, LEFT, FARTHER, swept_rad=RIGHT) == "HC-B34"
    assert bed.robot.moves == 2
