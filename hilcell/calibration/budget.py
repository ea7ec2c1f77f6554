"""Uncertainty budget of a corrected target, from the run's readings and the cell's stated limits.

It gives the target's 95 % bound, in use and in validation. These differ in three groups: errors
common to grid and validation, which cannot show there ({W}, the tracker's limits, the reflector,
the drill); the validation's own readings; and the temperature, allowed or measured.

The base frame's own error is no line: targets are corrected in the {B} in which the grid was
measured, so that it cancels, except for the tool's orientation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.calibration.frames import (
    Frames,
    base_covariance,
    hold_covariance,
    nest_noise,
    world_as_framed,
    world_covariance,
)
from hilcell.calibration.grid import learnt_points
from hilcell.calibration.influence import (
    ASSUMED,
    MEASURED,
    Bounds,
    Influence,
    NoBound,
    UncertaintyBudget,
    combined_bounds,
    motion,
    moved_frame,
    nearest_semidefinite,
)
from hilcell.calibration.known_arm import (
    APPROACH,
    REPEATABILITY,
    carried_arm,
    carried_calibration,
    carried_line,
)
from hilcell.calibration.lost_motion import reversal
from hilcell.calibration.position_errors import (
    Errors,
    position_errors,
    targets,
    visit_scatter,
    visits_mm,
)
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.cell.file import Station
from hilcell.geometry.frames import apply, inverse, matrix
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import (
    chi2_quantile,
    effective_freedom,
    rectangular_variance,
    rms,
    trace_freedom,
)
from hilcell.identification.known_arm import AGED
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm, variances_mm2
from hilcell.model.frame import TouchedBase
from hilcell.model.point import Point, Sent
from hilcell.model.results import TargetBounds
from hilcell.model.verdicts import Fitted
from hilcell.ports import Array

NO_VISITS = "the run visited no place again, so that the robot's repeatability is not known"
TEMPERATURE = "Temperature of the arm"
DRILL = "Drill's offset"


def target_uncertainty(log: Log) -> UncertaintyBudget:
    if not (visits_mm(log) or carried_calibration(log)):
        return UncertaintyBudget(missing=NO_VISITS)
    stated = log.cell.uncertainty
    lines, centring_mm = _Lines(log), stated.smr_centring_limit_mm
    centring = f"limit ±{centring_mm:g} mm of the optics against the sphere, on the flange"
    return UncertaintyBudget(
        [
            lines.repeatability(),
            lines.approach(),
            lines.drift(),
            lines.world(),
            lines.tracker(),
            _limit("SMR centring", centring, centring_mm, stated.smr_source or ASSUMED),
            lines.drill(),
        ],
        {station.name: lines.placing(station) for station in log.cell.station},
        stated.arm_growth_um_m_k * 1e-6,
        stated.air_range_k,
        lines.model_samples(),
    )


@dataclass(frozen=True, eq=False)
class _Lines:
    log: Log

    def model_samples(self) -> int | None:
        """Number of different poses from which the model's residual was estimated, if any.

        Without the curves of axis sweeps the residual is mostly the gears', and repeats where a
        joint's angle repeats: a grid of 64 poses may show only 16 different errors of axis 1.
        """
        if (arm := carried_arm(self.log)) is not None:
            return round(arm.samples / AGED) + len(learnt_points(self.log))
        points = self.log.select("grid")
        fitted = self.log.verdict(Fitted)
        if not points or (fitted is not None and fitted.curves.used):
            return len(points) or None
        large_axes = [0, 1, 2]  # whose errors have levers of metres
        same_deg = 0.1  # of a joint's angle: less than half the shortest wave of a gear
        angles = np.round(np.degrees(commanded_rad(points))[:, large_axes] / same_deg)
        return min(len(np.unique(each)) for each in angles.T)

    def repeatability(self) -> Influence:
        """Scatter of visits in {B}, less the readings'."""
        if (carried := carried_calibration(self.log)) is not None:
            return carried_line(carried, REPEATABILITY)
        R = (inverse(self.log.matrix("base")) @ self.log.matrix("world"))[:3, :3]
        scatter_mm2, visits, places = visit_scatter(self.log, R)
        robot_mm2 = nearest_semidefinite(
            scatter_mm2 - _mean_reading_mm2(self.log.select("repeatability"), R)
        )
        freedom = trace_freedom(scatter_mm2, visits - places)
        return Influence(
            REPEATABILITY, MEASURED,
            f"{visits} visits of {places} places, less the readings' noise", "4.2.4", "base",
            motion(robot_mm2), freedom=freedom if math.isfinite(freedom) else None,
            in_model=True, per_visit=True,
        )  # fmt: skip

    def approach(self) -> Influence:
        """The larger of limit and measurement, of the whole distance between both directions."""
        if (carried := carried_calibration(self.log)) is not None:
            return carried_line(carried, APPROACH)
        limit_mm = self.log.cell.uncertainty.reversal_limit_mm
        verdict = self.log.once_measured(reversal)
        measured_mm, measured = 0.0, ""
        if verdict is not None:
            measured_mm = verdict.max_mm
            measured = f"; {verdict.points} vertices from above: {measured_mm:.3f} mm"
        how = f"programs approach from below on every axis, as the run did{measured}"
        if limit_mm:
            how = f"limit ±{limit_mm:g} mm, programs approach from any side{measured}"
            limit_mm = max(limit_mm, measured_mm)
        return _limit(APPROACH, how, limit_mm)

    def drift(self) -> Influence:
        """Motion of the floor nests in the run, less the readings' noise."""
        firsts = {point.id.nest: point for point in self.log.select("world")}
        pairs = [
            (now, firsts[now.id.nest])
            for now in self.log.select("control")
            if now.id.nest in firsts
        ]
        if not pairs:
            limit_mm = self.log.cell.uncertainty.drift_limit_mm
            how = f"limit ±{limit_mm:g} mm, the floor nests were measured once only"
            return Influence(
                "Drift", ASSUMED, how, "4.3.7", "world", motion(rectangular_variance(limit_mm))
            )
        both = [[pair[n] for pair in pairs] for n in (0, 1)]
        noise_mm2 = sum(float(variances_mm2(points).mean()) for points in both)
        moved_mm = rms(positions_mm(both[0]) - positions_mm(both[1]))
        how = f"{len(pairs)} measurements of the floor nests against the first, less the readings'"
        variance_mm2 = max(0.0, moved_mm**2 - noise_mm2)
        return Influence("Drift", MEASURED, how, "4.2.2", "world", motion(variance_mm2))

    def world(self) -> Influence:
        """{W} as defined by the floor nests: their noise and the reflector's centring."""
        log, how, freedom = self.log, "the floor nests were not all measured", math.inf
        framed = world_as_framed(log)
        if framed is not None:
            nests, at_mm = nest_noise(log), log.matrix("base")[:3, 3]
            how = f"{nests.how}, and the reflector's centring in each, carried to the target"
            centring_mm2 = rectangular_variance(log.cell.uncertainty.smr_centring_limit_mm)
            noise_mm2, whole_mm2 = (
                float(np.trace(world_covariance(log, at_mm, each_mm2)[:3, :3]))
                for each_mm2 in (0.0, centring_mm2)
            )
            traces_mm2 = [[noise_mm2], [whole_mm2 - noise_mm2]]
            freedom = float(effective_freedom(traces_mm2, [nests.freedom, math.inf])[0])
        return Influence(
            "World frame", f"{MEASURED}, and {ASSUMED}", how, "5.1.2", "world",
            moved_frame(np.zeros((6, 6)) if framed is None else framed),
            freedom=freedom if math.isfinite(freedom) else None,
            applies="in use",
        )  # fmt: skip

    def tracker(self) -> Influence:
        stated = self.log.cell.uncertainty
        x_mm, y_mm, z_mm = self.log.matrix("world")[:3, 3].tolist()
        turn = rectangular_variance(stated.tracker_limit_um_m * 1e-6)
        how = f"limit ±{stated.tracker_limit_mm:g} mm"
        if turn:
            how += f", across the beam ±{stated.tracker_limit_um_m:g} µm/m besides"
        return Influence(
            "Tracker, systematic", stated.tracker_source or ASSUMED, how, "4.3.7", "world",
            motion(rectangular_variance(stated.tracker_limit_mm), turn), (x_mm, y_mm, z_mm),
            applies="in use",
        )  # fmt: skip

    def drill(self) -> Influence:
        """The drill's offset times the orientation errors of nominal robot and {B}."""
        stated = self.log.cell.uncertainty
        x_mm, y_mm, z_mm = stated.drill_offset_mm
        base_rad2 = self.log.frames["base"].C[3:, 3:]
        turn = (stated.orientation_urad * 1e-6) ** 2 + float(np.trace(base_rad2)) / 3
        how = (
            f"{math.hypot(x_mm, y_mm, z_mm):g} mm from the reflector, orientation "
            f"{stated.orientation_urad:g} µrad and the base frame's own"
        )
        return Influence(
            DRILL, ASSUMED, how, "5.1.2", "tool", motion(0.0, turn), (-x_mm, -y_mm, -z_mm),
            applies="in use",
        )  # fmt: skip

    def placing(self, station: Station) -> list[Influence]:
        """Contributions of placing the slide at a station: its frame, and the strip's
        repeatability.
        """
        x_mm, y_mm, z_mm = Frames(self.log.cell, self.log).base_in_world(station)[:3, 3].tolist()
        carried = station.name != self.log.cell.grid.station
        how = "noise of the slide nests, carried to the target"
        frame = Influence(
            "Station frame", MEASURED, how if carried else "the grid was measured here", "5.2.2",
            "world", moved_frame(base_covariance(self.log, station)), (x_mm, y_mm, z_mm),
        )  # fmt: skip
        return [frame, self._strip()] if self.log.cell.has_rail else [frame]

    def _strip(self) -> Influence:
        along = np.array(self.log.cell.layout.rail_direction)
        again = self.log.select("repeat", how="strip", direction="random")
        if len(again) > 1:
            at_mm = apply(self.log.matrix("world"), positions_mm(again)) @ along
            held_mm2, freedom = float(at_mm.var(ddof=1)) * np.outer(along, along), len(again) - 1
            how, clause = f"two holds, each of the scatter of {len(again)} approaches", "4.2.2"
        else:
            held_mm2, freedom = hold_covariance(self.log.cell), None
            how = f"two holds, each proven within ±{self.log.cell.rail.hold_limit_mm:g} mm"
            clause = "4.3.7"
        return Influence(
            "Strip", MEASURED, f"{how}, along the rail", clause, "world",
            motion(2 * held_mm2), freedom=freedom,
        )  # fmt: skip


