"""Which measured vertices stand out from their neighbours.

A smooth field, of second order in x, y and z, is fitted to all vertices, and each is judged by its
studentized residual: a residual divided by ``sqrt(1 - h)``, h its leverage, so that all have one
spread, at the grid's corners too. That spread is what the residuals themselves show: readings,
repeatability, and what of the robot's error no smooth field follows. A limit in mm would be
knowledge about one robot.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilcell.geometry.kinematics import Array

FALSE_ALARMS = 0.01  # expected of a whole grid whose residuals are normal


def outlying(errors_mm: ArrayLike, *, least_mm: float) -> NDArray[np.bool_]:
    """Return which (nx, ny, nz) of the errors (nx, ny, nz, 3) stand out, by more than ``least_mm``.

    The limit is the quantile that a sound grid exceeds with the probability `FALSE_ALARMS`, of
    the distance of three normal coordinates, at the spread that the median shows. The worst is
    taken out and the rest judged again, so that it neither hides nor accuses its neighbours.
    """
    errors = np.asarray(errors_mm, dtype=float)
    values, A = errors.reshape(-1, 3), _terms(errors.shape[:3])
    kept: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=1))
    highest = _quantile(1.0 - FALSE_ALARMS / len(values))
    while 2 * np.count_nonzero(kept) > len(values):
        off_mm = _studentized_mm(A[kept], values[kept])
        sigma_mm = float(np.median(off_mm)) / _quantile(0.5)
        if np.max(off_mm) <= max(highest * sigma_mm, least_mm):
            break
        kept[np.flatnonzero(kept)[np.argmax(off_mm)]] = False
    return ~kept.reshape(errors.shape[:3])


def _studentized_mm(A: Array, values: Array) -> Array:
    """Return the norms (N,) of the studentized residuals of values (N, 3)."""
    Q = np.linalg.qr(A)[0]
    residuals = values - Q @ (Q.T @ values)
    left = np.maximum(1.0 - np.sum(Q**2, axis=1), 1e-9)
    norms: Array = np.linalg.norm(residuals, axis=1) / np.sqrt(left)
    return norms


def _quantile(share: float) -> float:
    """Return what the distance of three standard normal coordinates stays below.

    The root of a chi-square quantile of 3 degrees of freedom, by Wilson and Hilferty.
    """
    cube = 1.0 - 2.0 / 27.0 + NormalDist().inv_cdf(share) * (2.0 / 27.0) ** 0.5
    return float((3.0 * cube**3) ** 0.5)


def _terms(shape: tuple[int, ...]) -> Array:
    """Return the terms (N, M) up to second order; a power is used where the axis has vertices."""
    places = [np.linspace(-1.0, 1.0, count) for count in shape]
    axes = [each.ravel() for each in np.meshgrid(*places, indexing="ij")]
    columns = [np.ones(len(axes[0])), *axes]
    for one, other in combinations_with_replacement(range(3), 2):
        if one != other or shape[one] > 2:
            columns.append(axes[one] * axes[other])
    return np.column_stack(columns)
