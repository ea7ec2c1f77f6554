"""Errors predicted from poses scattered in space, of which no lattice is known.

Both models state one covariance (3, 3) for all targets: the mean square of the misses at poses
that were left out. So it covers the poses' readings, repeatability and what lies between the
poses, in the mean over them; it does not say where in space a prediction is worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from hilcell.compensation.interpolation import inverse_distance_weights
from hilcell.compensation.model import Prediction
from hilcell.geometry.kinematics import Array
from hilcell.identification.readings import Ints

NEIGHBOURS = 8  # poses that one prediction is interpolated from


@dataclass(frozen=True, eq=False)
class Nominal:
    """Nominal kinematics alone: no error is predicted."""

    covariance_mm2: Array

    @classmethod
    def learn(cls, points_mm: Array, errors_mm: Array, fold: Ints) -> Self:
        """Return the model of errors (N, 3) at points (N, 3); no ``fold`` (N,) matters to it."""
        return cls(_mean_square_mm2(errors_mm))

    def predict(self, targets_mm: Array) -> Prediction:
        """Return no error at targets (N, 3)."""
        return _everywhere(np.zeros_like(targets_mm), self.covariance_mm2)


@dataclass(frozen=True, eq=False)
class NearestPoses:
    """Eqs 9-10 over the `NEIGHBOURS` nearest poses, by the distance of nominal positions."""

    points_mm: Array
    errors_mm: Array
    covariance_mm2: Array

    @classmethod
    def learn(cls, points_mm: Array, errors_mm: Array, fold: Ints) -> Self:
        """Return the model of errors (N, 3) at points (N, 3), N > 1.

        The points of one ``fold`` (N,) are left out together.
        """
        missed_mm = errors_mm.copy()
        for left_out in np.unique(fold):
            kept = fold != left_out
            missed_mm[~kept] -= _blended(points_mm[kept], errors_mm[kept], points_mm[~kept])
        return cls(points_mm, errors_mm, _mean_square_mm2(missed_mm))

    def predict(self, targets_mm: Array) -> Prediction:
        """Return the errors at targets (N, 3)."""
        error_mm = _blended(self.points_mm, self.errors_mm, targets_mm)
        return _everywhere(error_mm, self.covariance_mm2)


def _blended(points_mm: Array, errors_mm: Array, targets_mm: Array) -> Array:
    distance = np.linalg.norm(targets_mm[:, None] - points_mm, axis=-1)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
    weights = inverse_distance_weights(np.take_along_axis(distance, nearest, axis=1))
    blended: Array = np.einsum("nk,nkx->nx", weights, errors_mm[nearest])
    return blended


def _mean_square_mm2(misses_mm: Array) -> Array:
    return misses_mm.T @ misses_mm / len(misses_mm)


def _everywhere(error_mm: Array, covariance_mm2: Array) -> Prediction:
    return Prediction(error_mm, np.broadcast_to(covariance_mm2, (len(error_mm), 3, 3)))
