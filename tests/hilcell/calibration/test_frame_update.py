"""A frame corrected by points: weights decide, a bad point is left out, nothing gets worse."""

import numpy as np
import pytest

from hilcell.calibration.touch import updated_frame
from hilcell.geometry.frames import (
    FrameError,
    apply,
    cross_matrix,
    from_rotvec,
    matrix,
    pose_from_zyx,
)
from hilcell.geometry.kinematics import Array

T = pose_from_zyx(-1850.0, 0.0, 300.0, 20.0, -10.0, 5.0)
RNG = np.random.default_rng(7)
A_MM = np.array([1850.0, 0.0, 950.0]) + RNG.uniform(-450.0, 450.0, (8, 3))
SIGMA_MM = 0.03
NOISE_MM2 = np.tile(SIGMA_MM**2 * np.eye(3), (8, 1, 1))
ALONG = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
SLIP = 0.016**2 * np.outer(ALONG, ALONG)
PRIOR = np.diag([1e-4] * 3 + [2.5e-11] * 3)


def moved(x: Array) -> Array:
    """Return the frame after a shift and a rotation (6,)."""
    return matrix(from_rotvec(x[3:]) @ T[:3, :3], T[:3, 3] + x[:3])


def noisy(at: Array, rng: np.random.Generator) -> Array:
    points: Array = apply(at, A_MM) + rng.normal(0.0, SIGMA_MM, A_MM.shape)
    return points


def test_exact_points_and_a_wide_prior_give_the_frame() -> None:
    true = moved(np.array([0.02, -0.03, 0.01, 1e-5, -2e-5, 3e-5]))
    found = updated_frame(T, np.diag([1.0] * 3 + [1e-6] * 3), A_MM, apply(true, A_MM), NOISE_MM2)
    np.testing.assert_allclose(apply(found.T, A_MM), apply(true, A_MM), atol=1e-3)
    assert found.left_out == ()


def test_points_that_know_nothing_change_nothing() -> None:
    found = updated_frame(T, PRIOR, A_MM, apply(T, A_MM) + 0.5, 1e12 * NOISE_MM2)
    np.testing.assert_allclose(found.T, T, atol=1e-9)
    np.testing.assert_allclose(found.covariance, PRIOR, rtol=1e-6, atol=1e-18)


def test_a_frame_that_is_known_exactly_stays() -> None:
    found = updated_frame(T, np.zeros((6, 6)), A_MM, apply(T, A_MM) + 0.02, NOISE_MM2)
    np.testing.assert_array_equal(found.T, T)


def test_growth_from_the_centre_is_no_shift() -> None:
    wide, centre_mm = np.diag([1.0] * 3 + [1e-6] * 3 + [1e-8]), A_MM.mean(axis=0)
    true = moved(np.array([0.02, -0.03, 0.01, 1e-5, -2e-5, 3e-5]))
    grown_mm = centre_mm + (1.0 + 5e-5) * (A_MM - centre_mm)
    exact = NOISE_MM2 * 1e-4
    found = updated_frame(T, wide, A_MM, apply(true, grown_mm), exact, centre_mm)
    assert found.growth == pytest.approx(5e-5, rel=0.01)
    np.testing.assert_allclose(apply(found.T, A_MM), apply(true, A_MM), atol=1e-3)
    assert updated_frame(T, wide[:6, :6], A_MM, apply(true, A_MM), exact).growth == 0.0


def test_a_slip_along_one_direction_is_found_and_no_other() -> None:
    """The prior is singular: it allows this motion alone."""
    off_mm = np.array([0.04, 0.02, -0.03])
    found = updated_frame(T, SLIP, A_MM, apply(T, A_MM) + off_mm, NOISE_MM2)
    np.testing.assert_allclose(found.T[:3, :3], T[:3, :3], atol=1e-12)
    shift = found.T[:3, 3] - T[:3, 3]
    np.testing.assert_allclose(shift[[0, 2]], 0.0, atol=1e-9)
    assert 0.6 * 0.02 < shift[1] < 0.02


