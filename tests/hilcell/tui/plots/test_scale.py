"""Scales: ticks of 1, 2 and 5, limits off the frame, and no scale that shrinks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.tui.plots import Scale

SIZES = st.floats(1e-6, 1e6)
VALUES = st.lists(st.one_of(SIZES, st.floats()), max_size=8)
HEIGHTS = st.integers(2, 60)


def is_step(value: float) -> bool:
    """Whether a value is 1, 2 or 5 times a power of ten, or zero."""
    return value == 0 or f"{abs(value):.6e}"[0:2] in ("1.", "2.", "5.")


@given(VALUES, st.lists(st.floats(0.001, 100.0), max_size=2), HEIGHTS)
def test_a_log_scale_has_steps_as_ticks_and_no_limit_at_its_frame(
    values: list[float], limits: list[float], height: int
) -> None:
    scale = Scale.log(np.array(values), limits)
    ticks = scale.ticks(height)
    assert scale.low <= Scale.LOG_LOW
    assert scale.high >= Scale.LOG_HIGH
    assert all(is_step(value) for _, value in ticks)
    assert len({row for row, _ in ticks}) == len(ticks)
    assert all(scale.low < limit < scale.high for limit in limits)


@given(VALUES, st.lists(st.floats(-100.0, 100.0), max_size=2), HEIGHTS)
def test_an_even_scale_does_too(values: list[float], limits: list[float], height: int) -> None:
    scale = Scale.even(np.array(values), limits, height)
    assert scale.low <= 0 <= scale.high
    assert is_step(scale.step)
    assert all(scale.low < limit < scale.high for limit in limits if abs(limit) > 1e-3)
    for _, value in scale.ticks(height):
        assert value == pytest.approx(scale.step * round(value / scale.step), abs=1e-6 * scale.step)


@given(VALUES, VALUES, st.booleans())
def test_a_scale_never_shrinks(first: list[float], second: list[float], is_log: bool) -> None:
    make = Scale.log if is_log else Scale.even
    before = make(np.array(first))
    after = make(np.array(second), before=before)
    slack = 1e-6 * (before.high - before.low)
    assert after.low <= before.low + slack
    assert after.high >= before.high - slack


def test_the_ticks_of_the_design() -> None:
    scale = Scale.log(np.array([0.03, 1.6]), [1.0])
    assert [value for _, value in scale.ticks(24)] == [2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01]
    assert [row for row, _ in scale.ticks(24)] == [0, 3, 6, 10, 13, 16, 20, 23]
    assert scale.decimals == 2


def test_a_log_scale_goes_on_by_whole_steps() -> None:
    assert Scale.log(np.array([0.0043, 3.0])) == Scale(0.002, 5.0)
    assert Scale.log(np.array([0.1]), [2.0]) == Scale(0.01, 5.0)  # else the limit were its frame


def test_few_rows_have_decades_only() -> None:
    assert [value for _, value in Scale.log(np.zeros(0)).ticks(6)] == [1.0, 0.1, 0.01]


def test_rows_of_values() -> None:
    scale = Scale(0.0, 10.0, 1.0)
    rows = scale.rows(np.array([10.0, 5.0, 0.0, -3.0, math.nan]), 11)
    np.testing.assert_allclose(rows, [0.5, 5.5, 10.5, 10.5, math.nan])


def test_ticks_have_the_same_decimals() -> None:
    assert Scale.even(np.array([0.0004]), height=24).decimals == 5
    assert Scale.even(np.array([42.0]), height=24).decimals == 0
