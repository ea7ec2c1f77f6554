"""A pass over targets: errors as measured, and their residuals folded into the calibration.

Targets more than 5 standard deviations off their neighbours are left out and named. After a common
motion that the calibration does not predict (base, slide or mount), nothing is folded in.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import msgspec
import numpy as np

from hilcell.calibration.budget import target_bounds
from hilcell.calibration.decision_rule import decide_errors
from hilcell.calibration.file import Calibration, TargetPass, Targets
from hilcell.calibration.lookup import used_calibration
from hilcell.calibration.recheck import FEWEST, Judgement, RecheckErrors, Visits
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


def listed_targets(log: Log) -> tuple[list[str], Array] | None:
    """Names and values (N, 6) in {W} of the targets, once journalled."""
    for targets in log.happened(TargetsListed):
        values: Array = np.array(targets.values, dtype=float)
        return targets.names, values
    return None


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


@dataclass(frozen=True, eq=False)
class MeasuredTargets:
    """The targets that a run has measured so far."""

    log: Log

    @cached_property
    def points(self) -> list[Point]:
        names, _ = listed_targets(self.log) or ([], None)
        known = {point.id.target: point for point in self.log.select(KIND)}
        return [known[name] for name in names if name in known]

    @cached_property
    def calibration(self) -> Calibration:
        return used_calibration(self.log)

    @property
    def station(self) -> str:
        return self.points[0].station

    @cached_property
    def visits(self) -> Visits:
        return Visits.of(self.log, self.points, self.station)

    @cached_property
    def poses(self) -> Array:
        """Commanded poses (N, 4, 4) in {B}."""
        return forward(self.log.cell.robot.arm(), commanded_rad(self.points))

    def as_pass(self, run: str) -> TargetPass:
        residuals_mm = self.visits.actual_mm - self.poses[:, :3, 3] - self._predicted.error_mm
        return TargetPass(
            run,
            [point.id.target for point in self.points],
            [tuple(row) for row in zyx_from_pose(self.poses).tolist()],
            [tuple(row) for row in residuals_mm.tolist()],
            self.visits.own_mm2.tolist(),
            self.visits.common.tolist(),
        )

    @cached_property
    def gross(self) -> list[str]:
        """Targets that contradict their neighbours."""
        residuals = TargetResiduals.learn([self.as_pass("").measured()], self._stated_mm2)
        gross = 5.0  # standard deviations
        sigmas = zip(self.points, residuals.sigmas(), strict=True)
        return [point.id.target for point, size in sigmas if not size <= gross]

    def updated(self, run: str) -> Calibration:
        """The calibration with this pass of a ``run`` folded in."""
        this, earlier = self.as_pass(run).without(self.gross), self.calibration.targets
        passes = [*([] if earlier is None else earlier.passes), *([this] if this.names else [])]
        if not passes:
            return self.calibration
        measured = [each.measured() for each in passes]
        residuals = TargetResiduals.learn(measured, self._stated_mm2)
        targets = Targets(residuals.variance_mm2, passes)
        return msgspec.structs.replace(self.calibration, targets=targets)

    def verdict(self) -> Judged:
        return decide_errors(self.log, self.visits.error_mm)

    def common_motion(self) -> Judgement | None:
        """Judgement of a motion common to all targets; None where not significant.

        Fewer targets than in a re-check are not judged. Errors of the model are alike at
        neighbouring targets: many say no more than ten.
        """
        if len(self.points) < FEWEST:
            return None
        errors = RecheckErrors.of(self.log, self.points, self.station)
        apart = 10  # targets that count as independent, as in a re-check
        own_mm2 = errors.own_mm2 * max(1.0, len(self.points) / apart)
        judgement = replace(errors, own_mm2=own_mm2).judgement()
        return None if judgement.moved.holds else judgement

    def result(self) -> TargetsResult:
        _, values = listed_targets(self.log) or ([], np.zeros((0, 6)))
        after, sizes_mm = self.updated(""), lengths_mm(self.visits.error_mm)
        before_mm, after_mm = (
            float(target_bounds(each, self.station, poses_from_zyx(values)).radii_mm.mean())
            for each in (self.calibration, after)
        )
        left, moved = np.ones(1), self.common_motion()
        if after.targets is not None:
            left = after.targets.residuals().at(self.poses)[1]
        return TargetsResult(
            calibration=self.calibration.provenance.latest,
            station=self.station,
            points=len(self.points),
            as_found=figures_of(sizes_mm)._asdict(),
            in_tolerance=self.verdict().holds,
            as_predicted=moved is None,
            shift_mm=None if moved is None else moved.shift_mm,
            u_mm=None if moved is None else moved.u_mm,
            share=1.0 - float(left.mean()),
            bound_before_mm=before_mm,
            bound_after_mm=after_mm,
            left_out=self.gross,
            targets=[
                TargetError(point.id.target, float(size_mm))
                for point, size_mm in zip(self.points, sizes_mm, strict=True)
            ],
        )

    @cached_property
    def _predicted(self) -> Prediction:
        """Prediction of the learnt model at the poses; outside, that of the volume's face."""
        at = self.poses.copy()
        at[:, :3, 3] = self.calibration.grid().clamped(self.poses[:, :3, 3])
        return self.calibration.learnt_model().predict(at)

    @property
    def _stated_mm2(self) -> float:
        return float(np.trace(self._predicted.covariance_mm2, axis1=1, axis2=2).mean()) / 3
