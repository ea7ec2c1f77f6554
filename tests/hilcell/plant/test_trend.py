"""Trends and steps are found where they are, and seldom where none is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hilcell.plant.equipment import (
    FEWEST,
    SIGNIFICANCE,
    Series,
    Trend,
    fit_trends,
    main_direction,
    theil_sen,
    why_no_slope,
    why_no_trend,
)  # fmt: skip
from hilcell.ports import Array

YEARS = np.arange(24) / 12.0
NOISE = 0.02
AT = 13


def fit_trend(years: Array, values: Array, temperatures_c: Array | None = None) -> Trend | None:
    """Return the trend of a quantity that is judged alone."""
    (found,) = fit_trends([Series(years, values, temperatures_c)])
    return found


def noise(seed: int, count: int = len(YEARS)) -> Array:
    return np.random.default_rng(seed).normal(0.0, NOISE, count)


def test_noise_is_no_step_and_no_drift() -> None:
    found = [fit_trend(YEARS, noise(seed)) for seed in range(200)]
    assert all(each is not None for each in found)
    steps = sum(bool(each.steps) for each in found if each is not None)
    drifts = sum(each.drifts for each in found if each is not None)
    assert steps <= 200 * SIGNIFICANCE * 3
    assert drifts <= 200 * SIGNIFICANCE * 4


@pytest.mark.parametrize("changed", [0, 5])
def test_of_a_whole_plant_hardly_a_line_is_false(changed: int) -> None:
    """100 quantities, some with a step: 1 % of the steps and of the drifts that are shown may be
    false, or a plant in a hundred without any change has a line.
    """
    false = found = 0
    for seed in range(20):
        step = 0.15 * (np.arange(24) >= AT)
        every = [Series(YEARS, noise(1000 * seed + n) + step * (n < changed)) for n in range(100)]
        trends = [each for each in fit_trends(every) if each is not None]
        found += sum(AT in [step.at for step in each.steps] for each in trends[:changed])
        false += sum(len(each.steps) for each in trends[changed:])
        false += sum(each.drifts for each in trends[changed:])
    assert false <= 3
    assert found >= 0.9 * 20 * changed


def test_a_step_is_found_where_it_is_with_a_true_uncertainty() -> None:
    covered = 0
    for seed in range(100):
        found = fit_trend(YEARS, noise(seed) + 0.15 * (np.arange(24) >= AT))
        assert found is not None
        assert AT in [step.at for step in found.steps]
        step = next(step for step in found.steps if step.at == AT)
        assert step.after == 24 - AT
        covered += abs(step.size - 0.15) <= step.U
    assert covered >= 88


def test_a_trend_is_no_step() -> None:
    stepped = 0
    for seed in range(1000, 1100):
        found = fit_trend(YEARS, noise(seed) + 0.1 * YEARS)
        assert found is not None
        assert found.drifts
        stepped += bool(found.steps)
        assert abs(found.slope - 0.1) < 0.05
    assert stepped <= 4


def fitted(columns: list[Array], steps: list[int], values: Array) -> tuple[Array, Array, float]:
    """Return parameters, their covariance and the sum of squares that is left."""
    places = np.arange(len(values))
    design = np.column_stack([*columns, *((places >= at).astype(float) for at in steps)])
    found = np.linalg.lstsq(design, values, rcond=None)[0]
    rest = float(np.sum((values - design @ found) ** 2))
    degrees = len(values) - design.shape[1]
    covariance: Array = np.linalg.pinv(design.T @ design) * rest / degrees
    return np.asarray(found, dtype=float), covariance, rest


@pytest.mark.parametrize("seed", range(12))
def test_all_places_at_once_are_least_squares_at_each(seed: int) -> None:
    """Digits are those of one fit at each place, and the tests those of scipy.stats."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(FEWEST, 60))
    years = np.sort(rng.uniform(0.0, 5.0, count))
    celsius = rng.normal(20.0, 3.0, count)
    jumps = [rng.normal(0.0, 0.3) * (np.arange(count) >= at) for at in rng.integers(1, count, 3)]
    values = 0.1 * years + 0.01 * celsius + sum(jumps) + rng.normal(0.0, NOISE, count)
    columns = [np.ones(count), years - years.mean(), celsius - celsius.mean()]
    steps: list[int] = []
    while len(steps) < 5:
        without = fitted(columns, steps, values)[2]
        places = [at for at in range(1, count) if at not in steps]
        rests = [fitted(columns, [*steps, at], values)[2] for at in places]
        degrees = count - len(columns) - len(steps) - 1
        if degrees < 3:
            break
        best = int(np.argmin(rests))
        p = stats.f.sf((without - rests[best]) * degrees / rests[best], 1, degrees) * len(places)
        if not p < SIGNIFICANCE:
            break
        steps.append(places[best])
    expected, covariance, rest = fitted(columns, steps, values)
    degrees = count - len(columns) - len(steps)
    found = fit_trend(years, values, celsius)
    assert found is not None
    assert [step.at for step in found.steps] == sorted(steps)
    U = stats.t.ppf(0.975, degrees) * np.sqrt(np.diag(covariance))
    sizes = {at: (expected[n], U[n]) for n, at in enumerate(steps, start=len(columns))}
    for step in found.steps:
        assert (step.size, step.U) == pytest.approx(sizes[step.at], rel=1e-9)
    assert (found.slope, found.U) == pytest.approx((expected[1], U[1]), rel=1e-9)
    assert found.noise == pytest.approx(np.sqrt(rest / degrees), rel=1e-9)


