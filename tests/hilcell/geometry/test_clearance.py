"""Distances of capsules from boxes are exact, and bounds of travel are bounds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.geometry.clearance import (
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
