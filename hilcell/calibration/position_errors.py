"""Position errors e = actual - nominal at the targets, in {W}, mm, from the log alone (eq 18).

Also the scatter of one visit: the robot's own, and the readings' noise, a length along the beam and
an angle across it. A total station's 0.3 mm along and 0.02 mm across show as 0.05 mm in a direction
10 deg off the normal to the beam, so only the robot's scatter is transferred to other places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.frames import Frames
from hilcell.calibration.known_arm import carried_calibration, carried_scatter
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import BeamNoise, Figures, figures_of, lengths_mm
from hilcell.journal.log import (
    Log,
    commanded_rad,
    noise_at,
    of_measured,
    positions_mm,
    repeated_visits,
    run_noise,
)
from hilcell.model.point import Point, Sent
from hilcell.model.verdicts import OTHERS
from hilcell.ports import Array


@dataclass(frozen=True, slots=True)
class Errors:
    """Nominal targets (N, 3) and errors e = actual - nominal (N, 3), in {W}."""

    nominal_mm: Array
    error_mm: Array

    def __len__(self) -> int:
        return len(self.error_mm)

    @property
    def norms_mm(self) -> Array:
        """3D errors (N,) of eq 18."""
        return lengths_mm(self.error_mm)

    @property
    def figures(self) -> Figures:
        """Mean, p95 and maximum of the 3D errors (mm)."""
        return figures_of(self.norms_mm)


def position_errors(log: Log, points: list[Point]) -> Errors:
    known = [point for point in points if point.nominal_mm is not None]
    nominal_mm = np.array([point.nominal_mm for point in known], dtype=float).reshape(-1, 3)
    actual_mm = apply(log.matrix("world"), positions_mm(known))
    return Errors(nominal_mm, actual_mm - nominal_mm)


def targets(log: Log, station: str, how: Sent) -> list[Point]:
    """Targets of a station, sent as ``how``, each by its largest measured error. So a
    re-measurement, for any reason, cannot reduce the figures.
    """
    return _counting(log, log.select("validate", station, how=how))


def _counting(log: Log, points: list[Point]) -> list[Point]:
    return [counting(log, point) for point in points if point.nominal_mm is not None]


def counting(log: Log, point: Point) -> Point:
    """The measurement of a target with the largest error: the one that counts."""
    if point.key not in log.repeated:
        return point
    measured = [*log.repeated[point.key], point]
    return measured[int(np.argmax(position_errors(log, measured).norms_mm))]


def validation(log: Log, stations: list[str]) -> dict[Sent, Errors]:
    """Errors before and after at ``stations``, as far as measured; those before a quick plan's
    correction by its corrected targets.
    """
    sent: dict[tuple[str, str], list[Point]] = {}
    for point in log.select("validate") if "world" in log.frames else ():
        sent.setdefault((point.station, point.id.how), []).append(point)
    series: dict[Sent, Errors] = {}
    for how in Sent:
        points = [p for name in stations for p in sent.get((name, how), ())]
        if known := _counting(log, points):
            series[how] = position_errors(log, known)
            if how == Sent.CHOSEN and log.cell.plan.quick:
                series = {Sent.BEFORE: uncorrected_errors(log, known)} | series
    return series


def uncorrected_errors(log: Log, points: list[Point]) -> Errors:
    """Errors of the poses that were commanded, which the robot has without a correction: those of
    targets that the correction has moved by some tenths of a millimetre.
    """
    frames, arm = Frames(log.cell, log), log.cell.robot.arm()
    bases = np.array([frames.base_in_world(log.cell.station_named(p.station)) for p in points])
    commanded_mm = (bases @ forward(arm, commanded_rad(points)))[:, :3, 3]
    return Errors(commanded_mm, apply(log.matrix("world"), positions_mm(points)) - commanded_mm)


def judged_places(cell: Cell) -> dict[str, list[str]]:
    """Places of validation with their stations: the grid's, all others, each other."""
    reference = cell.grid.station
    others = [station.name for station in cell.station if station.name != reference]
    together = {OTHERS: others} if others else {}
    return {reference: [reference]} | together | {name: [name] for name in others}


def places(cell: Cell) -> dict[str, list[str]]:
    """Places of validation, without the others where that is one station twice."""
    found = judged_places(cell)
    return {name: each for name, each in found.items() if name != OTHERS or len(each) > 1}


