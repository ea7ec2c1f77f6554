"""Measured residuals come back by their share: noise of one visit is not folded in."""

import numpy as np
import pytest

from hilcell.compensation.model import ModelError, Prediction
from hilcell.compensation.residual import Pass, TargetResiduals, WithTargetResiduals
from hilcell.geometry.frames import motion_levers, pose_from_zyx
from hilcell.ports import Array

COUNT = 60
MODEL_MM, VISIT_MM = 0.05, 0.02  # of one coordinate
NO_FRAMES = np.zeros((7, 7))


def poses(rng: np.random.Generator, count: int = COUNT) -> Array:
    turned = pose_from_zyx(0, 0, 0, 0, 75, 0)
    found = np.tile(turned, (count, 1, 1))
    found[:, :3, 3] = np.array([1850.0, 0.0, 950.0]) + rng.uniform(-450, 450, (count, 3))
    return found


def own(count: int = COUNT) -> Array:
    return np.tile(VISIT_MM**2 * np.eye(3), (count, 1, 1))


def one_pass(seed: int, common: Array = NO_FRAMES) -> tuple[Pass, Array]:
    """Return a pass, and the model's errors (N, 3) in it."""
    rng = np.random.default_rng(seed)
    at = poses(rng)
    error_mm = MODEL_MM * rng.standard_normal((COUNT, 3))
    frames_mm = motion_levers(at[:, :3, 3]) @ rng.multivariate_normal(np.zeros(7), common)
    noise_mm = VISIT_MM * rng.standard_normal((COUNT, 3))
    return Pass(at, error_mm + frames_mm + noise_mm, own(), common), error_mm


@pytest.mark.parametrize("stated_mm", [0.02, 0.12])
def test_the_share_is_that_of_the_models_error(stated_mm: float) -> None:
    after, naive, left = [], [], []
    for seed in range(5):
        this, error_mm = one_pass(seed)
        residuals = TargetResiduals.learn([this], stated_mm**2)
        mean_mm, share_left = residuals.at(this.poses)
        after.append(np.square(error_mm - mean_mm).mean())
        naive.append(np.square(error_mm - this.residuals_mm).mean())
        left.append(share_left.mean())
    best_mm2 = 1 / (1 / MODEL_MM**2 + 1 / VISIT_MM**2)
    assert np.mean(after) == pytest.approx(best_mm2, rel=0.1)
    assert np.mean(after) < 0.95 * np.mean(naive)
    assert np.mean(left) == pytest.approx(best_mm2 / MODEL_MM**2, rel=0.25)


def test_a_model_without_error_keeps_its_commands() -> None:
    rng = np.random.default_rng(5)
    noise_mm = VISIT_MM * rng.standard_normal((COUNT, 3))
    residuals = TargetResiduals.learn([Pass(poses(rng), noise_mm, own(), NO_FRAMES)], 0.02**2)
    mean_mm, _ = residuals.at(residuals.poses)
    assert np.abs(mean_mm).max() < 0.4 * VISIT_MM


def test_what_moved_all_targets_together_is_not_folded_in() -> None:
    common = np.diag([0.1**2] * 3 + [1e-10] * 3 + [0.0])
    this, error_mm = one_pass(2, common)
    assert np.abs(this.residuals_mm.mean(axis=0)).max() > 0.05
    mean_mm, _ = TargetResiduals.learn([this], MODEL_MM**2).at(this.poses)
    assert np.sqrt(np.square(error_mm - mean_mm).mean()) < 0.024


def test_a_second_pass_knows_more() -> None:
    this, error_mm = one_pass(3)
    rng = np.random.default_rng(33)
    again = Pass(
        this.poses, error_mm + VISIT_MM * rng.standard_normal((COUNT, 3)), own(), NO_FRAMES
    )
    once, twice = TargetResiduals([this], MODEL_MM**2), TargetResiduals([this, again], MODEL_MM**2)
    assert (twice.at(this.poses)[1] < 0.7 * once.at(this.poses)[1]).all()
    miss = [np.square(error_mm - each.at(this.poses)[0]).mean() for each in (once, twice)]
    assert miss[1] < miss[0]


