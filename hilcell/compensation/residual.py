"""Residuals of a model at measured targets, weighted and added to its predictions.

A residual contains the model's own error, the visit's repeatability, its reading, and the frames of
that day, common to all targets. Only the first comes back, so a residual counts by its share of the
variance, estimated by marginal likelihood. Between distant targets the model's errors are
independent: gear ripple changes within centimetres.

The covariance is that of groups of close targets, plus the frames' of each pass, of rank 7: solved
group by group, with the frames by Woodbury's identity.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hilcell.compensation.model import ErrorModel, ModelError, Prediction
from hilcell.geometry.frames import motion_levers
from hilcell.geometry.kinematics import Array, Ints

NEAR_MM = 20.0  # beyond, nothing is known


@dataclass(frozen=True, eq=False)
class Pass:
    """Residuals (N, 3) in {B} at commanded poses (N, 4, 4) in {B}, measured in one run.

    ``own_mm2`` (N, 3, 3): covariance of visit and reading; ``common`` (7, 7): of the frames, shift
    (mm), rotation vector (rad) and growth about the origin of {B}.
    """

    poses: Array
    residuals_mm: Array
    own_mm2: Array
    common: Array

    def every(self, step: int) -> Pass:
        some = slice(None, None, step)
        return Pass(self.poses[some], self.residuals_mm[some], self.own_mm2[some], self.common)


class TargetResiduals:
    """The model's error known by passes over targets; ``variance_mm2``: of one coordinate."""

    def __init__(self, passes: Sequence[Pass], variance_mm2: float) -> None:
        self.passes, self.variance_mm2 = tuple(passes), variance_mm2
        self._known = _Known.of(passes)
        self._pull, self._inverses, _ = self._known.solved(variance_mm2)

    @classmethod
    def learn(cls, passes: Sequence[Pass], stated_mm2: float) -> TargetResiduals:
        """Estimate the most probable variance; ``stated_mm2``: the model's."""
        factors = 2.0 ** np.arange(-10.0, 6.0, 0.5)  # of the variance that the model states
        if not (stated_mm2 > 0 and np.isfinite(stated_mm2)):
            raise ModelError(f"targets: the model states a variance of {stated_mm2} mm2")
        enough = 200  # targets from which the variance is found
        step = -(-sum(len(each.poses) for each in passes) // enough)
        known = _Known.of([each.every(step) for each in passes])
        variances = factors * stated_mm2
        likelihood = np.array([known.solved(float(each))[2] for each in variances])
        spread = 1.5  # standard deviation of their logarithm, before any target says so
        likelihood -= 0.5 * np.square(np.log(factors) / spread)
        return cls(passes, float(variances[int(np.argmax(likelihood))]))

    @property
    def poses(self) -> Array:
        """Return all commanded poses (N, 4, 4)."""
        return self._known.poses

    def at(self, poses: Array) -> tuple[Array, Array]:
        """Residuals (M, 3) in {B} at poses (M, 4, 4), and the remaining share (M,) of variance."""
        known = self._known
        mean_mm, left = np.zeros((len(poses), 3)), np.ones(len(poses))
        near, nearest = known.nearest(poses)
        for group, inverse in zip(known.groups, self._inverses, strict=True):
            for row in np.flatnonzero(np.isin(group.members, nearest).any(axis=1)):
                part, members = near[np.isin(nearest, group.members[row])], group.members[row]
                K = self.variance_mm2 * _alike(_places(poses[part]), known.places[members])
                mean_mm[part] = (K @ self._pull[members].reshape(-1)).reshape(-1, 3)
                gained = np.einsum("ij,ij->i", K @ inverse[row], K).reshape(-1, 3).sum(axis=1)
                left[part] = np.clip(1.0 - gained / (3 * self.variance_mm2), 0.0, 1.0)
        return mean_mm, left

    def sigmas(self) -> Array:
        """Residuals (N,) in standard deviations of a coordinate, each against the others."""
        sigmas = np.empty(len(self.poses))
        for group, inverse in zip(self._known.groups, self._inverses, strict=True):
            count, size = group.members.shape
            blocks = inverse.reshape(count, size, 3, size, 3)
            own = np.moveaxis(np.diagonal(blocks, axis1=1, axis2=3), -1, 1)
            pull = self._pull[group.members]
            squares = np.einsum("gmi,gmij,gmj->gm", pull, np.linalg.inv(own), pull)
            sigmas[group.members] = np.sqrt(squares / 3)
        return sigmas


@dataclass(frozen=True, eq=False)
class WithTargetResiduals:
    """A model with measured residuals folded in; its covariance shrinks accordingly."""

    model: ErrorModel
    residuals: TargetResiduals

    def predict(self, poses: Array) -> Prediction:
        """Errors at poses (N, 4, 4) in {B}; raises as the model does."""
        found = self.model.predict(poses)
        mean_mm, left = self.residuals.at(poses)
        covariance_mm2 = found.covariance_mm2 * left[:, None, None]
        return Prediction(found.error_mm + mean_mm, covariance_mm2, found.orientation)


class _Groups(NamedTuple):
    """All groups of M targets: members (G, M), correlations and own covariances (G, 3M, 3M)."""

    members: Ints
    alike: Array
    own_mm2: Array

    @classmethod
    def of(cls, members: Ints, places: Array, own_mm2: Array) -> _Groups:
        count, size = members.shape
        alike = np.array([_alike(places[each], places[each]) for each in members])
        own = np.zeros((count, size, 3, size, 3))
        for place in range(size):
            own[:, place, :, place, :] = own_mm2[members[:, place]]
        return cls(members, alike, own.reshape(count, 3 * size, 3 * size))


@dataclass(frozen=True, eq=False)
class _Known:
    """All passes as one, with the targets that lie close together in groups, by their size."""

    poses: Array
    places: Array
    residuals_mm: Array
    levers: Array  # (N, 3, 7 P), by pass
    common: Array  # (7 P, 7 P)
    groups: list[_Groups]

    @classmethod
    def of(cls, passes: Sequence[Pass]) -> _Known:
        from scipy.linalg import block_diag

        poses = np.concatenate([each.poses for each in passes])
        own_mm2 = np.concatenate([each.own_mm2 for each in passes])
        frames = 7  # degrees of freedom of what moves a whole pass
        levers = np.zeros((len(poses), 3, frames * len(passes)))
        first = 0
        for number, each in enumerate(passes):
            rows = slice(first, first + len(each.poses))
            columns = slice(frames * number, frames * (number + 1))
            levers[rows, :, columns] = motion_levers(each.poses[:, :3, 3])
            first += len(each.poses)
        places = _places(poses)
        return cls(
            poses,
            places,
            np.concatenate([each.residuals_mm for each in passes]),
            levers,
            np.array(block_diag(*(each.common for each in passes))),
            [_Groups.of(members, places, own_mm2) for members in cls._members(places)],
        )

    def nearest(self, poses: Array) -> tuple[Ints, Ints]:
        """Return the numbers of poses that lie near to known ones, and of those."""
        from scipy.spatial import cKDTree

        distances, nearest = cKDTree(self.places).query(
            _places(poses), distance_upper_bound=NEAR_MM
        )
        near = np.flatnonzero(np.isfinite(distances))
        return near, np.asarray(nearest)[near]

    def solved(self, variance_mm2: float) -> tuple[Array, list[Array], float]:
        """Solve under a variance of the model's error. The inverse covariance times the residuals
        (N, 3), its diagonal blocks as in `_Groups`, and the logarithm of the likelihood.
        """
        alone, log_det = [], 0.0
        weighted, levered = np.empty_like(self.residuals_mm), np.empty_like(self.levers)
        for members, alike, own_mm2 in self.groups:
            inverse = np.linalg.inv(variance_mm2 * alike + own_mm2)
            alone.append(inverse)
            log_det -= float(np.linalg.slogdet(inverse)[1].sum())
            both = np.concatenate(
                [
                    self._rows(self.levers, members),
                    self._rows(self.residuals_mm[..., None], members),
                ],
                axis=-1,
            )
            solved = (inverse @ both).reshape(*members.shape, 3, -1)
            levered[members], weighted[members] = solved[..., :-1], solved[..., -1]
        J = self.levers.reshape(-1, self.levers.shape[-1])
        rank = np.eye(len(self.common)) + J.T @ levered.reshape(J.shape) @ self.common
        inner = self.common @ np.linalg.inv(rank)
        log_det += float(np.linalg.slogdet(rank)[1])
        pull = weighted - levered @ (inner @ (J.T @ weighted.reshape(-1)))
        inverses = []
        for (members, _, _), inverse in zip(self.groups, alone, strict=True):
            U = self._rows(levered, members)
            inverses.append(inverse - U @ inner @ np.swapaxes(U, -1, -2))
        square = float(self.residuals_mm.reshape(-1) @ pull.reshape(-1))
        return pull, inverses, -0.5 * (square + log_det)

    @staticmethod
    def _rows(values: Array, members: Ints) -> Array:
        picked: Array = values[members]
        return picked.reshape(len(members), 3 * members.shape[1], -1)

    @staticmethod
    def _members(places: Array) -> list[Ints]:
        """Groups (G, M) of each size M, connected by steps of `NEAR_MM`."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import cKDTree

        pairs = cKDTree(places).query_pairs(NEAR_MM, output_type="ndarray")
        shape = (len(places), len(places))
        links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape)
        count, labels = connected_components(links, directed=False)
        groups = [np.flatnonzero(labels == label) for label in range(count)]
        sizes = sorted({len(group) for group in groups})
        return [np.array([group for group in groups if len(group) == size]) for size in sizes]


def _places(poses: Array) -> Array:
    """Features (N, 12) whose distance is that of positions, and of rotations by the lever."""
    lever_mm = 200.0  # at which rotations count as lengths
    turned = poses[:, :3, :3].reshape(-1, 9) * (lever_mm / np.sqrt(2.0))
    return np.concatenate([poses[:, :3, 3], turned], axis=1)


def _alike(first: Array, second: Array) -> Array:
    """Correlations (3N, 3M) of the model's errors at features (N, 12), (M, 12)."""
    squares = np.square(first[:, None] - second).sum(axis=-1)
    close_mm = 5.0  # within it the model's error is the same; a command is far closer to its target
    return np.asarray(np.kron(np.exp(-squares / (2 * close_mm**2)), np.eye(3)))
