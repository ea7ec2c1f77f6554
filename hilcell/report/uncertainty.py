"""Uncertainty after the GUM (JCGM 100:2008): contributions, combined and expanded.

Every figure is for **one coordinate** of a position, in mm. A contribution that acts along one
direction only, or a 3D length, counts with its root mean square over the three coordinates; 3D
errors are sqrt(3) times larger than what stands here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from hilcell.ports import Array

COVERAGE_FACTOR = 2.0  # about 95 % of a normal distribution (GUM 6.3.3)
MEASURED, ASSUMED = "measured in this run", "stated assumption"
Distribution = Literal["normal", "rectangular"]
_DIVISORS: dict[Distribution, float] = {"normal": 1.0, "rectangular": math.sqrt(3.0)}


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a budget.

    ``estimate_mm`` is a standard deviation (normal) or a half-width (rectangular, GUM 4.3.7);
    ``directions`` of the three coordinates feel it.
    """

    name: str
    estimate_mm: float
    distribution: Distribution
    source: str
    how: str
    clause: str
    directions: int = 3

    @property
    def u_mm(self) -> float:
        """Return the standard uncertainty of one coordinate (GUM 4.2, 4.3)."""
        return self.estimate_mm / _DIVISORS[self.distribution] * math.sqrt(self.directions / 3)


def combined_mm(contributions: Iterable[Contribution]) -> float:
    """Return the combined standard uncertainty of uncorrelated contributions (GUM 5.1.2, eq 10).

    All sensitivity coefficients are 1: every contribution is already a length at the tool point.
    """
    return math.sqrt(sum(each.u_mm**2 for each in contributions))


def expanded_mm(u_mm: float, k: float = COVERAGE_FACTOR) -> float:
    """Return the expanded uncertainty U = k u (GUM 6.2.1)."""
    return k * u_mm


def coordinate_rms_mm(vectors_mm: ArrayLike) -> float:
    """Return the root mean square of one coordinate of vectors (N, 3)."""
    return float(np.sqrt(np.mean(np.square(np.asarray(vectors_mm, dtype=float)))))


def pooled_std_mm(clouds_mm: Sequence[Array]) -> float:
    """Return the standard deviation of one coordinate, pooled over clouds (N_i, 3) (GUM 4.2.4).

    Each cloud spends one degree of freedom a coordinate on its own mean.
    """
    squares = sum(float(np.square(cloud - cloud.mean(axis=0)).sum()) for cloud in clouds_mm)
    return math.sqrt(squares / (3 * sum(len(cloud) - 1 for cloud in clouds_mm)))


def mean_reading_std_mm(std_mm: ArrayLike, samples: ArrayLike) -> float:
    """Return the standard deviation of one coordinate of averaged readings (GUM 4.2.3).

    ``std_mm`` (N, 3) is that of a single reading, ``samples`` (N,) how many were averaged.
    """
    variance_mm2 = np.square(np.asarray(std_mm, dtype=float)) / np.asarray(samples)[:, None]
    return float(np.sqrt(variance_mm2.mean()))


def thermal_limit_mm(length_mm: float, expansion_per_k: float, range_k: float) -> float:
    """Return by how much half a temperature range lengthens ``length_mm`` (GUM 4.3.7)."""
    return length_mm * expansion_per_k * range_k / 2


def remainder_mm(whole_mm: float, *parts_mm: float) -> float:
    """Return what independent parts leave of a whole, in squares; nothing where they exceed it."""
    return math.sqrt(max(0.0, whole_mm**2 - sum(part**2 for part in parts_mm)))
