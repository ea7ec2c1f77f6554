"""What is identified of robots with known errors, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.geometry.inverse import refined
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import lengths_mm
from hilcell.identification.estimate import (
    Estimate,
    System,
    identify,
    observability,
    predict,
    triangle,
)
from hilcell.identification.kinematics import Kinematics, Placed
from hilcell.identification.measured_poses import (
    FOLDS,
    SAME_RAD,
    IdentificationError,
    Noise,
    Readings,
    count_poses,
    pose_folds,
    pose_numbers,
)
from tests.hilcell.identification.robots import ARM, MIDDLE_RAD, SMR_MM, T_L_B, Robot, curve

KINEMATICS = Kinematics(ARM, 1)


def found(robot: Robot, readings: Readings, noise: Noise | None = None) -> Estimate:
    kinematics = robot.kinematics
    start = kinematics.start(T_L_B, SMR_MM[: kinematics.reflectors] + 3.0)
    return identify(kinematics, readings, start, noise)


def missed_mm(estimate: Estimate, robot: Robot, seed: int = 77) -> np.ndarray:
    joints = robot.joints_rad(seed, 50)
    wanted = robot.kinematics.positions_mm(robot.state, joints)
    return lengths_mm(
        (estimate.kinematics.positions_mm(estimate.state, joints) - wanted).reshape(-1, 3)
    )


@pytest.mark.parametrize("seed", range(2))
def test_unseen_poses_of_a_crooked_robot_are_predicted(seed: int) -> None:
    robot = Robot.drawn(KINEMATICS, seed)
    estimate = found(robot, robot.measured(seed, 80, 0.005, 5e-6))
    assert missed_mm(estimate, robot).mean() < 0.02
    assert not estimate.outliers.any()


def test_twenty_poses_are_enough() -> None:
    robot = Robot.drawn(KINEMATICS, 5)
    assert missed_mm(found(robot, robot.measured(1, 20, 0.01)), robot).mean() < 0.4


def test_noise_of_joints_and_readings_is_found() -> None:
    robot = Robot.drawn(KINEMATICS, 2)
    noise = found(robot, robot.measured(3, 150, 0.03, 40e-6), Noise.of_joints()).noise
    assert noise.reading_mm == pytest.approx(0.03, rel=0.3)
    np.testing.assert_allclose(noise.joint_rad[:3], 40e-6, rtol=0.3)


def test_a_shift_that_all_reflectors_share_is_found() -> None:
    robot = Robot.drawn(Kinematics(ARM, 3), 2)
    readings = robot.measured(3, 200, 0.03)
    readings.xyz_mm[:] += 0.05 * np.random.default_rng(1).standard_normal((200, 1, 3))
    noise = found(robot, readings).noise
    assert noise.reading_mm == pytest.approx(0.03, rel=0.1)
    assert noise.pose_mm == pytest.approx(0.05, rel=0.1)


def test_bounds_cover_unseen_readings() -> None:
    """Squared distances over their predicted variances are 1 in the mean."""
    ratios = []
    for seed in range(3):
        robot = Robot.drawn(KINEMATICS, seed)
        estimate = found(robot, robot.measured(seed, 40, 0.02, 20e-6), Noise.of_joints())
        test = robot.measured(900 + seed, 60, 0.02, 20e-6)
        at, covariance = predict(
            estimate.kinematics, estimate.state, estimate.system.covariance, estimate.noise,
            test.joints_rad,
        )  # fmt: skip
        left = (test.xyz_mm - at)[:, 0]
        ratios.append(
            np.einsum(
                "mi,mi->m", left, np.linalg.solve(covariance[:, 0], left[..., None])[..., 0]
            ).mean()
            / 3
        )
    assert 0.7 < np.mean(ratios) < 1.3


@pytest.mark.parametrize("reflectors", [1, 3])
def test_gross_readings_are_named_and_move_nothing(reflectors: int) -> None:
    robot = Robot.drawn(Kinematics(ARM, reflectors), 4)
    clean = robot.measured(1, 60, 0.01, 10e-6)
    rng, bad = np.random.default_rng(5), np.zeros(clean.known.shape, dtype=bool)
    bad[rng.choice(60, 3, replace=False), rng.integers(0, reflectors, 3)] = True
    spoilt = replace(
        clean, xyz_mm=clean.xyz_mm + 5.0 * bad[..., None] * rng.standard_normal((60, 1, 3))
    )
    estimate = found(robot, spoilt)
    assert np.array_equal(estimate.outliers, bad)
    exact = found(robot, clean.without(bad))
    np.testing.assert_allclose(missed_mm(estimate, robot), missed_mm(exact, robot), atol=1e-4)


def test_a_shifted_curve_is_found() -> None:
    waves = curve(1, (31.0, 62.0, 170.0), 3)
    robot = Robot.drawn(Kinematics(ARM, 1, curves=(waves,)), 1)
    shift = robot.kinematics.names.index("axis 2: shift rad") - robot.kinematics.placed
    robot.state.values[shift] = 350e-6
    estimate = found(robot, robot.measured(1, 64, 0.001))
    column = robot.kinematics.placed + shift
    sigma = np.sqrt(estimate.system.covariance[column, column])
    assert estimate.state.values[shift] == pytest.approx(350e-6, abs=3 * sigma)
    assert sigma < 0.5 * waves.shift_sigma_rad


@pytest.mark.parametrize("seed", [0, 1, 5])
def test_one_orientation_settles_by_itself(seed: int) -> None:
    """What it leaves to the prior lies along a curved valley, here with waves that no parameter
    describes.
    """
    robot = Robot.drawn(Kinematics(ARM, gravity=False, waves=False, tool=True), seed)
    rng = np.random.default_rng(seed)
    poses = np.tile(forward(ARM, MIDDLE_RAD[None]), (70, 1, 1))
    poses[:, :3, 3] += rng.uniform(-400.0, 400.0, (70, 3))
    joints = refined(ARM, poses, np.tile(MIDDLE_RAD, (70, 1)))[0]
    at_mm = robot.kinematics.positions_mm(robot.state, joints + 2e-4 * np.sin(5.0 * joints + seed))
    at_mm += rng.normal(0.0, 0.01, at_mm.shape)
    readings = Readings(joints[:40], at_mm[:40], np.zeros((40, 1, 3, 3)))
    T = T_L_B.copy()
    T[:3, 3] += T[:3, :3] @ poses[0, :3, :3] @ SMR_MM[0]
    estimate = identify(robot.kinematics, readings, robot.kinematics.start(T, np.zeros((1, 3))))
    positions, _ = estimate.predict(joints[40:])
    assert lengths_mm((positions - at_mm[40:])[:, 0]).mean() < 0.25


def test_too_few_poses_are_refused() -> None:
    robot = Robot.drawn(KINEMATICS, 1)
    with pytest.raises(IdentificationError, match="19 poses"):
        found(robot, robot.measured(1, 19))


def test_shuffled_poses_are_refused() -> None:
    robot = Robot.drawn(KINEMATICS, 1)
    readings = robot.measured(1, 40, 0.01)
    with pytest.raises(IdentificationError):
        found(robot, replace(readings, joints_rad=readings.joints_rad[::-1]))


def test_a_joint_that_never_moves_leaves_its_own_parameters_to_the_prior() -> None:
    robot = Robot.drawn(KINEMATICS, 1)
    readings = robot.measured(1, 40, 0.01)
    joints = readings.joints_rad.copy()
    joints[:, 2] = joints[0, 2]
    still = replace(
        readings, joints_rad=joints, xyz_mm=KINEMATICS.positions_mm(robot.state, joints)
    )
    moving = observability(robot.kinematics, found(robot, readings).covariance)
    known = observability(robot.kinematics, found(robot, still).covariance)
    assert known.directions < moving.directions
    beta = KINEMATICS.names.index("alpha3 rad")
    assert known.ratio[beta] > moving.ratio[beta]


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


CLOSE = Placed(2.0, 2e-3, 2.0)  # so that the dense matrices are well conditioned
CLOSE_BY = Kinematics(ARM, 2, waves=False, curves=(curve(1, (40.0,)),), assumed=CLOSE)
NOISE = Noise(0.02, 0.01, np.array([30e-6, 20e-6, 10e-6, 50e-6, 40e-6, 60e-6]))


@pytest.fixture(scope="module")
def system() -> System:
    robot = Robot.drawn(CLOSE_BY, 1)
    readings = robot.measured(2, 25, 0.02, 30e-6)
    readings.xyz_mm[3, 1] = np.nan
    start = CLOSE_BY.start(robot.state.T, robot.state.smr_mm)
    return System.at(CLOSE_BY, start, readings, NOISE)


def dense(system: System) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The known rows: design, residual, their covariance under the prior, prior mean."""
    rows = np.flatnonzero(np.repeat(system.known, 3, axis=1).ravel())
    A = system.design.reshape(-1, system.design.shape[2])[rows]
    r = system.residual_mm.ravel()[rows]
    C = np.zeros((system.residual_mm.size,) * 2)
    size = system.residual_mm.shape[1]
    for n, block in enumerate(system.noise_mm2):
        C[n * size : (n + 1) * size, n * size : (n + 1) * size] = block
    Q = np.linalg.inv(system.prior_root.T @ system.prior_root)
    mean = np.linalg.solve(system.prior_root, system.pull)
    return A, r - A @ mean, A @ Q @ A.T + C[np.ix_(rows, rows)], mean


