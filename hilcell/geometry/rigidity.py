"""Points that have moved on a rigid body, found by distances, which no frame changes.

Points that change places in a symmetry of the body keep every distance. So distances
prove a body only together with the expected place of each point, roughly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array

SIGMAS = 4.0  # known ones. 28 pairs of 8 nests at 3 stations: by chance one in a hundred runs


@dataclass(frozen=True, slots=True)
class Moved:
    """Points (by number) that moved against those ``kept``; the worst distance and its limit."""

    moved: tuple[int, ...]
    kept: tuple[int, ...]
    worst_mm: float
    limit_mm: float


def moved_points(a_mm: Array, b_mm: Array, covariances_mm2: Array, sigmas: float = SIGMAS) -> Moved:
    """Return which of the points (N, 3), seen as ``a`` and later as ``b``, moved on their body.

    ``covariances_mm2`` (N, 3, 3) are those of each pair's difference, axes of b. Where they are
    estimates, ``sigmas`` is the factor of the same risk (`coverage_factor`). The point with the
    most excess in its distances to the others is taken away until all distances agree.
    """
    change_mm = _distances(b_mm) - _distances(a_mm)
    # by which each pair may differ besides: a reflector taken out and put back
    by_seating_mm = 0.005
    limit_mm = sigmas * np.sqrt(_variances(b_mm, covariances_mm2) + by_seating_mm**2)
    ratio = np.abs(change_mm) / limit_mm
    np.fill_diagonal(ratio, 0.0)
    ratio[~np.isfinite(ratio)] = np.inf  # not a number agrees with nothing
    kept, moved = list(range(len(a_mm))), []
    while True:
        excess = ratio[np.ix_(kept, kept)]
        bad = ~(excess <= 1.0)
        if not bad.any():
            break
        worst = kept[int(np.argmax(np.where(bad, np.minimum(excess, 1e6) ** 2, 0.0).sum(axis=1)))]
        kept.remove(worst)
        moved.append(worst)
    first, second = np.unravel_index(int(np.argmax(ratio)), ratio.shape)
    return Moved(
        tuple(sorted(moved)),
        tuple(kept),
        float(np.abs(change_mm[first, second])),
        float(limit_mm[first, second]),
    )


def _distances(points_mm: Array) -> Array:
    distances: Array = np.linalg.norm(points_mm[:, None] - points_mm[None], axis=-1)
    return distances


def _variances(points_mm: Array, covariances_mm2: Array) -> Array:
    """Return the variances (N, N) of distances between points (N, 3) along their directions."""
    between = points_mm[:, None] - points_mm[None]
    length = np.linalg.norm(between, axis=-1, keepdims=True)
    direction = np.divide(between, length, out=np.zeros_like(between), where=length > 0)
    pairs = covariances_mm2[:, None] + covariances_mm2[None]
    variances: Array = np.einsum("mni,mnij,mnj->mn", direction, pairs, direction)
    return variances
