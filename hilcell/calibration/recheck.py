"""Whether a calibration is still valid, judged by a few corrected poses measured again.

The calibration predicts the covariance C of N errors e (3N values): of each pose (model, one visit,
reading), and of frames, which move all together. Generalised least squares splits ``e' C^-1 e``
into 6 degrees of freedom of a small motion of the base, and a rest of 3N - 6; both are chi^2 where
nothing has changed. A large rest requires a new calibration, a large motion an update of the base
frame. A slipped reflector is a shift in {T}, indistinguishable from one of the base without
reoriented poses. The motion is the mean of its posterior: noise of {W} alone moves no base.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from hilcell.calibration.budget import driven_poses
from hilcell.calibration.causes import axis_6_pattern, inverse_covariance, left_by, patterns
from hilcell.calibration.decision_rule import decide_errors
from hilcell.calibration.influence import nearest_semidefinite
from hilcell.calibration.lookup import used, visited
from hilcell.geometry.frames import cross_matrix, from_rotvec, matrix, motion_levers
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.statistics import bounds95_mm
from hilcell.journal.log import Log, commanded_rad
from hilcell.model.point import Point
from hilcell.model.suspicion import Cause, Suspicion
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import counted

KIND = "recheck"  # of the points, key of result and verdict
RISK = 0.01  # that a valid calibration is judged invalid
MOTION, SLIP = 6, 3  # degrees of freedom
FEWEST = 4  # poses: three leave the rest too few degrees of freedom to say anything

Verdict = Literal["valid", "update", "redo"]


@dataclass(frozen=True, eq=False)
class Rechecked:
    """Errors e = actual - target (N, 3) at targets (N, 3), both in {B}, with their covariance.

    ``own_mm2`` (N, 3, 3): of each error; ``common_mm2`` (3N, 3N): of frames, which move all poses
    together; ``orientations`` (N, 3, 3): of {T} in {B}.
    """

    targets_mm: Array
    errors_mm: Array
    own_mm2: Array
    common_mm2: Array
    orientations: Array

    @property
    def covariance_mm2(self) -> Array:
        """Covariance (3N, 3N) of all errors."""
        total = self.common_mm2.copy()
        for n, own in enumerate(self.own_mm2):
            total[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += own
        return total

    @property
    def each_mm2(self) -> Array:
        """Covariances (N, 3, 3) of the errors one by one."""
        count = len(self.own_mm2)
        blocks = self.covariance_mm2.reshape(count, 3, count, 3)
        return np.moveaxis(np.diagonal(blocks, axis1=0, axis2=2), -1, 0)

    def drift(self) -> tuple[float, float]:
        """Root of the errors' mean square beyond the predicted one, and its u.

        The mean square is a quadratic form of normal variables, of variance ``2 tr C^2 + 4 e' C e``
        over N^2. u is half the width of its image under the root, which stays finite at 0.
        """
        count, C, e = len(self.errors_mm), self.covariance_mm2, self.errors_mm.reshape(-1)
        excess_mm2 = max(0.0, float(e @ e - np.trace(C)) / count)
        shown = e * math.sqrt(count * excess_mm2 / float(e @ e)) if excess_mm2 else 0.0 * e
        spread_mm2 = math.sqrt(2 * float(np.square(C).sum()) + 4 * float(shown @ C @ shown)) / count
        drift_mm = math.sqrt(excess_mm2)
        return drift_mm, math.sqrt(excess_mm2 + spread_mm2) - drift_mm


class ChiSquare(msgspec.Struct, frozen=True):
    """A value, its degrees of freedom, and its limit at its share of the risk."""

    chi2: float
    freedom: int
    limit: float

    @property
    def holds(self) -> bool:
        return self.chi2 <= self.limit


@dataclass(frozen=True, eq=False)
class Judgement:
    """Both tests, the base's motion, and the residual.

    ``motion`` (6,): shift of {B}'s origin (mm) and rotation vector (rad) about it, axes of {B},
    with ``covariance`` (6, 6). ``shift_mm``: motion of the middle of the poses; ``drift_mm``:
    excess of the errors' root mean square over the prediction; u: standard uncertainties of these
    3D lengths. ``left_mm`` (N, 3): errors less the motion, ``sigmas`` (N,) in standard deviations
    of a coordinate. ``slipped``: test of the residual of a mount that slipped by ``slip_mm``,
    without a motion.
    """

    moved: ChiSquare
    rest: ChiSquare
    slipped: ChiSquare
    slip_mm: float
    motion: Array
    covariance: Array
    shift_mm: float
    u_mm: float
    turn_urad: float
    turn_u_urad: float
    drift_mm: float
    drift_u_mm: float
    left_mm: Array
    sigmas: Array

    @property
    def verdict(self) -> Verdict:
        if not self.rest.holds:
            return "redo"
        return "valid" if self.moved.holds else "update"

    @property
    def may_be_slip(self) -> bool:
        """Whether the poses do not distinguish the base's motion from a slipped mount."""
        return self.verdict == "update" and self.slipped.holds

    @property
    def worst(self) -> int:
        """The pose that the motion explains least."""
        return int(np.argmax(self.sigmas))

    @property
    def base(self) -> Array:
        """The present base (4, 4) in the {B} of the calibration."""
        return matrix(from_rotvec(self.motion[3:]), self.motion[:3])


