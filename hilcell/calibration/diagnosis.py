"""Causes of wrong figures that a run's own comparisons let suspect: re-visits, the mount, targets.

A robot that repeats worse than it should (a brake that slips a little at each stop) moves no mean
and loses no zero. So the deviations e of the corrected targets from their mean at each station are
compared with their covariance C: by the mean of ``e' C^-1 e / 3``, and along the column a of each
large axis by that of ``(a' C^-1 e)^2 / a' C^-1 a``. Both are 1 where the validation's budget is
true, and are judged as F. If it slips from the first point on, the visits have it, too: they are
compared with the stated RP.
"""

from __future__ import annotations

import dataclasses
from itertools import chain, permutations
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.budget import growth_since, validated, validated_bounds, validation_points
from hilcell.calibration.causes import (
    LARGE_AXES,
    RISK,
    SPREAD,
    Change,
    Differences,
    changed,
    likeliest,
    zero_columns,
)
from hilcell.calibration.changes import risen_nest, since_before
from hilcell.calibration.drift import robot_drift, tracker_drift
from hilcell.calibration.file import learnt_so_far
from hilcell.calibration.frames import (
    axis_6_height_mm,
    axis_circle,
    hold_covariance,
    world_covariance,
)
from hilcell.calibration.influence import SIZE, NoBound, motion
from hilcell.calibration.instrument import axis_off, scale
from hilcell.calibration.lost_motion import lost_too_much
from hilcell.calibration.measurement_budget import systematic_mm2
from hilcell.calibration.position_errors import (
    block_diagonal,
    position_errors,
    visit_noise,
    visit_scatter,
)
from hilcell.geometry.circles import base_frame_covariance, reading_covariance
from hilcell.geometry.frames import apply, from_rotvec, inverse, matrix, motion_levers
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import (
    bounds95_mm,
    chance_of_at_most,
    chi2_quantile,
    effective_freedom,
    f_quantile,
    rectangular_variance,
    rms,
    trace_freedom,
)
from hilcell.journal.log import (
    PROOFS,
    Log,
    commanded_rad,
    covariances_mm2,
    of_measured,
    positions_mm,
    repeated_visits,
    variances_mm2,
)
from hilcell.model.frame import MeasuredBase
from hilcell.model.point import CHECKS, CONTROL, Point
from hilcell.model.suspicion import Cause, Suspicion
from hilcell.model.verdicts import Fitted, Revisited
from hilcell.ports import Array

# -- the room --------------------------------------------------------------------------------------

NOTICED_BY = "weather station"


def reference_c(log: Log) -> float | None:
    """Return the temperature at the grid's first point, before there is one at the run's first."""
    points = chain(log.measured("grid"), log.points.values())
    return next((p.temperature_c for p in points if p.temperature_c is not None), None)


def warm(log: Log) -> Suspicion | None:
    """Return the room's change, where points that count were measured beyond its limit."""
    then_c = reference_c(log)
    if then_c is None:
        return None
    counted = (p for p in log.points.values() if p.id.group != CONTROL)
    off_k = [p.temperature_c - then_c for p in counted if p.temperature_c is not None]
    worst_k = max(off_k, key=abs, default=0.0)
    if abs(worst_k) <= log.cell.room.range_k:
        return None
    return Suspicion(Cause.TEMPERATURE, worst_k, "K", NOTICED_BY)


# -- the robot's base where it was measured, against where the cell file has it --------------------

# Floor nests are known to each other: reflectors of another size in all of them leave their
# distances as they are, and lift {W} with all that is measured in it. The base stands where it
# stood, so it comes out lower or higher by the difference of the radii.


def misplaced_base(log: Log) -> Suspicion | None:
    """Return a base that is not where the cell file says, with the cause that fits."""
    cell = log.cell
    if not isinstance(log.frames.get("base"), MeasuredBase):
        return None
    station = cell.reference
    stated_mm = cell.layout.nominal_base(station.rail_mm)[:3, 3]
    off_mm = log.matrix("base")[:3, 3] - stated_mm
    size_mm = float(np.linalg.norm(off_mm))
    if size_mm <= cell.layout.base_tolerance_mm:
        return None
    bases_place = "the base's place in the cell file"
    if balls := _balls(off_mm):
        return Suspicion(
            Cause.REFLECTOR, float(off_mm[2]), f"mm along z of {{W}}, as of {balls}", bases_place
        )
    return Suspicion(Cause.BASE_MISPLACED, size_mm, "mm", bases_place)


