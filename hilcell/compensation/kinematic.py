"""The identified robot as an error model.

The curves of axis sweeps are used only where they improve the prediction of static poses, which no
sweep covered: a wrong abscissa makes a calibration worse.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import msgspec
import numpy as np

from hilcell.compensation.grid import Grid
from hilcell.compensation.model import (
    LearntModel,
    Measured,
    MeasuredArm,
    ModelError,
    PredictedOrientation,
    Prediction,
)
from hilcell.decoding import Json, typed
from hilcell.geometry.frames import is_rotation, to_rotvec
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import Arm, Array, Ints
from hilcell.geometry.statistics import lengths_mm
from hilcell.identification.estimate import (
    Estimate,
    identify,
    identify_trusted,
    observability,
    predict,
    predict_orientations,
)
from hilcell.identification.kinematics import Kinematics, Placed, State, TransmissionCurve
from hilcell.identification.measured_poses import IdentificationError, Noise
from hilcell.identification.static_curves import static_curves
from hilcell.identification.weight import flange_levers_mm
from hilcell.language import marked
from hilcell.model.verdicts import CurvesUsed

MOST_MM, MOST_RAD = 1e5, 1e3  # beyond is no robot's length or angle
LARGE_AXES = 3  # whose errors have levers of metres
LEAST_LEVER_MM = 10.0  # that tells a load
ORDERS = (1, 2, 3)  # waves a revolution of each joint that static poses settle
CLEARLY = 0.98  # of the mean miss of poses left out, for more parameters to be taken


class RobotEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """The nominal robot: rows of six, the tool point's frame (4, 4), posture and limits (2, 6)."""

    a_mm: list[float]
    alpha_rad: list[float]
    d_mm: list[float]
    offset_rad: list[float]
    sign: list[float]
    tool: list[list[float]]
    status: int
    limits_rad: list[list[float]]
    reference_rad: list[float]
    coupling: float = 0.0

    def nominal(self) -> NominalRobot:
        names = ("a_mm", "alpha_rad", "d_mm", "offset_rad", "sign")
        rows = {
            name: _numbers(f"robot.{name}", getattr(self, name), (6,), MOST_MM) for name in names
        }
        if not (np.abs(rows["sign"]) == 1.0).all():
            raise ModelError("robot.sign: expected 1 or -1")
        if self.coupling not in (-1.0, 0.0, 1.0):
            raise ModelError(f"robot.coupling {self.coupling}, expected 0, 1 or -1")
        if self.status not in range(8):
            raise ModelError(f"robot.status {self.status}, expected 0 .. 7")
        return NominalRobot(
            Arm(**rows, tool=_frame("robot.tool", self.tool), coupling=self.coupling, prismatic=()),
            self.status,
            _numbers("robot.limits_rad", self.limits_rad, (2, 6), MOST_RAD),
            _numbers("robot.reference_rad", self.reference_rad, (6,), MOST_RAD),
        )


class CurveEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Waves of a transmission curve; their amplitudes are among the values."""

    axis: int
    cycles: list[float]

    def curve(self) -> TransmissionCurve:
        """Return the curve with these waves, of no amplitude; raises `ModelError`."""
        if self.axis not in range(6):
            raise ModelError(f"curves: axis {self.axis}, expected 0 .. 5")
        count = len(self.cycles)
        most_cycles = 1e4
        cycles = _numbers("curves.cycles", self.cycles, (count,), most_cycles)
        zeros = np.zeros((2 * count, 2 * count))
        return TransmissionCurve(
            self.axis, cycles, np.zeros((count, 2)), zeros, 0.0, 0.0, -np.pi, np.pi, 0.0
        )


class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the identified robot.

    ``base`` (4, 4), ``reflector_mm`` (3,), ``values`` by name (V,), and the ``covariance`` (P, P)
    of base, reflectors and values; noise; number of directions of the parameters that the poses
    determine, and ratio of the best to the worst; number of poses rejected as outliers.
    ``more_reflectors_mm``: the others on the flange, where the orientation was measured;
    ``pose_mm``: their common part of the noise; ``levers_mm``: of the axes whose curves grow with
    the load.
    """

    robot: RobotEntry
    gravity: bool
    waves: bool
    tool: bool
    curves: list[CurveEntry]
    base: list[list[float]]
    reflector_mm: list[float]
    names: list[str]
    values: list[float]
    covariance: list[list[float]]
    reading_mm: float
    joint_rad: list[float]
    decision: CurvesUsed
    directions: int
    condition: float
    outliers: list[int]
    more_reflectors_mm: list[list[float]]
    pose_mm: float
    levers_mm: list[float] = []

    def levers(self) -> tuple[float, ...]:
        """Return the levers; raises `ModelError`."""
        if len(self.levers_mm) not in (0, LARGE_AXES):
            raise ModelError(f"levers_mm: {len(self.levers_mm)}, expected 0 or {LARGE_AXES}")
        levers_mm = _numbers("levers_mm", self.levers_mm, (len(self.levers_mm),), MOST_MM)
        if not (levers_mm >= LEAST_LEVER_MM).all():
            raise ModelError(f"levers_mm: expected >= {LEAST_LEVER_MM:g} mm")
        return tuple(levers_mm.tolist())


