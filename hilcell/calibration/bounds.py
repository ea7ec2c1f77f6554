"""95 % bounds of corrected targets: in use, as a calibration file states them, and as validated.

Both have the same parts but for three groups: errors that grid and validation share and that so
cannot show there ({W}, the tracker's limits, the reflector, the drill); the readings of the
validation itself; and the temperature, allowed or measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.budget import in_validation, temperature, touched
from hilcell.calibration.errors import Errors, errors_of, targets
from hilcell.calibration.form import Calibration
from hilcell.calibration.influence import Bounds, Influence, NoBound, Uncertainty, bounds_of
from hilcell.geometry.frames import inverse, matrix
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log, commanded_rad
from hilcell.model.point import Point, Sent
from hilcell.model.results import TargetBounds
from hilcell.ports import Array


@dataclass(frozen=True, eq=False)
class Coverage:
    """Validated errors (N,) and the bounds (N,) that 95 % of them should keep."""

    errors_mm: Array
    bounds_mm: Array

    def __len__(self) -> int:
        return len(self.errors_mm)

    @property
    def inside(self) -> int:
        """Return how many errors keep their bounds."""
        return int(np.count_nonzero(self.errors_mm <= self.bounds_mm))

    @property
    def share(self) -> float:
        """Return the share of errors inside their bounds."""
        return self.inside / len(self)

    @property
    def figures(self) -> TargetBounds:
        """Return the share inside, mean and largest bound."""
        mean_mm, max_mm = float(self.bounds_mm.mean()), float(self.bounds_mm.max())
        return TargetBounds(coverage=self.share, mean_mm=mean_mm, max_mm=max_mm)


def target_bounds(
    calibration: Calibration, station: str, poses: Array, temperature_c: float | None = None
) -> Bounds:
    """Return the bounds of corrected targets at poses (N, 4, 4) in {W}.

    ``temperature_c`` is the room's; None: any that the check of validity allows. Raises
    `NoBound` with the reason where the file states no budget, and `OutsideGrid`.
    """
    stated, lines = _stated(calibration), lines_in_use(calibration, station)
    air = temperature(
        stated.growth_per_k, calibration.validity.temperature_c, stated.air_range_k, temperature_c
    )
    return _bounds(calibration, station, poses, [*lines, air])


def lines_in_use(calibration: Calibration, station: str) -> list[Influence]:
    """Return the lines of the budget, but for the temperature's, that count for targets in use."""
    stated = _stated(calibration)
    lines = (*stated.lines, *stated.stations[station])
    return [each for each in lines if each.counts != "in validation"]


def cube_bounds(calibration: Calibration, station: str) -> Bounds:
    """Return the bounds in use through the calibrated cube, in its orientation."""
    grid = calibration.grid()
    shares = np.array([0.25, 0.75])  # along each axis of a grid's cell
    axes = [
        low_mm + grid.pitch_mm * np.add.outer(np.arange(count - 1), shares).ravel()
        for low_mm, count in zip(grid.origin_mm, grid.shape, strict=True)
    ]
    places_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = calibration.poses_at(places_mm)
    return target_bounds(calibration, station, _base(calibration, station) @ poses)


def validated(calibration: Calibration, log: Log, station: str) -> Coverage | None:
    """Return the corrected validation points of a station; None where none was measured.

    Raises `NoBound`.
    """
    found = validated_bounds(calibration, log, station)
    return None if found is None else Coverage(found[0].norms_mm, found[1].radii_mm)


def validated_bounds(
    calibration: Calibration, log: Log, station: str
) -> tuple[Errors, Bounds] | None:
    """Return the errors of `validation_points` and the contributions to each; None without one.

    Raises `NoBound`.
    """
    points = validation_points(log, station)
    if not points:
        return None
    found = errors_of(log, points)
    T_W_B = _base(calibration, station)
    in_base_mm = (found.nominal_mm - T_W_B[:3, 3]) @ T_W_B[:3, :3]
    lines = lines_in_validation(calibration, log, station, points)
    poses = driven_poses(calibration, log, points, in_base_mm)
    return found, _bounds(calibration, station, T_W_B @ poses, lines)


def lines_in_validation(
    calibration: Calibration, log: Log, station: str, points: list[Point]
) -> list[Influence]:
    """Return the lines of the budget that count for validation points of a station."""
    stated, stop = _stated(calibration), log.cell.station_named(station)
    on_visit = touched(log, stop)
    placed = stated.stations[station] if on_visit is None else [on_visit]
    lines = [each for each in (*stated.lines, *placed) if each.counts != "in use"]
    return [*lines, *in_validation(log, stop, points)]


def driven_poses(
    calibration: Calibration, log: Log, points: list[Point], places_mm: Array
) -> Array:
    """Return the targets' poses (N, 4, 4) in {B} at places (N, 3), turned as commanded."""
    if any(point.commanded_deg is None for point in points):
        return calibration.poses_at(places_mm)
    R = forward(log.cell.robot.arm(), commanded_rad(points))[:, :3, :3]
    return matrix(R, places_mm)


def validation_points(log: Log, station: str) -> list[Point]:
    """Return the points of a station that `validated` judges, in its order."""
    return targets(log, station, Sent.CHOSEN)


def coverages(
    calibration: Calibration, log: Log, places: Mapping[str, Sequence[str]]
) -> dict[str, Coverage]:
    """Return the validation by place, each of one or several stations, as far as it was measured.

    Raises `NoBound`.
    """
    names = {name for stations in places.values() for name in stations}
    single = {name: validated(calibration, log, name) for name in names}
    found = {}
    for place, stations in places.items():
        parts = [part for name in stations if (part := single[name]) is not None]
        if parts:
            found[place] = Coverage(
                np.concatenate([part.errors_mm for part in parts]),
                np.concatenate([part.bounds_mm for part in parts]),
            )
    return found


def _stated(calibration: Calibration) -> Uncertainty:
    if calibration.uncertainty.missing:
        raise NoBound(calibration.uncertainty.missing)
    return calibration.uncertainty


def _bounds(
    calibration: Calibration, station: str, poses: Array, lines: Sequence[Influence]
) -> Bounds:
    T_W_B = _base(calibration, station)
    model_mm2 = calibration.error_model().predict(inverse(T_W_B) @ poses).covariance_mm2
    samples = _stated(calibration).model_samples
    return bounds_of(model_mm2, lines, T_W_B, poses, samples)


def _base(calibration: Calibration, station: str) -> Array:
    return np.array(calibration.stations[station].T_W_B)
