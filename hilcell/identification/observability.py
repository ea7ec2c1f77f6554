"""Which errors of a robot the measured poses determine, and which only the prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.identification.system import System

DETERMINED = 0.5  # of the prior's standard deviation: below, the data say more than the prior


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
    """Return what a system's readings determine."""
    W = system.prior_root
    whitened = W @ system.covariance @ W.T
    prior = np.linalg.inv(W.T @ W)
    ratio = np.sqrt(np.diag(system.covariance) / np.diag(prior))
    left = np.clip(np.linalg.eigvalsh((whitened + whitened.T) / 2), 1e-30, 1.0)
    gains = np.sqrt(1.0 / left - 1.0)  # standard deviations of the prior over the data's
    known = gains[gains > 1.0]
    condition = float(known.max() / known.min()) if len(known) else 1.0
    return Observability(ratio, len(known), float(np.sum(1.0 - left)), condition)
