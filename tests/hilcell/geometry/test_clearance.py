"""Distances of capsules from boxes are exact; a motion counts as clear only where all of it is."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.cell.file import load_cell
from hilcell.cell.surroundings import posture
from hilcell.geometry.clearance import (
    Body,
    Boxes,
    Capsules,
    clearance_mm,
    joint_lines,
    levers_mm,
    placed_mm,
    segment_to_box_mm,
)
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.kinematics import Arm, Array, forward, link_transforms
from tests.hilcell.geometry.test_kinematics import arm_of

SEEDS = st.integers(0, 2**32 - 1)
LOOKS = 1001


def capsules_of(arm: Arm, rng: np.random.Generator) -> Capsules:
    lines = [(link, line) for link in range(1, 7) for line in joint_lines(arm, link)]
    lines += [(3, rng.uniform(-300, 300, (2, 3)))]  # a part that sticks out
    return Capsules(
        np.array([link for link, _ in lines]),
        np.array([line for _, line in lines]),
        rng.uniform(10, 200, len(lines)),
    )


def boxes_of(rng: np.random.Generator, count: int = 3) -> Boxes:
    frames = [
        pose_from_zyx(*rng.uniform(-2000, 2000, 3), *rng.uniform(-180, 180, 3))
        for _ in range(count)
    ]
    return Boxes(np.array(frames), rng.uniform(5, 800, (count, 3)))


def sampled_mm(ends_mm: Array, half_mm: Array) -> tuple[float, float]:
    """Return the least distance of many points of a segment from a box, and their distance."""
    points = ends_mm[0] + np.linspace(0, 1, LOOKS)[:, None] * (ends_mm[1] - ends_mm[0])
    beyond = np.maximum(np.abs(points) - half_mm, 0.0)
    step_mm = float(np.linalg.norm(ends_mm[1] - ends_mm[0])) / (LOOKS - 1)
    return float(np.linalg.norm(beyond, axis=1).min()), step_mm


@given(SEEDS, st.sampled_from([0.0, 1.0, 30.0]))
def test_a_segment_is_as_near_as_its_nearest_point(seed: int, grid_mm: float) -> None:
    rng = np.random.default_rng(seed)
    ends, half = rng.uniform(-100, 100, (8, 2, 3)), rng.uniform(1, 60, (8, 3))
    if grid_mm:  # parallel to faces, through edges and corners, points for segments
        ends, half = np.round(ends / grid_mm) * grid_mm, np.ceil(half / grid_mm) * grid_mm
    for found, segment, edges in zip(segment_to_box_mm(ends, half), ends, half, strict=True):
        nearest_mm, step_mm = sampled_mm(segment, edges)
        assert nearest_mm - step_mm / 2 - 1e-9 <= found <= nearest_mm + 1e-9


@pytest.mark.parametrize("where", list(np.ndindex(2, 3)))
def test_an_end_that_is_no_number_has_no_distance(where: tuple[int, int]) -> None:
    ends = np.array([[0.0, 0.0, 50.0], [30.0, 0.0, 50.0]])
    ends[where] = np.nan
    assert np.isnan(segment_to_box_mm(ends[None], np.full((1, 3), 10.0))).all()


@given(SEEDS)
def test_lines_run_from_joint_to_joint(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, joints = arm_of(rng), rng.uniform(-np.pi, np.pi, 6)
    capsules = capsules_of(arm, rng)
    ends = placed_mm(arm, capsules, joints[None])[0]
    frame, origins = np.eye(4), [np.zeros(3)]
    for link in link_transforms(arm, joints):
        frame = frame @ link
        origins.append(frame[:3, 3])
    origins.append(forward(arm, joints)[:3, 3])
    chain = ends[:-1].reshape(-1, 3)
    column_mm = arm.d_mm[0] * np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(chain[0], column_mm, atol=1e-6)
    np.testing.assert_allclose(chain[2::2], chain[1:-1:2], atol=1e-6)  # without a gap
    for origin in origins[1:]:
        assert np.linalg.norm(chain - origin, axis=1).min() < 1e-6


@given(SEEDS)
def test_no_point_travels_farther_than_its_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = arm_of(rng)
    capsules = capsules_of(arm, rng)
    start, end = rng.uniform(-np.pi, np.pi, (2, 6))
    if seed % 3 == 0:  # one axis alone
        end = np.where(np.arange(6) == seed % 6, end, start)
    ways = start + np.linspace(0, 1, 200)[:, None] * (end - start)
    steps_mm = np.linalg.norm(np.diff(placed_mm(arm, capsules, ways), axis=0), axis=-1)
    bound_mm = levers_mm(arm, capsules) @ np.abs(end - start)
    assert bool(np.all(steps_mm.sum(axis=0).max(axis=-1) <= bound_mm * (1 + 1e-9) + 1e-6))


@given(SEEDS, st.floats(-200, 800))
def test_clearances_are_exact_where_they_are_not_enough(seed: int, enough_mm: float) -> None:
    rng = np.random.default_rng(seed)
    arm, boxes = arm_of(rng), boxes_of(rng)
    capsules = capsules_of(arm, rng)
    ends = placed_mm(arm, capsules, rng.uniform(-np.pi, np.pi, (4, 6)))
    found = clearance_mm(
        ends, capsules.radius_mm, boxes, np.full(ends.shape[:2], enough_mm), np.zeros((4, 3, 3))
    )
    for volume, (frame, half_mm) in enumerate(zip(boxes.frames, boxes.half_mm, strict=True)):
        back = inverse(frame)
        within = ends @ back[:3, :3].T + back[:3, 3]
        flat = segment_to_box_mm(
            within.reshape(-1, 2, 3), np.tile(half_mm, (ends[..., 0, 0].size, 1))
        )
        exact = flat.reshape(ends.shape[:2]) - capsules.radius_mm
        short = exact < enough_mm
        np.testing.assert_allclose(found[..., volume][short], exact[short], atol=1e-6)
        assert bool(np.all(found[..., volume][~short] >= min(enough_mm, np.inf) - 1e-6))
        assert bool(np.all(found[..., volume] <= exact + 1e-6))


CELL = load_cell("paper")
ARM = CELL.robot.arm()
LOW, HIGH = CELL.robot.margin_limits_rad
HOME = np.radians(CELL.robot.home_deg)
WANTED_MM = 40.0
NONE = Boxes(np.zeros((0, 4, 4)), np.zeros((0, 3)))


def body(fixed: Boxes, carried: Boxes = NONE) -> Body:
    lines = [(link, line) for link in range(1, 7) for line in joint_lines(ARM, link)]
    capsules = Capsules(
        np.array([link for link, _ in lines]),
        np.array([line for _, line in lines]),
        np.full(len(lines), 100.0),
    )
    layout = CELL.layout
    base, direction = layout.nominal_base(0.0), np.array(layout.rail_direction)
    return Body(ARM, capsules, base, direction, fixed, carried)


def box(
    x_mm: float, y_mm: float, z_mm: float, size_mm: tuple[float, float, float] = (100, 100, 100)
) -> Boxes:
    frame = pose_from_zyx(x_mm, y_mm, z_mm, 0.0, 0.0, 0.0)
    return Boxes(frame[None], np.array([size_mm]) / 2)


def looked_at_mm(around: Body, start: Array, end: Array) -> float:
    """Return the least clearance that 200 looks at a motion find."""
    ways = start + np.linspace(0, 1, 200)[:, None] * (end - start)
    return float(around.clearances_mm(ways, np.full((len(ways), 1), np.inf)).min())


def test_what_rides_is_as_near_wherever_the_slide_stands() -> None:
    around = body(NONE, box(1500.0, 0.0, 900.0))
    near, far = (posture(at_mm, HOME) for at_mm in (0.0, 2000.0))
    assert looked_at_mm(around, near, near) == looked_at_mm(around, far, far)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_what_is_proven_clear_is_clear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [
        pose_from_zyx(*rng.uniform(-2500, 2500, 3), *rng.uniform(-180, 180, 3)) for _ in range(2)
    ]
    boxes = Boxes(np.array(frames), rng.uniform(50, 400, (2, 3)))
    around = body(boxes) if seed % 2 else body(NONE, boxes)
    starts, ends = (posture(1100.0, rng.uniform(LOW, HIGH, (4, 6))) for _ in range(2))
    if seed % 3 == 0:
        ends[:, 0] = 300.0  # the slide moves, too
    proof = around.prove(starts, ends, WANTED_MM)
    for clear, start, end in zip(proof.clear, starts, ends, strict=True):
        least_mm = looked_at_mm(around, start, end)
        if clear:
            assert least_mm >= WANTED_MM
        else:  # 200 looks come nearer to the least clearance than this
            assert least_mm < WANTED_MM + 2 * Body.RESOLUTION_MM + 40.0


def test_a_posture_that_is_no_number_proves_nothing() -> None:
    around = body(box(0.0, 0.0, -5000.0))
    ends = posture(0.0, HOME), posture(0.0, HOME + 0.1)
    assert around.prove(ends[0][None], ends[1][None], WANTED_MM).clear.tolist() == [True]
    for axis, value, which in product(range(7), (np.nan, np.inf), (0, 1)):
        spoilt = [each.copy()[None] for each in ends]
        spoilt[which][0, axis] = value
        with np.errstate(invalid="ignore"):
            assert around.prove(spoilt[0], spoilt[1], WANTED_MM).clear.tolist() == [False]


def test_a_base_that_is_no_number_proves_nothing() -> None:
    around = body(box(0.0, 0.0, -5000.0))
    nowhere = replace(around, base=np.full((4, 4), np.nan))
    start, end = posture(0.0, HOME), posture(0.0, HOME + 0.1)
    assert nowhere.prove(start[None], end[None], WANTED_MM).clear.tolist() == [False]


@pytest.mark.parametrize("value", [1e12, 1e307, 1e308])
def test_a_motion_from_beyond_all_reach_is_refused_at_once(value: float) -> None:
    start, end = posture(1100.0, HOME), posture(1100.0, HOME)
    start[0] = value
    with np.errstate(over="ignore"):
        assert not body(box(0, 0, 5000)).prove(start[None], end[None], WANTED_MM).clear.any()


def test_a_motion_is_clear_as_a_whole_or_not_at_all() -> None:
    """A post 20 mm thick in the middle of a turn of axis 1: both ends are far from it."""
    start, end = np.tile(posture(0.0, HOME), (2, 1))
    start[1], end[1] = np.radians([-60.0, 60.0])
    tip_mm = 1500.0
    post = box(-1850.0 + tip_mm, -1100.0, 1500.0, size_mm=(20.0, 20.0, 6000.0))
    around = body(post)
    for half in (start, end):
        assert around.prove(half[None], half[None], WANTED_MM).clear.tolist() == [True]
    proof = around.prove(start[None], end[None], WANTED_MM)
    assert proof.clear.tolist() == [False]
    tightest = around.tightest(start, end, float(proof.share[0]))
    assert tightest.clearance_mm < 0.0
    assert tightest.share == pytest.approx(0.5, abs=0.1)


def test_many_motions_are_judged_each_for_itself() -> None:
    post = body(box(-350.0, -1100.0, 1500.0, size_mm=(20.0, 20.0, 6000.0)))
    start, end = np.tile(posture(0.0, HOME), (2, 3, 1))
    end[:, 1] = np.radians([-60.0, 60.0, 90.0])
    start[:, 1] = np.radians([-90.0, -60.0, 60.0])
    assert post.prove(start, end, WANTED_MM).clear.tolist() == [True, False, True]


@pytest.mark.parametrize(("from_mm", "to_mm", "clear"), [(0, 800, True), (0, 3000, False)])
def test_a_ride_of_the_slide_is_a_motion(from_mm: float, to_mm: float, clear: bool) -> None:
    post = body(box(-350.0, 1200.0, 1500.0, size_mm=(20.0, 20.0, 6000.0)))
    start, end = posture(from_mm, HOME), posture(to_mm, HOME)
    assert post.prove(start[None], end[None], WANTED_MM).clear.tolist() == [clear]
    riding = body(NONE, box(0.0, 0.0, -300.0))  # moves with the arm
    assert riding.prove(start[None], end[None], WANTED_MM).clear.tolist() == [True]


def test_the_wanted_clearance_is_kept_to_the_resolution() -> None:
    """Standing still, the proof is exact; a motion beside a wall is proven to 1 mm."""
    start, end = posture(0.0, HOME), posture(500.0, HOME)
    wall = body(box(-1850.0 + 3000.0, 0.0, 1500.0, size_mm=(100.0, 9000.0, 9000.0)))
    least_mm = looked_at_mm(wall, start, start)
    for wanted_mm, clear in ((least_mm - 1e-6, True), (least_mm + 1e-6, False)):
        assert wall.prove(start[None], start[None], wanted_mm).clear.tolist() == [clear]
    for wanted_mm, clear in ((least_mm - 1.01, True), (least_mm + 0.01, False)):
        assert wall.prove(start[None], end[None], wanted_mm).clear.tolist() == [clear]
