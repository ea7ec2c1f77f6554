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
from typing import Literal, Self

import msgspec
import numpy as np

from hilcell.calibration.budget import driven_poses, temperature
from hilcell.calibration.causes import axis_6_pattern, inverse_covariance, left_by, patterns
from hilcell.calibration.decision_rule import decide_errors
from hilcell.calibration.file import Calibration
from hilcell.calibration.influence import nearest_semidefinite
from hilcell.calibration.lookup import used_calibration
from hilcell.geometry.frames import apply, cross_matrix, from_rotvec, inverse, matrix, motion_levers
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.statistics import bounds95_mm
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm
from hilcell.model.point import Point
from hilcell.model.verdicts import Cause, Suspicion
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import counted

KIND = "recheck"  # of the points, key of result and verdict
RISK = 0.01  # that a valid calibration is judged invalid
MOTION, SLIP = 6, 3  # degrees of freedom
FEWEST = 4  # poses: three leave the rest too few degrees of freedom to say anything

Verdict = Literal["valid", "update", "redo"]


class ChiSquare(msgspec.Struct, frozen=True):
    """A value, its degrees of freedom, and its limit at its share of the risk."""

    chi2: float
    freedom: int
    limit: float

    @classmethod
    def of(cls, chi2: float, freedom: int) -> Self:
        from scipy.special import chdtri

        tests = 2  # the motion and the rest share it
        return cls(chi2, freedom, float(chdtri(freedom, RISK / tests)))

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


# -- of a run --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Visits:
    """Nominal and measured positions (N, 3) in {B} of a run that uses a calibration, covariances.

    (N, 3, 3) of visit and reading, and (7, 7) of the frames, which move all points together: shift
    (mm), rotation vector (rad), growth about the origin of {B}. ``in_model_mm2`` (3, 3): the part
    of a visit that the model's covariance contains.
    """

    nominal_mm: Array
    actual_mm: Array
    own_mm2: Array
    common: Array
    in_model_mm2: Array

    @classmethod
    def of(cls, log: Log, points: list[Point], station: str) -> Self:
        """The points, all measured at ``station``; raises `NoBound` without a budget."""
        calibration = used_calibration(log)
        T_W_B = calibration.base(station)
        T_B_L = inverse(T_W_B) @ log.matrix("world")
        nominal_mm = apply(inverse(T_W_B), np.array([p.nominal_mm for p in points], dtype=float))
        per_visit_mm2, in_model_mm2, common = cls._noise(log, calibration, station, T_W_B)
        own_mm2 = per_visit_mm2 + covariances_mm2(points, T_B_L[:3, :3])
        return cls(nominal_mm, apply(T_B_L, positions_mm(points)), own_mm2, common, in_model_mm2)

    @staticmethod
    def _noise(
        log: Log, calibration: Calibration, station: str, T_W_B: Array
    ) -> tuple[Array, Array, Array]:
        """Covariances in {B}: of one visit and of its part in the model, (3, 3); of frames, (7, 7).

        The tracker was set up for the calibration and again for this run, so that the lines of {W}
        count twice. The drill is not included.
        """
        stated = calibration.budget
        air_c, then_c = log.temperatures_c(), calibration.validity.temperature_c
        now_c = float(np.mean(air_c)) if air_c and then_c is not None else None
        air = temperature(stated.growth_per_k, then_c, stated.air_range_k, now_c)
        set_up = [line for line in stated.lines if line.frame == "world" and not line.per_visit]
        frames = {"world": np.eye(4), "base": T_W_B}
        per_visit, in_model, common = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((7, 7))
        for line in (*stated.lines, *set_up, *stated.stations[station], air):
            if line.frame == "tool" or line.applies == "in validation":
                continue
            covariance = line.about(frames[line.frame], T_W_B)
            if line.per_visit:
                per_visit += covariance[:3, :3]
                in_model += covariance[:3, :3] * line.in_model
            else:
                common += covariance
        return per_visit, in_model, common

    @property
    def error_mm(self) -> Array:
        return self.actual_mm - self.nominal_mm


