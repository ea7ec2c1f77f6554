"""How far one visit of a pose scatters there: the robot's scatter, and the readings' noise.

An instrument's noise is a length along its beam and an angle across it: it turns with the beam, and
grows with the range. So what a few places have shown holds elsewhere only for the robot. A total
station's noise, 0.3 mm along the beam and 0.02 mm across it, shows as 0.05 mm across a direction
that is 10 deg from the beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.errors import repeated_visits
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.log import Log, Point, positions_mm
from hilcell.ports import Array

ROUNDS = 8  # of weighting: the weights follow from the variances that are fitted
STEPS = 200  # of the scatter's estimate
SMALLEST_MM2 = 1e-12  # far below any reading's variance: so that an inverse exists
LEAST_SHARE = 1e-3  # of the largest variance: none counts as better known than that


@dataclass(frozen=True, slots=True)
class BeamNoise:
    """Variances of a single reading: along the beam, and across it at a range of 1 m."""

    along_mm2: float
    across_mm2_m2: float

    def at(self, points: Sequence[Point]) -> Array:
        """Return the covariances (N, 3, 3) of the averaged readings, the tracker's axes."""
        beams, range_m2 = _beams(points)
        along = beams[:, :, None] * beams[:, None, :]
        across_mm2 = (self.across_mm2_m2 * range_m2)[:, None, None]
        samples = np.array([point.samples for point in points])[:, None, None]
        found: Array = (self.along_mm2 * along + across_mm2 * (np.eye(3) - along)) / samples
        return found


def beam_noise(points: Sequence[Point]) -> BeamNoise:
    """Return the noise that the scatter of readings at many places shows.

    Each states three variances, with the axes of the tracker, from a few samples; least squares
    with weights as of variances, none of both below nought.
    """
    beams, range_m2 = _beams(points)
    shares = np.square(beams)
    A = np.stack([shares, range_m2[:, None] * (1.0 - shares)], axis=-1).reshape(-1, 2)
    stated_mm2 = np.square([point.std_mm for point in points]).reshape(-1)
    weights: Array = np.ones(len(A))
    found: Array = np.zeros(2)
    for _ in range(ROUNDS):
        found = _non_negative(A * weights[:, None], stated_mm2 * weights)
        fitted_mm2 = A @ found
        if not fitted_mm2.max() > 0.0:
            break
        weights = 1.0 / np.maximum(fitted_mm2, LEAST_SHARE * fitted_mm2.max())
    return BeamNoise(float(found[0]), float(found[1]))


@dataclass(frozen=True, slots=True)
class VisitNoise:
    """The robot's own scatter (3, 3), the tracker's axes, and the noise of single readings."""

    robot_mm2: Array
    beam: BeamNoise

    def covariances(self, points: Sequence[Point], R: Array) -> Array:
        """Return the covariances (N, 3, 3) of single visits of points' poses, turned by ``R``
        (3, 3) from the tracker's frame.
        """
        found: Array = R @ (self.robot_mm2 + self.beam.at(points)) @ R.T
        return found


def visit_noise(log: Log) -> VisitNoise:
    """Return what a run's readings and its repeated visits show."""
    beam, visits = beam_noise(list(log.points.values())), repeated_visits(log)
    noise_mm2 = np.array([beam.at(each).mean(axis=0) for each in visits])
    return VisitNoise(scatter_besides([positions_mm(each) for each in visits], noise_mm2), beam)


def scatter_besides(clouds_mm: Sequence[Array], noise_mm2: Array) -> Array:
    """Return the covariance (3, 3) that clouds (N, 3) share besides their noise (K, 3, 3).

    The likeliest one, by expectation and maximisation (Dempster, Laird and Rubin 1977). A plain
    difference would have negative variances; cutting them off takes from other directions too.
    """
    freedom = np.array([len(cloud) - 1 for cloud in clouds_mm])
    squares = (len(cloud) * np.cov(cloud, rowvar=False, bias=True) for cloud in clouds_mm)
    squares_mm2 = np.array([*squares])
    noise_mm2 = noise_mm2 + SMALLEST_MM2 * np.eye(3)
    found: Array = squares_mm2.sum(axis=0) / freedom.sum()
    for _ in range(STEPS):
        seen_mm2 = found + noise_mm2
        K = found @ np.linalg.inv(seen_mm2)
        beyond_mm2 = squares_mm2 - freedom[:, None, None] * seen_mm2
        found = found + (K @ beyond_mm2 @ np.swapaxes(K, 1, 2)).sum(axis=0) / freedom.sum()
    return found


def of_differences(blocks: Array) -> Array:
    """Return the covariance (3N, 3N) of N independent differences, of their own (N, 3, 3)."""
    count = len(blocks)
    found = np.zeros((count, 3, count, 3))
    found[np.arange(count), :, np.arange(count), :] = blocks
    return found.reshape(3 * count, 3 * count)


def _beams(points: Sequence[Point]) -> tuple[Array, Array]:
    """Return the beams' directions (N, 3) and their squared lengths (N,) in m^2."""
    at_mm = positions_mm(points)
    range_mm = lengths_mm(at_mm)
    return at_mm / range_mm[:, None], np.square(range_mm / 1000.0)


def _non_negative(A: Array, b: Array) -> Array:
    """Return x (2,) >= 0 that leaves least of ``A x = b``."""
    both = np.linalg.lstsq(A, b, rcond=None)[0]
    if bool(np.all(both >= 0.0)):
        return np.array(both)
    alone = np.maximum(0.0, (A.T @ b) / np.square(A).sum(axis=0))
    each = np.diag(alone)
    return np.array(min(each, key=lambda x: float(np.square(A @ x - b).sum())))