@dataclass(frozen=True, eq=False)
class Kinematic(LearntModel):
    """Errors by identified kinematics. The covariance covers the parameters, the repeatability of
    one visit, and what no parameter describes, both as shown by the static poses.
    """

    name = "kinematic"
    text = marked("corrected by the robot's kinematics, identified from these errors")
    any_orientation = True
    scattered = False

    robot: NominalRobot
    kinematics: Kinematics
    state: State
    covariance: Array
    noise: Noise
    decision: CurvesUsed
    directions: int
    condition: float
    outliers: list[int]

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        """Return the robot identified from poses and curves; raises `IdentificationError`."""
        arm = _arm(measured)
        estimate, decision = _identified(arm)
        known = observability(estimate.kinematics, estimate.covariance)
        excess = 1.0 if arm.known is not None else _excess(estimate)
        return cls(
            arm.robot,
            estimate.kinematics,
            estimate.state,
            excess * estimate.system.covariance,
            estimate.noise.scaled(excess**0.5),
            decision,
            known.directions,
            known.condition,
            np.flatnonzero(estimate.outliers.any(axis=1)).tolist(),
        )

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Predicted minus measured (M, 3), each fifth pose left out, without outliers."""
        return -_left_out_mm(_identified(_arm(measured))[0])

    @classmethod
    def left_out_sizes_mm(cls, measured: Measured) -> Array:
        """Lengths (M,) of the errors at poses left out or struck out: each in the standard
        deviations of its prediction, times that of an error at this pose once it is learnt.

        A corner is uncertain while it is left out, and normal errors along one line scatter more
        than those in all directions: neither is a heavy tail.
        """
        arm = _arm(measured)
        estimate = _identified(arm)[0]
        there_mm, learnt_mm2 = (each[:, 0] for each in estimate.predict(arm.readings.joints_rad))
        missed_mm, covariance_mm2 = (each[:, 0] for each in estimate.left_out(_folds(estimate)))
        struck = estimate.outliers[:, 0]
        missed_mm[struck] = (arm.readings.xyz_mm[:, 0] - there_mm)[struck]
        covariance_mm2[struck] = learnt_mm2[struck]
        whitened = np.linalg.solve(np.linalg.cholesky(covariance_mm2), missed_mm[..., None])
        usual_mm: Array = np.sqrt(np.trace(learnt_mm2, axis1=1, axis2=2) / 3.0)
        return lengths_mm(whitened[..., 0]) * usual_mm

    def predict(self, poses: Array) -> Prediction:
        """Return the errors at nominal poses (N, 4, 4) in {B}; raises `ReachError`."""
        known = (self.kinematics, self.state, self.covariance, self.noise)
        joints = self.robot.joints_for(poses)
        found_mm, covariance_mm2 = predict(*known, joints)
        error_mm, orientation = found_mm[:, 0] - poses[:, :3, 3], None
        if self.kinematics.reflectors > 1:
            R, covariance_rad2 = predict_orientations(*known, joints)
            back = np.swapaxes(poses[:, :3, :3] @ self.robot.arm.tool[:3, :3].T, 1, 2)
            orientation = PredictedOrientation(to_rotvec(R @ back), covariance_rad2)
        return Prediction(error_mm, covariance_mm2[:, 0], orientation)

    def parameters(self) -> Json:
        arm, robot = self.robot.arm, self.robot
        placed = self.kinematics.placed
        entry = Parameters(
            RobotEntry(
                arm.a_mm.tolist(), arm.alpha_rad.tolist(), arm.d_mm.tolist(),
                arm.offset_rad.tolist(), arm.sign.tolist(), arm.tool.tolist(), robot.status,
                robot.limits_rad.tolist(), robot.reference_rad.tolist(), arm.coupling,
            ),
            self.kinematics.gravity,
            self.kinematics.waves,
            self.kinematics.tool,
            [CurveEntry(curve.axis, curve.cycles.tolist()) for curve in self.kinematics.curves],
            self.state.T.tolist(),
            self.state.smr_mm[0].tolist(),
            self.kinematics.names[placed:],
            self.state.values.tolist(),
            self.covariance.tolist(),
            self.noise.reading_mm,
            self.noise.joint_rad.tolist(),
            self.decision,
            self.directions,
            self.condition,
            self.outliers,
            self.state.smr_mm[1:].tolist(),
            self.noise.pose_mm,
            list(self.kinematics.levers_mm),
        )  # fmt: skip
        content: Json = msgspec.to_builtins(entry)
        return content

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Json) -> Self:
        """Model from its `parameters`; the grid's errors are not used."""
        try:
            entry = typed(parameters, Parameters)
        except msgspec.ValidationError as error:
            raise ModelError(f"no identified robot: {error}") from error
        robot = entry.robot.nominal()
        curves = tuple(curve.curve() for curve in entry.curves)
        seats = [entry.reflector_mm, *entry.more_reflectors_mm]
        kinematics = Kinematics(
            robot.arm, len(seats), gravity=entry.gravity, waves=entry.waves, orders=ORDERS,
            tool=entry.tool, curves=curves, levers_mm=entry.levers(),
        )  # fmt: skip
        placed, size = kinematics.placed, len(kinematics.names)
        covariance = _numbers("covariance", entry.covariance, (size, size), MOST_MM)
        cls._check_covariance(covariance)
        state = State(
            _frame("base", entry.base),
            cls._seats_mm(seats),
            _numbers("values", entry.values, (size - placed,), MOST_MM),
            np.zeros(placed),
        )
        deviations = [entry.reading_mm, entry.pose_mm, *entry.joint_rad]
        scatter = _numbers("reading_mm, pose_mm and joint_rad", deviations, (8,), MOST_MM)
        if not (scatter >= 0.0).all():
            raise ModelError("reading_mm, pose_mm and joint_rad: a standard deviation below zero")
        noise = Noise(float(scatter[0]), float(scatter[1]), scatter[2:])
        return cls(
            robot, kinematics, state, covariance, noise, entry.decision, entry.directions,
            entry.condition, entry.outliers,
        )  # fmt: skip

    @staticmethod
    def _seats_mm(places: list[list[float]]) -> Array:
        """Reflectors (K, 3): one, or at least three that span a triangle."""
        seats_mm = _numbers("reflector_mm", places, (len(places), 3), MOST_MM)
        across_mm = np.linalg.svd(seats_mm - seats_mm.mean(axis=0), compute_uv=False)
        least_across_mm = 1.0
        if len(seats_mm) > 1 and not across_mm[1] > least_across_mm:
            raise ModelError("more_reflectors_mm: an orientation needs a triangle of reflectors")
        return seats_mm

    @staticmethod
    def _check_covariance(covariance: Array) -> None:
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        scale = np.outer(sigma, sigma)
        symmetric = 1e-9  # of the parameters' correlations
        if not (np.abs(covariance - covariance.T) <= symmetric * scale).all():
            raise ModelError("covariance: not symmetric")
        positive = np.where(sigma > 0.0, sigma, 1.0)
        if not np.linalg.eigvalsh(covariance / np.outer(positive, positive)).min() >= -symmetric:
            raise ModelError("covariance: a variance below zero")