def _balls(off_mm: Array) -> str:
    """Return which reflectors in all floor nests leave a base (3,) off so; "" for none."""
    inch_mm = 25.4
    balls_in = (0.5, 0.875, 1.5)  # diameters of reflectors as sold
    same_mm = 3.0  # by which a base that is bolted as usual may be elsewhere
    for seated, expected in permutations(balls_in, 2):
        higher_mm = (expected - seated) * inch_mm / 2.0
        if float(np.linalg.norm(off_mm - [0.0, 0.0, higher_mm])) <= same_mm:
            return f"{seated:g} in reflectors in floor nests for {expected:g} in"
    return ""


# -- the mount -------------------------------------------------------------------------------------

# Both are compared with what links, zeros and a mount measured by hand explain, and with what the
# instrument itself does: a turn of {B} about z, that axis 6's small circle leaves open, looks
# like a reflector that sits sideways.

CIRCLE, CONSTANT = "circle of axis 6", "constant error in the tool's frame"


def mount_offset(log: Log) -> Suspicion | None:
    """Return a reflector that is not where the cell file says, if it is clearly not."""
    frame, arm = log.frames.get("base"), log.cell.robot.arm()
    of_base, radius_mm2 = np.zeros((6, 6)), 0.0
    sigmas = 3.0
    most_radius_mm = 2.0  # 3 sigma: a mount to +-1 mm as measured by hand, an arm's links to 0.4 mm
    if isinstance(frame, MeasuredBase):
        of_base, radius_mm2 = _by_circles(log)
        turn = from_rotvec(np.array([arm.alpha_rad[5], 0.0, 0.0]))
        last = matrix(turn, np.array([arm.a_mm[5], 0.0, 0.0])) @ arm.tool
        off_mm = abs(frame.radius_mm[1] - float(np.hypot(last[0, 3], last[1, 3])))
        if not off_mm <= np.hypot(most_radius_mm, sigmas * np.sqrt(radius_mm2)):
            return Suspicion(Cause.MOUNT_OFFSET, off_mm, "mm", CIRCLE)
    points = log.select("grid")
    if not points:
        return None
    R = log.matrix("base")[:3, :3] @ forward(arm, commanded_rad(points))[:, :3, :3]
    errors = position_errors(log, points)
    off = np.einsum("nji,nj->ni", R, errors.error_mm).mean(axis=0)
    levers = motion_levers(errors.nominal_mm - log.matrix("base")[:3, 3])[:, :, :6]
    J = (np.swapaxes(R, 1, 2) @ levers).mean(axis=0)
    systematic = systematic_mm2(log.cell.uncertainty, positions_mm(points)).mean()
    most_constant_mm = 3.0  # 3 sigma of the uncorrected error, that links and zeros explain
    mount_mm2 = (most_constant_mm / sigmas) ** 2
    covariance = (mount_mm2 + systematic) * np.eye(3) + J @ of_base @ J.T
    if off @ np.linalg.solve(covariance, off) <= sigmas**2:
        return None
    return Suspicion(Cause.MOUNT_OFFSET, float(np.linalg.norm(off)), "mm", CONSTANT)


def _by_circles(log: Log) -> tuple[Array, float]:
    """Return the covariances that both circles' readings give {B} (6, 6) and axis 6's radius."""
    circles, covariances = [], []
    for axis in (1, 6):
        points = log.select("base", axis=axis)
        circle = axis_circle(log.cell, log, axis, points)
        at_mm = apply(log.matrix("world"), positions_mm(points))
        limits = systematic_mm2(log.cell.uncertainty, positions_mm(points))
        noise = covariances_mm2(points, log.matrix("world")[:3, :3])
        covariances.append(
            reading_covariance(circle, at_mm, (noise + limits[:, None, None] * np.eye(3)))
        )
        circles.append(dataclasses.replace(circle, covariance=covariances[-1][:6, :6]))
    axis_1, axis_6 = circles
    of_base = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(log.cell))
    return of_base, float(covariances[-1][6, 6])


