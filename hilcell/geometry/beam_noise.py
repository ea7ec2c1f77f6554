"""Noise of an instrument's readings: a length along its beam, and an angle across it.

It turns with the beam and grows with the range, so the scatter at many places tells that of any
other. The spread of a few readings at one place says little: that of 2 along a beam is half the
noise or less in 38 % of all places, a fortieth in 2 %. Positions are in the tracker's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import lengths_mm


@dataclass(frozen=True, slots=True)
class BeamNoise:
    """Variances of a single reading: along the beam, and across it at a range of 1 m.

    ``freedom`` are the degrees of freedom that they are estimated with.
    """

    along_mm2: float
    across_mm2_m2: float
    freedom: float

    def at(self, at_mm: Array, samples: ArrayLike) -> Array:
        """Return the covariances (N, 3, 3) of averages of so many readings at places (N, 3)."""
        beams, range_m2 = _beams(at_mm)
        along = beams[:, :, None] * beams[:, None, :]
        across_mm2 = (self.across_mm2_m2 * range_m2)[:, None, None]
        single_mm2 = self.along_mm2 * along + across_mm2 * (np.eye(3) - along)
        found: Array = single_mm2 / np.asarray(samples, dtype=float)[:, None, None]
        return found


def beam_noise(at_mm: Array, std_mm: ArrayLike, samples: ArrayLike) -> BeamNoise:
    """Return the noise that the scatter of readings at places (N, 3) shows, N >= 1.

    ``std_mm`` (N, 3) are those of a single reading, axes of the tracker, from so many ``samples``
    (N,); one sample states what the instrument says of itself. Least squares with weights as of
    variances, none of both below nought.
    """
    beams, range_m2 = _beams(at_mm)
    freedom = np.maximum(np.asarray(samples, dtype=float) - 1.0, 1.0)
    shares = np.square(beams)
    A = np.stack([shares, range_m2[:, None] * (1.0 - shares)], axis=-1).reshape(-1, 2)
    stated_mm2 = np.square(np.asarray(std_mm, dtype=float)).reshape(-1)
    known = np.repeat(np.sqrt(freedom), 3)
    weights: Array = known
    found: Array = np.zeros(2)
    least_share = 1e-3  # of the largest variance: none counts as better known than that
    for _ in range(8):  # the weights follow from the variances that are fitted
        found = _non_negative(A * weights[:, None], stated_mm2 * weights)
        fitted_mm2 = A @ found
        if not fitted_mm2.max() > 0.0:
            break
        weights = known / np.maximum(fitted_mm2, least_share * fitted_mm2.max())
    return BeamNoise(float(found[0]), float(found[1]), float(freedom.sum()))


def _beams(at_mm: Array) -> tuple[Array, Array]:
    """Return the beams' directions (N, 3) and their squared lengths (N,) in m^2."""
    least_mm = 1.0  # range of a beam: the centre of the tracker has no direction
    range_mm = np.maximum(lengths_mm(at_mm), least_mm)
    return at_mm / range_mm[:, None], np.square(range_mm / 1000.0)


def _non_negative(A: Array, b: Array) -> Array:
    """Return x (2,) >= 0 that leaves least of ``A x = b``."""
    both = np.linalg.lstsq(A, b, rcond=None)[0]
    if bool(np.all(both >= 0.0)):
        return np.array(both, dtype=float)
    alone = np.maximum(0.0, (A.T @ b) / np.square(A).sum(axis=0))
    each = np.diag(alone)
    return np.array(min(each, key=lambda x: float(np.square(A @ x - b).sum())))
