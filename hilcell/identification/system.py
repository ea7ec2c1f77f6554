"""The linear-Gaussian system of one Gauss-Newton step, of readings and prior.

With readings r = A x + v, x ~ N(m, Q) and v ~ N(0, C), block by block of a pose, the posterior is
found from the whitened rows by one factorisation. P is the inverse of the readings'
whole covariance A Q A' + C; with it every pose's prediction by all others follows without another
solution: r_F less its prediction is (P_FF)^-1 (P r)_F for poses F left out together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.kinematics import Kinematics, Linearised, State
from hilcell.identification.noise import Noise
from hilcell.identification.readings import Readings

DETERMINED = 0.5  # of the prior's standard deviation: below, the data say more than the prior


@dataclass(frozen=True, eq=False)
class System:
    """Rows of M poses with N = 3 K readings each; rows of unknown readings are zero.

    ``design`` (M, N, P), ``residual_mm`` (M, N), ``noise_mm2`` (M, N, N) with a variance of 1 in
    unknown rows; ``prior_root`` (P, P) whitens the prior, ``pull`` (P,) is its whitened residual.
    """

    design: Array
    residual_mm: Array
    noise_mm2: Array
    prior_root: Array
    pull: Array
    by_joint: Array
    known: Bools

    @classmethod
    def at(cls, kinematics: Kinematics, state: State, readings: Readings, noise: Noise) -> System:
        """Return the system linearised at a state."""
        found = kinematics.linearised(state, readings.joints_rad)
        return cls.of(kinematics, state, readings, noise, found)

    @classmethod
    def of(
        cls,
        kinematics: Kinematics,
        state: State,
        readings: Readings,
        noise: Noise,
        found: Linearised,
    ) -> System:
        """Return the system of a linearisation that is known."""
        known = readings.known
        count = len(readings)
        residual = np.where(known[..., None], readings.xyz_mm - found.positions_mm, 0.0)
        design = found.by_parameter.copy()
        design[~known] = 0.0
        root = kinematics.prior_root
        pull = root @ (kinematics.prior()[0] - kinematics.flat(state))
        return cls(
            design.reshape(count, -1, design.shape[-1]),
            residual.reshape(count, -1),
            noise.covariance(found.by_joint, readings.covariance_mm2, known),
            root,
            pull,
            found.by_joint,
            known,
        )

    @cached_property
    def _whitener(self) -> Array:
        """Return W (M, N, N) with W'W the inverse of the noise's covariance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.noise_mm2)), dtype=float)

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """Return the posterior's root R (P, P) and the step (P,)."""
        size = self.design.shape[2]
        rows = (self._whitener @ self.design).reshape(-1, size)
        missed = (self._whitener @ self.residual_mm[..., None]).ravel()
        R = triangle(rows, self.prior_root)
        pull = rows.T @ missed + self.prior_root.T @ self.pull
        return R, np.asarray(np.linalg.solve(R, np.linalg.solve(R.T, pull)), dtype=float)

    @property
    def step(self) -> Array:
        """Return the step (P,) to the most probable parameters."""
        return self._factor[1]

    def damped(self, damping: float) -> Array:
        """Return the step (P,) held back by so many times the prior's information."""
        R, step = self._factor
        size = len(step)
        held = np.column_stack([damping**0.5 * self.prior_root, np.zeros(size)])
        rows = np.concatenate([np.column_stack([R, R @ step]), held])
        both = np.asarray(np.linalg.qr(rows, mode="r"))
        return np.asarray(np.linalg.solve(both[:size, :size], both[:size, size]))

    @cached_property
    def cost(self) -> float:
        """Return chi^2 of readings and prior before the step."""
        whitened = self._whitener @ self.residual_mm[..., None]
        return float(np.sum(whitened**2) + np.sum(self.pull**2))

    @cached_property
    def covariance(self) -> Array:
        """Return the parameters' posterior covariance (P, P)."""
        inverse = np.linalg.inv(self._factor[0])
        return inverse @ inverse.T

    @cached_property
    def _precision_parts(self) -> tuple[Array, Array]:
        """Return C^-1 (M, N, N), and S (M, N, P) with P = C^-1 - S S'."""
        inverse = np.swapaxes(self._whitener, 1, 2) @ self._whitener
        size = self.design.shape[2]
        S = (inverse @ self.design).reshape(-1, size) @ np.linalg.inv(self._factor[0])
        return np.asarray(inverse), S.reshape(self.design.shape)

    @cached_property
    def weighted(self) -> Array:
        """Return P r (M, N)."""
        left = self.residual_mm - self.design @ self.step
        weighted: Array = np.einsum("mij,mj->mi", self._precision_parts[0], left)
        return weighted

    @cached_property
    def precision(self) -> Array:
        """Return the blocks of P (M, N, N)."""
        inverse, S = self._precision_parts
        return inverse - S @ np.swapaxes(S, 1, 2)

    @property
    def evidence(self) -> float:
        """Return the log marginal likelihood of the readings, but for a constant of their count."""
        R, step = self._factor
        left = self.residual_mm - self.design @ step
        chi2 = float(np.sum(left * self.weighted))
        chi2 += float(np.sum((self.pull - self.prior_root @ step) ** 2))
        log_noise = -2.0 * float(np.log(np.einsum("mii->mi", self._whitener)).sum())
        log_posterior = 2.0 * float(np.log(np.abs(np.diag(R))).sum())
        log_prior = 2.0 * float(np.linalg.slogdet(self.prior_root)[1])
        return -0.5 * (chi2 + log_noise + log_posterior - log_prior)

    def left_out_mm(self, folds: Iterable[Ints]) -> Array:
        """Return measured less predicted (M, K, 3), by folds (F,) of poses left out together.

        NaN where nothing was measured, and in poses of no fold.
        """
        count, rows = self.residual_mm.shape
        missed: Array = np.full((count, rows), np.nan)
        for fold in folds:
            P = self._fold_precision(fold)
            missed[fold] = np.linalg.solve(P, self.weighted[fold].ravel()).reshape(-1, rows)
        return np.where(self.known[..., None], missed.reshape(count, -1, 3), np.nan)

    def excess(self, folds: Iterable[Ints]) -> float:
        """Return the mean square of the misses by folds of poses left out over its expectation.

        About 1 where poses err independently; more where those of a fold err alike, so that all
        others are taken to know more than they do.
        """
        found = expected = 0.0
        for fold in folds:
            covariance = np.linalg.inv(self._fold_precision(fold))
            known = np.repeat(self.known[fold].ravel(), 3)
            missed = covariance @ self.weighted[fold].ravel()
            found += float(np.sum(missed[known] ** 2))
            expected += float(np.sum(np.diag(covariance)[known]))
        return found / expected

    def _fold_precision(self, fold: Ints) -> Array:
        """Return the block of P (F N, F N) of the poses (F,) of a fold."""
        inverse, S = self._precision_parts
        rows = self.residual_mm.shape[1]
        own = S[fold].reshape(len(fold) * rows, -1)
        P: Array = -(own @ own.T)
        for n, pose in enumerate(fold):
            at = slice(n * rows, (n + 1) * rows)
            P[at, at] += inverse[pose]
        return P

    def distances(self) -> tuple[Array, Array]:
        """Return squared Mahalanobis distances of the readings (M, K) and of whole poses (M,), each
        from what all others predict.
        """
        g = self.weighted
        poses = np.einsum("mi,mi->m", g, np.linalg.solve(self.precision, g[..., None])[..., 0])
        readings = np.empty(self.known.shape)
        for k in range(self.known.shape[1]):
            at = slice(3 * k, 3 * k + 3)
            own = np.linalg.solve(self.precision[:, at, at], g[:, at, None])[..., 0]
            readings[:, k] = np.einsum("mi,mi->m", g[:, at], own)
        return readings, poses


