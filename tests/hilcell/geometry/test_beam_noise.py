"""Noise along and across the beam is found from few readings at many places, with its freedom."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.geometry.statistics import BeamNoise, beam_noise, coverage_factor
from hilcell.ports import Array

STATION = BeamNoise(0.36, (4.85e-3) ** 2, np.inf)  # a total station: 0.6 mm, 1 second of arc
LASER = BeamNoise(4e-6, (2.5e-3) ** 2, np.inf)
ALONG = BeamNoise(0.01, 0.0, np.inf)


def places(count: int, rng: np.random.Generator) -> Array:
    return np.array([0.0, 2900.0, -300.0]) + rng.uniform(-700.0, 700.0, (count, 3))


def readings(
    noise: BeamNoise, at_mm: Array, samples: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return what averages of so many readings are, and the scatter of each."""
    single = noise.at(at_mm, np.ones(len(at_mm)))
    drawn = [
        rng.multivariate_normal(each_mm, covariance, count, method="eigh")
        for each_mm, covariance, count in zip(at_mm, single, samples, strict=True)
    ]
    means = np.array([each.mean(axis=0) for each in drawn])
    return means, np.array([each.std(axis=0, ddof=1) for each in drawn])


@pytest.mark.parametrize("noise", [STATION, LASER, ALONG], ids=["station", "laser", "along"])
def test_noise_is_found_along_and_across_the_beam(noise: BeamNoise) -> None:
    rng = np.random.default_rng(1)
    samples = rng.choice([2, 4, 5, 9], 600)
    seen_mm, std_mm = readings(noise, places(600, rng), samples, rng)
    found = beam_noise(seen_mm, std_mm, samples)
    assert found.along_mm2 == pytest.approx(noise.along_mm2, rel=0.15)
    assert found.across_mm2_m2 == pytest.approx(noise.across_mm2_m2, rel=0.15, abs=1e-7)
    assert found.freedom == (samples - 1).sum()


def test_readings_without_scatter_have_no_noise() -> None:
    at_mm = places(20, np.random.default_rng(2))
    assert beam_noise(at_mm, np.zeros((20, 3)), np.full(20, 4)) == BeamNoise(0.0, 0.0, 60.0)


def test_readings_at_other_places_scatter_as_stated() -> None:
    rng = np.random.default_rng(3)
    at_mm, samples = places(2000, rng), np.full(2000, 4)
    off_mm = readings(STATION, at_mm, samples, rng)[0] - at_mm
    inside = STATION.at(at_mm, samples)
    chi2 = np.einsum("ni,nij,nj->n", off_mm, np.linalg.inv(inside), off_mm)
    assert chi2.mean() == pytest.approx(3.0, rel=0.08)
    one_for_all = np.linalg.inv(inside.mean(axis=0))
    assert np.einsum("ni,ij,nj->n", off_mm, one_for_all, off_mm).max() > chi2.max()


def test_a_limit_by_the_noise_found_is_exceeded_as_often_as_its_sigmas_say() -> None:
    """2 standard deviations instead of 4: 4.55 % of all are a number that can be counted."""
    rng = np.random.default_rng(4)
    beyond, points = 0, 3
    for _ in range(600):
        at_mm, samples = places(points, rng), np.full(points, 3)
        noise = beam_noise(*readings(STATION, at_mm, samples, rng), samples)
        again_mm = readings(STATION, at_mm[:1], samples[:1], rng)[0] - at_mm[:1]
        sigma_mm = np.sqrt(np.trace(noise.at(at_mm[:1], samples[:1])[0]))
        beyond += bool(np.linalg.norm(again_mm) > coverage_factor(2.0, noise.freedom) * sigma_mm)
    assert beyond / 600 == pytest.approx(0.0455, abs=0.02)