def curves_used(measured: Measured) -> CurvesUsed:
    """Whether the curves are used, and why; also where no robot can be identified."""
    try:
        return _identified(_arm(measured))[1]
    except IdentificationError as error:
        return CurvesUsed(False, f"not used: {error}")


def _arm(measured: Measured) -> MeasuredArm:
    if measured.arm is None:
        raise IdentificationError("kinematics: the arm's reflectors were not measured")
    return measured.arm


@lru_cache(maxsize=1)
def _identified(measured: MeasuredArm) -> tuple[Estimate, CurvesUsed]:
    """Identification, with curves only if poses left out are predicted better. Cached: a run needs
    it for each of its results.
    """
    if measured.known is not None:
        reason = f"used: those of {measured.known.run}, with the arm that it identified"
        return measured.known.followed(measured.readings).estimate, CurvesUsed(True, reason)
    arm, seats_mm = measured.robot.arm, measured.seats_mm
    assumed = Placed(2.0, 2e-3, 2.0)  # {B} from circles, the reflector as it is mounted
    if len(seats_mm) > 1:  # so little that a orientation of all is theirs and not the last link's
        assumed = replace(assumed, reflector_mm=50.0)
    kinematics = Kinematics(arm, len(seats_mm), orders=ORDERS, assumed=assumed)
    start, noise = kinematics.start(np.eye(4), seats_mm), Noise.of_joints(len(seats_mm))
    found = identify(kinematics, measured.readings, start, noise)
    without = _better(found, replace(kinematics, tool=True))
    kinematics = without.kinematics
    curves = tuple(curve for curve in measured.curves if len(curve.cycles))
    if not curves:
        why = "found no wave" if measured.curves else "were not made"
        return without, CurvesUsed(False, f"not used: axis sweeps {why}")
    with_ = _with_curves(without, curves)
    kept = tuple(curve for curve, bad in zip(curves, _contradicted(with_), strict=True) if not bad)
    if 0 < len(kept) < len(curves):
        with_ = min(with_, _with_curves(without, kept), key=_mean_mm)
    both = [_mean_mm(each) for each in (with_, without)]
    used = both[0] < both[1]
    swept = with_.kinematics.curves
    if used:
        with_ = _loaded(with_)
        with_ = _with_static_curves(with_)
    reason = (
        f"{'used' if used else 'not used'}: static poses that no sweep saw, left out in turn, are "
        f"missed by {both[0]:.4f} mm in the mean with the curves of axes {_axes(swept)}, by "
        f"{both[1]:.4f} mm without"
    )
    if with_.kinematics.levers_mm:
        reason += "; the curves grow with the load"
    if more := with_.kinematics.curves[len(swept) :]:
        reason += f"; axes {_axes(more)} err smoothly by these poses alone"
    return (with_ if used else without), CurvesUsed(used, reason, *both)