def _limit(name: str, how: str, limit_mm: float, source: str = ASSUMED) -> Influence:
    shift = motion(rectangular_variance(limit_mm))
    return Influence(name, source, how, "4.3.7", "base", shift, applies="in use")


def with_drill(
    stated: UncertaintyBudget,
    offset_mm: tuple[float, float, float],
    u_mm: float = 0.0,
    bounds_deg: Array | None = None,
) -> UncertaintyBudget:
    """Budget of a drill at ``offset_mm`` (1 sigma ``u_mm``) from the reflector in {T}. Bounds of
    corrected orientation ``bounds_deg`` (N,) replace the stated limit. Raises `NoBound`.
    """
    x_mm, y_mm, z_mm = offset_mm
    far = f"{math.hypot(*offset_mm):g} mm from the reflector"
    if DRILL not in [line.name for line in stated.lines]:
        raise NoBound(f"the calibration states no line {DRILL}; calibrate again")
    changed: dict[str, object] = {"origin_mm": (-x_mm, -y_mm, -z_mm)}
    changed["how"] = f"{far}, as the cell that was given states it"
    if bounds_deg is not None:
        turn_rad2 = math.radians(float(bounds_deg.max())) ** 2 / chi2_quantile(0.95, 3.0)
        changed["covariance"] = motion(0.0, turn_rad2)
        changed["how"] = f"{far}, orientation corrected within {bounds_deg.max():.4f} deg (95 %)"
    lines = [
        msgspec.structs.replace(line, **changed) if line.name == DRILL else line
        for line in stated.lines
    ]
    if u_mm:
        how = f"1 sigma {u_mm:g} mm against the reflector, as the cell file states it"
        own = motion(u_mm**2)
        lines.append(Influence("Tool's tip", ASSUMED, how, "4.3.7", "tool", own, applies="in use"))
    return msgspec.structs.replace(stated, lines=lines)


