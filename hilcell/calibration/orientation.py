"""Orientation errors of the tool at measured targets, from the log alone, and their bounds.

The pose of the tool is the rigid fit of its reflectors, with their positions on the flange from the
calibration. An error is a rotation vector in {W}: actual = exp(vector) nominal. Its bound includes
model, visit and frames, and in a validation the readings. U of a measured orientation includes the
readings, the stated limits of tracker and reflectors, each reflector by itself, and the rotation of
{W}; a shift common to all reflectors has no effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, pairwise
from typing import Self

import numpy as np

from hilcell.calibration.budget import driven_poses, lines_in_use, lines_in_validation
from hilcell.calibration.decision_rule import stated_mm2
from hilcell.calibration.file import Calibration
from hilcell.calibration.frames import Frames, world_as_framed
from hilcell.calibration.grid import measured_errors
from hilcell.calibration.influence import Influence, NoBound
from hilcell.calibration.measurement_budget import expanded_mm
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import seats_mm
from hilcell.geometry.frames import (
    apply,
    from_rotvec,
    from_zyx,
    inverse,
    orientations,
    rotation_levers,
    to_rotvec,
)
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import (
    bounds95_mm,
    effective_freedom,
    figures_of,
    lengths_mm,
    trace_freedom,
)
from hilcell.identification.measured_poses import IdentificationError
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm
from hilcell.model.point import Point, Sent
from hilcell.model.results import OrientationBounds, OrientationFigures
from hilcell.model.verdicts import OrientationError
from hilcell.ports import Array, HilcellError

ROTATION = slice(3, 6)  # of an influence's covariance
MOVED_MM = 0.03  # of reflectors against each other: at 150 mm it turns the tool by 0.01 deg


@dataclass(frozen=True, eq=False)
class OrientationErrors:
    """Tool points of N targets and their orientation errors (N, 3) in rad, axes of {W}. Covariances
    (N, 3, 3) by the readings, and those by 1 mm^2 in each coordinate of each reflector.
    """

    points: list[Point]
    error_rad: Array
    reading_rad2: Array
    per_mm2_rad2: Array

    @classmethod
    def of_poses(cls, log: Log, poses: Sequence[Sequence[Point]], seats: Array) -> Self:
        """Errors of poses; each has its reflectors, the tool point first."""
        known = [each[0] for each in poses]
        if not known:
            return cls([], np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
        T_W_L = log.matrix("world")
        seen_mm = np.stack([apply(T_W_L, positions_mm(each)) for each in poses])
        own_mm2 = np.stack([covariances_mm2(each, T_W_L[:3, :3]) for each in poses])
        R = orientations(seats, seen_mm)
        levers = rotation_levers(seats, R)
        nominal = from_zyx(np.array([point.nominal_deg for point in known], dtype=float))
        reading_rad2, per_mm2_rad2 = (
            np.sum(levers @ each @ np.swapaxes(levers, -1, -2), axis=1)
            for each in (own_mm2, np.eye(3))
        )
        return cls(known, to_rotvec(R @ np.swapaxes(nominal, 1, 2)), reading_rad2, per_mm2_rad2)

    def __len__(self) -> int:
        return len(self.points)

    @property
    def angles_deg(self) -> Array:
        """Orientation error of each target (N,)."""
        return np.degrees(lengths_mm(self.error_rad))

    @property
    def noise_deg(self) -> float:
        """Orientation error by the readings alone: root mean square of all."""
        return math.degrees(math.sqrt(np.trace(self.reading_rad2, axis1=1, axis2=2).mean()))

    @property
    def figures(self) -> OrientationFigures:
        figures = figures_of(self.angles_deg)
        return OrientationFigures(mean_deg=figures.mean, p95_deg=figures.p95, max_deg=figures.max)


def seats_of(log: Log) -> Array | None:
    """Positions of the reflectors (K, 3) on the flange; None where unknown."""
    framed = {"world", "base"} <= log.frames.keys()
    if not (log.cell.robot.more_smr_mm and framed and log.select("grid")):
        return None
    try:
        return seats_mm(measured_errors(log))
    except IdentificationError:
        return None


def last_orientation_errors(log: Log, points: Sequence[Point], seats: Array) -> OrientationErrors:
    """Last errors of tool points with a nominal orientation, all reflectors measured."""
    return OrientationErrors.of_poses(
        log, [times[-1] for times in _times(log, points, len(seats))], seats
    )


def repeated_orientation_errors(log: Log, point: Point, seats: Array) -> OrientationErrors:
    return OrientationErrors.of_poses(log, [*chain(*_times(log, [point], len(seats)))], seats)


def largest_orientation_errors(
    log: Log, points: Sequence[Point], seats: Array
) -> OrientationErrors:
    """Each target's largest measured error; otherwise as `last_orientation_errors`."""
    measured = _times(log, points, len(seats))
    every = OrientationErrors.of_poses(log, [*chain(*measured)], seats)
    ends, angles_deg = np.cumsum([0, *map(len, measured)]), every.angles_deg
    chosen = [begin + int(np.argmax(angles_deg[begin:end])) for begin, end in pairwise(ends)]
    return OrientationErrors(
        [every.points[n] for n in chosen],
        every.error_rad[chosen],
        every.reading_rad2[chosen],
        every.per_mm2_rad2[chosen],
    )