# -- poses that were visited again, and corrected targets ------------------------------------------

REVISIT, CLOSING = "revisit", "closing"  # kinds of points: after the grid, and in the end
VERDICTS = {REVISIT: "revisits", CLOSING: "revisits.closing"}  # their keys in the journal


def established(log: Log, kind: str) -> Suspicion | None:
    """Return what re-visits have shown before: the points in between are of a changed robot."""
    kept = log.verdict(Revisited, VERDICTS[kind])
    return None if kept is None else kept.suspicion


def revisited(log: Log, kind: str) -> list[Point]:
    """Return the points of poses that were visited again, in the order of the first readings.

    One whose first reading was replaced by a later one says nothing until it is visited once more.
    """
    points = [point for point in log.select(kind) if _first(log, point) < log.recorded(point)]
    return sorted(points, key=lambda point: _first(log, point))


def overtaken(log: Log, point: Point) -> bool:
    """Whether something was measured after a pose was visited again that the visit is to prove.

    At the end that is all but proofs, after the grid the pose's first reading.
    """
    if point.id.kind != CLOSING:
        return _first(log, point) > log.recorded(point)
    return log.last_recorded(besides=(CLOSING, *PROOFS, *CHECKS)) > log.recorded(point)


def _first(log: Log, point: Point) -> int:
    return log.recorded(_before(log, point))


def _before(log: Log, point: Point) -> Point:
    return log.point(replace(point.id, kind="base" if point.id.axis else "grid"))


@of_measured
def revisits(log: Log, kind: str) -> Change:
    """Return whether the poses that were visited again are where they were."""
    names = {REVISIT: "re-visited poses", CLOSING: "vertices re-visited at the end"}
    return changed(_differences(log, kind), log.cell.robot.arm(), names[kind])


def _differences(log: Log, kind: str) -> Differences:
    now = revisited(log, kind)
    before = [_before(log, point) for point in now]
    T_B_W = inverse(log.matrix("base"))
    T_B_L = T_B_W @ log.matrix("world")
    at_mm = apply(T_B_L, positions_mm(now))
    _, visits, places = visit_scatter(log, T_B_L[:3, :3])
    noise = visit_noise(log)
    visits_mm2 = [noise.covariances(points, T_B_L[:3, :3]) for points in (before, now)]
    common = np.array(motion(rectangular_variance(log.cell.uncertainty.drift_limit_mm)))
    grown = growth_since(log, before, now, "the first visits")
    if grown is not None:
        common += grown.covariance
    R = T_B_W[:3, :3]
    if kind == CLOSING:  # the slide has left the station, and come back
        common += np.array(motion(R @ hold_covariance(log.cell) @ R.T))
    J = motion_levers(at_mm).reshape(-1, SIZE)
    covariance_mm2 = block_diagonal(np.sum(visits_mm2, axis=0)) + J @ common @ J.T
    elsewhere = np.repeat([p.set_up != q.set_up for p, q in zip(before, now, strict=True)], 3)
    if elsewhere.any():
        framed = J * elsewhere[:, None]
        covariance_mm2 += framed @ _framed_again(log, R) @ framed.T
    return Differences(
        at_mm - apply(T_B_L, positions_mm(before)),
        covariance_mm2,
        commanded_rad(now),
        3.0 * (visits - places),
        R @ np.array(log.cell.layout.rail_direction),
        [len(now)] if kind == CLOSING else _moments(before),
    )


def _moments(before: list[Point]) -> list[int]:
    """Return of how many of the first visits a change is judged to have come after.

    A few spread over the grid, the first right after the base frame: each more is one more chance
    of a false alarm, and finds hardly what its neighbours do not.
    """
    of_base = sum(point.id.kind == "base" for point in before)
    moments = 5  # of the grid at which a change may have come
    return [*np.unique(np.linspace(max(of_base, 1), len(before), moments).astype(int)).tolist()]