def seats_mm(measured: Measured) -> Array:
    """Return the reflectors (K, 3) on the flange, by the zero of axis 6, as identified."""
    return _identified(_arm(measured))[0].state.smr_mm


def _axes(curves: tuple[TransmissionCurve, ...]) -> str:
    return ", ".join(f"{curve.axis + 1}" for curve in curves)


def _with_curves(without: Estimate, curves: tuple[TransmissionCurve, ...]) -> Estimate:
    kinematics = replace(without.kinematics, curves=curves)
    start = kinematics.start(without.state.T, without.state.smr_mm)
    found = identify_trusted(kinematics, without.readings, start, without.noise)
    return replace(found, outliers=without.outliers)


def _loaded(swept: Estimate) -> Estimate:
    """Curves that grow with the load, where these predict poses better that are left out."""
    arm, joints_rad = swept.kinematics.arm, swept.readings.joints_rad
    middle_mm = flange_levers_mm(arm.by_angles, arm.angles(joints_rad)).mean(axis=0)[:LARGE_AXES]
    if not middle_mm.min() >= LEAST_LEVER_MM:
        return swept
    return _better(swept, replace(swept.kinematics, levers_mm=tuple(middle_mm.tolist())))


def _with_static_curves(swept: Estimate) -> Estimate:
    """Add smooth errors of the wrist's axes that no curve describes, where these predict poses
    better that are left out. Ripple of a large axis, whose angles repeat on a grid, would be taken
    for one.
    """
    described = {curve.axis for curve in swept.kinematics.curves}
    wrist = range(LARGE_AXES, len(swept.kinematics.arm))
    more = static_curves(swept, (axis for axis in wrist if axis not in described))
    if not more:
        return swept
    found = _with_curves(swept, (*swept.kinematics.curves, *more))
    return found if _mean_mm(found) < CLEARLY * _mean_mm(swept) else swept