def judged(measured: Rechecked) -> Judgement:
    """Judge the errors; raises `HilcellError` for too few, or not finite."""
    bumped_mm, bumped_rad = 1.0, 1e-3  # 1 sigma of a base that was moved, before any pose says so
    count = len(measured.errors_mm)
    if not count >= FEWEST:
        problem = f"re-check: {counted(count, 'pose')}, expected at least {FEWEST}"
        raise HilcellError(problem, code="HC-C21")
    if not np.isfinite(measured.errors_mm).all():
        raise HilcellError("re-check: an error is not finite; measure again", code="HC-C21")
    J = motion_columns(measured.targets_mm)
    C, e = measured.covariance_mm2, measured.errors_mm.reshape(-1)
    weighted = np.linalg.solve(C, np.column_stack([J, e]))
    information, pull = J.T @ weighted[:, :MOTION], J.T @ weighted[:, MOTION]
    explained = float(pull @ np.linalg.solve(information, pull))
    rest = float(e @ weighted[:, MOTION]) - explained
    prior = np.diag([bumped_mm**-2] * 3 + [bumped_rad**-2] * 3)
    covariance = np.asarray(np.linalg.inv(information + prior), dtype=float)
    motion = covariance @ pull
    left_mm = measured.errors_mm - (J @ motion).reshape(-1, 3)
    at_middle = np.hstack([np.eye(3), -cross_matrix(measured.targets_mm.mean(axis=0))])
    drift_mm, drift_u_mm = measured.drift()
    slipped, slip_mm = left_by(
        measured.errors_mm, inverse_covariance(C), measured.orientations.reshape(-1, SLIP)
    )
    return Judgement(
        _test(explained, MOTION),
        _test(rest, 3 * count - MOTION),
        _test(slipped, 3 * count - SLIP),
        slip_mm,
        motion,
        covariance,
        float(np.linalg.norm(at_middle @ motion)),
        math.sqrt(float(np.trace(at_middle @ covariance @ at_middle.T))),
        1e6 * float(np.linalg.norm(motion[3:])),
        1e6 * math.sqrt(float(np.trace(covariance[3:, 3:]))),
        drift_mm,
        drift_u_mm,
        left_mm,
        np.sqrt(np.einsum("ni,nij,nj->n", left_mm, np.linalg.inv(measured.own_mm2), left_mm) / 3),
    )


def suspicions(
    measured: Rechecked, judgement: Judgement, arm: Arm, joints_rad: Array
) -> list[Suspicion]:
    """Causes that explain the errors at joints (N, 6), the likeliest first.

    Each is removed together with a motion of the base. Where such a motion suffices, only a mount
    whose slip explains the errors as well is suspected.
    """
    noticed_by = "re-check"
    if judgement.may_be_slip:
        return [Suspicion(Cause.MOUNT_SLIPPED, judgement.slip_mm, "mm", noticed_by)]
    if judgement.rest.holds:
        return []
    likely: list[tuple[float, Suspicion]] = []
    moved, weights = (
        motion_columns(measured.targets_mm),
        inverse_covariance(measured.covariance_mm2),
    )
    causes = [*patterns(arm, joints_rad), *axis_6_pattern(arm, joints_rad)]
    for cause, columns, factor, unit in causes:
        chi2, size = left_by(measured.errors_mm, weights, columns, besides=moved)
        freedom = judgement.rest.freedom - columns.shape[1]
        if _test(chi2, freedom).holds:
            likely.append((chi2 / freedom, Suspicion(cause, factor * size, unit, noticed_by)))
    return [each for _, each in sorted(likely, key=lambda pair: pair[0])]


