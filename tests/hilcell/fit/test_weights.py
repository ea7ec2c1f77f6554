"""What rows say beside positions: their uncertainty, orientations, and that they repeat a pose."""

from dataclasses import replace

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements
from hilcell.fit.methods import FittedArm, fit_robot
from hilcell.fit.orientations import points_of
from hilcell.fit.placement import place
from hilcell.fit.repeats import averaged
from hilcell.geometry.frames import from_rotvec
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import lengths_mm
from tests.hilcell.fit.test_fit import IRB120, SMR_MM, T_L_B, crooked_arm, measured

TURNED_RAD = 1e-4


def noisy(seed: int, u_mm: np.ndarray, u_rad: float = TURNED_RAD) -> Measurements:
    """Poses of the crooked robot, of a body at SMR2, with noise of each row's uncertainty."""
    rng, poses = np.random.default_rng(seed), len(u_mm)
    joints_rad = rng.uniform(-0.8, 0.8, (poses, 6))
    flange = T_L_B @ forward(crooked_arm(), joints_rad)
    xyz_mm = flange[:, :3, 3] + flange[:, :3, :3] @ np.array(SMR_MM["SMR2"])
    body = flange[:, :3, :3] @ from_rotvec([0.3, -1.0, 0.5])
    return replace(
        Measurements.from_arrays(
            joints_rad, xyz_mm + u_mm[:, None] * rng.normal(size=xyz_mm.shape)
        ),
        covariance_mm2=u_mm[:, None, None] ** 2 * np.eye(3),
        R=from_rotvec(rng.normal(0, u_rad, (poses, 3))) @ body,
        u_rad=np.full(poses, u_rad),
    )


def plain(rows: Measurements) -> Measurements:
    return replace(rows, covariance_mm2=None, R=None, u_rad=None)


def true_miss_mm(rows: Measurements) -> float:
    """Mean distance of the identified arm from the true robot at other poses."""
    truth = plain(noisy(1000, np.zeros(60)))
    arm = FittedArm.learn(place(IRB120.arm, rows), rows, "mdh", trusted=False)
    return float(lengths_mm(arm.predict(truth)[0] - truth.xyz_mm).mean())


@pytest.mark.parametrize("stated", [True, False])
def test_orientations_improve_a_fit_of_few_poses(stated: bool) -> None:
    """Their uncertainty is estimated where it is not stated."""
    without, with_ = [], []
    for seed in (1, 2, 3, 4):
        rows = replace(noisy(seed, np.full(22, 0.02)), covariance_mm2=None)
        without.append(true_miss_mm(plain(rows)))
        with_.append(true_miss_mm(rows if stated else replace(rows, u_rad=None)))
    assert np.mean(with_) < 0.8 * np.mean(without)


def test_bad_orientations_do_little_harm() -> None:
    rows = replace(noisy(5, np.full(40, 0.02), u_rad=5e-3), covariance_mm2=None)
    for told in (rows, replace(rows, u_rad=None)):
        assert true_miss_mm(told) < 1.1 * true_miss_mm(plain(rows))


def test_an_orientation_of_some_rows_is_enough_to_read() -> None:
    rows = noisy(6, np.full(30, 0.02))
    assert rows.R is not None
    rows.R[::2] = np.nan
    points = points_of(rows, TURNED_RAD)
    assert (len(points), set(points.target)) == (30, {"SMR x", "SMR y"})
    other = replace(rows, target=["SMR2"] * 30)
    twice = points_of(replace(rows.at([*range(30)] * 2), target=[*rows.target, *other.target]), 1.0)
    assert twice.target == points.target
    result = fit_robot(IRB120, rows).result
    assert (result["train"], result["test"], result["outliers"]) == (30, 30, [])


def test_rows_count_by_their_weights() -> None:
    good = np.arange(60) % 2 == 0
    told, untold = [], []
    for seed in (1, 2, 3):
        rows = replace(noisy(seed, np.where(good, 0.02, 0.2)), R=None, u_rad=None)
        told.append(true_miss_mm(rows))
        untold.append(true_miss_mm(plain(rows)))
    assert np.mean(told) < 0.5 * np.mean(untold)


