"""Eqs 11-13 and 17 on random rigid motions."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hilcell.calibration.frames import base_at
from hilcell.geometry.frames import apply, inverse, pose_from_zyx, rigid_fit, three_point_frame

angle = st.floats(-180, 180)
length = st.floats(-3000, 3000)
poses = st.builds(pose_from_zyx, length, length, length, angle, angle, angle)
seeds = st.integers(0, 2**32 - 1)
SLIDE = np.array([[350, -350, 60], [350, 350, 60], [-350, 350, 90], [-350, -350, 90.0]])


@given(poses, poses, poses, seeds)
def test_station_frames_carry_measured_data(
    T_W_B1: np.ndarray, move: np.ndarray, T_B_S: np.ndarray, seed: int
) -> None:
    """The rail moves the slide by any rigid motion; all that station 1 measured rides along."""
    in_base = np.random.default_rng(seed).uniform(-2000, 2000, (10, 3))
    T_W_Bi = move @ T_W_B1
    rides = base_at(T_W_B1 @ T_B_S, T_W_Bi @ T_B_S, np.eye(4))
    nominal, actual = (apply(rides @ T_W_B1, points) for points in (in_base, in_base + 1.0))
    np.testing.assert_allclose(nominal, apply(T_W_Bi, in_base), atol=1e-7)
    np.testing.assert_allclose(actual, apply(T_W_Bi, in_base + 1.0), atol=1e-7)


@given(poses, poses, poses, seeds)
def test_equation_13_and_equation_17_agree(
    T_W_B1: np.ndarray, move: np.ndarray, T_B_S: np.ndarray, seed: int
) -> None:
    points = np.random.default_rng(seed).uniform(-2000, 2000, (10, 3))
    T_W_Bi = move @ T_W_B1
    by_base = apply(T_W_Bi @ inverse(T_W_B1), points)
    by_station = apply(base_at(T_W_B1 @ T_B_S, T_W_Bi @ T_B_S, np.eye(4)), points)
    np.testing.assert_allclose(by_station, by_base, atol=1e-7)
    np.testing.assert_allclose(base_at(T_W_B1 @ T_B_S, T_W_Bi @ T_B_S, T_W_B1), T_W_Bi, atol=1e-7)


@given(poses, poses)
def test_three_points_and_best_fit_frames_carry_alike(T_W_B1: np.ndarray, move: np.ndarray) -> None:
    first, there = apply(T_W_B1, SLIDE), apply(move @ T_W_B1, SLIDE)
    one, other = three_point_frame(*first[:3]), three_point_frame(*there[:3])
    by_three = base_at(one, other, np.eye(4))
    np.testing.assert_allclose(by_three, rigid_fit(first, there).T, atol=1e-7)
