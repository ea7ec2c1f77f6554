"""The smooth error of a joint: its prior, its evidence, and what records determine of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hilcell.geometry.kinematics import Array
from hilcell.identification.smooth_error import Matern, Regression, most_likely

CYCLES = np.arange(3.0, 46.0, 3.0)
KERNEL = Matern(40e-6, 0.15)


def waves(angle_rad: Array) -> Array:
    phase = np.outer(angle_rad, CYCLES)
    return np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angle_rad), -1)


def test_its_waves_have_the_covariance_of_matern() -> None:
    cycles, apart_rad = np.arange(0.25, 400.0, 0.5), np.linspace(0.0, 0.5, 26)
    by_waves = np.cos(np.outer(apart_rad, cycles)) @ KERNEL.sigma_rad(cycles) ** 2
    root = 5.0**0.5 * apart_rad / KERNEL.length_rad
    correlation = (1.0 + root + root**2 / 3.0) * np.exp(-root)
    np.testing.assert_allclose(by_waves / KERNEL.size_rad**2, correlation, atol=1e-3)


def test_evidence_and_posterior_are_those_of_the_whole_distribution() -> None:
    rng = np.random.default_rng(1)
    columns, sigma, noise = rng.normal(size=(30, 4)), np.array([1.0, 2.0, 0.5, 1e-9]), 0.3
    values = rng.normal(size=30)
    found = Regression.of(columns, values)
    whole = (columns * sigma**2) @ columns.T + noise**2 * np.eye(30)
    constant = 15.0 * np.log(2.0 * np.pi)
    wanted = multivariate_normal(cov=whole).logpdf(values) + constant
    assert found.evidence(sigma, noise) == pytest.approx(wanted)
    mean, covariance = found.posterior(sigma, noise)
    gain = (columns * sigma**2).T @ np.linalg.inv(whole)
    np.testing.assert_allclose(mean, gain @ values, atol=1e-12)
    np.testing.assert_allclose(covariance, np.diag(sigma**2) - gain @ (columns * sigma**2))


@pytest.mark.parametrize("size_rad", [0.0, 10e-6, 150e-6])
def test_size_and_noise_are_told_apart(size_rad: float) -> None:
    rng = np.random.default_rng(3)
    angle = np.linspace(-0.4, 0.4, 1000)
    drawn = Matern(size_rad, 0.15).sigma_rad(CYCLES).repeat(2) * rng.normal(size=2 * len(CYCLES))
    values = waves(angle) @ drawn + 5e-6 * rng.normal(size=1000)
    columns = np.hstack([np.ones((1000, 1)), waves(angle)])
    found = most_likely(
        Regression.of(columns, values), np.array([0.1]), CYCLES, float(np.std(values))
    )
    assert found.noise == pytest.approx(5e-6, rel=0.1)
    assert (found.gain > 6.0) == (size_rad > 0.0)
    if size_rad:
        assert 0.4 < found.kernel.size_rad / size_rad < 2.5


def test_records_without_noise_have_a_process_too() -> None:
    """The search tries a noise so small that the equations are singular to the computer."""
    angle = np.linspace(-0.4, 0.4, 1000)
    drawn = KERNEL.sigma_rad(CYCLES).repeat(2) * np.random.default_rng(3).normal(size=30)
    columns = np.hstack([np.ones((1000, 1)), waves(angle)])
    values = waves(angle) @ drawn
    found = most_likely(
        Regression.of(columns, values), np.array([100.0]), CYCLES, float(np.std(values))
    )
    assert np.isfinite(found.gain)
    assert found.gain > 6.0
