"""Errors at scattered poses: what is predicted there, and what the one covariance says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.compensation.scattered import NearestPoses, Nominal
from hilcell.geometry.kinematics import Array
from hilcell.identification.readings import Ints
from hilcell.identification.repeats import FOLDS

seeds = st.integers(0, 2**32 - 1)


def folds(count: int) -> Ints:
    return np.arange(count) % FOLDS


def poses(seed: int, count: int = 60) -> tuple[Array, Array]:
    """Return points and errors (N, 3): smooth ones with 20 um of noise."""
    rng = np.random.default_rng(seed)
    points_mm = rng.uniform(0, 1000, (count, 3))
    return points_mm, points_mm @ rng.normal(0, 5e-4, (3, 3)) + rng.normal(0, 0.02, (count, 3))


@given(seeds)
def test_a_pose_is_predicted_exactly_and_others_between_its_neighbours(seed: int) -> None:
    points_mm, errors_mm = poses(seed)
    model = NearestPoses.learn(points_mm, errors_mm, folds(60))
    np.testing.assert_allclose(model.predict(points_mm).error_mm, errors_mm, atol=1e-12)
    found_mm = model.predict(points_mm[:5] + 1.0).error_mm
    assert (found_mm >= errors_mm.min(axis=0)).all()
    assert (found_mm <= errors_mm.max(axis=0)).all()


@pytest.mark.parametrize("count", [8, 60])
def test_the_covariance_is_the_mean_square_of_poses_left_out(count: int) -> None:
    points_mm, errors_mm = poses(5, count)
    missed = []
    for number in range(count):
        kept = [n for n in range(count) if n % FOLDS != number % FOLDS]
        model = NearestPoses.learn(points_mm[kept], errors_mm[kept], folds(len(kept)))
        missed.append(errors_mm[number] - model.predict(points_mm[[number]]).error_mm[0])
    model = NearestPoses.learn(points_mm, errors_mm, folds(count))
    found = model.predict(points_mm[:3] + 7.0).covariance_mm2
    wanted = sum(np.outer(each, each) for each in missed) / count
    np.testing.assert_allclose(found, np.tile(wanted, (3, 1, 1)), rtol=1e-9)
    assert np.linalg.eigvalsh(wanted).min() > 0


def test_nominal_kinematics_predict_no_error_and_know_how_large_it_is() -> None:
    points_mm, errors_mm = poses(6)
    found = Nominal.learn(points_mm, errors_mm, folds(60)).predict(points_mm[:4])
    assert (found.error_mm == 0).all()
    np.testing.assert_allclose(found.covariance_mm2[3], errors_mm.T @ errors_mm / len(errors_mm))
