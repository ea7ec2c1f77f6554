"""Changes since the calibration that a run would supersede, parameter by parameter.

Both have the same frames in {W}, independent of the tracker's set-up: the base at the grid's
station, and the slide at all stations. A reflector of another size, a prism with another offset, a
tilted axis of the tracker or a moved base shows there only, since it affects all readings of the
run alike; a slipping brake shows in the scatter of visits. An operator decides which calibration is
right.

Noise exceeds a limit in one of a thousand pairs of calibrations, all parameters together. Stated
limits (drift, tracker, seating, strip, growth) are added in quadrature.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.frames import (
    axis_6_height_mm,
    floor_points,
    has_own_place,
    hold_covariance,
    slide_covariance,
    world_covariance,
    world_motion,
)
from hilcell.calibration.measurement_budget import systematic_mm2
from hilcell.calibration.position_errors import pooled, visits_mm
from hilcell.geometry.frames import to_rotvec
from hilcell.geometry.statistics import f_quantile, lengths_mm, rectangular_variance, trace_freedom
from hilcell.journal.log import Log, positions_mm, variances_mm2
from hilcell.journal.previous_reference import FLOOR_NESTS
from hilcell.model.frame import MeasuredBase
from hilcell.model.plan import PreviousReference
from hilcell.model.verdicts import Cause, Parameter, Suspicion
from hilcell.ports import Array

RISK = 0.001
SPREAD = 1.5  # of the circles' variance: scatter along them is not of each point by itself
FITTED = 12  # parameters of the two circles: centre, axis and radius of each


def since_before(log: Log, *, with_base: bool = True) -> Suspicion | None:
    before = log.inputs.floor_before
    return None if before is None else changed_since(compared(log, with_base=with_base), before.run)


def changed_since(changes: list[Parameter], run: str) -> Suspicion | None:
    """The change farthest beyond its limit; None where all are within."""
    beyond = [each for each in changes if not each.holds]
    if not beyond:
        return None
    worst = max(beyond, key=lambda each: abs(each.now - each.then) / each.limit)
    return Suspicion(
        Cause.CHANGED_SINCE,
        worst.now - worst.then,
        f"{worst.unit} of {worst.name}",
        f"the calibration of run {run}: {worst.text}",
    )


def compared(log: Log, *, with_base: bool = True) -> list[Parameter]:
    """Parameters measured by both this run and that of the current calibration. ``with_base``: the
    base's too; displaced by a risen nest, it is no change of its own.
    """
    before = log.inputs.floor_before
    if before is None or len(floor_points(log)) < FLOOR_NESTS:
        return []
    pairs = [
        *([("base", before.base)] if with_base else []),
        *((f"station.{name}", frame) for name, frame in before.stations.items()),
    ]
    known = [
        (key, then)
        for key, then in pairs
        if then is not None and key in log.frames and has_own_place(log.cell, key)
    ]
    freedom = 2.0 * len(log.select("base")) - FITTED
    if not (known and freedom > 0.0):
        return []
    risk = RISK / (6 * len(known) + 1)
    factor = float(np.sqrt(f_quantile(1.0 - risk, 1, freedom)))
    tolerance_limits = _Limits(log)
    parameters = tolerance_limits.repeatability(
        [np.array(cloud) for cloud in before.visits_mm], risk
    )
    bounded = float(np.sqrt(3.0))  # of what is stated as a limit, which no change exceeds
    for key, then in known:
        both = log.frames[key].C + then.C
        noise = noise_covariance(log, key) + np.array(then.covariance)
        noise += (SPREAD - 1.0) * both if key == "base" else 0.0
        stated = (
            limit_covariance(log, key)
            + tolerance_limits.instrument(key)
            + tolerance_limits.growth(key, before)
        )
        limits = np.hypot(*np.sqrt([factor**2 * np.diag(noise), bounded**2 * np.diag(stated)]))
        parameters += _coordinates(key, np.array(then.matrix), log.matrix(key), limits)
    return parameters


@dataclass(frozen=True, eq=False)
class _Limits:
    """Limits within which frames of two runs agree."""

    log: Log

    def repeatability(self, then_mm: list[Array], risk: float) -> list[Parameter]:
        """Scatter of one visit, from clouds (N, 3) of both runs, if any. The noise in the former
        scatter is unknown: all of the present one may be additional.
        """
        now_mm = visits_mm(self.log)
        if not (now_mm and then_mm):
            return []
        estimates = [pooled(clouds, np.eye(3)) for clouds in (then_mm, now_mm)]
        then, now = (float(np.sqrt(np.trace(covariance_mm2))) for covariance_mm2, _, _ in estimates)
        of_then, of_now = (trace_freedom(C, visits - places) for C, visits, places in estimates)
        noise_mm2 = variances_mm2(self.log.select("repeatability")).sum(axis=1).mean()
        most_mm2 = SPREAD * f_quantile(1.0 - risk, of_now, of_then) * then**2 + noise_mm2
        return [Parameter("repeatability", "mm", then, now, float(np.sqrt(most_mm2)) - then)]

    def instrument(self, key: str) -> Array:
        """Covariance of a frame's change by the limits of tracker and seating, in both runs."""
        stated = self.log.cell.uncertainty
        points = self.log.select("base") if key == "base" else floor_points(self.log)
        limit_mm2 = float(systematic_mm2(stated, positions_mm(points)).mean())
        limit_mm2 += rectangular_variance(stated.smr_centring_limit_mm)
        if key != "base":
            return 2.0 * slide_covariance(self.log.cell, self.log.matrix(key), limit_mm2)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = 2.0 * limit_mm2 * np.eye(3)
        return covariance

    def growth(self, key: str, before: PreviousReference) -> Array:
        covariance, now_c = np.zeros((6, 6)), self.log.temperatures_c()
        then_c = before.temperature_c if before.frames_c is None else before.frames_c
        if then_c is None or not now_c:
            return covariance
        at_mm = float(np.linalg.norm(self.log.matrix(key)[:3, 3]))
        if key == "base":
            at_mm += axis_6_height_mm(self.log.cell)  # from which its height is known
        change_k = float(np.mean(now_c)) - then_c
        rate = rectangular_variance(self.log.cell.uncertainty.arm_growth_um_m_k * 1e-6)
        covariance[:3, :3] = rate * (change_k * at_mm) ** 2 * np.eye(3)
        return covariance


