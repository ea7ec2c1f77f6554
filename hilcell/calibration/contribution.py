"""Uncertainty after the GUM (JCGM 100:2008): contributions, combined and expanded.

Every figure is for **one coordinate** of a position, in mm. Where all three have the same u, 95 %
of 3D errors keep 2.80 u, which is 1.40 U: the root of chi^2 of three degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hilcell.cell.uncertainty import UncertaintyTable
from hilcell.geometry.statistics import rectangular_variance
from hilcell.ports import Array

COVERAGE_FACTOR = 2.0  # about 95 % of a normal distribution (GUM 6.3.3)
Distribution = Literal["normal", "rectangular"]
_DIVISORS: dict[Distribution, float] = {"normal": 1.0, "rectangular": math.sqrt(3.0)}


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a budget.

    ``estimate_mm`` is a standard deviation (normal) or a half-width (rectangular, GUM 4.3.7).
    """

    name: str
    estimate_mm: float
    distribution: Distribution
    source: str
    how: str
    clause: str

    @property
    def u_mm(self) -> float:
        """Return the standard uncertainty of one coordinate (GUM 4.2, 4.3)."""
        return self.estimate_mm / _DIVISORS[self.distribution]


def combined_mm(contributions: Iterable[Contribution]) -> float:
    """Return the combined standard uncertainty of uncorrelated contributions (GUM 5.1.2, eq 10).

    All sensitivity coefficients are 1: every contribution is already a length at the tool point.
    """
    return math.sqrt(sum(each.u_mm**2 for each in contributions))


def expanded_mm(u_mm: float, k: float = COVERAGE_FACTOR) -> float:
    """Return the expanded uncertainty U = k u (GUM 6.2.1)."""
    return k * u_mm


def thermal_limit_mm(length_mm: float, expansion_per_k: float, range_k: float) -> float:
    """Return by how much half a temperature range lengthens ``length_mm`` (GUM 4.3.7)."""
    return length_mm * expansion_per_k * range_k / 2


def systematic_mm2(stated: UncertaintyTable, at_mm: Array) -> Array:
    """Return the variances (N,) of one coordinate at (N, 3), tracker's frame, by its limits."""
    range_mm2 = np.square(at_mm).sum(axis=-1)
    found: Array = rectangular_variance(stated.tracker_limit_mm) + range_mm2 * (
        rectangular_variance(stated.tracker_limit_um_m * 1e-6)
    )
    return found
