"""Poses chosen by information: against dense algebra, by trial, and when to stop."""

import numpy as np
import pytest

from procedures.robot_grid import Rows, design

P = 5


def rows(seed: int, count: int, noise_mm: float = 0.1) -> Rows:
    J = np.random.default_rng(seed).standard_normal((count, 3, P))
    return Rows(J, np.tile(noise_mm**2 * np.eye(3), (count, 1, 1)))


VOLUME, CANDIDATES = rows(1, 8, 0.01), rows(2, 20)
PRIOR = np.diag([1.0, 2.0, 0.5, 1.0, 3.0])


def mean_variance_mm2(measured: list[int]) -> float:
    """The predictions' variance (trace) over the volume, by the whole normal equations."""
    information = np.linalg.inv(PRIOR).astype(float)
    for n in measured:
        J = CANDIDATES.by_parameter[n]
        information = information + J.T @ np.linalg.inv(CANDIDATES.noise_mm2[n]) @ J
    covariance = np.linalg.inv(information).astype(float)
    covariances = VOLUME.covariance_mm2(covariance)
    return float(np.trace(covariances, axis1=1, axis2=2).mean())


def test_each_pose_is_the_best_after_those_before() -> None:
    found = design(CANDIDATES, VOLUME, PRIOR, bound_mm=1e-6, counts=(0, 4))
    for count, chosen in enumerate(found.chosen):
        before = found.chosen[:count]
        others = [n for n in range(20) if n not in before]
        assert chosen == min(others, key=lambda n: mean_variance_mm2([*before, n]))
    assert len(set(found.chosen)) == 4
    assert np.all(np.diff(found.bounds_mm) < 0)


def test_the_bound_is_that_of_the_posterior() -> None:
    """Of a spherical covariance 95 % of lengths are within 2.7955 standard deviations."""
    J = np.eye(3)[None]
    one = Rows(J, np.zeros((1, 3, 3)))
    found = design(
        Rows(J, 0.04 * np.eye(3)[None]), one, 0.04 * np.eye(3), bound_mm=1e-6, counts=(0, 1)
    )
    assert found.bounds_mm == pytest.approx([2.7955 * 0.2, 2.7955 * 0.2 / np.sqrt(2)], rel=1e-4)


def test_it_stops_where_the_bound_is_low_enough() -> None:
    whole = design(CANDIDATES, VOLUME, PRIOR, bound_mm=1e-6, counts=(0, 10))
    found = design(CANDIDATES, VOLUME, PRIOR, bound_mm=whole.bounds_mm[3], counts=(0, 10))
    assert found.chosen == whole.chosen[:3]
    assert design(CANDIDATES, VOLUME, PRIOR, bound_mm=1e3, counts=(0, 10)).chosen == []


def test_it_stops_where_noise_is_all_that_is_left() -> None:
    noisy = Rows(VOLUME.by_parameter, 1.0 * np.tile(np.eye(3), (8, 1, 1)))
    found = design(CANDIDATES, noisy, PRIOR, bound_mm=0.1, counts=(0, 20))
    assert 0 < len(found.chosen) < 5
    assert found.bounds_mm[-1] <= 1.1 * 2.7955
