"""A residual of the joints: what it explains of an error that no parameter describes."""

from dataclasses import replace

import numpy as np
import pytest

from hilcell.geometry.statistics import bounds95_mm, lengths_mm
from hilcell.identification.estimate import identify_trusted
from hilcell.identification.joint_error import WithResidual, with_residual
from hilcell.identification.kinematics import Kinematics
from hilcell.identification.measured_poses import Readings
from tests.hilcell.identification.robots import ARM, SMR_MM, T_L_B, Robot

KINEMATICS = Kinematics(ARM)


def measured(seed: int, poses: int, size_rad: float) -> Readings:
    """Readings of a robot whose axis 2 errs smoothly with axes 1 and 3, too."""
    robot = Robot.drawn(KINEMATICS, 1)
    joints = robot.joints_rad(seed, poses)
    true = joints.copy()
    true[:, 1] += size_rad * np.sin(3.0 * joints[:, 0]) * np.cos(3.0 * joints[:, 2])
    xyz_mm = KINEMATICS.positions_mm(robot.state, true)
    xyz_mm += 0.01 * np.random.default_rng([seed, 2]).standard_normal(xyz_mm.shape)
    return Readings(joints, xyz_mm, np.zeros((*xyz_mm.shape, 3)))


def learnt(size_rad: float) -> WithResidual:
    readings = measured(1, 80, size_rad)
    start = KINEMATICS.start(T_L_B, SMR_MM[:1])
    return with_residual(identify_trusted(KINEMATICS, readings, start))


@pytest.mark.parametrize(("size_rad", "most"), [(200e-6, 0.6), (0.0, 1.1)])
def test_smooth_errors_are_explained_and_none_is_invented(size_rad: float, most: float) -> None:
    model, test = learnt(size_rad), measured(2, 60, size_rad)
    wanted_mm = test.xyz_mm[:, 0]
    misses_mm = []
    for each in (model, model.base):
        at_mm, covariance_mm2 = each.predict(test.joints_rad)
        misses_mm.append(lengths_mm(wanted_mm - at_mm[:, 0]))
        assert (misses_mm[-1] <= bounds95_mm(covariance_mm2[:, 0])).mean() >= 0.85
    assert misses_mm[0].mean() < most * misses_mm[1].mean()


def test_poses_left_out_are_those_of_a_second_solution() -> None:
    """Closed form against the same scales, learnt from the other poses."""
    model = learnt(200e-6)
    out = np.arange(0, 80, 5)
    known = np.setdiff1d(np.arange(80), out)
    rows = model.rows
    own = np.isin(rows.pose, out)
    K = np.linalg.inv(model.solved.precision)  # of readings and parameters together
    weighted = np.linalg.solve(K[np.ix_(~own, ~own)], (K @ model.solved.weighted)[~own])
    wanted = (K @ model.solved.weighted)[own] - K[np.ix_(own, ~own)] @ weighted
    found = model.left_out_mm([out])
    np.testing.assert_allclose(
        found[out].ravel(), wanted, atol=5e-5
    )  # the dense inverse is ill conditioned
    assert np.isnan(found[known]).all()


def test_a_missing_reading_is_left_out() -> None:
    readings = measured(1, 40, 0.0)
    readings.xyz_mm[3] = np.nan
    start = KINEMATICS.start(T_L_B, SMR_MM[:1])
    model = with_residual(identify_trusted(KINEMATICS, readings, start))
    other = with_residual(
        identify_trusted(KINEMATICS, readings.at(np.delete(np.arange(40), 3)), start)
    )
    joints = measured(2, 5, 0.0).joints_rad
    np.testing.assert_allclose(model.predict(joints)[0], other.predict(joints)[0], atol=2e-3)
    assert replace(model, doubt=2.0).predict(joints)[1] == pytest.approx(
        2.0 / model.doubt * model.predict(joints)[1]
    )
