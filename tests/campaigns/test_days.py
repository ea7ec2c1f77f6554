"""The campaign of days can fail: a run that grows, or slows down, is said."""

from __future__ import annotations

import math

import pytest

from campaigns.days import Usage, report


def month(*, grows_mb: float = 0.0, slows: float = 1.0) -> list[Usage]:
    """Return the usage of 1000 points; each grows by so much, the last takes so much longer."""
    used_s, found = 0.0, []
    for number in range(1000):
        used_s += 0.01 * (1.0 + (slows - 1.0) * number / 999)
        found.append(Usage(number + 1, 80.0 + grows_mb * number, used_s))
    return found


@pytest.mark.parametrize(
    ("change", "holds"),
    [
        ({}, True),
        ({"grows_mb": 0.005}, True),
        ({"grows_mb": 0.006}, False),
        ({"slows": 1.05}, True),
        ({"slows": 1.3}, False),
        ({"grows_mb": math.nan}, False),
    ],
)
def test_growth_is_said(change: dict[str, float], holds: bool) -> None:
    assert report(month(**change)) == holds
