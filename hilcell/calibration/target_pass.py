"""A pass over targets: errors as measured, and their residuals folded into the calibration.

Targets more than 5 standard deviations off their neighbours are left out and named. After a common
motion that the calibration does not predict (base, slide or mount), nothing is folded in.
"""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from hilcell.calibration.budget import target_bounds
from hilcell.calibration.decision_rule import decide_errors
from hilcell.calibration.file import Calibration, TargetPass, Targets
from hilcell.calibration.lookup import used, visited
from hilcell.calibration.recheck import FEWEST, Judgement, as_predicted, judged
from hilcell.compensation.model import Prediction
from hilcell.compensation.residual import TargetResiduals
from hilcell.geometry.frames import poses_from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import figures_of, lengths_mm
from hilcell.journal.log import Log, commanded_rad
from hilcell.model.events import TargetsListed
from hilcell.model.point import Point
from hilcell.model.verdicts import Judged
from hilcell.ports import Array

KIND = "targets"


def listed(log: Log) -> tuple[list[str], Array] | None:
    """Names and values (N, 6) in {W} of the targets, once journalled."""
    for targets in log.happened(TargetsListed):
        values: Array = np.array(targets.values, dtype=float)
        return targets.names, values
    return None


def target_points(log: Log) -> list[Point]:
    names, _ = listed(log) or ([], None)
    known = {point.id.target: point for point in log.select(KIND)}
    return [known[name] for name in names if name in known]


def gross_targets(log: Log) -> list[str]:
    points, (this, poses) = target_points(log), _pass(log)
    residuals = TargetResiduals.learn([this.measured()], _stated_mm2(used(log), poses))
    sigmas = residuals.sigmas()
    gross = 5.0
    return [p.id.target for p, size in zip(points, sigmas, strict=True) if not size <= gross]


def folded(log: Log, run: str) -> Calibration:
    calibration, (this, poses) = used(log), _pass(log, run)
    this = this.without(gross_targets(log))
    before = calibration.targets.passes if calibration.targets is not None else []
    passes = [*before, *([this] if this.names else [])]
    if not passes:
        return calibration
    measured = [each.measured() for each in passes]
    residuals = TargetResiduals.learn(measured, _stated_mm2(calibration, poses))
    return msgspec.structs.replace(calibration, targets=Targets(residuals.variance_mm2, passes))


class TargetError(msgspec.Struct, frozen=True):
    """Error of a target before its residual is folded in."""

    name: str
    error_mm: float


class TargetsResult(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Measured errors, the share folded in, and an unpredicted common motion."""

    calibration: str
    station: str
    points: int
    as_found: dict[str, float]
    in_tolerance: bool
    as_predicted: bool
    shift_mm: float | None = None
    u_mm: float | None = None
    share: float
    bound_before_mm: float
    bound_after_mm: float
    left_out: list[str]
    targets: list[TargetError]

    @property
    def text(self) -> str:
        begin = (
            f"With calibration {self.calibration}, {self.points} targets at {self.station} are "
            f"{self.as_found['mean']:.3f} mm off in the mean and {self.as_found['max']:.3f} mm at "
            "most. "
        )
        if not self.in_tolerance:
            return (
                f"{begin}That is out of tolerance: nothing is folded in; `hilcell run recheck` "
                "first."
            )
        if self.shift_mm is not None and self.u_mm is not None:
            return (
                f"{begin}They share a motion of {self.shift_mm:.3f} mm ± {2.0 * self.u_mm:.3f} mm "
                "(k = 2) that the calibration does not predict: base, slide or the reflector's "
                "mount has moved. Nothing is folded in; `hilcell run recheck` first."
            )
        left_out = f" Left out, they contradict all others: {', '.join(self.left_out[:5])}."
        return (
            f"{begin}{100 * self.share:.0f} % of what the model left of each is folded into this "
            "run's calibration, the rest is this visit's noise: compensate the programs with it. "
            f"Mean 95 % bound {self.bound_after_mm:.3f} mm, before {self.bound_before_mm:.3f} mm."
            f"{left_out if self.left_out else ''}"
        )


def targets_result(log: Log) -> TargetsResult:
    calibration, points = used(log), target_points(log)
    station, (_, values) = points[0].station, listed(log) or ([], np.zeros((0, 6)))
    after, sizes_mm = folded(log, ""), lengths_mm(_errors_mm(log))
    before_mm, after_mm = (
        float(target_bounds(each, station, poses_from_zyx(values)).radii_mm.mean())
        for each in (calibration, after)
    )
    left, moved = np.ones(1), moved_together(log)
    if after.targets is not None:
        left = after.targets.residuals().at(_pass(log)[1])[1]
    return TargetsResult(
        calibration=calibration.provenance.latest,
        station=station,
        points=len(points),
        as_found=figures_of(sizes_mm)._asdict(),
        in_tolerance=judged_pass(log).holds,
        as_predicted=moved is None,
        shift_mm=None if moved is None else moved.shift_mm,
        u_mm=None if moved is None else moved.u_mm,
        share=1.0 - float(left.mean()),
        bound_before_mm=before_mm,
        bound_after_mm=after_mm,
        left_out=gross_targets(log),
        targets=[
            TargetError(point.id.target, float(size_mm))
            for point, size_mm in zip(points, sizes_mm, strict=True)
        ],
    )


def judged_pass(log: Log) -> Judged:
    return decide_errors(log, _errors_mm(log))


def moved_together(log: Log) -> Judgement | None:
    """Judgement of a motion common to all targets; None where not significant.

    Fewer targets than in a re-check are not judged. Errors of the model are alike at neighbouring
    targets: many say no more than ten.
    """
    points = target_points(log)
    if len(points) < FEWEST:
        return None
    errors = as_predicted(log, points, points[0].station)
    apart = 10  # targets that count as independent, as in a re-check
    own_mm2 = errors.own_mm2 * max(1.0, len(points) / apart)
    judgement = judged(replace(errors, own_mm2=own_mm2))
    return None if judgement.moved.holds else judgement


def _errors_mm(log: Log) -> Array:
    points = target_points(log)
    visits = visited(log, points, points[0].station)
    return visits.actual_mm - visits.nominal_mm


def _pass(log: Log, run: str = "") -> tuple[TargetPass, Array]:
    """The pass, and its commanded poses (N, 4, 4) in {B}."""
    calibration, points = used(log), target_points(log)
    visits = visited(log, points, points[0].station)
    poses = forward(log.cell.robot.arm(), commanded_rad(points))
    model_mm = _predicted(calibration, poses).error_mm
    residuals_mm = visits.actual_mm - poses[:, :3, 3] - model_mm
    this = TargetPass(
        run,
        [point.id.target for point in points],
        [tuple(row) for row in zyx_from_pose(poses).tolist()],
        [tuple(row) for row in residuals_mm.tolist()],
        visits.own_mm2.tolist(),
        visits.common.tolist(),
    )
    return this, poses


def _predicted(calibration: Calibration, poses: Array) -> Prediction:
    """Prediction of the learnt model at poses; outside, that of the volume's face."""
    at = poses.copy()
    at[:, :3, 3] = calibration.grid().clamped(poses[:, :3, 3])
    return calibration.learnt_model().predict(at)


def _stated_mm2(calibration: Calibration, poses: Array) -> float:
    covariance_mm2 = _predicted(calibration, poses).covariance_mm2
    return float(np.trace(covariance_mm2, axis1=1, axis2=2).mean()) / 3
