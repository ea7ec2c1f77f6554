"""Nests that moved on their slide are found by distances, whatever the frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.geometry.frames import apply, pose_from_zyx
from hilcell.geometry.kinematics import Array
from procedures.station_frames import SIGMAS, moved_points

angle = st.floats(-180, 180)
length = st.floats(-5000, 5000)
poses = st.builds(pose_from_zyx, length, length, length, angle, angle, angle)
seeds = st.integers(0, 2**32 - 1)
NESTS = np.array(
    [
        [350, -350, 60], [350, 350, 60], [-350, 350, 90], [-350, -350, 90.0],
        [300, -350, 420], [300, 350, 420], [-300, 350, 450], [-300, -350, 450],
    ]
)  # fmt: skip
SIGMA_MM = 0.004
NOISE_MM2 = np.tile(SIGMA_MM**2 * np.eye(3), (8, 1, 1))


def seen(T: Array, seed: int) -> Array:
    noise_mm = np.random.default_rng(seed).normal(0.0, SIGMA_MM, NESTS.shape)
    moved: Array = apply(T, NESTS) + noise_mm
    return moved


@given(poses)
def test_a_rigid_slide_has_moved_no_nest(T: Array) -> None:
    found = moved_points(NESTS, apply(T, NESTS), NOISE_MM2)
    assert (found.moved, found.kept) == ((), tuple(range(8)))


def test_noise_moves_no_nest() -> None:
    still = [moved_points(NESTS, seen(np.eye(4), seed), NOISE_MM2).moved for seed in range(200)]
    assert still.count(()) >= 198


@given(poses, st.integers(0, 7), seeds)
def test_the_one_that_moved_is_named(T: Array, nest: int, seed: int) -> None:
    later = seen(T, seed)
    direction = np.random.default_rng(seed).standard_normal(3)
    later[nest] += 0.15 * direction / np.linalg.norm(direction)
    found = moved_points(NESTS, later, NOISE_MM2)
    assert found.moved == (nest,)
    assert found.worst_mm > found.limit_mm > SIGMAS * SIGMA_MM


@pytest.mark.parametrize("swapped", [(0, 5), (2, 7)])
def test_two_that_changed_places_are_both_named(swapped: tuple[int, int]) -> None:
    later = NESTS.copy()
    later[list(swapped)] = later[list(swapped[::-1])]
    assert moved_points(NESTS, later, NOISE_MM2).moved == swapped


def test_what_is_not_a_number_has_moved() -> None:
    later = NESTS.copy()
    later[3, 1] = np.nan
    assert moved_points(NESTS, later, NOISE_MM2).moved == (3,)


def test_of_three_nobody_knows_which() -> None:
    later = NESTS[:3].copy()
    later[1, 0] += 0.2
    assert len(moved_points(NESTS[:3], later, NOISE_MM2[:3]).kept) < 3
