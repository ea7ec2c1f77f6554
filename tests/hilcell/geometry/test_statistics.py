"""The statistics of errors against figures worked out by hand."""

import math

import numpy as np
import pytest

from hilcell.geometry.statistics import (
    figures_of,
    from_mean_mm,
    lengths_mm,
    pooled_std_mm,
    reading_variances_mm2,
    repeatability_mm,
    rms,
    variance_of_mean,
)

PAIR = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


def test_figures_of_3d_errors() -> None:
    lengths = lengths_mm([[3.0, 4.0, 0.0], *[[0.0, 0.0, n] for n in range(20)]])
    np.testing.assert_allclose(lengths[:3], [5.0, 0.0, 1.0])
    found = figures_of(lengths)
    assert found == pytest.approx((195 / 21, 18.0, 19.0))
    assert found._asdict() == {"mean": found[0], "p95": found[1], "max": found[2]}


def test_nan_is_no_figure() -> None:
    assert np.isnan(figures_of(lengths_mm([[0.0, 0.0, 1.0], [np.nan, 0.0, 0.0]]))).all()


def test_rms_of_vectors_is_that_of_one_coordinate() -> None:
    assert rms([[3, 0, 0], [0, 3, 0], [0, 0, 3]]) == pytest.approx(math.sqrt(3))
    assert rms([3.0, 4.0]) == pytest.approx(math.sqrt(12.5))


def test_repeatability_is_mean_and_three_standard_deviations() -> None:
    np.testing.assert_allclose(from_mean_mm(PAIR), [1.0, 1.0])
    assert repeatability_mm(from_mean_mm(PAIR)) == 1.0
    assert repeatability_mm(np.array([1.0, 2.0, 3.0])) == pytest.approx(2.0 + 3.0)


def test_variance_of_a_mean() -> None:
    assert variance_of_mean([1.0, 2.0, 3.0]) == pytest.approx(1 / 3)


def test_averaged_readings() -> None:
    found = reading_variances_mm2([[3.0, 3.0, 3.0], [7.0, 0.0, 1.0]], [9, 1])
    np.testing.assert_allclose(found, [[1.0, 1.0, 1.0], [49.0, 0.0, 1.0]])


def test_pooled_std_spends_a_degree_of_freedom_on_each_mean() -> None:
    # The squares of a pair sum to 2; it has one degree of freedom a coordinate.
    assert pooled_std_mm([PAIR]) == pytest.approx(math.sqrt(2 / 3))
    assert pooled_std_mm([PAIR, PAIR + 100.0]) == pytest.approx(math.sqrt(4 / 6))


def test_pooled_std_is_the_truth_on_the_average() -> None:
    rng = np.random.default_rng(5)
    clouds = [rng.normal(scale=0.02, size=(10, 3)) + place for place in range(200)]
    assert pooled_std_mm(clouds) == pytest.approx(0.02, rel=0.03)