def test_the_covariance_is_that_of_the_errors_left() -> None:
    """Over many draws of frame and points; the cube's centre is far better known than before."""
    rng, squares, at_mm = np.random.default_rng(11), [], A_MM.mean(axis=0)
    J = np.hstack([np.eye(3), -cross_matrix(T[:3, :3] @ at_mm)])
    for _ in range(300):
        true = moved(rng.multivariate_normal(np.zeros(6), PRIOR + SLIP))
        each = updated_frame(T, PRIOR + SLIP, A_MM, noisy(true, rng), NOISE_MM2)
        stated = J @ each.covariance @ J.T
        left_mm = (apply(each.T, at_mm[None]) - apply(true, at_mm[None]))[0]
        squares.append(left_mm @ np.linalg.inv(stated) @ left_mm)
        assert np.trace(stated) < 0.5 * np.trace(J @ (PRIOR + SLIP) @ J.T)
    assert np.mean(squares) == pytest.approx(3.0, abs=0.45)


def test_one_bad_point_is_named_and_does_not_count() -> None:
    rng = np.random.default_rng(3)
    good_mm = noisy(T, rng)
    bad_mm = good_mm.copy()
    bad_mm[5] += [0.0, 0.6, 0.2]
    found, clean = (updated_frame(T, PRIOR, A_MM, each, NOISE_MM2) for each in (bad_mm, good_mm))
    assert found.left_out == (5,)
    assert clean.left_out == ()
    np.testing.assert_allclose(found.T[:3, 3], clean.T[:3, 3], atol=0.01)
    assert np.linalg.norm(found.residuals_mm[5]) == pytest.approx(0.63, abs=0.1)


def test_points_better_than_stated_count_more() -> None:
    """A model may state more than its misses are; the residuals show it."""
    rng = np.random.default_rng(5)
    near_mm = apply(T, A_MM) + rng.normal(0.0, 0.3 * SIGMA_MM, A_MM.shape)
    worse_mm = apply(T, A_MM) + rng.normal(0.0, SIGMA_MM, A_MM.shape)
    near, stated = (updated_frame(T, PRIOR, A_MM, b_mm, NOISE_MM2) for b_mm in (near_mm, worse_mm))
    assert near.misfit < 0.5
    assert np.trace(near.covariance[:3, :3]) < 0.8 * np.trace(stated.covariance[:3, :3])


def test_points_worse_than_stated_count_less() -> None:
    far_mm = apply(T, A_MM) + np.random.default_rng(5).normal(0.0, 5 * SIGMA_MM, A_MM.shape)
    found = updated_frame(T, PRIOR, A_MM, far_mm, NOISE_MM2)
    stated = updated_frame(T, PRIOR, A_MM, apply(T, A_MM), NOISE_MM2)
    assert np.trace(found.covariance[:3, :3]) > 1.4 * np.trace(stated.covariance[:3, :3])


def test_points_that_contradict_the_frame_show_it() -> None:
    """A base that rose, against a prior that knows of a slip alone; and a slip too large for it."""
    risen, slipped = (
        updated_frame(T, SLIP, A_MM, apply(T, A_MM) + off_mm, NOISE_MM2)
        for off_mm in ([0.0, 0.0, 0.3], [0.0, 0.3, 0.0])
    )
    assert risen.pull < 0.1
    assert risen.misfit > 5.0
    assert slipped.pull > 8.0
    small = updated_frame(T, SLIP, A_MM, apply(T, A_MM) + [0.0, 0.02, 0.0], NOISE_MM2)
    assert small.pull < 2.0
    assert small.misfit < 1.0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_points_are_enough(count: int) -> None:
    found = updated_frame(T, PRIOR, A_MM[:count], apply(T, A_MM[:count]) + 0.01, NOISE_MM2[:count])
    assert np.isfinite(found.T).all()
    assert np.trace(found.covariance) < np.trace(PRIOR)


@pytest.mark.parametrize("which", range(5))
def test_what_is_not_finite_is_refused(which: int) -> None:
    given = [T.copy(), PRIOR.copy(), A_MM.copy(), apply(T, A_MM), NOISE_MM2.copy()]
    given[which].flat[0] = np.nan
    with pytest.raises(FrameError, match="finite"):
        updated_frame(*given)
