"""The error that a model leaves at targets which were measured, folded in by its share.

A measured remainder is the model's own error, the visit's repeatability, its reading, and the
frames of that day, which moved all targets together. Only the first comes back, so a remainder
counts by the first's share of the whole variance: subtracting it in full folds one visit's noise
into the command. The share follows from the remainders themselves, by marginal likelihood.
Between targets the model's errors are taken as independent: gear ripple and all else that a smooth
model leaves changes within centimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.compensation.grid import Ints
from hilcell.compensation.model import ErrorModel, ModelError, Prediction
from hilcell.geometry.frames import motion_levers
from hilcell.geometry.kinematics import Array

CLOSE_MM = 5.0  # within it the model's error is the same; a command is far closer to its target
NEAR = 6.0  # times that: beyond, nothing is known
LEVER_MM = 200.0  # at which rotations count as lengths
FACTORS = 2.0 ** np.arange(-10.0, 6.0, 0.5)  # of the variance that the model states
SPREAD = 1.5  # standard deviation of their logarithm, before any target says so
ENOUGH = 200  # targets from which the variance is found
AT_ONCE = 2000


@dataclass(frozen=True, eq=False)
class Pass:
    """Remainders (N, 3) in {B} at commanded poses (N, 4, 4) in {B}, measured in one run.

    ``own_mm2`` (N, 3, 3) is the covariance of visit and reading, ``common`` (7, 7) that of the
    frames: shift (mm), rotation vector (rad) and growth about the origin of {B}.
    """

    poses: Array
    remainders_mm: Array
    own_mm2: Array
    common: Array

    @property
    def noise_mm2(self) -> Array:
        """Return the covariance (3N, 3N) of all that does not come back."""
        J = motion_levers(self.poses[:, :3, 3]).reshape(-1, 7)
        noise: Array = J @ self.common @ J.T
        for n, own in enumerate(self.own_mm2):
            noise[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += own
        return noise

    def every(self, step: int) -> Pass:
        """Return each ``step``-th target."""
        some = slice(None, None, step)
        return Pass(self.poses[some], self.remainders_mm[some], self.own_mm2[some], self.common)


class Remainder:
    """The model's error as passes over targets know it; ``variance_mm2`` of one coordinate."""

    def __init__(self, passes: Sequence[Pass], variance_mm2: float) -> None:
        self.passes, self.variance_mm2 = tuple(passes), variance_mm2
        self.poses = np.concatenate([each.poses for each in passes])
        total = _noise_mm2(passes) + variance_mm2 * _alike(self.poses, self.poses)
        self._inverse = np.linalg.inv(total)
        self._pull = self._inverse @ _stacked_mm(passes)

    @classmethod
    def learn(cls, passes: Sequence[Pass], stated_mm2: float) -> Remainder:
        """Return the remainder under its most probable variance.

        ``stated_mm2`` is the variance of one coordinate that the model states of its error.
        """
        return cls(passes, _most_probable(passes, stated_mm2))

    def at(self, poses: Array) -> tuple[Array, Array]:
        """Return the remainder (M, 3) in {B} to be expected at poses (M, 4, 4), and which share
        (M,) of the model's variance is left.
        """
        mean_mm, left = np.zeros((len(poses), 3)), np.ones(len(poses))
        near = _near(poses, self.poses)
        for first in range(0, len(near), AT_ONCE):
            part = near[first : first + AT_ONCE]
            K = self.variance_mm2 * _alike(poses[part], self.poses).reshape(len(part), 3, -1)
            mean_mm[part] = K @ self._pull
            known = np.einsum("mik,mik->m", K @ self._inverse, K)
            left[part] = np.clip(1.0 - known / (3 * self.variance_mm2), 0.0, 1.0)
        return mean_mm, left

    def sigmas(self) -> Array:
        """Return the remainders (N,) in standard deviations of a coordinate, each by the others."""
        count = len(self.poses)
        blocks = self._inverse.reshape(count, 3, count, 3)
        own = np.moveaxis(np.diagonal(blocks, axis1=0, axis2=2), -1, 0)
        pull = self._pull.reshape(count, 3)
        squares = np.einsum("ni,nij,nj->n", pull, np.linalg.inv(own), pull)
        sigmas: Array = np.sqrt(squares / 3)
        return sigmas


@dataclass(frozen=True, eq=False)
class WithRemainder:
    """A model with what was measured of its error folded in; its covariance shrinks with it."""

    model: ErrorModel
    remainder: Remainder

    def predict(self, poses: Array) -> Prediction:
        """Return the errors at poses (N, 4, 4) in {B}; raises as the model does."""
        found = self.model.predict(poses)
        mean_mm, left = self.remainder.at(poses)
        return Prediction(found.error_mm + mean_mm, found.covariance_mm2 * left[:, None, None])


def _places(poses: Array) -> Array:
    """Return features (N, 12) whose distance is that of places, and of rotations by the lever."""
    turned = poses[:, :3, :3].reshape(-1, 9) * (LEVER_MM / np.sqrt(2.0))
    places: Array = np.concatenate([poses[:, :3, 3], turned], axis=1)
    return places


def _alike(first: Array, second: Array) -> Array:
    """Return the correlations (3N, 3M) of the model's errors at poses (N, 4, 4), (M, 4, 4)."""
    one, other = _places(first), _places(second)
    squares = np.square(one).sum(axis=1)[:, None] + np.square(other).sum(axis=1)
    squares = np.maximum(squares - 2 * one @ other.T, 0.0)
    alike: Array = np.kron(np.exp(-squares / (2 * CLOSE_MM**2)), np.eye(3))
    return alike


def _near(poses: Array, known: Array) -> Ints:
    """Return the numbers of poses that lie near to a known one."""
    from scipy.spatial import cKDTree

    distances, _ = cKDTree(_places(known)).query(
        _places(poses), distance_upper_bound=NEAR * CLOSE_MM
    )
    return np.flatnonzero(np.isfinite(distances))


def _stacked_mm(passes: Sequence[Pass]) -> Array:
    stacked: Array = np.concatenate([each.remainders_mm for each in passes]).reshape(-1)
    return stacked


def _noise_mm2(passes: Sequence[Pass]) -> Array:
    """Return the covariance (3N, 3N) of all passes, which are independent of each other."""
    from scipy.linalg import block_diag

    noise: Array = block_diag(*(each.noise_mm2 for each in passes))
    return noise


def _most_probable(passes: Sequence[Pass], stated_mm2: float) -> float:
    """Return the variance of greatest marginal likelihood.

    With K the correlations and N the noise, ``N^-1/2 K N^-1/2`` is diagonalised once, so that
    each variance costs only a sum.
    """
    if not (stated_mm2 > 0 and np.isfinite(stated_mm2)):
        raise ModelError(f"targets: the model states a variance of {stated_mm2} mm2")
    step = -(-sum(len(each.poses) for each in passes) // ENOUGH)
    some = [each.every(step) for each in passes]
    poses = np.concatenate([each.poses for each in some])
    whiten = np.linalg.inv(np.linalg.cholesky(_noise_mm2(some)))
    values, axes = np.linalg.eigh(whiten @ _alike(poses, poses) @ whiten.T)
    squares = np.square(axes.T @ (whiten @ _stacked_mm(some)))
    variances = FACTORS * stated_mm2
    spread = 1.0 + np.outer(variances, np.maximum(values, 0.0))
    likelihood = -0.5 * (squares / spread + np.log(spread)).sum(axis=1)
    likelihood -= 0.5 * np.square(np.log(FACTORS) / SPREAD)
    return float(variances[int(np.argmax(likelihood))])
