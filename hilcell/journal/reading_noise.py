"""The noise of readings, from the scatter that points state, evaluated at any of them."""

from __future__ import annotations

from collections.abc import Sequence

from hilcell.geometry.beam_noise import BeamNoise, beam_noise
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import Point
from hilcell.ports import Array


def run_noise(log: Log) -> BeamNoise:
    """Return the noise that all points of a run show."""
    return log.once_measured(_run_noise)


def _run_noise(log: Log) -> BeamNoise:
    points = list(log.points.values())
    std_mm = [point.std_mm for point in points]
    return beam_noise(positions_mm(points), std_mm, [point.samples for point in points])


def noise_at(noise: BeamNoise, points: Sequence[Point]) -> Array:
    """Return the covariances (N, 3, 3) of points' averaged readings, the tracker's axes."""
    return noise.at(positions_mm(points), [point.samples for point in points])