def test_the_step_is_the_posterior_mean(system: System) -> None:
    A, r, K, mean = dense(system)
    Q = np.linalg.inv(system.prior_root.T @ system.prior_root)
    wanted = mean + Q @ A.T @ np.linalg.solve(K, r)
    sigma = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(system.step / sigma, wanted / sigma, atol=1e-6)
    posterior = Q - Q @ A.T @ np.linalg.solve(K, A @ Q)
    np.testing.assert_allclose(
        system.covariance / np.outer(sigma, sigma), posterior / np.outer(sigma, sigma), atol=1e-6
    )


def test_evidence_is_the_likelihood_of_the_rows(system: System) -> None:
    _, r, K, _ = dense(system)
    wanted = -0.5 * (r @ np.linalg.solve(K, r) + np.linalg.slogdet(K)[1])
    assert system.evidence == pytest.approx(wanted, rel=1e-6)


def test_poses_left_out_are_predicted_by_the_others(system: System) -> None:
    _, r, K, _ = dense(system)
    pose = np.repeat(np.arange(25), 6)[np.repeat(system.known, 3, axis=1).ravel()]
    folds = [np.arange(0, 25, 2, dtype=np.int_), np.arange(1, 25, 2, dtype=np.int_)]
    found, _ = system.left_out(folds)
    for fold in folds:
        out = np.isin(pose, fold)
        predicted = K[np.ix_(out, ~out)] @ np.linalg.solve(K[np.ix_(~out, ~out)], r[~out])
        np.testing.assert_allclose(
            found[fold][system.known[fold]].ravel(), (r[out] - predicted), atol=1e-6
        )
    assert np.isnan(found[3, 1]).all()


