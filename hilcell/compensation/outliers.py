"""Which measured vertices do not go with their neighbours.

A smooth field, of second order in x, y and z, is fitted to all vertices but one, and that one is
judged by its distance from it. The trap: a residual of a fit that includes the outlier is pulled
towards it, the more so at the grid's corners; deleted residuals are not.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.kinematics import Array


def deleted_residuals_mm(errors_mm: ArrayLike) -> Array:
    """Return the norms (nx, ny, nz) of the deleted residuals of errors (nx, ny, nz, 3).

    ``r_i / (1 - h_i)``, with h the leverages of the least-squares fit.
    """
    errors = np.asarray(errors_mm, dtype=float)
    A = _terms(errors.shape[:3])
    Q = np.linalg.qr(A)[0]
    values = errors.reshape(-1, 3)
    residuals = values - Q @ (Q.T @ values)
    kept = np.maximum(1.0 - np.sum(Q**2, axis=1), 1e-9)
    norms: Array = np.linalg.norm(residuals, axis=1) / kept
    return norms.reshape(errors.shape[:3])


def _terms(shape: tuple[int, ...]) -> Array:
    """Return the terms (N, M) up to second order; a power is used where the axis has vertices."""
    places = [np.linspace(-1.0, 1.0, count) for count in shape]
    axes = [each.ravel() for each in np.meshgrid(*places, indexing="ij")]
    columns = [np.ones(len(axes[0])), *axes]
    for one, other in combinations_with_replacement(range(3), 2):
        if one != other or shape[one] > 2:
            columns.append(axes[one] * axes[other])
    return np.column_stack(columns)
