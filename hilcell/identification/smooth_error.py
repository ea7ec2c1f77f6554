"""The smooth error of a joint in records of its motion: a Gaussian process of one angle.

Its covariance is Matern's of order 5/2, expanded in waves of even frequencies, so close that the
process repeats far beyond the records' range. Size, length and noise are those of greatest
evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array

HIGHEST = 45.0  # cycles per revolution of a smooth error


@dataclass(frozen=True, slots=True)
class Matern:
    """Standard deviation of a smooth error, and over what angle it changes."""

    size_rad: float
    length_rad: float

    def sigma_rad(self, cycles: Array) -> Array:
        """Return the standard deviations (K,) of the waves of even frequencies (K,)."""
        density = (5.0 / self.length_rad**2 + cycles**2) ** -3.0
        sigma: Array = self.size_rad * np.sqrt(density / density.sum())
        return sigma


@dataclass(frozen=True, slots=True)
class Regression:
    """Products of columns (N, P), and with values (N,); the values' own squares."""

    normal: Array  # (P, P)
    right: Array  # (P,)
    squares: float
    count: int

    @classmethod
    def of(cls, columns: Array, values: Array) -> Regression:
        right = columns.T @ values
        return cls(columns.T @ columns, right, float(values @ values), len(values))

    def _root(self, sigma: Array, noise: float) -> Array:
        """Return the root of the posterior's information in units of the prior's ``sigma`` (P,)."""
        information = self.normal * np.outer(sigma, sigma) / noise**2
        return np.asarray(np.linalg.cholesky(information + np.eye(len(sigma))), dtype=float)

    def evidence(self, sigma: Array, noise: float) -> float:
        """Return the logarithm of the marginal likelihood, up to a constant."""
        root = self._root(sigma, noise)
        explained = np.linalg.solve(root, sigma * self.right) / noise**2
        left = self.squares / noise**2 - float(explained @ explained)
        return -0.5 * left - float(np.log(np.diag(root)).sum()) - self.count * float(np.log(noise))

    def posterior(self, sigma: Array, noise: float) -> tuple[Array, Array]:
        """Return the mean (P,) of the coefficients and their covariance (P, P)."""
        back = np.linalg.inv(self._root(sigma, noise)) * sigma
        covariance = back.T @ back
        return covariance @ self.right / noise**2, covariance


@dataclass(frozen=True, slots=True)
class Likely:
    """The most probable process, and by how much the evidence for it beats that for none."""

    kernel: Matern
    noise: float
    gain: float


def most_likely(found: Regression, known: Array, cycles: Array, noise: float) -> Likely:
    """Return the process that explains most. The regression's columns are others with priors of
    ``known`` (Q,), then cosine and sine of each of ``cycles`` (K,); ``noise`` is that without it.
    """
    from scipy.optimize import minimize

    shortest_rad = 4.5 / float(cycles[-1])  # so that little is beyond the highest frequency
    middle = np.log([30e-6, max(0.2, shortest_rad), noise])
    doubt = np.array([2.0, 1.0, 3.0])  # of these logarithms

    def kernel(scales: Array) -> Matern:
        return Matern(float(np.exp(scales[0])), max(float(np.exp(scales[1])), shortest_rad))

    def evidence(process: Matern, noise: float) -> float:
        waves = np.repeat(process.sigma_rad(cycles), 2)
        return found.evidence(np.concatenate([known, waves]), noise)

    def cost(scales: Array) -> float:
        away = (scales - middle) / doubt
        try:
            return 0.5 * float(away @ away) - evidence(kernel(scales), float(np.exp(scales[2])))
        except np.linalg.LinAlgError:  # so little noise that rounding is more
            return np.inf

    best = minimize(
        cost,
        middle,
        method="Nelder-Mead",
        options={"maxiter": 300, "xatol": 0.02, "fatol": 0.05},
    ).x
    process, noise_found = kernel(best), float(np.exp(best[2]))
    nothing = evidence(Matern(1e-12, shortest_rad), noise)
    return Likely(process, noise_found, evidence(process, noise_found) - nothing)