def test_the_first_component_is_that_of_a_singular_value_decomposition() -> None:
    rng = np.random.default_rng(4)
    for shape in ((24, 9), (24, 192), (6, 9)):
        vectors = rng.normal(size=shape)
        centred = vectors - vectors.mean(axis=0)
        along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
        found = main_direction(vectors)
        assert found == pytest.approx(along if along[-1] >= along[0] else -along, rel=1e-9)


def test_what_follows_the_room_s_temperature_is_no_drift() -> None:
    warm_c = 20.0 + 4.0 * np.sin(2 * np.pi * YEARS)
    values = noise(1) + 0.05 * (warm_c - 20.0)
    with_it, without = fit_trend(YEARS, values, warm_c), fit_trend(YEARS, values)
    assert with_it is not None
    assert without is not None
    assert not with_it.drifts
    assert not with_it.steps
    assert with_it.noise < 1.5 * NOISE < without.noise


def test_a_run_that_alone_differs_at_the_end_is_seen_once() -> None:
    values = noise(3)
    values[-1] += 0.4
    found = fit_trend(YEARS, values)
    assert found is not None
    assert [(step.at, step.after) for step in found.steps] == [(23, 1)]


SHORT = "too short: expected runs over 7 days or more"


@pytest.mark.parametrize(
    ("years", "values", "reason"),
    [
        (YEARS, np.zeros(24), "all calibrations gave the same values"),
        (YEARS, np.full(24, 0.3), "all calibrations gave the same values"),
        (np.full(24, 0.5), noise(1), "all calibrations ended at the same time"),
        (YEARS[: FEWEST - 1], noise(1, FEWEST - 1), "expected at least 6 calibrations, got 5"),
    ],
)
def test_what_has_no_course_has_a_reason(years: Array, values: Array, reason: str) -> None:
    assert fit_trend(years, values) is None
    assert why_no_trend(years, values) == reason


@pytest.mark.parametrize(
    ("years", "reason"),
    [
        (YEARS, ""),
        (np.linspace(0.0, 7.1, 24) / 365.25, ""),
        (np.linspace(0.0, 6.9, 24) / 365.25, f"{SHORT}, got 6.9 days"),
        (np.full(24, np.nan), f"{SHORT}, got nan days"),
        (YEARS[: FEWEST - 1], "expected at least 6 runs, got 5"),
    ],
)
def test_a_change_a_year_needs_runs_and_time(years: Array, reason: str) -> None:
    assert why_no_slope(years) == reason


def test_the_main_direction_is_that_of_the_change_whatever_the_order() -> None:
    rng = np.random.default_rng(5)
    along = rng.normal(size=81)
    along /= np.linalg.norm(along)
    vectors = rng.normal(0.0, 0.01, (24, 81)) + np.outer(np.arange(24) >= AT, along)
    found = main_direction(vectors)
    assert found[AT:].mean() - found[:AT].mean() == pytest.approx(1.0, abs=0.05)
    order = rng.permutation(24)
    mixed = main_direction(vectors[order])
    assert np.abs(mixed) == pytest.approx(np.abs(found[order]))


@pytest.mark.parametrize("digits", [6, 1])
@pytest.mark.parametrize("count", [FEWEST, 25])
def test_the_slope_of_a_station_is_that_of_scipy(count: int, digits: int) -> None:
    """With and without equal values."""
    from scipy import stats

    rng = np.random.default_rng(count)
    times = np.sort(rng.uniform(0.0, 5.0, count))
    values = np.round(0.1 * times + rng.normal(0.0, 0.1, count), digits)
    expected = stats.theilslopes(values, times, 0.95)
    np.testing.assert_allclose(theil_sen(times, values), expected, rtol=1e-12)