def test_far_from_targets_and_turned_the_model_is_as_it_was() -> None:
    this, _ = one_pass(4)
    residuals = TargetResiduals([this], MODEL_MM**2)
    aside = this.poses.copy()
    aside[:, 2, 3] += 40.0
    turned = this.poses @ pose_from_zyx(0, 0, 0, 20, 0, 0)
    for elsewhere in (aside, turned):
        mean_mm, left = residuals.at(elsewhere)
        assert not mean_mm.any()
        assert (left == 1.0).all()
    close = this.poses.copy()
    close[:, 0, 3] += 0.1  # as far as a command moves when it is corrected again
    np.testing.assert_allclose(
        residuals.at(close)[0], residuals.at(this.poses)[0], rtol=1e-3, atol=1e-6
    )


def test_a_model_with_it_adds_the_mean_and_shrinks_its_covariance() -> None:
    class Nothing:
        def predict(self, poses: Array) -> Prediction:
            count = len(poses)
            return Prediction(np.ones((count, 3)), np.tile(np.eye(3), (count, 1, 1)))

    this, _ = one_pass(6)
    residuals = TargetResiduals([this], MODEL_MM**2)
    aside = this.poses.copy()
    aside[:, 2, 3] += 40.0
    both = np.concatenate([this.poses, aside])
    mean_mm, left = residuals.at(both)
    assert left.min() < 0.5 * left.max()
    found = WithTargetResiduals(Nothing(), residuals).predict(both)
    np.testing.assert_allclose(found.error_mm, 1.0 + mean_mm)
    np.testing.assert_allclose(found.covariance_mm2, left[:, None, None] * np.eye(3))


def test_a_gross_reading_stands_out() -> None:
    this, _ = one_pass(7)
    this.residuals_mm[11] += [0.0, 0.9, 0.0]
    sigmas = TargetResiduals.learn([this], MODEL_MM**2).sigmas()
    assert np.argmax(sigmas) == 11
    assert sigmas[11] > 5 > np.delete(sigmas, 11).max()


def test_groups_and_frames_are_the_whole_covariance() -> None:
    """Against the dense solution, with two passes, close targets and frames of rank 5."""
    common = np.diag([0.05**2, 0.02**2, 0.0, 1e-9, 1e-9, 1e-10, 0.0])
    first, _ = one_pass(10, common)
    again = Pass(first.poses[:20].copy(), first.residuals_mm[20:40], own(20), common)
    again.poses[:10, 0, 3] += 6.0
    passes = [first, again]
    at = np.concatenate([each.poses for each in passes])
    total = np.zeros((240, 240))
    for each, rows in zip(passes, (slice(0, 180), slice(180, 240)), strict=True):
        J = motion_levers(each.poses[:, :3, 3]).reshape(-1, 7)
        total[rows, rows] = J @ common @ J.T + VISIT_MM**2 * np.eye(len(J))
    off_mm = np.linalg.norm(at[:, None, :3, 3] - at[None, :, :3, 3], axis=-1)
    K = MODEL_MM**2 * np.kron(np.exp(-(off_mm**2) / 50.0) * (off_mm < 20.0), np.eye(3))
    measured = np.concatenate([each.residuals_mm for each in passes]).reshape(-1)
    inverse = np.linalg.inv(K + total)
    mean_mm, left = TargetResiduals(passes, MODEL_MM**2).at(at)
    np.testing.assert_allclose(mean_mm.reshape(-1), K @ inverse @ measured, atol=1e-9)
    gained = np.diag(K @ inverse @ K).reshape(-1, 3).sum(axis=1)
    np.testing.assert_allclose(left, 1.0 - gained / (3 * MODEL_MM**2), atol=1e-9)


def test_a_model_that_states_nothing_is_refused() -> None:
    with pytest.raises(ModelError, match="nan"):
        TargetResiduals.learn([one_pass(8)[0]], float("nan"))