def touch_influence(log: Log, station: Station) -> Influence | None:
    """Contribution of placing the slide, as measured by touch poses on the last visit."""
    frame = log.frames.get(f"touch.{station.name}")
    if not isinstance(frame, TouchedBase):
        return None
    x_mm, y_mm, z_mm = log.matrix(f"touch.{station.name}")[:3, 3].tolist()
    covariance = moved_frame(frame.C)
    how = f"station frame, strip and {frame.poses} touch poses of the visit"
    return Influence(
        "Touched base", MEASURED, how, "5.2.2", "world", covariance, (x_mm, y_mm, z_mm),
        applies="in validation",
    )  # fmt: skip


def temperature(
    growth_per_k: float, range_c: tuple[float, float] | None, air_range_k: float,
    now_c: float | None = None,
) -> Influence:  # fmt: skip
    """The arm's growth from {B} at the temperatures of use. ``range_c`` is the grid's; if ``now_c``
    is known, its distance from the middle counts.
    """
    if range_c is None:
        half_k, how = air_range_k / 2, f"no weather station, ±{air_range_k / 2:g} K taken"
    elif now_c is not None:
        off_k = now_c - sum(range_c) / 2
        return _growth(growth_per_k, off_k**2, f"{off_k:+z.2f} K from the grid's mean", "4.3.7")
    else:
        half_k = (range_c[1] - range_c[0]) / 2 + TEMPERATURE_MARGIN_K
        how = f"±{half_k:.2f} K allowed: the grid's range and {TEMPERATURE_MARGIN_K:g} K more"
    return _growth(growth_per_k, rectangular_variance(half_k), how, "4.3.7")


