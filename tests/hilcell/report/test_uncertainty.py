"""The arithmetic of the GUM against figures worked out by hand."""

import math

import pytest

from hilcell.report.uncertainty import (
    MEASURED,
    Contribution,
    Distribution,
    combined_mm,
    expanded_mm,
    remainder_mm,
    thermal_limit_mm,
)


def line(estimate_mm: float, distribution: Distribution, directions: int = 3) -> Contribution:
    return Contribution("it", estimate_mm, distribution, MEASURED, "somehow", "4.2", directions)


@pytest.mark.parametrize(
    ("estimate_mm", "distribution", "directions", "u_mm"),
    [
        (0.010, "normal", 3, 0.010),
        (0.015, "rectangular", 3, 0.0086603),  # 0.015 / sqrt(3)
        (0.010, "rectangular", 1, 0.0033333),  # 0.010 / sqrt(3), in one of three directions
        (0.030, "normal", 1, 0.0173205),
        (0.0, "rectangular", 3, 0.0),
    ],
)
def test_standard_uncertainty_of_one_coordinate(
    estimate_mm: float, distribution: Distribution, directions: int, u_mm: float
) -> None:
    found_mm = line(estimate_mm, distribution, directions).u_mm
    assert found_mm == pytest.approx(u_mm, abs=5e-8)


def test_combined_and_expanded() -> None:
    u_mm = combined_mm([line(0.03, "normal"), line(0.04, "normal")])
    assert u_mm == pytest.approx(0.05)
    assert expanded_mm(u_mm) == pytest.approx(0.10)
    assert expanded_mm(u_mm, 3.0) == pytest.approx(0.15)


def test_a_whole_budget_by_hand() -> None:
    lines = [
        line(0.010, "normal"),  # 100e-6
        line(0.015, "rectangular"),  # 75e-6
        line(0.0127, "rectangular"),  # 53.7633e-6
        line(0.010, "rectangular", 1),  # 11.1111e-6
    ]
    assert combined_mm(lines) == pytest.approx(math.sqrt(239.8744e-6), rel=1e-6)
    assert expanded_mm(combined_mm(lines)) == pytest.approx(0.0309757, abs=1e-6)


def test_thermal_limit() -> None:
    assert thermal_limit_mm(2000.0, 11.5e-6, 2.0) == pytest.approx(0.023)


@pytest.mark.parametrize(
    ("whole_mm", "parts_mm", "left_mm"),
    [(5.0, (4.0,), 3.0), (13.0, (4.0, 3.0), 12.0), (1.0, (2.0,), 0.0)],
)
def test_remainder(whole_mm: float, parts_mm: tuple[float, ...], left_mm: float) -> None:
    assert remainder_mm(whole_mm, *parts_mm) == pytest.approx(left_mm)
