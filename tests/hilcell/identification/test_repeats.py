"""Rows of one pose are known by their joints, in any order and under any number."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hilcell.identification.measured_poses import (
    FOLDS,
    SAME_RAD,
    count_poses,
    pose_folds,
    pose_numbers,
)

seeds = st.integers(0, 2**32 - 1)


@given(seeds)
def test_rows_of_one_pose_are_found_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = rng.permutation(np.repeat(np.arange(40), 3))
    joints = rng.uniform(-2.0, 2.0, (40, 6))[pose] + rng.uniform(0.0, SAME_RAD / 2, (120, 6))
    found, fold = pose_numbers(joints), pose_folds(joints)
    assert count_poses(joints) == 40
    for each in range(40):
        assert len(set(found[pose == each])) == len(set(fold[pose == each])) == 1
    order = rng.permutation(120)
    np.testing.assert_array_equal(pose_folds(joints[order]), fold[order])
    sizes = np.bincount(fold, minlength=FOLDS)
    assert sizes.min() >= 3 * 7
    assert sizes.max() <= 3 * 9


def test_small_steps_along_a_line_stay_different_poses() -> None:
    joints = np.zeros((100, 6))
    joints[:, 3] = 0.6 * SAME_RAD * np.arange(100)
    assert count_poses(joints) == 50


def test_five_poses_are_five_folds() -> None:
    assert sorted(pose_folds(np.eye(6)[:5])) == [0, 1, 2, 3, 4]