def in_validation(log: Log, station: Station, points: Sequence[Point]) -> list[Influence]:
    """Additional contributions to measured errors of validation points: readings, growth. Touch
    poses include the arm's growth in the base, except for its change over the cube.
    """
    R = log.matrix("world")[:3, :3]
    readings = Influence(
        "Tracker, readings", MEASURED, f"scatter of the readings of {len(points)} points", "4.2.3",
        "world", motion(_mean_reading_mm2(points, R)), applies="in validation", per_visit=True,
    )  # fmt: skip
    grown = growth_since(log, learnt_points(log), points, "the grid's mean")
    frame = log.frames.get(f"touch.{station.name}")
    if not isinstance(frame, TouchedBase) or grown is None:
        return [readings] if grown is None else [readings, grown]
    x_mm, y_mm, z_mm = log.cell.grid.centre.matrix()[:3, 3].tolist()
    over_cube = msgspec.structs.replace(
        grown, name=f"{TEMPERATURE}, over the cube", origin_mm=(x_mm, y_mm, z_mm)
    )
    touches = [p for p in log.select("touch", station.name) if p.id.visit == frame.visit]
    later = growth_since(log, touches, points, "the touch poses' mean")
    return [readings, over_cube] if later is None else [readings, over_cube, later]


def growth_since(
    log: Log, before: Sequence[Point], points: Sequence[Point], name: str
) -> Influence | None:
    """The arm's growth at ``points`` since ``before``; None without a weather station."""
    then_c, now_c = (
        [p.temperature_c for p in group if p.temperature_c is not None]
        for group in (before, points)
    )
    if not (then_c and now_c):
        return None
    off_k = rms(np.array(now_c) - np.mean(then_c))
    growth_per_k = log.cell.uncertainty.arm_growth_um_m_k * 1e-6
    return _growth(growth_per_k, off_k**2, f"{off_k:.2f} K from {name}", "4.2.2")


def _growth(limit_per_k: float, variance_k2: float, how: str, clause: str) -> Influence:
    """Growth of an arm that follows the ambient temperature by any share from 0 to 1."""
    rate = f"0 .. {limit_per_k * 1e6:g} µm/(m·K)"
    return Influence(
        TEMPERATURE, f"{MEASURED}, and {ASSUMED}", f"{rate}, {how}", clause, "base",
        motion(growth=rectangular_variance(limit_per_k) * variance_k2),
    )  # fmt: skip