def test_rows_of_large_uncertainty_are_no_outliers() -> None:
    rows = replace(noisy(2, np.where(np.arange(60) % 3 == 0, 3.0, 0.02)), R=None, u_rad=None)
    rows.xyz_mm[7] += [0.0, 2.0, 0.0]
    result = fit_robot(IRB120, rows).result
    assert [each["pose"] for each in result["outliers"]] == ["8"]


def test_repeated_readings_of_a_pose_are_one_row() -> None:
    rows = noisy(3, np.where(np.arange(12) < 6, 0.01, 0.03))
    twice = rows.at([*range(12), *range(3, 9)])
    twice.xyz_mm[12:] += 0.01
    placement = place(IRB120.arm, rows)
    mean = averaged(placement, twice, np.zeros(6))
    assert (len(mean), mean.pose) == (12, rows.pose)
    assert mean.covariance_mm2 is not None
    assert mean.u_rad is not None
    np.testing.assert_allclose(
        mean.xyz_mm - rows.xyz_mm,
        np.repeat([0, 5e-3, 0], [3, 6, 3])[:, None] * np.ones(3),
        atol=1e-9,
    )
    np.testing.assert_allclose(mean.covariance_mm2[4], np.eye(3) * 0.01**2 / 2)
    np.testing.assert_allclose(mean.u_rad[[0, 4]], [TURNED_RAD, TURNED_RAD / 2**0.5])
    assert averaged(placement, rows, np.zeros(6)) is rows
    often = rows.at([*range(12), *[2] * 5])
    often.xyz_mm[13] += 5.0
    again = averaged(placement, often, np.zeros(6))
    np.testing.assert_allclose(again.xyz_mm, rows.xyz_mm, atol=1e-9)


def test_bounds_are_of_one_reading_after_repeated_ones() -> None:
    """Means of ten readings scatter less than the single ones of the test rows."""
    rows, test = measured(1, 40, ["SMR1"]), measured(2, 60, ["SMR1"])
    rng = np.random.default_rng(3)
    ten = rows.at(np.repeat(np.arange(40), 10))
    noisy_ten = replace(ten, xyz_mm=ten.xyz_mm + rng.normal(0, 0.05, ten.xyz_mm.shape))
    single = replace(test, xyz_mm=test.xyz_mm + rng.normal(0, 0.05, test.xyz_mm.shape))
    result = fit_robot(IRB120, noisy_ten, single).result
    assert result["coverage95"] == pytest.approx(0.95, abs=0.05)


def test_a_pose_measured_often_does_not_sharpen_what_others_tell() -> None:
    """A hundred readings of one pose are no hundred poses."""
    rows = measured(1, 24, ["SMR1", "SMR2"])
    rng = np.random.default_rng(2)
    again = rows.at([6, 7] * 100)
    again = replace(again, xyz_mm=again.xyz_mm + rng.normal(0, 0.01, again.xyz_mm.shape))
    once = fit_robot(IRB120, rows).result
    often = fit_robot(
        IRB120,
        Measurements.from_arrays(
            np.concatenate([rows.joints_rad, again.joints_rad]),
            np.concatenate([rows.xyz_mm, again.xyz_mm]),
            [*rows.target, *again.target],
        ),
    ).result
    assert (often["train"], often["test"]) == (48, 48)
    assert once["model"] is not None
    assert often["model"] is not None
    assert often["model"]["sigma"] == pytest.approx(once["model"]["sigma"], rel=0.2)
    assert often["methods"]["mdh"] == pytest.approx(once["methods"]["mdh"], rel=0.2)


def test_whole_turns_of_a_joint_change_nothing() -> None:
    rows, test = measured(1, 30, ["SMR1"]), measured(2, 10, ["SMR1"])
    turned = [replace(each, joints_rad=each.joints_rad.copy()) for each in (rows, test)]
    turned[0].joints_rad[::2, 5] += 2.0 * np.pi
    turned[1].joints_rad[::3, 3] -= 2.0 * np.pi
    fits = [fit_robot(IRB120, *each) for each in ((rows, test), turned)]
    for method, figures in fits[0].result["methods"].items():
        assert fits[1].result["methods"][method] == pytest.approx(figures, rel=1e-3)
    asked = replace(test, joints_rad=test.joints_rad + 2.0 * np.pi * np.eye(6)[0])
    before_mm, after_mm = (fits[0].methods["gp"].predict(each)[0] for each in (test, asked))
    np.testing.assert_allclose(after_mm, before_mm, atol=1e-6)