def _times(log: Log, points: Sequence[Point], count: int) -> list[list[list[Point]]]:
    """The ``count`` reflectors of each pose, each time; a missing time is the last one."""
    found = []
    for point in points:
        ids = [point.id.at_seat(n) for n in range(1, count + 1)]
        if point.nominal_deg is None or not all(log.find(id) for id in ids):
            continue
        seen = [[*log.repeated.get(id.key, ()), log.point(id)] for id in ids]
        times = range(max(map(len, seen)))
        found.append([[each[min(n, len(each) - 1)] for each in seen] for n in times])
    return found


def validated_orientation_errors(
    log: Log, stations: Sequence[str]
) -> dict[Sent, OrientationErrors]:
    seats = seats_of(log)
    if seats is None:
        return {}
    errors = {}
    for how in Sent:
        points = [p for name in stations for p in log.select("validate", name, how=how)]
        turned = largest_orientation_errors(log, points, seats)
        if not len(turned):
            continue
        errors[how] = turned
        if how == Sent.CHOSEN and log.cell.plan.quick:
            errors = {Sent.BEFORE: _uncorrected(log, turned)} | errors
    return errors


def _uncorrected(log: Log, turned: OrientationErrors) -> OrientationErrors:
    """Errors of the orientations that were commanded; see `uncorrected_errors`."""
    frames, points = Frames(log.cell, log), turned.points
    bases = np.array([frames.base_in_world(log.cell.station_named(p.station)) for p in points])
    sent = (bases @ forward(log.cell.robot.arm(), commanded_rad(points)))[:, :3, :3]
    nominal = from_zyx(np.array([point.nominal_deg for point in points], dtype=float))
    actual = from_rotvec(turned.error_rad) @ nominal
    return replace(turned, error_rad=to_rotvec(actual @ np.swapaxes(sent, 1, 2)))


def largest_orientation_error(log: Log, turned: OrientationErrors | None) -> OrientationError:
    """Largest orientation error and its U; NaN where none was measured."""
    if turned is None or not len(turned):
        return OrientationError(math.nan, math.nan)  # accepts nothing
    return OrientationError(
        float(turned.angles_deg.max()),
        float(expanded_deg(orientation_covariances_rad2(log, turned)).max()),
    )


def orientation_covariances_rad2(
    log: Log, turned: OrientationErrors, *, readings: bool = True
) -> Array:
    """Covariances (N, 3, 3) of orientations in {W}, with or without ``readings``."""
    covariance_rad2 = stated_mm2(log.cell) * turned.per_mm2_rad2
    if readings:
        covariance_rad2 = covariance_rad2 + turned.reading_rad2
    if (framed := world_as_framed(log)) is not None:
        covariance_rad2 = covariance_rad2 + framed[3:, 3:]
    return covariance_rad2


def check_orientation_limit(cell: Cell) -> None:
    """Raise `HilcellError` where the stated uncertainties alone consume the limit."""
    limit_deg = cell.validation.max_tolerance_deg
    if limit_deg is None:
        return
    levers = rotation_levers(cell.robot.seats_mm, np.eye(3)[None])
    per_mm2_rad2 = np.sum(levers @ np.swapaxes(levers, -1, -2), axis=1)
    (least_deg,) = expanded_deg(stated_mm2(cell) * per_mm2_rad2)
    if not limit_deg > least_deg:
        raise HilcellError(
            f"validation.max_tolerance_deg {limit_deg:g}: nothing could be accepted, the tracker "
            f"and the reflectors' centring alone have U = {least_deg:.4f} deg (k = 2); state "
            "a larger one, or mount the reflectors farther apart",
            code="HC-C10",
        )


def expanded_deg(covariances_rad2: Array) -> Array:
    """U (N,) of each angle, of covariances (N, 3, 3): along the axis of the largest."""
    u_rad = np.sqrt(np.linalg.eigvalsh(covariances_rad2)[:, -1])
    return np.degrees([expanded_mm(each) for each in u_rad])


