"""The statistics of errors against figures worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hilcell.geometry.statistics import (
    LEAST_BOUNDED,
    BeamNoise,
    beam_noise,
    bounds95_mm,
    chance_of_at_most,
    chi2_quantile,
    conformal_factor,
    coverage_factor,
    effective_freedom,
    expanded,
    f_quantile,
    figures_of,
    from_mean_mm,
    lengths_mm,
    pooled_std_mm,
    repeatability_mm,
    rms,
    rounded,
    slope,
    trace_freedom,
)
from hilcell.ports import Array

PAIR = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


def test_figures_of_3d_errors() -> None:
    lengths = lengths_mm([[3.0, 4.0, 0.0], *[[0.0, 0.0, n] for n in range(20)]])
    np.testing.assert_allclose(lengths[:3], [5.0, 0.0, 1.0])
    found = figures_of(lengths)
    assert found == pytest.approx((195 / 21, 18.0, 19.0))
    assert found._asdict() == {"mean": found[0], "p95": found[1], "max": found[2]}


def test_rms_of_vectors_is_that_of_one_coordinate() -> None:
    assert rms([[3, 0, 0], [0, 3, 0], [0, 0, 3]]) == pytest.approx(math.sqrt(3))
    assert rms([3.0, 4.0]) == pytest.approx(math.sqrt(12.5))


def test_repeatability_is_mean_and_three_standard_deviations() -> None:
    np.testing.assert_allclose(from_mean_mm(PAIR), [1.0, 1.0])
    assert repeatability_mm(from_mean_mm(PAIR)) == 1.0
    assert repeatability_mm(np.array([1.0, 2.0, 3.0])) == pytest.approx(2.0 + 3.0)


def test_pooled_std_spends_a_degree_of_freedom_on_each_mean() -> None:
    # The squares of a pair sum to 2; it has one degree of freedom a coordinate.
    assert pooled_std_mm([PAIR]) == pytest.approx(math.sqrt(2 / 3))
    assert pooled_std_mm([PAIR, PAIR + 100.0]) == pytest.approx(math.sqrt(4 / 6))


@pytest.mark.parametrize(
    ("variances", "bound"),
    [
        ((1, 1, 1), math.sqrt(7.814728)),  # chi^2 of three degrees of freedom
        ((4, 4, 0), 2 * math.sqrt(5.991465)),  # of two
        ((0, 9, 0), 3 * math.sqrt(3.841459)),  # of one
        ((0, 0, 0), 0.0),
    ],
)
def test_bounds_of_equal_variances_are_those_of_chi2(
    variances: tuple[float, ...], bound: float
) -> None:
    rotation = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    covariance = rotation @ np.diag(np.array(variances, dtype=float)) @ rotation.T
    np.testing.assert_allclose(bounds95_mm(covariance[None]), [bound], rtol=1e-5)


@pytest.mark.parametrize("sizes", [(1, 0.7, 0.4), (1, 0.5, 0), (1, 0.1, 0.1)])
def test_bounds_cover_95_percent_of_drawn_errors(sizes: tuple[float, ...]) -> None:
    sigmas = np.array(sizes)
    drawn = np.linalg.norm(np.random.default_rng(2).standard_normal((200_000, 3)) * sigmas, axis=1)
    found = bounds95_mm(np.diag(sigmas**2)[None])[0]
    assert found == pytest.approx(np.quantile(drawn, 0.95), rel=0.015)
    assert 0.945 <= np.mean(drawn <= found) <= 0.955


def test_bounds_of_estimated_covariances_cover_as_much() -> None:
    """Each trial estimates the covariance from twelve vectors, and draws one error."""
    rng, sigmas, samples = np.random.default_rng(3), np.array([1.0, 0.6, 0.3]), 12
    vectors = rng.standard_normal((5000, samples, 3)) * sigmas
    covariances = np.einsum("tsi,tsj->tij", vectors, vectors) / samples
    errors = lengths_mm(rng.standard_normal((len(vectors), 3)) * sigmas)
    freedom = [trace_freedom(each, samples) for each in covariances]
    assert 0.942 <= np.mean(errors <= bounds95_mm(covariances, freedom)) <= 0.958
    assert np.mean(errors <= bounds95_mm(covariances)) < 0.94


def test_degrees_of_freedom_of_a_sum() -> None:
    assert trace_freedom(np.eye(3), 10) == pytest.approx(30)
    assert trace_freedom(np.diag([1.0, 0, 0]), 10) == pytest.approx(10)
    assert trace_freedom(np.zeros((3, 3)), 10) == math.inf
    found = effective_freedom([[4.0, 0.0, 2.0], [4.0, 0.0, 2.0]], [4, math.inf])
    np.testing.assert_allclose(found, [16.0, math.inf, 16.0])  # 8^2 / (4^2 / 4)


def test_a_variance_of_nan_has_no_bound() -> None:
    assert np.isnan(bounds95_mm(np.full((1, 3, 3), np.nan))[0])


def test_the_slope_of_a_line_and_its_uncertainty() -> None:
    # By hand: residuals 1/6, -2/6, 1/6 about 1.5 x - 1/6, one degree of freedom, S_xx = 2.
    x = np.arange(3.0)
    assert slope(x, np.array([0.0, 1.0, 3.0])) == pytest.approx((1.5, math.sqrt(1 / 12)))
    assert slope(x, np.full(3, 4.0)) == (0.0, 0.0)
    assert slope(x, 2.0 * x) == pytest.approx((2.0, 0.0), abs=1e-7)


def test_quantiles_are_those_of_the_tables() -> None:
    assert chi2_quantile(0.95, 3) == pytest.approx(7.8147, abs=1e-4)
    assert f_quantile(0.95, 3, 10) == pytest.approx(3.7083, abs=1e-4)


def test_the_chance_of_few_is_the_binomial_s() -> None:
    assert chance_of_at_most(0, 8, 0.6) == pytest.approx(0.4**8)
    assert chance_of_at_most(1, 2, 0.5) == pytest.approx(0.75)
    assert chance_of_at_most(8, 8, 0.6) == pytest.approx(1.0)


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


@pytest.mark.parametrize("place", [True, False])
def test_a_reading_that_is_no_number_shows_no_noise(place: bool) -> None:
    rng = np.random.default_rng(2)
    at_mm, std_mm, samples = places(20, rng), np.full((20, 3), 0.1), np.full(20, 4)
    wanted = beam_noise(at_mm[1:], std_mm[1:], samples[1:])
    (at_mm if place else std_mm)[0, 1] = np.nan
    assert beam_noise(at_mm, std_mm, samples) == wanted


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


def test_expanded_is_of_the_worst_direction_and_of_few_degrees_of_freedom() -> None:
    turned = np.array([[5.0, 4.0], [4.0, 5.0]])  # variances 9 and 1
    assert expanded(turned) == pytest.approx(6.0)
    assert expanded(turned, freedom=4) == pytest.approx(3.0 * 2.8693, rel=1e-4)


@pytest.mark.parametrize(
    ("U", "value"), [(0.12, 1638.35), (2.3, 1638.3), (0.0098, 1638.3457), (0.0, 1638.34567)]
)
def test_a_value_has_the_digits_that_its_uncertainty_supports(U: float, value: float) -> None:
    assert rounded(1638.34567, U) == value
    assert str(rounded(-0.001, 2.0)) == "0.0"


@pytest.mark.parametrize("count", [19, 40, 200])
def test_a_conformal_factor_bounds_19_of_20_further_values(count: int) -> None:
    """Whatever their distribution, here a very skewed one."""
    rng, inside = np.random.default_rng(count), []
    for _ in range(400):
        scores = rng.standard_normal((2, count)) ** 4
        inside.append((scores[1] <= conformal_factor(scores[0])).mean())
    assert 0.94 < float(np.mean(inside)) < 0.95 + 1.2 / count + 0.01


def test_few_scores_bound_nothing() -> None:
    scores = np.arange(LEAST_BOUNDED)
    assert conformal_factor(scores) == LEAST_BOUNDED - 1
    assert math.isinf(conformal_factor(scores[1:]))


def test_at_the_centre_of_the_tracker_all_noise_is_along_the_beam() -> None:
    at_mm = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2000.0]])
    found = beam_noise(at_mm, np.full((2, 3), 0.1), np.array([5, 5]))
    np.testing.assert_allclose(found.at(at_mm, [1, 1]), np.tile(0.01 * np.eye(3), (2, 1, 1)))