@dataclass(frozen=True, eq=False)
class RecheckErrors:
    """Errors e = actual - target (N, 3) at targets (N, 3), in {B}, and their predicted covariance.

    ``own_mm2`` (N, 3, 3): of each error; ``common_mm2`` (3N, 3N): of frames, which move all poses
    together; ``orientations`` (N, 3, 3): of {T} in {B}.
    """

    targets_mm: Array
    errors_mm: Array
    own_mm2: Array
    common_mm2: Array
    orientations: Array

    @classmethod
    def of(cls, log: Log, points: list[Point], station: str) -> Self:
        calibration, visits = used_calibration(log), Visits.of(log, points, station)
        poses = driven_poses(calibration, log, points, visits.nominal_mm)
        model = calibration.error_model().predict(poses)
        J = motion_levers(visits.nominal_mm).reshape(-1, 7)
        return cls(
            visits.nominal_mm,
            visits.error_mm,
            nearest_semidefinite(model.covariance_mm2 - visits.in_model_mm2) + visits.own_mm2,
            J @ visits.common @ J.T,
            poses[:, :3, :3],
        )

    @classmethod
    def of_run(cls, log: Log) -> Self:
        return cls.of(log, log.select(KIND), log.cell.grid.station)

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

    def _drift(self) -> tuple[float, float]:
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

    @property
    def motion_columns(self) -> Array:
        """d(errors) / d(motion of the base), (3N, 6)."""
        return motion_levers(self.targets_mm)[:, :, :MOTION].reshape(-1, MOTION)

    def judgement(self) -> Judgement:
        """Judge the errors; raises `HilcellError` for too few, or not finite."""
        bumped_mm, bumped_rad = 1.0, 1e-3  # 1 sigma of a moved base, before any pose says so
        count = len(self.errors_mm)
        if not count >= FEWEST:
            problem = f"re-check: {counted(count, 'pose')}, expected at least {FEWEST}"
            raise HilcellError(problem, code="HC-C21")
        if not np.isfinite(self.errors_mm).all():
            raise HilcellError("re-check: an error is not finite; measure again", code="HC-C21")
        J = self.motion_columns
        C, e = self.covariance_mm2, self.errors_mm.reshape(-1)
        weighted = np.linalg.solve(C, np.column_stack([J, e]))
        information, pull = J.T @ weighted[:, :MOTION], J.T @ weighted[:, MOTION]
        explained = float(pull @ np.linalg.solve(information, pull))
        rest = float(e @ weighted[:, MOTION]) - explained
        prior = np.diag([bumped_mm**-2] * 3 + [bumped_rad**-2] * 3)
        covariance = np.asarray(np.linalg.inv(information + prior), dtype=float)
        motion = covariance @ pull
        left_mm = self.errors_mm - (J @ motion).reshape(-1, 3)
        at_middle = np.hstack([np.eye(3), -cross_matrix(self.targets_mm.mean(axis=0))])
        drift_mm, drift_u_mm = self._drift()
        slipped, slip_mm = left_by(
            self.errors_mm, inverse_covariance(C), self.orientations.reshape(-1, SLIP)
        )
        return Judgement(
            ChiSquare.of(explained, MOTION),
            ChiSquare.of(rest, 3 * count - MOTION),
            ChiSquare.of(slipped, 3 * count - SLIP),
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
            np.sqrt(np.einsum("ni,nij,nj->n", left_mm, np.linalg.inv(self.own_mm2), left_mm) / 3),
        )

    def suspicions(self, judgement: Judgement, arm: Arm, joints_rad: Array) -> list[Suspicion]:
        """Causes that explain the errors at joints (N, 6), the likeliest first.

        Each is removed together with a motion of the base. Where such a motion suffices, only a
        mount whose slip explains the errors as well is suspected.
        """
        noticed_by = "re-check"
        if judgement.may_be_slip:
            return [Suspicion(Cause.MOUNT_SLIPPED, judgement.slip_mm, "mm", noticed_by)]
        if judgement.rest.holds:
            return []
        likely: list[tuple[float, Suspicion]] = []
        moved, weights = self.motion_columns, inverse_covariance(self.covariance_mm2)
        causes = [*patterns(arm, joints_rad), *axis_6_pattern(arm, joints_rad)]
        for cause, columns, factor, unit in causes:
            chi2, size = left_by(self.errors_mm, weights, columns, besides=moved)
            freedom = judgement.rest.freedom - columns.shape[1]
            if ChiSquare.of(chi2, freedom).holds:
                likely.append((chi2 / freedom, Suspicion(cause, factor * size, unit, noticed_by)))
        return [each for _, each in sorted(likely, key=lambda pair: pair[0])]


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

    @classmethod
    def of(cls, log: Log) -> Self:
        """Result of a run that has measured its poses; raises `HilcellError`."""
        measured = RecheckErrors.of_run(log)
        calibration, judgement = used_calibration(log), measured.judgement()
        as_found = decide_errors(log, measured.errors_mm)
        verdict = judgement.verdict
        left_mm = judgement.left_mm if verdict == "update" else measured.errors_mm
        if not decide_errors(log, left_mm).holds:
            verdict = "redo"  # no update brings the errors into tolerance
        air_c, points = log.temperatures_c(), log.select(KIND)
        bounds_mm = bounds95_mm(measured.each_mm2)
        result = cls(
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
            suspicions=measured.suspicions(judgement, log.cell.robot.arm(), commanded_rad(points)),
        )
        return msgspec.structs.replace(result, text=result.verdict_text(judgement.worst))

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