def motion_columns(targets_mm: Array) -> Array:
    """d(errors) / d(motion of the base), (3N, 6), at targets (N, 3) in {B}."""
    return motion_levers(targets_mm)[:, :, :MOTION].reshape(-1, MOTION)


def _test(chi2: float, freedom: int) -> ChiSquare:
    from scipy.special import chdtri

    tests = 2  # the motion and the rest share it
    return ChiSquare(chi2, freedom, float(chdtri(freedom, RISK / tests)))


# -- of a run --------------------------------------------------------------------------------------


def rechecked_run(log: Log) -> Judgement:
    """Judgement of a run that has measured its poses; raises `HilcellError`."""
    return judged(rechecked(log))


def rechecked(log: Log) -> Rechecked:
    return as_predicted(log, log.select(KIND), log.cell.grid.station)


def as_predicted(log: Log, points: list[Point], station: str) -> Rechecked:
    calibration, visits = used(log), visited(log, points, station)
    poses = driven_poses(calibration, log, points, visits.nominal_mm)
    model = calibration.error_model().predict(poses)
    J = motion_levers(visits.nominal_mm).reshape(-1, 7)
    return Rechecked(
        visits.nominal_mm,
        visits.actual_mm - visits.nominal_mm,
        nearest_semidefinite(model.covariance_mm2 - visits.within_mm2) + visits.own_mm2,
        J @ visits.common @ J.T,
        poses[:, :3, :3],
    )


class CheckedPose(msgspec.Struct, frozen=True):
    """A pose's error, its predicted bound (95 %), and its residual after the base's motion."""

    pose: str
    at_mm: list[float]
    error_mm: float
    bound_mm: float
    left_mm: float
    sigmas: float


class ChiSquares(msgspec.Struct, frozen=True):
    """The tests of a `Judgement`."""

    motion: ChiSquare
    rest: ChiSquare
    slip: ChiSquare


