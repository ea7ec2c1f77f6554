"""Errors of the joints: which are explained, which are not invented, and how far bounds hold."""

from collections.abc import Callable

import numpy as np
import pytest

from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import bounds95_mm, lengths_mm
from hilcell.identification import joint_error
from hilcell.identification.estimate import Estimate, identify_trusted
from hilcell.identification.joint_error import Rows, Scales, WithJointErrors, with_joint_errors
from hilcell.identification.kinematics import Kinematics
from hilcell.identification.measured_poses import Readings, pose_folds
from tests.hilcell.identification.robots import ARM, SMR_MM, T_L_B, Robot

KINEMATICS = Kinematics(ARM)
Bent = Callable[[Array], Array]  # errors (M, 6) of the joints (M, 6)


def none(joints: Array) -> Array:
    return np.zeros_like(joints)


def gears(joints: Array) -> Array:
    """Waves of 9 and 14 a turn, of axes 1 to 3: no parameter has them."""
    errors = np.zeros_like(joints)
    large = joints[:, :3]
    errors[:, :3] = 150e-6 * np.sin(9.0 * large) + 100e-6 * np.cos(14.0 * large)
    return errors


def shared(joints: Array) -> Array:
    """An error of axis 2 that depends on axes 1 and 3."""
    errors = np.zeros_like(joints)
    errors[:, 1] = 200e-6 * np.sin(3.0 * joints[:, 0]) * np.cos(3.0 * joints[:, 2])
    return errors


def measured(seed: int, poses: int, bent: Bent) -> Readings:
    robot = Robot.drawn(KINEMATICS, 1)
    joints = robot.joints_rad(seed, poses)
    xyz_mm = KINEMATICS.positions_mm(robot.state, joints + bent(joints))
    xyz_mm += 0.01 * np.random.default_rng([seed, 2]).standard_normal(xyz_mm.shape)
    return Readings(joints, xyz_mm, np.zeros((*xyz_mm.shape, 3)))


def estimated(readings: Readings) -> Estimate:
    return identify_trusted(KINEMATICS, readings, KINEMATICS.start(T_L_B, SMR_MM[:1]))


def learnt(bent: Bent, poses: int = 80) -> WithJointErrors:
    return with_joint_errors(estimated(measured(1, poses, bent)))


@pytest.mark.parametrize(
    ("bent", "most"), [(gears, 0.5), (shared, 0.6), (none, 1.1)], ids=["gears", "shared", "none"]
)
def test_errors_of_joints_are_explained_and_none_is_invented(bent: Bent, most: float) -> None:
    model, test = learnt(bent), measured(2, 60, bent)
    misses_mm = []
    for each in (model, model.base):
        at_mm, covariance_mm2 = each.predict(test.joints_rad)
        misses_mm.append(lengths_mm((test.xyz_mm - at_mm)[:, 0]))
        assert (misses_mm[-1] <= bounds95_mm(covariance_mm2[:, 0])).mean() >= 0.85
    assert misses_mm[0].mean() < most * misses_mm[1].mean()


def test_each_joint_has_the_size_of_its_own_error() -> None:
    scales = learnt(gears).scales
    assert scales.own_rad[:3].min() > 60e-6 > scales.visit_rad[:3].max()
    assert scales.reading_mm == pytest.approx(0.01, rel=0.6)


def test_the_gradient_is_that_of_the_likelihood() -> None:
    estimate = estimated(measured(1, 24, gears))
    rows = Rows.of(estimate, np.arange(24))
    logs = Scales.prior(6)[0] + np.random.default_rng(3).normal(0.0, 0.3, 32)

    def evidence(logs: Array) -> float:
        return rows.solved(rows.covariance(Scales.of(logs)), estimate.system).evidence

    scales = Scales.of(logs)
    alike = rows.alike(scales)
    solved = rows.solved(rows.covariance(scales, alike), estimate.system)
    found = rows.by_scales(scales, alike, solved)
    steps = 1e-4 * np.eye(32)
    wanted = [(evidence(logs - step) - evidence(logs + step)) / 2e-4 for step in steps]
    np.testing.assert_allclose(found, wanted, rtol=1e-3, atol=2e-4)
    np.testing.assert_allclose(scales.logs, logs)


def test_poses_left_out_are_those_of_a_second_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed form against the same scales, learnt from the other poses."""
    model = learnt(shared)
    out = np.arange(0, 80, 5)
    others = np.setdiff1d(np.arange(80), out)
    monkeypatch.setattr(joint_error, "_scales", lambda *_: model.scales)
    found_mm, covariance_mm2 = model.left_out([out])
    again = with_joint_errors(estimated(model.base.readings.at(others)))
    at_mm, wanted_mm2 = again.predict(model.base.readings.joints_rad[out])
    wanted_mm = (model.base.readings.xyz_mm[out] - at_mm)[:, 0]
    np.testing.assert_allclose(found_mm[out][:, 0], wanted_mm, atol=1e-3)
    np.testing.assert_allclose(covariance_mm2[out][:, 0], wanted_mm2[:, 0], rtol=0.05, atol=1e-5)
    assert np.isnan(found_mm[others]).all()


def test_scales_do_not_know_the_poses_left_out() -> None:
    """Poses that err otherwise than the others are missed as such, not explained by themselves."""
    readings = measured(1, 60, none)
    fold = pose_folds(readings.joints_rad) == 2
    readings.xyz_mm[fold] += 0.3 * np.sign(np.sin(40.0 * readings.joints_rad[fold, :1, None]))
    model = with_joint_errors(estimated(readings))
    missed_mm, covariance_mm2 = model.left_out([np.flatnonzero(fold).astype(np.int_)])
    bounds_mm = bounds95_mm(covariance_mm2[fold][:, 0])
    assert (lengths_mm(missed_mm[fold][:, 0]) > 2.0 * bounds_mm).all()


def test_a_missing_reading_is_left_out() -> None:
    readings = measured(1, 40, none)
    readings.xyz_mm[3] = np.nan
    model = with_joint_errors(estimated(readings))
    other = with_joint_errors(estimated(readings.at(np.delete(np.arange(40), 3))))
    joints = measured(2, 5, none).joints_rad
    np.testing.assert_allclose(model.predict(joints)[0], other.predict(joints)[0], atol=2e-3)


def test_more_poses_than_are_learnt_from_are_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joint_error, "MOST_ROWS", 90)
    model = learnt(none)
    assert len(model.poses) == 30
    missed_mm, _ = model.left_out([np.arange(0, 80, 2), np.arange(1, 80, 2)])
    learnt_from = np.flatnonzero(np.isfinite(missed_mm[:, 0, 0]))
    assert learnt_from.tolist() == model.poses.tolist()