def test_excess_compares_misses_with_their_covariance(system: System) -> None:
    _, r, K, _ = dense(system)
    pose = np.repeat(np.arange(25), 6)[np.repeat(system.known, 3, axis=1).ravel()]
    folds = [np.arange(0, 25, 2, dtype=np.int_), np.arange(1, 25, 2, dtype=np.int_)]
    found = expected = 0.0
    for fold in folds:
        out = np.isin(pose, fold)
        gain = K[np.ix_(out, ~out)] @ np.linalg.inv(K[np.ix_(~out, ~out)])
        found += np.sum((r[out] - gain @ r[~out]) ** 2)
        expected += np.trace(K[np.ix_(out, out)] - gain @ K[np.ix_(~out, out)])
    assert system.excess(folds) == pytest.approx(found / expected, rel=1e-5)


def test_distances_are_of_what_the_others_predict(system: System) -> None:
    _, r, K, _ = dense(system)
    rows = np.arange(6, 9)  # pose 1, first reflector
    others = np.setdiff1d(np.arange(len(r)), rows)
    gain = K[np.ix_(rows, others)] @ np.linalg.inv(K[np.ix_(others, others)])
    missed = r[rows] - gain @ r[others]
    covariance = K[np.ix_(rows, rows)] - gain @ K[np.ix_(others, rows)]
    wanted = missed @ np.linalg.solve(covariance, missed)
    assert system.distances()[0][1, 0] == pytest.approx(wanted, rel=1e-5)
    assert system.distances()[0][3, 1] == 0.0


@pytest.mark.parametrize("alike", [1e-1, 1e-3, 1e-5, 1e-7, 1e-10, 0.0])
def test_columns_that_are_nearly_alike_keep_their_digits(alike: float) -> None:
    """Of squares alone, columns that differ by less than 1e-8 would have no difference left."""
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((200, 4)) * [1e6, 1.0, 1e-6, 1.0]
    rows[:, 3] = rows[:, 1] + alike * rng.standard_normal(200)
    R, peer = triangle(rows), np.linalg.qr(rows, mode="r")
    assert np.array_equal(R, np.triu(R))
    found, wanted = np.abs(np.diag(R)), np.abs(np.diag(peer))
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-13)