def grid_errors(log: Log) -> Errors | None:
    """Errors at the grid's vertices; None where none was measured."""
    points = log.select("grid")
    return position_errors(log, points) if points and "world" in log.frames else None


def reduction(before_mm: float, after_mm: float) -> float:
    """Removed share of an error, 1 - after / before (row 16 of the paper)."""
    return 1.0 - after_mm / before_mm


def visits_mm(log: Log) -> list[Array]:
    """Clouds (N, 3), tracker's frame, of places that the robot visited repeatedly."""
    return [positions_mm(points) for points in repeated_visits(log)]


def visit_scatter(log: Log, R: Array) -> tuple[Array, int, int]:
    """One visit's covariance (3, 3), rotated by ``R``, and the counts of visits and places."""
    if (carried := carried_calibration(log)) is not None:
        noise, visits = visit_noise(log), round(carried_scatter(carried)[1])
        points = [point for point in log.points.values() if point.commanded_deg is not None]
        scatter_mm2 = noise.covariances(points, R).mean(axis=0)
        return scatter_mm2, visits + 1, 1
    return pooled(visits_mm(log), R)


def pooled(clouds_mm: Sequence[Array], R: Array) -> tuple[Array, int, int]:
    """Covariance (3, 3) of clouds (N, 3) about their means, rotated by ``R`` (GUM H.3.6). With the
    counts of points and clouds.
    """
    left_mm = np.concatenate([cloud - cloud.mean(axis=0) for cloud in clouds_mm]) @ R.T
    covariance_mm2: Array = left_mm.T @ left_mm / (len(left_mm) - len(clouds_mm))
    return covariance_mm2, len(left_mm), len(clouds_mm)


@dataclass(frozen=True, slots=True)
class VisitNoise:
    """The robot's own scatter (3, 3), the tracker's axes, and the noise of single readings."""

    robot_mm2: Array
    beam: BeamNoise

    def covariances(self, points: Sequence[Point], R: Array) -> Array:
        """Covariances (N, 3, 3) of single visits, rotated by ``R`` (3, 3)."""
        return R @ (self.robot_mm2 + noise_at(self.beam, points)) @ R.T


@of_measured
def visit_noise(log: Log) -> VisitNoise:
    beam, visits = run_noise(log), repeated_visits(log)
    if (carried := carried_calibration(log)) is not None:
        R = (inverse(log.matrix("world")) @ log.matrix("base"))[:3, :3]
        return VisitNoise(R @ carried_scatter(carried)[0] @ R.T, beam)
    noise_mm2 = np.array([noise_at(beam, each).mean(axis=0) for each in visits])
    return VisitNoise(scatter_besides([positions_mm(each) for each in visits], noise_mm2), beam)


def scatter_besides(clouds_mm: Sequence[Array], noise_mm2: Array) -> Array:
    """Covariance (3, 3) that clouds (N, 3) share besides their noise (K, 3, 3).

    Maximum likelihood by expectation and maximisation (Dempster, Laird and Rubin 1977). A plain
    difference could have negative variances; cutting them off would distort other directions.
    """
    freedom = np.array([len(cloud) - 1 for cloud in clouds_mm])
    squares = (len(cloud) * np.cov(cloud, rowvar=False, bias=True) for cloud in clouds_mm)
    squares_mm2 = np.array([*squares])
    smallest_mm2 = 1e-12  # far below any reading's variance: so that an inverse exists
    noise_mm2 = noise_mm2 + smallest_mm2 * np.eye(3)
    steps, settled = 200, 1e-15  # at most; a share of the estimate
    covariance_mm2: Array = squares_mm2.sum(axis=0) / freedom.sum()
    for _ in range(steps):
        seen_mm2 = covariance_mm2 + noise_mm2
        K = covariance_mm2 @ np.linalg.inv(seen_mm2)
        beyond_mm2 = squares_mm2 - freedom[:, None, None] * seen_mm2
        step = (K @ beyond_mm2 @ np.swapaxes(K, 1, 2)).sum(axis=0) / freedom.sum()
        covariance_mm2 = covariance_mm2 + step
        if np.abs(step).max() <= settled * np.trace(covariance_mm2):
            break
    return covariance_mm2


def block_diagonal(blocks: Array) -> Array:
    """Covariance (3N, 3N) of N independent differences with (N, 3, 3)."""
    count = len(blocks)
    matrix = np.zeros((count, 3, count, 3))
    matrix[np.arange(count), :, np.arange(count), :] = blocks
    return matrix.reshape(3 * count, 3 * count)
