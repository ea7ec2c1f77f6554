"""A smooth error of each joint that depends on all joints, and that no parameter describes.

A Gaussian process: joint j errs by s_j times a random function of all joints, once
differentiable (Matern 5/2), with one length scale a joint. It acts through the joints' derivatives,
so all reflectors of a pose share it. It is estimated together with the parameters, which would
otherwise absorb a part of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array, Ints
from hilcell.identification.estimate import Estimate
from hilcell.identification.kinematics import State
from hilcell.identification.measured_poses import Noise, pose_folds

ROWS = 300  # of evenly chosen poses, from which the scales are found


@dataclass(frozen=True, eq=False)
class Kernel:
    """Standard deviations of the joints' errors (n,) and length scales (n,), rad or m."""

    joint_rad: Array
    length_rad: Array

    def correlation(self, a_rad: Array, b_rad: Array) -> tuple[Array, Array]:
        """Correlation (A, B) of joints (A, n) and (B, n), and its derivative times -2. By the
        squared distance in length scales.
        """
        a, b = a_rad / self.length_rad, b_rad / self.length_rad
        square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2.0 * a @ b.T
        root = np.sqrt(5.0 * np.maximum(square, 0.0))
        fading = np.exp(-root)
        return (1.0 + root + root**2 / 3.0) * fading, 5.0 / 3.0 * (1.0 + root) * fading


@dataclass(frozen=True, eq=False)
class Rows:
    """Known rows (N) of an estimate: design (N, P), residual (N,), noise (N, N). The joints' levers
    (N, n) and pose (N,) of each row; joints (M, n).
    """

    design: Array
    residual_mm: Array
    noise_mm2: Array
    levers: Array
    pose: Ints
    joints_rad: Array

    @classmethod
    def of(cls, estimate: Estimate, poses: Ints) -> Rows:
        system = estimate.system
        size = system.residual_mm.shape[1]
        known = np.repeat(system.known[poses], 3, axis=1).ravel()
        noise = np.zeros((len(poses), size, len(poses), size))
        each = np.arange(len(poses))
        noise[each, :, each, :] = system.noise_mm2[poses]
        rows = len(poses) * size
        return cls(
            system.design[poses].reshape(rows, -1)[known],
            system.residual_mm[poses].ravel()[known],
            noise.reshape(rows, rows)[np.ix_(known, known)],
            system.by_joint[poses].reshape(rows, -1)[known],
            np.repeat(each, size)[known],
            estimate.readings.joints_rad[poses],
        )

    def covariance(self, kernel: Kernel, share: float) -> tuple[Array, Array, Array, Array]:
        """Return K (N, N), and its factors: levers' product, correlations, their derivatives."""
        correlation, slope = (
            each[np.ix_(self.pose, self.pose)]
            for each in kernel.correlation(self.joints_rad, self.joints_rad)
        )
        product = (self.levers * kernel.joint_rad**2) @ self.levers.T
        return product * correlation + share * self.noise_mm2, product, correlation, slope

    def solved(self, K: Array, prior_root: Array, pull: Array) -> _Solved:
        """Return the solution under the covariance K (N, N) of the rows."""
        size = len(pull)
        L: Array = np.asarray(np.linalg.cholesky(K), dtype=float)
        back: Array = np.asarray(np.linalg.inv(L), dtype=float)
        A = back @ np.column_stack([self.design, self.residual_mm])
        prior = np.column_stack([prior_root, pull])
        both: Array = np.asarray(np.linalg.qr(np.concatenate([A, prior]), mode="r"), dtype=float)
        R, rest = both[:size, :size], both[size:, size]
        step: Array = np.asarray(np.linalg.solve(R, both[:size, size]), dtype=float)
        S = back.T @ A[:, :size] @ np.linalg.inv(R)
        logs = np.log(np.diag(L)).sum() + np.log(np.abs(np.diag(R))).sum()
        return _Solved(
            L,
            R,
            step,
            back.T @ (A[:, size] - A[:, :size] @ step),
            back.T @ back - S @ S.T,
            float(-0.5 * rest @ rest - logs),
        )

    def doubt(self, solved: _Solved) -> float:
        """Return the mean square of poses left out over their predicted variance, at least 1."""
        total = 0.0
        fold = pose_folds(self.joints_rad)[self.pose]
        for left_out in np.unique(fold):
            own = fold == left_out
            left = solved.weighted[own]
            total += float(left @ np.linalg.solve(solved.precision[np.ix_(own, own)], left))
        return max(1.0, total / len(self.pose))