def _contradicted(estimate: Estimate) -> list[bool]:
    """Curves that change by more than prior's less posterior's covariance."""
    kinematics = estimate.kinematics
    mean, prior = kinematics.prior
    change = kinematics.flat(estimate.state) - mean
    explained = prior - estimate.system.covariance
    bad, end = [], len(mean) - sum(map(kinematics.size, kinematics.curves))
    least_share = 1e-3  # of a prior's variance that poses explain at least
    contradicted = 4.0  # times the square that chance gives a curve's change
    for curve in kinematics.curves:
        own = slice(end, end + 2 * len(curve.cycles))
        by_chance = explained[own, own] + least_share * prior[own, own]
        size = float(change[own] @ np.linalg.solve(by_chance, change[own]))
        bad.append(not size <= contradicted * 2 * len(curve.cycles))
        end += kinematics.size(curve)
    return bad


def _better(estimate: Estimate, richer: Kinematics) -> Estimate:
    """Richer kinematics where poses left out are predicted significantly better."""
    start = richer.start(estimate.state.T, estimate.state.smr_mm)
    other = identify_trusted(richer, estimate.readings, start, estimate.noise)
    better = _mean_mm(other) < CLEARLY * _mean_mm(estimate)
    return replace(other, outliers=estimate.outliers) if better else estimate


def _mean_mm(estimate: Estimate) -> float:
    return float(lengths_mm(_left_out_mm(estimate)).mean())


@lru_cache(maxsize=1)
def _excess(estimate: Estimate) -> float:
    """Ratio of variances to those of poses that err independently.

    What no parameter describes is mostly the gears', and repeats where a joint's angle repeats, as
    on a grid. So all poses that share an angle of one of the large axes are left out together.
    """
    same_rad = np.radians(0.1)  # less than half the shortest wave of a gear
    steps = np.round(estimate.readings.joints_rad[:, :LARGE_AXES] / same_rad)
    found = [1.0]
    for angles in steps.T:
        group = np.unique(angles, return_inverse=True)[1]
        folds = [np.flatnonzero(group == each).astype(np.int_) for each in range(group.max() + 1)]
        if len(folds) > 1:
            found.append(estimate.system.excess(folds))
    return max(found)


def _left_out_mm(estimate: Estimate) -> Array:
    return estimate.left_out(_folds(estimate))[0][:, 0][~estimate.outliers[:, 0]]


def _folds(estimate: Estimate) -> list[Ints]:
    count = 5  # each fifth pose is predicted by the others
    fold = np.arange(len(estimate.readings)) % count
    return [np.flatnonzero(fold == each).astype(np.int_) for each in range(count)]


def _frame(name: str, rows: list[list[float]]) -> Array:
    T = _numbers(name, rows, (4, 4), MOST_MM)
    R = T[:3, :3]
    if not (is_rotation(R) and np.array_equal(T[3], [0, 0, 0, 1])):
        raise ModelError(f"{name}: is not rigid")
    return T


def _numbers(name: str, found: object, shape: tuple[int, ...], most: float) -> Array:
    try:
        values = np.array(found, dtype=float)
    except (ValueError, TypeError) as error:
        raise ModelError(f"{name}: no numbers: {error}") from error
    if values.shape != shape or not (np.abs(values) <= most).all():
        counts = " x ".join(map(str, shape)) or "one"
        raise ModelError(f"{name}: expected {counts} finite numbers within +-{most:g}")
    return values
