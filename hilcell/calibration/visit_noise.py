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

from hilcell.geometry.beam_noise import BeamNoise
from hilcell.journal.log import Log, positions_mm, repeated_visits
from hilcell.journal.reading_noise import noise_at, run_noise
from hilcell.model.point import Point
from hilcell.ports import Array

STEPS, SETTLED = 200, 1e-15  # of the scatter's estimate; a share of it


@dataclass(frozen=True, slots=True)
class VisitNoise:
    """The robot's own scatter (3, 3), the tracker's axes, and the noise of single readings."""

    robot_mm2: Array
    beam: BeamNoise

    def covariances(self, points: Sequence[Point], R: Array) -> Array:
        """Return the covariances (N, 3, 3) of single visits of points' poses, turned by ``R``
        (3, 3) from the tracker's frame.
        """
        return R @ (self.robot_mm2 + noise_at(self.beam, points)) @ R.T


def visit_noise(log: Log) -> VisitNoise:
    """Return what a run's readings and its repeated visits show."""
    return log.once_measured(_visit_noise)


def _visit_noise(log: Log) -> VisitNoise:
    beam, visits = run_noise(log), repeated_visits(log)
    noise_mm2 = np.array([noise_at(beam, each).mean(axis=0) for each in visits])
    return VisitNoise(scatter_besides([positions_mm(each) for each in visits], noise_mm2), beam)


def scatter_besides(clouds_mm: Sequence[Array], noise_mm2: Array) -> Array:
    """Return the covariance (3, 3) that clouds (N, 3) share besides their noise (K, 3, 3).

    The likeliest one, by expectation and maximisation (Dempster, Laird and Rubin 1977). A plain
    difference would have negative variances; cutting them off takes from other directions too.
    """
    freedom = np.array([len(cloud) - 1 for cloud in clouds_mm])
    squares = (len(cloud) * np.cov(cloud, rowvar=False, bias=True) for cloud in clouds_mm)
    squares_mm2 = np.array([*squares])
    smallest_mm2 = 1e-12  # far below any reading's variance: so that an inverse exists
    noise_mm2 = noise_mm2 + smallest_mm2 * np.eye(3)
    found: Array = squares_mm2.sum(axis=0) / freedom.sum()
    for _ in range(STEPS):
        seen_mm2 = found + noise_mm2
        K = found @ np.linalg.inv(seen_mm2)
        beyond_mm2 = squares_mm2 - freedom[:, None, None] * seen_mm2
        step = (K @ beyond_mm2 @ np.swapaxes(K, 1, 2)).sum(axis=0) / freedom.sum()
        found = found + step
        if np.abs(step).max() <= SETTLED * np.trace(found):
            break
    return found


def of_differences(blocks: Array) -> Array:
    """Return the covariance (3N, 3N) of N independent differences, of their own (N, 3, 3)."""
    count = len(blocks)
    found = np.zeros((count, 3, count, 3))
    found[np.arange(count), :, np.arange(count), :] = blocks
    return found.reshape(3 * count, 3 * count)