@dataclass(frozen=True, eq=False)
class _Solved:
    """K = L L' of residual and noise; the parameters' posterior root; P and P r; evidence."""

    root: Array
    posterior_root: Array
    step: Array
    weighted: Array
    precision: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class WithResidual:
    """Kinematics and residual, estimated together; the noise is the kinematics' times a scale.

    The most probable scales may understate: covariances are multiplied by ``doubt``, at least 1, by
    poses left out.
    """

    base: Estimate
    kernel: Kernel
    noise: Noise
    state: State
    rows: Rows
    solved: _Solved
    doubt: float

    def predict(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return positions (M, K, 3) and covariances (M, K, 3, 3) of readings there."""
        at_once = 256  # poses predicted together
        parts = [
            self._predict(joints_rad[first : first + at_once])
            for first in range(0, len(joints_rad), at_once)
        ]
        return np.concatenate([p for p, _ in parts]), np.concatenate([c for _, c in parts])

    def _predict(self, joints_rad: Array) -> tuple[Array, Array]:
        rows, solved, variance = self.rows, self.solved, self.kernel.joint_rad**2
        found = self.base.kinematics.linearised(self.base.state, joints_rad)
        count, reflectors = found.positions_mm.shape[:2]
        correlation = self.kernel.correlation(joints_rad, rows.joints_rad)[0][:, rows.pose]
        levers = found.by_joint.reshape(count, -1, len(variance))
        cross = ((levers * variance) @ rows.levers.T) * correlation[:, None, :]
        flat = cross.reshape(-1, len(rows.pose))
        design = found.by_parameter.reshape(len(flat), -1)
        at_mm = found.positions_mm.reshape(-1) + design @ solved.step + flat @ solved.weighted
        whitened = np.linalg.solve(solved.root, np.column_stack([flat.T, rows.design]))
        own, X = whitened[:, : len(flat)], whitened[:, len(flat) :]
        carried = np.linalg.solve(solved.posterior_root.T, (design - own.T @ X).T)
        shape = (-1, count, reflectors, 3)
        own, carried = own.reshape(shape), carried.reshape(shape)
        covariance: Array = np.einsum("mkij,j,mklj->mkil", found.by_joint, variance, found.by_joint)
        covariance -= np.einsum("nmki,nmkl->mkil", own, own)
        covariance += np.einsum("pmki,pmkl->mkil", carried, carried)
        covariance += self.noise.scatter(found.by_joint)
        return at_mm.reshape(count, reflectors, 3), self.doubt * covariance

    def left_out_mm(self, folds: Iterable[Ints]) -> Array:
        """Return measured less predicted (M, K, 3), by folds of poses left out together."""
        known = self.base.system.known
        missed: Array = np.full((len(known), known.shape[1] * 3), np.nan)
        rows = np.repeat(known, 3, axis=1)
        for fold in folds:
            own = np.isin(self.rows.pose, fold)
            P = self.solved.precision[np.ix_(own, own)]
            inside = np.isin(np.arange(len(known)), fold)
            missed[rows & inside[:, None]] = np.linalg.solve(P, self.solved.weighted[own])
        return missed.reshape(*known.shape, 3)


def with_residual(estimate: Estimate) -> WithResidual:
    """Return the estimate with a residual, its scales those of greatest marginal likelihood."""
    every: Ints = np.arange(len(estimate.readings))
    thinned = every[:: max(1, -(-estimate.system.residual_mm.size // ROWS))]
    scales = _scales(estimate, Rows.of(estimate, thinned))
    rows, system = Rows.of(estimate, every), estimate.system
    kernel, share = _kernel(scales)
    solved = rows.solved(rows.covariance(kernel, share)[0], system.prior_root, system.pull)
    state = estimate.kinematics.moved(estimate.state, solved.step)
    noise = estimate.noise.scaled(share**0.5)
    return WithResidual(estimate, kernel, noise, state, rows, solved, rows.doubt(solved))


def _kernel(scales: Array) -> tuple[Kernel, float]:
    """Return the kernel and the noise's share, a variance, of logarithms (2 n + 1)."""
    joint_rad, length_rad = np.exp(scales[:-1]).reshape(2, -1)
    return Kernel(joint_rad, length_rad), float(np.exp(2.0 * scales[-1]))


def _scales(estimate: Estimate, rows: Rows) -> Array:
    """Return the logarithms (2 n + 1) of the kernel's scales and the noise's, by L-BFGS."""
    joints = rows.joints_rad.shape[1]
    each = [joints, joints, 1]
    doubt = np.repeat([1.5, 1.0, 1.0], each)  # of their logarithms, and of the noise's scale
    from scipy.optimize import minimize

    system = estimate.system
    # where the search begins, and what few data lean on
    middle = np.log(np.repeat([100e-6, 1.0, 1.0], each))
    squares = (rows.joints_rad[:, None] - rows.joints_rad) ** 2
    place = (rows.pose[:, None] == np.arange(len(rows.joints_rad))).astype(float)

    def cost(scales: Array) -> tuple[float, Array]:
        kernel, share = _kernel(scales)
        K, product, correlation, slope = rows.covariance(kernel, share)
        solved = rows.solved(K, system.prior_root, system.pull)
        M = solved.precision - np.outer(solved.weighted, solved.weighted)
        weighted = M * correlation
        by_joint = np.einsum("nj,nm,mj->j", rows.levers, weighted, rows.levers)
        by_pose = place.T @ (M * product * slope) @ place
        lengths = 0.5 * np.einsum("ij,ijd->d", by_pose, squares) / kernel.length_rad**2
        noise = share * float(np.sum(M * rows.noise_mm2))
        gradient = np.concatenate([by_joint * kernel.joint_rad**2, lengths, [noise]])
        away = (scales - middle) / doubt
        return -solved.evidence + 0.5 * float(away @ away), gradient + away / doubt

    limits = [(m - 6.0 * d, m + 4.0 * d) for m, d in zip(middle, doubt, strict=True)]
    found = minimize(
        cost,
        middle,
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": 40, "ftol": 1e-5},
    )
    return found.x
