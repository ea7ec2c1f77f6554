"""The linear system against plain dense algebra."""

import numpy as np
import pytest

from hilcell.identification.estimate import System, triangle
from hilcell.identification.kinematics import Kinematics, Placed
from hilcell.identification.measured_poses import Noise
from tests.hilcell.identification.robots import ARM, Robot, curve

CLOSE = Placed(2.0, 2e-3, 2.0)  # so that the dense matrices are well conditioned
KINEMATICS = Kinematics(ARM, 2, waves=False, curves=(curve(1, (40.0,)),), assumed=CLOSE)
NOISE = Noise(0.02, 0.01, np.array([30e-6, 20e-6, 10e-6, 50e-6, 40e-6, 60e-6]))


@pytest.fixture(scope="module")
def system() -> System:
    robot = Robot.drawn(KINEMATICS, 1)
    readings = robot.measured(2, 25, 0.02, 30e-6)
    readings.xyz_mm[3, 1] = np.nan
    start = KINEMATICS.start(robot.state.T, robot.state.smr_mm)
    return System.at(KINEMATICS, start, readings, NOISE)


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
    found = system.left_out_mm(folds)
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