@dataclass(frozen=True, eq=False)
class Observability:
    """``ratio`` (P,): posterior over prior standard deviation of each parameter.

    ``directions``: how many combinations of parameters the data determine better than the prior;
    ``effective``: the degrees of freedom that they spend; ``condition``: of these combinations,
    how much better the best is known than the worst.
    """

    ratio: Array
    directions: int
    effective: float
    condition: float


def observability(system: System) -> Observability:
    """Return which errors of a robot a system's readings determine, and which only the prior."""
    W = system.prior_root
    whitened = W @ system.covariance @ W.T
    prior = np.linalg.inv(W.T @ W)
    ratio = np.sqrt(np.diag(system.covariance) / np.diag(prior))
    left = np.clip(np.linalg.eigvalsh((whitened + whitened.T) / 2), 1e-30, 1.0)
    gains = np.sqrt(1.0 / left - 1.0)  # standard deviations of the prior over the data's
    known = gains[gains > 1.0]
    condition = float(known.max() / known.min()) if len(known) else 1.0
    return Observability(ratio, len(known), float(np.sum(1.0 - left)), condition)


def triangle(*blocks: Array) -> Array:
    """Return R (P, P), upper triangular, with R'R = A'A of rows A (N, P), given in blocks.

    By A'A, which has half of A's digits, where its columns differ enough to leave the others; else
    by an orthogonal factorisation, which takes three times as long.
    """
    squares = np.sum([rows.T @ rows for rows in blocks], axis=0)
    scale = np.sqrt(np.diag(squares))
    try:
        R: Array = np.linalg.cholesky(squares / np.outer(scale, scale)).T
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.qr(np.concatenate(blocks), mode="r"))
    least_pivot = 1e-4  # of columns of unit length: their squares keep 8 digits
    if not np.diag(R).min() >= least_pivot:
        return np.asarray(np.linalg.qr(np.concatenate(blocks), mode="r"))
    return R * scale