def moved_on_flange_mm(log: Log) -> float:
    """Motion of reflectors against each other between grid and validation, mm.

    A displaced reflector rotates the measured tool, and nothing else shows it. Medians of
    distances, so that one bad reading does not count; 0 where either was not measured.
    """
    before, after = _apart_mm(log, log.select("grid")), _apart_mm(log, log.select("validate"))
    if not (len(before) and len(after)):
        return 0.0
    return float(np.abs(np.median(after, axis=0) - np.median(before, axis=0)).max())


def _apart_mm(log: Log, points: Sequence[Point]) -> Array:
    """Distances (N, D) between reflectors at poses where all were measured."""
    numbers = range(1, len(log.cell.robot.seats_mm) + 1)
    each = [[log.find(point.id.at_seat(n)) for n in numbers] for point in points]
    known = [[seat for seat in seats if seat is not None] for seats in each]
    seen_mm = np.array([positions_mm(seats) for seats in known if len(seats) == len(numbers)])
    pairs = [*combinations(range(len(numbers)), 2)]
    if not len(seen_mm) or not pairs:
        return np.zeros((0, len(pairs)))
    one, other = np.array(pairs).T
    return np.asarray(np.linalg.norm(seen_mm[:, one] - seen_mm[:, other], axis=-1))


def orientation_bounds_deg(calibration: Calibration, station: str, poses: Array) -> Array | None:
    """95 % bounds (N,) of orientation at poses (N, 4, 4) in {W}, None where not corrected. Raises
    `NoBound`.
    """
    if not calibration.orients:
        return None
    lines = lines_in_use(calibration, station)
    return _bounds_deg(calibration, station, poses, lines, np.zeros((len(poses), 3, 3)))


def orientation_coverages(
    calibration: Calibration, log: Log, places: Mapping[str, Sequence[str]]
) -> dict[str, OrientationBounds]:
    """Bounds of corrected orientations by place; raises `NoBound`."""
    seats = seats_of(log) if calibration.orients else None
    if seats is None:
        return {}
    names = {name for stations in places.values() for name in stations}
    single = {name: _validated(calibration, log, name, seats) for name in names}
    coverages = {}
    for place, stations in places.items():
        angles_deg, bounds_deg = (
            np.concatenate([single[name][n] for name in stations]) for n in (0, 1)
        )
        if len(angles_deg):
            coverages[place] = OrientationBounds(
                coverage=float(np.mean(angles_deg <= bounds_deg)),
                mean_deg=float(bounds_deg.mean()),
                max_deg=float(bounds_deg.max()),
            )
    return coverages


def _validated(
    calibration: Calibration, log: Log, station: str, seats: Array
) -> tuple[Array, Array]:
    """Errors and bounds, (N,) each in deg, of a station's corrected targets."""
    turned = largest_orientation_errors(
        log, log.select("validate", station, how=Sent.CHOSEN), seats
    )
    if not len(turned):
        return np.zeros(0), np.zeros(0)
    T_W_B = calibration.base(station)
    nominal_mm = np.array([point.nominal_mm for point in turned.points], dtype=float)
    in_base_mm = apply(inverse(T_W_B), nominal_mm)
    poses = T_W_B @ driven_poses(calibration, log, turned.points, in_base_mm)
    lines = lines_in_validation(calibration, log, station, turned.points)
    bounds = _bounds_deg(calibration, station, poses, lines, turned.reading_rad2)
    return turned.angles_deg, bounds


def _bounds_deg(
    calibration: Calibration,
    station: str,
    poses: Array,
    lines: Sequence[Influence],
    own_rad2: Array,
) -> Array:
    """Bounds (N,) of model, frames of {W} and {B}, and other covariances (N, 3, 3)."""
    T_W_B = calibration.base(station)
    turn = calibration.error_model().predict(inverse(T_W_B) @ poses).orientation
    if turn is None:
        raise NoBound("its error model knows positions only")
    R = T_W_B[:3, :3]
    model_rad2 = R @ turn.covariance_rad2 @ R.T
    axes = {"world": np.eye(3), "base": R}
    frames_rad2 = np.zeros((3, 3))
    for line in lines:
        if line.frame in axes:  # the tool's is the stated limit of what is measured here
            own = axes[line.frame]
            frames_rad2 += own @ np.array(line.covariance)[ROTATION, ROTATION] @ own.T
    samples = calibration.uncertainty.model_samples
    freedom = trace_freedom(model_rad2.mean(axis=0), samples) if samples else math.inf
    rest_rad2 = frames_rad2 + own_rad2
    traces = [np.trace(each, axis1=1, axis2=2) for each in (model_rad2, rest_rad2)]
    whole = effective_freedom(traces, [freedom, math.inf])
    return np.degrees(bounds95_mm(model_rad2 + rest_rad2, whole))