def _framed_again(log: Log, R: Array) -> Array:
    """Return the covariance (7, 7) in {B} of one set-up's {W} as seen from another's, ``R`` (3, 3)
    turning from {W}: both rest on readings of the floor nests, of a tracker that drifts.
    """
    drift_mm2 = rectangular_variance(log.cell.uncertainty.drift_limit_mm)
    turn = np.kron(np.eye(2), R)
    found = np.zeros((SIZE, SIZE))
    at_mm = log.matrix("base")[:3, 3]
    found[:6, :6] = 2.0 * turn @ world_covariance(log, at_mm, drift_mm2) @ turn.T
    return found


def _of_targets(log: Log, fit: int) -> list[Suspicion]:
    calibration = learnt_so_far(log)
    if calibration is None:
        return []
    fitted = log.verdict(Fitted)
    curves = fitted is not None and fitted.curves.used
    least_inside = 0.82  # of corrected targets, within bounds that 95 % should keep
    least_without_curves = 0.6  # where the gears' ripple is not known: 0.73 was seen
    least = least_inside if curves else least_without_curves
    found = []
    validation = "validation"
    for name in (station.name for station in log.cell.station):
        try:
            coverage = validated(calibration, log, name)
        except NoBound:  # the report says why
            return []
        if coverage is None:
            continue
        # Of few targets some lie outside by chance: the same risk as of the re-visits.
        if chance_of_at_most(coverage.inside, len(coverage), least) > RISK:
            continue
        points = validation_points(log, name)
        R = calibration.base(name)[:3, :3]
        sigmas_mm = np.repeat(coverage.bounds_mm / bounds95_mm(np.eye(3)[None])[0], 3)
        differences = Differences(
            position_errors(log, points).error_mm @ R,
            np.diag(np.square(sigmas_mm)),
            commanded_rad(points),
            float(len(points)),
            R.T @ np.array(log.cell.layout.rail_direction),
            [len(points)],
        )
        place = f"{validation} at {name}: {coverage.share:.0%} within their bounds"
        found.append(likeliest(differences, log.cell.robot.arm(), place))
    return found


# -- scatter, and all comparisons together ---------------------------------------------------------


class Deviations(NamedTuple):
    """Deviations (N, 3) of targets from the mean of their station, in {W}, covariances (N, 3, 3),
    columns (N, 3, K) of axes in mm / rad, and the covariances' degrees of freedom.
    """

    off_mm: Array
    covariance_mm2: Array
    columns: Array
    freedom: float


def scattered(log: Log) -> Suspicion | None:
    """Return a repeatability worse than the run's own, where the corrected targets show it."""
    found = log.once_measured(target_deviations)
    return None if found is None else worst_scatter(found)


def worse_than_stated(log: Log) -> Suspicion | None:
    """Return a repeatability worse than the stated one, where repeated visits show it.

    The least ratio of RP to the rms distance is taken, and the readings' noise comes on top.
    """
    stated_mm, visits = log.cell.robot.rp_mm, repeated_visits(log)
    if stated_mm is None or not visits:
        return None
    covariance_mm2, count, places = visit_scatter(log, np.eye(3))
    noise_mm2 = float(variances_mm2([*chain(*visits)]).sum(axis=1).mean())
    freedom = trace_freedom(covariance_mm2, count - places)
    most = SPREAD * chi2_quantile(1.0 - RISK, freedom) / freedom
    seen_mm2 = float(np.trace(covariance_mm2))
    # RP = l + 3 S_l over rms distance, scatter alike in all directions; more else
    isotropic = 2.088
    if seen_mm2 <= most * ((stated_mm / isotropic) ** 2 + noise_mm2):
        return None
    size_mm = isotropic * float(np.sqrt(seen_mm2 - noise_mm2))
    noticed_by = f"repeated visits, RP {stated_mm:g} mm stated"
    return Suspicion(Cause.REPEATABILITY, size_mm, "mm", noticed_by)


