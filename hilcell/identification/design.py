"""Where to measure next: the poses that make predictions over a volume certain soonest.

Everything is linear and Gaussian about what is known: poses and places of the volume are rows of
the identification, and measuring a pose changes the parameters' covariance by a known amount
before it is measured (I-optimal design: least mean variance of the predictions; Pukelsheim 2006,
"Optimal Design of Experiments", chapter 9). Greedy: each pose is the best one after those before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import bounds95_mm


@dataclass(frozen=True, eq=False)
class Rows:
    """M positions: their derivatives by P parameters (M, 3, P), and what else they scatter by,
    ``noise_mm2`` (M, 3, 3).
    """

    by_parameter: Array
    noise_mm2: Array

    def covariance_mm2(self, covariance: Array) -> Array:
        """Return the positions' covariances (M, 3, 3) by that of the parameters (P, P)."""
        J = self.by_parameter
        return J @ covariance @ np.swapaxes(J, 1, 2) + self.noise_mm2

    def gains_mm2(self, covariance: Array, weight: Array) -> Array:
        """Return by how much each candidate (M,) would lower the mean variance over the volume."""
        J = self.by_parameter
        carried = J @ covariance
        spread_mm2 = carried @ np.swapaxes(J, 1, 2) + self.noise_mm2
        lowered = carried @ weight @ np.swapaxes(carried, 1, 2)
        gains: Array = np.trace(np.linalg.solve(spread_mm2, lowered), axis1=1, axis2=2)
        return gains

    def mean_bound_mm(self, covariance: Array) -> float:
        """Return the mean 95 % bound of the positions."""
        return float(bounds95_mm(self.covariance_mm2(covariance)).mean())


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen candidates in their order, and the mean 95 % bound before and after each (mm)."""

    chosen: list[int]
    bounds_mm: list[float]


def design(
    candidates: Rows,
    volume: Rows,
    covariance: Array,
    *,
    bound_mm: float,
    counts: tuple[int, int],
) -> Design:
    """Return the poses to measure until the mean bound over the volume is at most ``bound_mm``.

    Or until more of them would gain little; but between the least and the most of ``counts``.
    """
    count = len(volume.by_parameter)
    rows = volume.by_parameter.reshape(-1, volume.by_parameter.shape[-1])
    weight = rows.T @ rows / count
    rest = 1.1  # of the bound that is left with all parameters known: below, poses gain little
    enough_mm = max(bound_mm, rest * volume.mean_bound_mm(np.zeros_like(covariance)))
    chosen: list[int] = []
    bounds_mm = [volume.mean_bound_mm(covariance)]
    least, most = (min(each, len(candidates.by_parameter)) for each in counts)
    while len(chosen) < least or (bounds_mm[-1] > enough_mm and len(chosen) < most):
        gains_mm2 = candidates.gains_mm2(covariance, weight)
        gains_mm2[chosen] = -1.0  # a second visit says less about what no parameter describes
        best = int(np.argmax(gains_mm2))
        J, noise_mm2 = candidates.by_parameter[best], candidates.noise_mm2[best]
        carried = J @ covariance
        spread_mm2 = carried @ J.T + noise_mm2
        updated: Array = covariance - carried.T @ np.linalg.solve(spread_mm2, carried)
        covariance = 0.5 * (updated + updated.T)
        chosen.append(best)
        bounds_mm.append(volume.mean_bound_mm(covariance))
    return Design(chosen, bounds_mm)