class RecheckResult(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict, figures, and text, with their names in JSON."""

    verdict: Verdict
    calibration: str
    station: str
    points: int
    drift_mm: float
    drift_u_mm: float
    shift_mm: float
    u_mm: float
    turn_urad: float
    turn_u_urad: float
    chi2: float
    tests: ChiSquares
    risk: float
    mean_mm: float
    max_mm: float
    mean_tolerance_mm: float
    max_tolerance_mm: float
    mean_U_mm: float
    max_U_mm: float
    in_tolerance: bool
    temperature_c: float | None
    calibrated_c: tuple[float, float] | None
    poses: list[CheckedPose]
    suspicions: list[Suspicion]
    text: str = ""

    @property
    def doubt(self) -> str:
        """Alternative explanation of an update, besides a moved base; "" for none."""
        if self.verdict != "update" or not self.suspicions:
            return ""
        return (
            f"a reflector that slipped by {self.suspicions[0].size:.3f} mm on its mount explains "
            "it as well; see that it sits; if it had slipped, seat it, revoke this run and re-check"
        )

    def verdict_text(self, worst: int) -> str:
        spread = 2.0 * self.u_mm
        match self.verdict:
            case "valid":
                begin = (
                    f"Still valid: the errors are as calibration {self.calibration} predicts; "
                    f"drift {self.drift_mm:.3f} mm, uncertainty {self.drift_u_mm:.3f} mm."
                )
            case "update":
                begin = (
                    f"Update: the robot's base has moved by {self.shift_mm:.3f} mm ± "
                    f"{spread:.3f} mm (k = 2) at the volume's middle and turned by "
                    f"{self.turn_urad:.0f} µrad, {self._instead(self.suspicions)} This run's "
                    "calibration has the base where it seems to stand now: take its base frames "
                    "over on the controller and compensate the programs again."
                )
            case _:
                begin = self._redo(worst)
        kept = "within" if self.in_tolerance else "out of"
        return (
            f"{begin} As found, {self.points} corrected poses are {self.mean_mm:.3f} mm off "
            f"in the mean and {self.max_mm:.3f} mm at most, {kept} tolerance "
            f"({self.mean_tolerance_mm:g} and {self.max_tolerance_mm:g} mm; U "
            f"{self.mean_U_mm:.3f} and {self.max_U_mm:.3f} mm added)."
        )

    def _redo(self, worst: int) -> str:
        if self.tests.rest.holds:
            return "Calibrate again: the errors are as predicted, but out of tolerance."
        pose, causes = self.poses[worst], self.suspicions
        hint = "Look for a lost zero of an axis, a loose tool or reflector, another temperature."
        if causes:
            hint = f"It would be explained by: {'; or '.join(each.label for each in causes[:3])}."
            if causes[0].cause is Cause.MOUNT_SLIPPED:
                hint += (
                    " Seat the reflector again, take this re-check back with `hilcell revoke`, and "
                    "re-check."
                )
        at = ", ".join(f"{value:.0f}" for value in pose.at_mm)
        return (
            f"Calibrate again: no motion of the base explains the errors; worst is {pose.pose} at "
            f"({at}) mm: {pose.error_mm:.3f} mm, predicted {pose.bound_mm:.3f} mm (95 %), and "
            f"{pose.left_mm:.3f} mm after the best motion. {hint}"
        )

    @staticmethod
    def _instead(causes: list[Suspicion]) -> str:
        if causes:
            return (
                f"or the reflector has slipped on its mount by {causes[0].size:.3f} mm, or an "
                "axis's zero is lost: the poses do not tell them apart. See first that the "
                "reflector sits on its mount and that the mastering is right."
            )
        return (
            "or an axis's zero is lost; a reflector that slipped on its mount does not explain it. "
            "See first that the mastering is right."
        )


def recheck_result(log: Log) -> RecheckResult:
    """Result of a run that has measured its poses; raises `HilcellError`."""
    measured, judgement = rechecked(log), rechecked_run(log)
    calibration, as_found = used(log), decide_errors(log, measured.errors_mm)
    verdict = judgement.verdict
    left_mm = judgement.left_mm if verdict == "update" else measured.errors_mm
    if not decide_errors(log, left_mm).holds:
        verdict = "redo"  # no update brings the errors into tolerance
    air_c, points, bounds_mm = (
        log.temperatures_c(),
        log.select(KIND),
        bounds95_mm(measured.each_mm2),
    )
    result = RecheckResult(
        verdict=verdict,
        calibration=calibration.provenance.latest,
        station=log.cell.grid.station,
        points=len(measured.errors_mm),
        drift_mm=judgement.drift_mm,
        drift_u_mm=judgement.drift_u_mm,
        shift_mm=judgement.shift_mm,
        u_mm=judgement.u_mm,
        turn_urad=judgement.turn_urad,
        turn_u_urad=judgement.turn_u_urad,
        chi2=judgement.moved.chi2 + judgement.rest.chi2,
        tests=ChiSquares(judgement.moved, judgement.rest, judgement.slipped),
        risk=RISK,
        mean_mm=as_found.mean_mm,
        max_mm=as_found.max_mm,
        mean_tolerance_mm=as_found.mean_tolerance_mm,
        max_tolerance_mm=as_found.max_tolerance_mm,
        mean_U_mm=as_found.mean_U_mm,
        max_U_mm=as_found.max_U_mm,
        in_tolerance=as_found.holds,
        temperature_c=float(np.mean(air_c)) if air_c else None,
        calibrated_c=calibration.validity.temperature_c,
        poses=[
            CheckedPose(
                point.key,
                measured.targets_mm[n].tolist(),
                float(np.linalg.norm(measured.errors_mm[n])),
                float(bounds_mm[n]),
                float(np.linalg.norm(judgement.left_mm[n])),
                float(judgement.sigmas[n]),
            )
            for n, point in enumerate(points)
        ],
        suspicions=suspicions(measured, judgement, log.cell.robot.arm(), commanded_rad(points)),
    )
    return msgspec.structs.replace(result, text=result.verdict_text(judgement.worst))