def target_deviations(log: Log) -> Deviations | None:
    """Return the corrected targets' deviations; None where none or no bound is known."""
    calibration = learnt_so_far(log)
    if calibration is None:
        return None
    parts, arm = [], log.cell.robot.arm()
    for name in (station.name for station in log.cell.station):
        try:
            found = validated_bounds(calibration, log, name)
        except NoBound:  # the report says why
            return None
        if found is None or len(found[0]) < 2:
            continue
        errors, bounds = found
        R = calibration.base(name)[:3, :3]
        joints_rad = commanded_rad(validation_points(log, name))
        J = zero_columns(arm, joints_rad)
        covariance_mm2 = bounds.covariance_mm2
        traces = [np.trace(each.covariance_mm2, axis1=1, axis2=2) for each in bounds.parts]
        freedom = effective_freedom(traces, [each.freedom for each in bounds.parts])
        off_mm = errors.error_mm - errors.error_mm.mean(axis=0)
        parts.append(Deviations(off_mm, covariance_mm2, R @ J[:, :, :LARGE_AXES], freedom.min()))
    if not parts:
        return None
    offs_mm, covariances_mm2, columns, freedoms = zip(*parts, strict=True)
    return Deviations(
        np.concatenate(offs_mm), np.concatenate(covariances_mm2), np.concatenate(columns),
        float(min(freedoms)),
    )  # fmt: skip


def worst_scatter(found: Deviations) -> Suspicion | None:
    """Return what the test farthest beyond its limit shows; None where chance explains all."""
    off_mm, columns = found.off_mm, found.columns
    weighted = np.linalg.solve(found.covariance_mm2, np.dstack([off_mm, columns]))
    count, axes = len(off_mm), columns.shape[2]
    limit = SPREAD * f_quantile(1.0 - RISK, 3 * count, found.freedom)
    ratio = float(np.einsum("ni,ni->", off_mm, weighted[:, :, 0])) / (3 * count)
    tests = [(ratio, limit, rms(np.linalg.norm(off_mm, axis=1)), "mm")]
    along = np.einsum("nik,ni->nk", columns, weighted[:, :, 0])
    information = np.einsum("nik,nik->nk", columns, weighted[:, :, 1:])
    directions = 3  # of a covariance: one of them has a third of its degrees of freedom
    limit = SPREAD * f_quantile(1.0 - RISK / axes, count, found.freedom / directions)
    for axis in range(axes):
        known = information[:, axis] > 0.0
        ratio = float(np.mean(along[known, axis] ** 2 / information[known, axis]))
        excess_rad = np.sqrt(max(0.0, ratio - 1.0) / information[known, axis].mean())
        tests.append((ratio, limit, float(np.degrees(excess_rad)), f"deg of axis {axis + 1}"))
    ratio, limit, size, unit = max(tests, key=lambda test: test[0] / test[1])
    if ratio <= limit:
        return None
    return Suspicion(Cause.REPEATABILITY, size, unit, "scatter of the corrected targets")


def _again(log: Log, kind: str) -> Suspicion | None:
    if not revisited(log, kind):
        return None
    return established(log, kind) or revisits(log, kind).suspicion


def _targets(log: Log) -> list[Suspicion]:
    fit = log.judged.get("fit")
    return [] if fit is None else log.once_measured(_of_targets, fit.seq)


def suspected_causes(log: Log) -> list[Suspicion]:
    """Return what a run's journal lets suspect; nothing where all is as predicted.

    A correction that was learnt from a robot which changed names no cause of its own. Slow and
    small changes show where nothing larger has changed, or nothing that has a name.
    """
    nest = risen_nest(log)
    alone = [
        scale(log),
        axis_off(log),
        warm(log),
        misplaced_base(log),
        nest,
        since_before(log, with_base=nest is None),
        worse_than_stated(log),
    ]
    changed = _again(log, REVISIT) or _again(log, CLOSING)
    large = [
        log.once_measured(mount_offset),
        lost_too_much(log),
        *([changed] if changed else _targets(log)),
    ]
    slow = None
    if all(each is None or each.cause is Cause.UNKNOWN for each in large):
        slow = tracker_drift(log) or scattered(log) or robot_drift(log)
    return [each for each in (*alone, *large, slow) if each is not None]