def _mean_reading_mm2(points: Sequence[Point], R: Array) -> Array:
    """Mean covariance (3, 3) of averaged readings, rotated by ``R`` (3, 3)."""
    return np.asarray(covariances_mm2(points, R).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Coverage:
    """Validated errors (N,) and their 95 % bounds (N,)."""

    errors_mm: Array
    bounds_mm: Array

    def __len__(self) -> int:
        return len(self.errors_mm)

    @property
    def inside(self) -> int:
        return int(np.count_nonzero(self.errors_mm <= self.bounds_mm))

    @property
    def share(self) -> float:
        return self.inside / len(self)

    @property
    def figures(self) -> TargetBounds:
        mean_mm, max_mm = float(self.bounds_mm.mean()), float(self.bounds_mm.max())
        return TargetBounds(coverage=self.share, mean_mm=mean_mm, max_mm=max_mm)


def target_bounds(
    calibration: Calibration, station: str, poses: Array, temperature_c: float | None = None
) -> Bounds:
    """Bounds of corrected targets at poses (N, 4, 4) in {W}; temperature None: any in range. Raises
    `NoBound` with the reason where the file states no budget, and `OutsideGrid`.
    """
    stated, lines = calibration.budget, lines_in_use(calibration, station)
    air = temperature(
        stated.growth_per_k, calibration.validity.temperature_c, stated.air_range_k, temperature_c
    )
    return _bounds(calibration, station, poses, [*lines, air])


def lines_in_use(calibration: Calibration, station: str) -> list[Influence]:
    """Lines of the budget in use, except for the temperature's."""
    stated = calibration.budget
    lines = (*stated.lines, *stated.stations[station])
    return [each for each in lines if each.applies != "in validation"]


def cube_bounds(calibration: Calibration, station: str) -> Bounds:
    grid = calibration.grid()
    shares = np.array([0.25, 0.75])  # along each axis of a grid's cell
    axes = [
        low_mm + grid.pitch_mm * np.add.outer(np.arange(count - 1), shares).ravel()
        for low_mm, count in zip(grid.origin_mm, grid.shape, strict=True)
    ]
    places_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = calibration.poses_at(places_mm)
    return target_bounds(calibration, station, calibration.base(station) @ poses)


def lines_in_validation(
    calibration: Calibration, log: Log, station: str, points: list[Point]
) -> list[Influence]:
    stated, stop = calibration.budget, log.cell.station_named(station)
    on_visit = touch_influence(log, stop)
    placed = stated.stations[station] if on_visit is None else [on_visit]
    lines = [each for each in (*stated.lines, *placed) if each.applies != "in use"]
    return [*lines, *in_validation(log, stop, points)]


def driven_poses(
    calibration: Calibration, log: Log, points: list[Point], places_mm: Array
) -> Array:
    """Target poses (N, 4, 4) in {B} at positions (N, 3), oriented as commanded."""
    if any(point.commanded_deg is None for point in points):
        return calibration.poses_at(places_mm)
    R = forward(log.cell.robot.arm(), commanded_rad(points))[:, :3, :3]
    return matrix(R, places_mm)


def _bounds(
    calibration: Calibration, station: str, poses: Array, lines: Sequence[Influence]
) -> Bounds:
    """Bounds at the drill where the lines have one, else at the reflector."""
    T_W_B = calibration.base(station)
    model_mm2 = calibration.error_model().predict(inverse(T_W_B) @ poses).covariance_mm2
    samples = calibration.budget.model_samples
    drills = [-np.array(line.origin_mm) for line in lines if line.name == DRILL]
    return combined_bounds(model_mm2, lines, T_W_B, poses, samples, drills[0] if drills else None)


@dataclass(frozen=True, eq=False)
class ValidatedTargets:
    """Corrected targets measured by a run's validation at a station; their bounds by a
    calibration.
    """

    calibration: Calibration
    log: Log
    station: str

    @cached_property
    def points(self) -> list[Point]:
        return targets(self.log, self.station, Sent.CHOSEN)

    @cached_property
    def errors(self) -> Errors:
        return position_errors(self.log, self.points)

    @cached_property
    def bounds(self) -> Bounds:
        """Raises `NoBound`."""
        T_W_B = self.calibration.base(self.station)
        in_base_mm = (self.errors.nominal_mm - T_W_B[:3, 3]) @ T_W_B[:3, :3]
        lines = lines_in_validation(self.calibration, self.log, self.station, self.points)
        poses = driven_poses(self.calibration, self.log, self.points, in_base_mm)
        return _bounds(self.calibration, self.station, T_W_B @ poses, lines)

    @property
    def coverage(self) -> Coverage | None:
        """None where no target was measured; raises `NoBound`."""
        return Coverage(self.errors.norms_mm, self.bounds.radii_mm) if self.points else None


def coverages(
    calibration: Calibration, log: Log, places: Mapping[str, Sequence[str]]
) -> dict[str, Coverage]:
    """Coverage by place, as far as measured; raises `NoBound`."""
    names = {name for stations in places.values() for name in stations}
    single = {name: ValidatedTargets(calibration, log, name).coverage for name in names}
    found = {}
    for place, stations in places.items():
        parts = [part for name in stations if (part := single[name]) is not None]
        if parts:
            found[place] = Coverage(
                np.concatenate([part.errors_mm for part in parts]),
                np.concatenate([part.bounds_mm for part in parts]),
            )
    return found
