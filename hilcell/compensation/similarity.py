"""How alike the position errors of two poses are (section 3.2, eq 8), and over which distance.

The errors are smooth functions of the joints, so similarity falls with the distance of joints. Eq
8's infinity for equal errors is a definition and no weight, and one nearly equal pair rules a mean
of similarities: means are taken of the differences. And the distance of tool points stands for that
of joints only at one fixed orientation and configuration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError


class SimilarityError(HilcellError):
    """Poses or bins of which no similarity can be stated."""

    code = "HC-C21"


@dataclass(frozen=True, slots=True)
class Pairs:
    """Every two of a set of poses: distances of joints and of tool points, difference of errors.

    Each (P,); ``joint_rad`` is the norm of the six joints' differences, ``cartesian_mm`` the
    distance of nominal tool points, ``difference_mm`` the norm of the difference of errors.
    """

    joint_rad: Array
    cartesian_mm: Array
    difference_mm: Array

    @property
    def similarity(self) -> Array:
        """Return eq 8's similarity (P,) in 1/mm."""
        return _inverted(self.difference_mm)


@dataclass(frozen=True, slots=True)
class Binned:
    """Mean difference of errors over bins of a distance, each (K,); NaN in empty bins."""

    centre: Array
    difference_mm: Array
    count: NDArray[np.int_]

    @property
    def similarity(self) -> Array:
        """Return eq 8's similarity (K,) in 1/mm of the mean difference."""
        return _inverted(self.difference_mm)


def similarity_pairs(joints_rad: ArrayLike, points_mm: ArrayLike, errors_mm: ArrayLike) -> Pairs:
    """Return all N (N - 1) / 2 pairs of poses: joints (N, 6), nominal points and errors (N, 3).

    Raises `SimilarityError` for fewer than two poses, unequal lengths or values not finite.
    """
    sets = [np.asarray(each, dtype=float) for each in (joints_rad, points_mm, errors_mm)]
    count = len(sets[0])
    if [each.shape for each in sets] != [(count, 6), (count, 3), (count, 3)] or count < 2:
        found = ", ".join(str(each.shape) for each in sets)
        raise SimilarityError(f"similarity: shapes {found}, wanted (N, 6), (N, 3), (N, 3), N >= 2")
    if not all(np.isfinite(each).all() for each in sets):
        raise SimilarityError("similarity: joints, points and errors must be finite")
    one, other = np.triu_indices(count, 1)
    return Pairs(*(np.linalg.norm(each[one] - each[other], axis=1) for each in sets))


def binned(distance: Array, difference_mm: Array, edges: ArrayLike) -> Binned:
    """Return the mean difference over ``edges`` (K + 1,) of a distance (P,), the data of a plot.

    A bin holds its lower edge, the last one its upper edge too. Raises `SimilarityError` where
    the edges do not rise.
    """
    limits = np.asarray(edges, dtype=float)
    if limits.ndim != 1 or len(limits) < 2 or not (np.diff(limits) > 0).all():
        raise SimilarityError(f"similarity: edges {limits} of bins, wanted two or more that rise")
    count, _ = np.histogram(distance, limits)
    total, _ = np.histogram(distance, limits, weights=difference_mm)
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return Binned((limits[1:] + limits[:-1]) / 2, mean, count)


def _inverted(difference_mm: Array) -> Array:
    return np.divide(
        1.0, difference_mm, out=np.full_like(difference_mm, np.inf), where=difference_mm != 0
    )
