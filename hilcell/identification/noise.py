"""How far readings scatter about a smooth model, and its estimate from the poses themselves.

Two sources: the tracker's own beyond what the readings' covariance says, independent from reading
to reading; and the joints' (repeatability, and short waves of gears that no parameter describes),
common to all reflectors of a pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.identification.readings import Bools

TYPICAL_MM, TYPICAL_RAD = 0.02, 30e-6  # where the estimate starts, and what few data lean on
DOUBT = 4.0  # readings' worth of data that the typical values count for


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations: of a coordinate of a reading, and of the joints (6,)."""

    reading_mm: float
    joint_rad: Array

    @classmethod
    def typical(cls) -> Noise:
        """Return what is assumed before anything is known."""
        return cls(TYPICAL_MM, np.full(6, TYPICAL_RAD))

    def covariance(self, by_joint: Array, own_mm2: Array, known: Bools) -> Array:
        """Return the covariances (M, 3K, 3K) of the poses' readings.

        ``by_joint`` (M, K, 3, 6) and each reading's own covariance (M, K, 3, 3). An unknown
        reading (M, K) has variance 1 and no part in the others.
        """
        count, reflectors = known.shape
        levers = np.where(known[..., None, None], by_joint, 0.0).reshape(count, -1, 6)
        C: Array = np.einsum("mij,j,mkj->mik", levers, self.joint_rad**2, levers)
        for k in range(reflectors):
            at = slice(3 * k, 3 * k + 3)
            own = own_mm2[:, k] + self.reading_mm**2 * np.eye(3)
            C[:, at, at] += np.where(known[:, k, None, None], own, np.eye(3))
        return C

    def improved(self, weighted: Array, precision: Array, by_joint: Array, known: Bools) -> Noise:
        """Return the estimate after one step that cannot lower the marginal likelihood.

        ``weighted`` (M, 3K) is P y and ``precision`` (M, 3K, 3K) the blocks of P, the inverse of
        the readings' whole covariance under the prior: the MM algorithm for variance components,
        sigma^2 <- sigma^2 sqrt(y'P V P y / tr P V) (Zhou et al., J. Comp. Graph. Stat. 2019).
        """
        rows = np.repeat(known, 3, axis=1)
        levers = np.where(known[..., None, None], by_joint, 0.0).reshape(len(known), -1, 6)
        found = float(np.sum(np.where(rows, weighted, 0.0) ** 2))
        wanted = float(np.sum(np.where(rows, np.einsum("mii->mi", precision), 0.0)))
        reading = _step(self.reading_mm, found, wanted, TYPICAL_MM)
        turned = np.einsum("mij,mi->mj", levers, weighted)
        each_found = np.sum(turned**2, axis=0)
        each_wanted = np.einsum("mij,mik,mkj->j", levers, precision, levers)
        common = float(np.exp(np.mean(np.log(self.joint_rad))))
        joint = [
            _step(float(sigma), float(f), float(w), common)
            for sigma, f, w in zip(self.joint_rad, each_found, each_wanted, strict=True)
        ]
        return Noise(reading, np.array(joint))

    def changed(self, before: Noise) -> float:
        """Return the largest relative change of a standard deviation."""
        now, then = (
            np.append(self.joint_rad, self.reading_mm),
            np.append(before.joint_rad, before.reading_mm),
        )
        return float(np.abs(np.log(now / then)).max())


def _step(sigma: float, found: float, wanted: float, typical: float) -> float:
    """Return sigma after a step, drawn to the typical value by an inverse chi^2 of `DOUBT`."""
    found += DOUBT * typical**2 / sigma**4
    wanted += DOUBT / sigma**2
    return float(sigma * (found / wanted) ** 0.25)
