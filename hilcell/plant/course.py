"""The course of a measured quantity over years: a trend, steps in it, and what is noise.

The model is a straight line, one coefficient for the temperature where it is known to vary, and
steps. A step is taken in where an F test at 1 %, divided by the number of places at which it could
have been (Bonferroni), rejects the model without it; the best one first, again and again. Noise is
estimated from what the model leaves, so no stated uncertainty is trusted.

Of many coordinates one is judged: the direction in which they differ most over all runs (the first
principal component). It does not depend on the order of the runs, so it prefers no trend or step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hilcell.ports import Array

SIGNIFICANCE = 0.01
CONFIDENCE = 0.95
FEWEST = 6  # runs


@dataclass(frozen=True, slots=True)
class Step:
    """A step before observation ``at``, with its expanded uncertainty; ``after`` are later ones."""

    at: int
    size: float
    U: float
    after: int


@dataclass(frozen=True, slots=True)
class Course:
    """The trend a year with its expanded uncertainty, whether it is one, the steps, the noise."""

    slope: float
    U: float
    drifts: bool
    noise: float
    steps: list[Step]


def hindrance(years: Array, values: Array) -> str:
    """Return why calibrations with values (N,) at times (N,) in years have no course, or ""."""
    if len(values) < FEWEST:
        return f"{len(values)} of the {FEWEST} calibrations that are needed"
    if not float(np.ptp(years)) > 0.0:
        return "all calibrations ended at the same time"
    least_range = 1e-9
    if not float(np.ptp(values)) > least_range:  # a test would judge their rounding
        return "all calibrations found the same"
    return ""


def course(years: Array, values: Array, temperatures_c: Array | None = None) -> Course | None:
    """Return the course of values (N,) at times (N,) in years; None where `hindrance` says why."""
    from scipy import stats  # it takes half a second to import, and most questions need none

    if hindrance(years, values):
        return None
    count = len(values)
    base = [np.ones(count), years - years.mean()]
    least_span_k = 1.0  # less says nothing of how a quantity follows the temperature
    if temperatures_c is not None and float(np.ptp(temperatures_c)) >= least_span_k:
        base.append(temperatures_c - temperatures_c.mean())
    steps: list[int] = []
    while len(steps) < 5 and (at := _next(base, steps, values)) is not None:
        steps.append(at)
    fitted = _Fit.of(base, steps, values)
    factor = float(stats.t.ppf(0.5 + CONFIDENCE / 2, fitted.degrees))
    U = factor * np.sqrt(np.diag(fitted.covariance))
    found = [
        Step(at, float(fitted.values[n]), float(U[n]), count - at)
        for n, at in enumerate(steps, start=len(base))
    ]
    slope, slope_U = float(fitted.values[1]), float(U[1])
    sure = float(stats.t.ppf(1 - SIGNIFICANCE / 2, fitted.degrees)) / factor
    noise = float(np.sqrt(fitted.rest / fitted.degrees))
    steps_found = sorted(found, key=lambda step: step.at)
    return Course(slope, slope_U, abs(slope) > sure * slope_U, noise, steps_found)


def main_direction(vectors: Array) -> Array:
    """Return the coordinate (N,) of vectors (N, D) along the direction in which they differ most.

    It grows from the first to the last.
    """
    centred = vectors - vectors.mean(axis=0)
    along: Array = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    return along if along[-1] >= along[0] else -along


@dataclass(frozen=True, slots=True)
class _Fit:
    values: Array
    covariance: Array
    rest: float
    degrees: int

    @classmethod
    def of(cls, base: list[Array], steps: list[int], values: Array) -> Self:
        """Return the least squares of values (N,) on columns (N,), and a level from each step."""
        places = np.arange(len(base[0]))
        design = np.column_stack([*base, *((places >= at).astype(float) for at in steps)])
        solved = np.linalg.lstsq(design, values, rcond=None)
        found: Array = np.asarray(solved[0], dtype=float)
        rank = solved[2]
        rest, degrees = float(np.sum((values - design @ found) ** 2)), len(values) - int(rank)
        covariance: Array = np.linalg.pinv(design.T @ design) * rest / max(degrees, 1)
        return cls(found, covariance, rest, degrees)


def _next(base: list[Array], steps: list[int], values: Array) -> int | None:
    """Return where the best further step is, if it is one."""
    from scipy import stats

    without = _Fit.of(base, steps, values)
    degrees = without.degrees - 1
    places = [at for at in range(1, len(values)) if at not in steps]
    least_degrees = 3  # of freedom that remain for the noise
    if degrees < least_degrees or not places:
        return None
    rests = [_Fit.of(base, [*steps, at], values).rest for at in places]
    best = int(np.argmin(rests))
    gain = without.rest - rests[best]
    if not gain > 0.0:
        return None
    ratio = gain * degrees / max(rests[best], np.finfo(float).tiny)
    return places[best] if stats.f.sf(ratio, 1, degrees) * len(places) < SIGNIFICANCE else None
