"""Errors of the joints that no parameter describes: of each gear, of all joints, of each visit.

Gaussian processes, once differentiable (Matern 5/2). Joint j errs by a function of its own angle
(its gear), by one of all joints (elasticity beyond the parameters), and at random at each visit
(repeatability). They act through the joints' derivatives, so all reflectors of a pose share them.
Their sizes and length scales, and the noise of readings and poses, are those of the greatest
marginal likelihood; all errors are estimated together with the parameters, which would otherwise
absorb a part of them. A prismatic joint's angle is its way in m.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.estimate import Estimate, System, diagonal_blocks
from hilcell.identification.kinematics import Kinematics, State
from hilcell.identification.measured_poses import Noise, places_of

MOST_ROWS = 3600  # of evenly chosen poses, from which the errors are learnt
SCALE_ROWS = 600  # of evenly chosen poses, from which the scales are found
NONE: Ints = np.zeros(0, dtype=np.int_)


@dataclass(frozen=True, eq=False)
class Scales:
    """Standard deviations of the joints' errors (n,), and length scales (n,): rad, or m.

    ``own``: of each joint's angle; ``shared``: of all joints; ``visit``: of one visit.
    ``reading_mm``: of a reading's coordinate; ``pose_mm``: of a pose's, common to its reflectors.
    """

    own_rad: Array
    own_length_rad: Array
    shared_rad: Array
    shared_length_rad: Array
    visit_rad: Array
    reading_mm: float
    pose_mm: float

    @classmethod
    def of(cls, logs: Array) -> Scales:
        """Return the scales of their logarithms (5 n + 2,)."""
        own, own_length, shared, shared_length, visit = np.exp(logs[:-2]).reshape(5, -1)
        reading_mm, pose_mm = np.exp(logs[-2:]).tolist()
        return cls(own, own_length, shared, shared_length, visit, reading_mm, pose_mm)

    @property
    def logs(self) -> Array:
        scales: Array = np.concatenate([
            self.own_rad, self.own_length_rad, self.shared_rad, self.shared_length_rad,
            self.visit_rad, [self.reading_mm, self.pose_mm],
        ])  # fmt: skip
        return np.log(scales)

    @staticmethod
    def prior(joints: int) -> tuple[Array, Array]:
        """Return mean and standard deviation (5 n + 2,) of the logarithms."""
        middle = [100e-6, 0.1, 50e-6, 1.0, 60e-6, 0.02, 0.02]
        doubt = [1.5, 1.0, 1.5, 1.0, 0.5, 0.5, 0.5]
        each = [joints] * 5 + [1, 1]
        return np.log(np.repeat(middle, each)), np.repeat(doubt, each)


class _Correlations(NamedTuple):
    """Correlations of poses (A) and (B), and their derivatives by the logarithms of the lengths.

    ``own``, ``own_slope`` (n, A, B); ``shared`` (A, B), and ``shared_slope`` (A, B), to be
    multiplied by the squared distance of each joint in length scales.
    """

    own: Array
    own_slope: Array
    shared: Array
    shared_slope: Array


def _correlations(scales: Scales, a_rad: Array, b_rad: Array) -> _Correlations:
    far = np.abs(a_rad.T[:, :, None] - b_rad.T[:, None]) / scales.own_length_rad[:, None, None]
    own, slope = _matern(5.0 * far**2)
    a, b = a_rad / scales.shared_length_rad, b_rad / scales.shared_length_rad
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
    shared, shared_slope = _matern(5.0 * np.maximum(square, 0.0))
    return _Correlations(own, slope * far**2, shared, shared_slope)


def _matern(square: Array) -> tuple[Array, Array]:
    """Return the correlation, and its derivative by the logarithm of the length over the squared
    distance; ``square``: 5 times the latter.
    """
    root = np.sqrt(square)
    fading = np.exp(-root)
    return (1.0 + root + square / 3.0) * fading, 5.0 / 3.0 * (1.0 + root) * fading


@dataclass(frozen=True, eq=False)
class Rows:
    """Known coordinates (N), by pose: design (N, P), residual (N,), their own covariance (N, N).

    The joints' levers (N, n), pose (N,) and axis of each; the axes' angles (M, n).
    """

    design: Array
    residual_mm: Array
    own_mm2: Array
    levers: Array
    pose: Ints
    axis: Ints
    angles_rad: Array

    @classmethod
    def of(cls, estimate: Estimate, poses: Ints) -> Rows:
        system, readings = estimate.system, estimate.readings.at(poses)
        count, size = len(poses), system.residual_mm.shape[1]
        known = np.repeat(system.known[poses], 3, axis=1).ravel()
        own = np.zeros((count, size, count, size))
        each = np.arange(count)
        for k in range(size // 3):
            at = slice(3 * k, 3 * k + 3)
            own[each, at, each, at] = readings.covariance_mm2[:, k]
        rows = count * size
        return cls(
            system.design[poses].reshape(rows, -1)[known],
            system.residual_mm[poses].ravel()[known],
            own.reshape(rows, rows)[np.ix_(known, known)],
            system.by_joint[poses].reshape(rows, -1)[known],
            np.repeat(each, size)[known],
            np.tile(np.arange(3), rows // 3)[known],
            estimate.kinematics.arm.angles(readings.joints_rad),
        )

    def spread(self, of_poses: Array) -> Array:
        """Return values (..., M, M) of pairs of poses for pairs of rows (..., N, N)."""
        return of_poses[..., self.pose, :][..., self.pose]

    def gathered(self, of_rows: Array) -> Array:
        """Return the sums (M, M) of values (N, N) of pairs of rows for pairs of poses."""
        first = np.flatnonzero(np.diff(self.pose, prepend=-1))
        return np.add.reduceat(np.add.reduceat(of_rows, first, axis=0), first, axis=1)

    @property
    def same_axis(self) -> Bools:
        """Return which coordinates (N, N) a shift of one pose moves alike."""
        same: Bools = (self.pose[:, None] == self.pose) & (self.axis[:, None] == self.axis)
        return same

    def alike(self, scales: Scales) -> _Correlations:
        return _correlations(scales, self.angles_rad, self.angles_rad)

    def covariance(self, scales: Scales, alike: _Correlations | None = None) -> Array:
        """Return the covariance (N, N) of all errors but the parameters'."""
        alike = alike or self.alike(scales)
        K = self.own_mm2 + scales.pose_mm**2 * self.same_axis
        K[np.diag_indices_from(K)] += scales.reading_mm**2
        shared = self.levers * scales.shared_rad
        K += (shared @ shared.T) * self.spread(alike.shared)
        visits = np.eye(len(self.angles_rad))
        for lever, own_rad, visit_rad, correlation in zip(
            self.levers.T, scales.own_rad, scales.visit_rad, alike.own, strict=True
        ):
            variance = own_rad**2 * correlation + visit_rad**2 * visits
            K += np.outer(lever, lever) * self.spread(variance)
        return K

    def solved(self, K: Array, system: System) -> _Solved:
        """Return the solution under the covariance K (N, N) of the rows and a system's prior."""
        from scipy.linalg import solve_triangular

        size = len(system.pull)
        L: Array = np.asarray(np.linalg.cholesky(K), dtype=float)
        back: Array = solve_triangular(L, np.eye(len(L)), lower=True, check_finite=False)
        A = back @ np.column_stack([self.design, self.residual_mm])
        prior = np.column_stack([system.prior_root, system.pull])
        both: Array = np.asarray(np.linalg.qr(np.concatenate([A, prior]), mode="r"), dtype=float)
        R, rest = both[:size, :size], both[size:, size]
        step: Array = np.asarray(np.linalg.solve(R, both[:size, size]), dtype=float)
        logs = np.log(np.diag(L)).sum() + np.log(np.abs(np.diag(R))).sum()
        return _Solved(
            back,
            A[:, :size],
            R,
            step,
            back.T @ (A[:, size] - A[:, :size] @ step),
            float(-0.5 * rest @ rest - logs),
        )

    def by_scales(self, scales: Scales, alike: _Correlations, solved: _Solved) -> Array:
        """Return the derivatives (5 n + 2,) of minus the evidence by the scales' logarithms."""
        M = solved.precision() - np.outer(solved.weighted, solved.weighted)
        own, own_length, visit = np.zeros((3, len(scales.own_rad)))
        for j, lever in enumerate(self.levers.T):
            of_poses = self.gathered(M * np.outer(lever, lever))
            own[j] = float(np.sum(of_poses * alike.own[j]))
            own_length[j] = 0.5 * float(np.sum(of_poses * alike.own_slope[j]))
            visit[j] = float(np.trace(of_poses))
        weighted = M * self.spread(alike.shared)
        shared = np.sum((weighted @ self.levers) * self.levers, axis=0)
        levers = self.levers * scales.shared_rad
        of_poses = self.gathered(M * (levers @ levers.T)) * alike.shared_slope
        angles = self.angles_rad / scales.shared_length_rad
        squares = of_poses.sum(axis=0) @ angles**2  # (a - b)^2 = a^2 + b^2 - 2 a b
        length = squares - np.sum(angles * (of_poses @ angles), axis=0)
        reading = scales.reading_mm**2 * float(np.trace(M))
        pose = scales.pose_mm**2 * float(np.sum(M, where=self.same_axis))
        own_variance = scales.own_rad**2
        return np.concatenate([
            own_variance * own, own_variance * own_length, scales.shared_rad**2 * shared, length,
            scales.visit_rad**2 * visit, [reading, pose],
        ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Solved:
    """K = L L' of the rows: L^-1 and L^-1 times the design; the parameters' posterior root; their
    step; P r, P being the inverse of the rows' whole covariance; evidence.
    """

    back: Array
    design: Array
    posterior_root: Array
    step: Array
    weighted: Array
    evidence: float

    def precision(self, of: slice | Bools = slice(None)) -> Array:
        """Return P (N, N), or its block of some rows."""
        back = self.back[:, of]
        S = back.T @ np.linalg.solve(self.posterior_root.T, self.design.T).T
        return np.asarray(back.T @ back - S @ S.T)


@dataclass(frozen=True, eq=False)
class WithJointErrors:
    """Kinematics and errors of the joints, estimated together; rows of ``poses``."""

    base: Estimate
    scales: Scales
    poses: Ints
    rows: Rows
    solved: _Solved

    @property
    def kinematics(self) -> Kinematics:
        return self.base.kinematics

    @property
    def state(self) -> State:
        return self.kinematics.moved(self.base.state, self.solved.step)

    @property
    def covariance(self) -> Array:
        """Return the parameters' covariance (P, P)."""
        inverse = np.linalg.inv(self.solved.posterior_root)
        return inverse @ inverse.T

    @property
    def noise(self) -> Noise:
        return Noise(self.scales.reading_mm, self.scales.pose_mm, self.scales.visit_rad)

    def predict(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return positions (M, K, 3) and covariances (M, K, 3, 3) of readings there."""
        at_once = 256  # poses predicted together
        parts = [
            self._predict(joints_rad[first : first + at_once])
            for first in range(0, len(joints_rad), at_once)
        ]
        return np.concatenate([p for p, _ in parts]), np.concatenate([c for _, c in parts])

    def _predict(self, joints_rad: Array) -> tuple[Array, Array]:
        rows, solved, scales = self.rows, self.solved, self.scales
        found = self.kinematics.linearised(self.base.state, joints_rad)
        count, reflectors = found.positions_mm.shape[:2]
        angles_rad = self.kinematics.arm.angles(joints_rad)
        alike = _correlations(scales, angles_rad, rows.angles_rad)
        levers = found.by_joint.reshape(count, -1, len(scales.own_rad))
        cross = ((levers * scales.shared_rad**2) @ rows.levers.T) * alike.shared[:, None, rows.pose]
        for j, own_rad in enumerate(scales.own_rad):
            product = levers[..., j, None] * (own_rad**2 * rows.levers[:, j])
            cross += product * alike.own[j][:, None, rows.pose]
        flat = cross.reshape(-1, len(rows.pose))
        design = found.by_parameter.reshape(len(flat), -1)
        at_mm = found.positions_mm.reshape(-1) + design @ solved.step + flat @ solved.weighted
        own = solved.back @ flat.T
        carried = np.linalg.solve(solved.posterior_root.T, (design - own.T @ solved.design).T)
        shape = (-1, count, reflectors, 3)
        own, carried = own.reshape(shape), carried.reshape(shape)
        joint_rad2 = scales.own_rad**2 + scales.shared_rad**2 + scales.visit_rad**2
        covariance: Array = (found.by_joint * joint_rad2) @ np.swapaxes(found.by_joint, -1, -2)
        covariance += (scales.reading_mm**2 + scales.pose_mm**2) * np.eye(3)
        covariance -= np.einsum("nmki,nmkl->mkil", own, own)
        covariance += np.einsum("pmki,pmkl->mkil", carried, carried)
        return at_mm.reshape(count, reflectors, 3), covariance

    def left_out(self, folds: Iterable[Ints]) -> tuple[Array, Array]:
        """Return measured less predicted (M, K, 3) and its covariance (M, K, 3, 3), by folds of
        poses left out together, also of the scales. NaN for poses that are in no fold or were not
        learnt from.
        """
        known, system = self.base.system.known, self.base.system
        missed: Array = np.full((*known.shape, 3), np.nan)
        covariance: Array = np.full((*known.shape, 3, 3), np.nan)
        for fold in folds:
            out = np.isin(self.poses, fold)
            own = out[self.rows.pose]
            if not own.any():
                continue
            others = _evenly(self.base, SCALE_ROWS, without=fold)
            scales = _scales(self.base, Rows.of(self.base, others), self.scales)
            solved = self.rows.solved(self.rows.covariance(scales), system)
            C: Array = np.asarray(np.linalg.inv(solved.precision(own)), dtype=float)
            at = np.zeros(known.shape, dtype=np.bool_)
            at[self.poses[out]] = known[self.poses[out]]
            missed[at] = (C @ solved.weighted[own]).reshape(-1, 3)
            covariance[at] = diagonal_blocks(C)
        return missed, covariance


def with_joint_errors(estimate: Estimate) -> WithJointErrors:
    """Return the estimate with errors of the joints, its scales those of greatest likelihood."""
    scales = _scales(estimate, Rows.of(estimate, _evenly(estimate, SCALE_ROWS)))
    poses = _evenly(estimate, MOST_ROWS)
    rows = Rows.of(estimate, poses)
    solved = rows.solved(rows.covariance(scales), estimate.system)
    return WithJointErrors(estimate, scales, poses, rows, solved)


def _evenly(estimate: Estimate, rows: int, without: Ints = NONE) -> Ints:
    """Return measured poses, in ascending order, of about so many rows at most."""
    known = estimate.system.known
    scattered = np.argsort(places_of(estimate.readings.joints_rad), kind="stable")
    measured = scattered[known[scattered].any(axis=1) & ~np.isin(scattered, without)]
    spent = 3 * np.cumsum(known[measured].sum(axis=1))
    return np.sort(measured[spent <= rows])


def _scales(estimate: Estimate, rows: Rows, start: Scales | None = None) -> Scales:
    """Return the most probable scales by L-BFGS; few steps are enough from others close by."""
    from scipy.optimize import minimize

    middle, doubt = Scales.prior(rows.levers.shape[1])

    def cost(logs: Array) -> tuple[float, Array]:
        scales = Scales.of(logs)
        alike = rows.alike(scales)
        solved = rows.solved(rows.covariance(scales, alike), estimate.system)
        away = (logs - middle) / doubt
        gradient = rows.by_scales(scales, alike, solved) + away / doubt
        return -solved.evidence + 0.5 * float(away @ away), gradient

    found = minimize(
        cost,
        middle if start is None else start.logs,
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(middle - 5.0 * doubt, middle + 4.0 * doubt, strict=True)),
        options={"maxiter": 60 if start is None else 12, "ftol": 1e-5},
    )
    return Scales.of(found.x)
