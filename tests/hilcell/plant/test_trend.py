"""Trends and steps are found where they are, and seldom where none is."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.plant.equipment import FEWEST, SIGNIFICANCE, fit_trend, main_direction, why_no_trend
from hilcell.ports import Array

YEARS = np.arange(24) / 12.0
NOISE = 0.02
AT = 13


def noise(seed: int, count: int = len(YEARS)) -> Array:
    return np.random.default_rng(seed).normal(0.0, NOISE, count)


def test_noise_is_no_step_and_no_drift() -> None:
    found = [fit_trend(YEARS, noise(seed)) for seed in range(200)]
    assert all(each is not None for each in found)
    steps = sum(bool(each.steps) for each in found if each is not None)
    drifts = sum(each.drifts for each in found if each is not None)
    assert steps <= 200 * SIGNIFICANCE * 3
    assert drifts <= 200 * SIGNIFICANCE * 4


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
