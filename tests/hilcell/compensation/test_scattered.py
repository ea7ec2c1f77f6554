"""Errors at scattered poses: what is predicted there, and what the one covariance says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.compensation.grid import GridError
from hilcell.compensation.interpolation import Idw, Trilinear
from hilcell.compensation.model import Measured, StaticPoses
from hilcell.compensation.model_choice import Nominal
from hilcell.identification.measured_poses import FOLDS
from tests.hilcell.compensation.models import level

seeds = st.integers(0, 2**32 - 1)


def poses(seed: int, count: int = 60) -> StaticPoses:
    """Return poses with smooth errors and 20 um of noise; each fifth is left out with others."""
    rng = np.random.default_rng(seed)
    points_mm = rng.uniform(0, 1000, (count, 3))
    error_mm = points_mm @ rng.normal(0, 5e-4, (3, 3)) + rng.normal(0, 0.02, (count, 3))
    unknown_mm2 = np.full((count, 3, 3), np.nan)
    fold = np.arange(count) % FOLDS
    return StaticPoses(np.zeros((count, 6)), level(points_mm), error_mm, unknown_mm2, fold)


@given(seeds)
def test_a_pose_is_predicted_exactly_and_others_between_its_neighbours(seed: int) -> None:
    known = poses(seed)
    model = Idw.learn(Measured(known))
    np.testing.assert_allclose(model.predict(known.nominal).error_mm, known.error_mm, atol=1e-12)
    found_mm = model.predict(level(known.nominal[:5, :3, 3] + 1.0)).error_mm
    assert (found_mm >= known.error_mm.min(axis=0)).all()
    assert (found_mm <= known.error_mm.max(axis=0)).all()


@pytest.mark.parametrize("count", [8, 60])
def test_the_covariance_is_the_mean_square_of_poses_left_out(count: int) -> None:
    known = poses(5, count)
    missed = []
    for number in range(count):
        model = Idw.learn(Measured(known.at(known.fold != number % FOLDS)))
        missed.append(known.error_mm[number] - model.predict(known.nominal[[number]]).error_mm[0])
    found = Idw.learn(Measured(known)).predict(level(np.full((3, 3), 7.0))).covariance_mm2
    wanted = sum(np.outer(each, each) for each in missed) / count
    np.testing.assert_allclose(found, np.tile(wanted, (3, 1, 1)), rtol=1e-9)
    assert np.linalg.eigvalsh(wanted).min() > 0


def test_nominal_kinematics_predict_no_error_and_know_how_large_it_is() -> None:
    known = poses(6)
    found = Nominal.learn(Measured(known)).predict(known.nominal[:4])
    assert (found.error_mm == 0).all()
    wanted = known.error_mm.T @ known.error_mm / len(known)
    np.testing.assert_allclose(found.covariance_mm2[3], wanted)


def test_trilinear_interpolation_wants_a_lattice() -> None:
    with pytest.raises(GridError, match="lattice"):
        Trilinear.learn(Measured(poses(6)))