def _coordinates(key: str, then: Array, now: Array, limits: Array) -> Iterator[Parameter]:
    """Yield the coordinates of a frame; ``limits`` (6,) in mm and rad."""
    name = key.removeprefix("station.")
    for n, axis in enumerate("xyz"):
        values_mm = float(then[n, 3]), float(now[n, 3])
        yield Parameter(f"{name} {axis}", "mm", *values_mm, float(limits[n]))
    turned = np.degrees(frame_change(then, now)[3:])
    for n, axis in enumerate("xyz"):
        limit_deg = float(np.degrees(limits[3 + n]))
        yield Parameter(f"{name} turned about {axis}", "deg", 0.0, float(turned[n]), limit_deg)


def frame_change(then: Array, now: Array) -> Array:
    """Shift of a frame's origin (mm) and its rotation vector (rad), axes of {W}."""
    turn = to_rotvec(now[:3, :3] @ then[:3, :3].T)
    return np.concatenate([now[:3, 3] - then[:3, 3], turn.reshape(3)])


def noise_covariance(log: Log, key: str) -> Array:
    """Covariance (6, 6) of the change of a frame in {W} by noise, without the former frame's own.
    Both runs have the floor nests' noise, and the slide nests' where these define {S}.
    """
    T, own = log.matrix(key), log.frames[key].C
    covariance: Array = own + 2.0 * world_covariance(log, T[:3, 3])
    nests = log.select("slide", log.cell.grid.station)
    if key != "base" and nests:
        of_nest_mm2 = float(variances_mm2(nests).mean())
        covariance += 2.0 * slide_covariance(log.cell, T, of_nest_mm2, nests=3)
    return covariance


def limit_covariance(log: Log, key: str) -> Array:
    """Covariance (6, 6) of the change of a frame in {W} by stated limits, in both runs. Drift and
    error of the tracker at the floor nests, and the strip's tolerance.
    """
    stated, at_mm = log.cell.uncertainty, log.matrix(key)[:3, 3]
    far_mm = float(lengths_mm(positions_mm(floor_points(log))).max())
    limit_mm = stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * far_mm
    centring_mm2 = sum(map(rectangular_variance, (stated.drift_limit_mm, limit_mm)))
    covariance: Array = world_covariance(log, at_mm, centring_mm2) - world_covariance(log, at_mm)
    covariance[:3, :3] += hold_covariance(log.cell)
    return 2.0 * covariance


# Distances of three nests hardly change where one rises straight out of their plane, but {W} tilts
# about the other two, and the robot's base lies elsewhere in it. So {B} as this run measured it is
# compared with that of the calibration's run: each nest moves it along one direction of six. A nest
# is suspected where its height explains the difference better than chance does, and chance what is
# left: a base that was moved, or a robot with other zeros, is no risen nest.


def risen_nest(log: Log) -> Suspicion | None:
    """The nest that clearly rose or sank, if any; None without a base to compare."""
    before = log.inputs.floor_before
    if before is None or before.base is None or not before.alike:
        return None
    if not isinstance(log.frames.get("base"), MeasuredBase):
        return None
    now = log.matrix("base")
    covariance = noise_covariance(log, "base") + limit_covariance(log, "base")
    covariance += before.base.C
    d = frame_change(before.base.T, now)
    up = log.matrix("world")[:3, :3].T[:, 2]  # of {W}, in the tracker's frame
    columns = [world_motion(log, now[:3, 3], nest, up) for nest in range(FLOOR_NESTS)]
    heights_mm, sigmas_mm = np.array([_height(d, covariance, each) for each in columns]).T
    nest = int(np.argmax(np.abs(heights_mm / sigmas_mm)))
    explained = (heights_mm[nest] / sigmas_mm[nest]) ** 2
    left = float(d @ np.linalg.solve(covariance, d)) - explained
    freedom = 2.0 * len(log.select("base")) - FITTED
    if not explained > f_quantile(1.0 - RISK / FLOOR_NESTS, 1, freedom):
        return None
    if not left <= 5.0 * f_quantile(1.0 - RISK, 5, freedom):
        return None
    name = log.cell.layout.floor[nest].name
    noticed_by = f"base frame of run {before.run}"
    return Suspicion(Cause.NEST_MOVED, float(heights_mm[nest]), f"mm of {name}", noticed_by)


def _height(d: Array, covariance: Array, column: Array) -> tuple[float, float]:
    """Height by generalised least squares, and its standard uncertainty."""
    weighted = np.linalg.solve(covariance, column)
    information = float(weighted @ column)
    return float(weighted @ d) / information, 1.0 / np.sqrt(information)
