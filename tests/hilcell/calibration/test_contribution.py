"""The arithmetic of the GUM against figures worked out by hand."""

import math

import pytest

from hilcell.calibration.measurement_budget import (
    Contribution,
    Distribution,
    combined_mm,
    expanded_mm,
    thermal_limit_mm,
)


def line(estimate_mm: float, distribution: Distribution) -> Contribution:
    return Contribution("it", estimate_mm, distribution, "somewhere", "somehow", "4.2")


@pytest.mark.parametrize(
    ("estimate_mm", "distribution", "u_mm"),
    [
        (0.010, "normal", 0.010),
        (0.015, "rectangular", 0.0086603),  # 0.015 / sqrt(3)
        (0.0, "rectangular", 0.0),
    ],
)
def test_standard_uncertainty_of_one_coordinate(
    estimate_mm: float, distribution: Distribution, u_mm: float
) -> None:
    found_mm = line(estimate_mm, distribution).u_mm
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
        line(0.010, "rectangular"),  # 33.3333e-6
    ]
    assert combined_mm(lines) == pytest.approx(math.sqrt(262.0966e-6), rel=1e-6)
    assert expanded_mm(combined_mm(lines)) == pytest.approx(0.0323788, abs=1e-6)


def test_thermal_limit() -> None:
    assert thermal_limit_mm(2000.0, 11.5e-6, 2.0) == pytest.approx(0.023)
