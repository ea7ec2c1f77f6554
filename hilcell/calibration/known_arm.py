"""The calibration from which a re-calibration starts, and the parts of it that are carried.

Gears, stiffness and repeatability do not change in weeks: the arm that the earlier calibration
identified, with the curves of its sweeps, is the prior of the new one, and the scatter of a visit
and the lost motion are the earlier ones. Frames and corrections are measured again.

A reflector that has slipped on its mount moves all poses of one orientation as a moved base does,
and no target shows it. The base's circles do: the reflector turns with axis 6. Both runs swept the
same joints, so that the arm's own errors are in both.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.causes import PENALTY, RISK, SPREAD, inverse_covariance, left_by, patterns
from hilcell.calibration.file import Calibration, Circle
from hilcell.calibration.influence import Influence
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse, motion_levers, turned_deg
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import f_quantile
from hilcell.identification.known_arm import KnownArm
from hilcell.identification.measured_poses import Readings
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, of_measured, positions_mm
from hilcell.model.events import ArmCarried
from hilcell.model.verdicts import Cause, Suspicion
from hilcell.ports import Array

REPEATABILITY, APPROACH = "Robot repeatability", "Approach direction"
USUAL_SAMPLES = 27.0  # poses that showed the noise, where the file states none: a quick grid's


@of_measured
def carried_calibration(log: Log) -> Calibration | None:
    """The calibration from which a run re-calibrates; None where it starts from none."""
    found = log.happened(ArmCarried)
    return typed(found[-1].content, Calibration) if found else None


def known_arm(calibration: Calibration) -> KnownArm:
    """The arm of a calibration for which `unfit` yields nothing."""
    model = calibration.learnt_model()
    assert isinstance(model, Kinematic)  # noqa: S101 - `unfit` yields that it is not
    samples = calibration.budget.model_samples or USUAL_SAMPLES
    return KnownArm(
        calibration.provenance.latest,
        model.kinematics,
        model.state,
        model.covariance,
        model.noise,
        samples,
    )


@of_measured
def carried_arm(log: Log) -> KnownArm | None:
    calibration = carried_calibration(log)
    return None if calibration is None else known_arm(calibration)


def seed_after(calibration: Calibration) -> int:
    """The seed of a run that uses a calibration and states none: another one after each, so that no
    two links of a chain measure the same poses, or have one simulated noise.
    """
    digest = hashlib.sha256(msgspec.json.encode(calibration.provenance, order="sorted")).digest()
    return int.from_bytes(digest[:2]) + 2  # 1 is the usual one


def carried_line(calibration: Calibration, name: str) -> Influence:
    """The line of a budget that a re-calibration does not measure again."""
    carried = ", in an earlier run"
    line = next(line for line in calibration.budget.lines if line.name == name)
    return msgspec.structs.replace(line, how=line.how.removesuffix(carried) + carried)


def carried_scatter(calibration: Calibration) -> tuple[Array, float]:
    """Covariance (3, 3) in {B} of one visit without the reading's noise, and how many visits, less
    their places, showed it.
    """
    line = carried_line(calibration, REPEATABILITY)
    robot_mm2 = np.array(line.covariance)[:3, :3]
    squares = float(np.square(robot_mm2).sum())
    if line.freedom is None or not squares:
        return robot_mm2, USUAL_SAMPLES
    return robot_mm2, line.freedom * squares / float(np.trace(robot_mm2)) ** 2


# -- the reflector's mount -------------------------------------------------------------------------

SWEPT = (1, 6)  # axes of the base's circles


class Mount(NamedTuple):
    """How far the reflector has moved on the flange since the earlier calibration, beside a motion
    of the base. ``slipped``: chance does not explain it, nor does another change of the robot.
    """

    shift_mm: float
    slipped: bool


def base_circles(log: Log) -> list[Circle]:
    """The circles of axes 1 and 6, from which a run has made its base."""
    to_base, circles = inverse(log.matrix("base")) @ log.matrix("world"), []
    for points in (log.select("base", axis=axis) for axis in SWEPT):
        joints_deg = [list(point.commanded_deg or ()) for point in points]
        circles.append(Circle(joints_deg, apply(to_base, positions_mm(points)).tolist()))
    return circles


@of_measured
def mount_since(log: Log) -> Mount | None:
    """The reflector's mount in a re-calibration; None where the earlier run swept other joints. Its
    circles leave open whether the reflector went along axis 6 or a zero was lost: its poses tell.
    """
    from scipy.linalg import block_diag

    calibration = carried_calibration(log)
    if calibration is None or "base" not in log.frames or not calibration.circles:
        return None
    arm, T_B_L = log.cell.robot.arm(), inverse(log.matrix("base")) @ log.matrix("world")
    scatter_mm2, freedom = carried_scatter(calibration)
    visited = []
    for axis, circle in zip(SWEPT, calibration.circles, strict=True):
        points = log.select("base", axis=axis)
        then_mm = _errors_then(arm, circle, axis - 1, commanded_rad(points))
        if then_mm is None:
            return None
        now_mm = apply(T_B_L, positions_mm(points)) - forward(arm, commanded_rad(points))[:, :3, 3]
        own_mm2 = 2.0 * (covariances_mm2(points, T_B_L[:3, :3]) + scatter_mm2)
        visited.append((commanded_rad(points), now_mm - then_mm, block_diag(*own_mm2)))
    if poses := [each for each in log.select("pose") if each.id.seat is None]:
        at_mm, own_mm2 = apply(T_B_L, positions_mm(poses)), covariances_mm2(poses, T_B_L[:3, :3])
        readings = Readings(commanded_rad(poses), at_mm[:, None], own_mm2[:, None])
        visited.append((readings.joints_rad, *known_arm(calibration).misses(readings)))
    joints_rad, difference_mm, covariances = zip(*visited, strict=True)
    stacked = np.vstack(joints_rad), np.vstack(difference_mm)
    return moved_mount(arm, *stacked, block_diag(*covariances), freedom)


def _errors_then(arm: Arm, circle: Circle, axis: int, joints_rad: Array) -> Array | None:
    """Errors (N, 3) against the nominal arm at joints (N, 6) of the same sweep of an axis (from 0),
    linear between the circle's points; None where it was another sweep.
    """
    then_rad = np.radians(circle.joints_deg)
    then_rad, at_mm = then_rad[(order := np.argsort(then_rad[:, axis]))], np.array(circle.at_mm)
    fixed_rad = np.delete(joints_rad - then_rad[0], axis, axis=1)
    q_rad, swept_rad, same_rad = joints_rad[:, axis], then_rad[:, axis], 1e-6
    beyond_rad = max(swept_rad[0] - q_rad.min(), q_rad.max() - swept_rad[-1])
    if not max(float(np.abs(fixed_rad).max()), beyond_rad) <= same_rad:
        return None
    error_mm = at_mm[order] - forward(arm, then_rad)[:, :3, 3]
    return np.stack([np.interp(q_rad, swept_rad, each) for each in error_mm.T], axis=1)


def moved_mount(
    arm: Arm, joints_rad: Array, difference_mm: Array, covariance_mm2: Array, freedom: float
) -> Mount:
    """Judge differences (N, 3) in {B} at joints (N, 6), with their covariance (3N, 3N) by so many
    degrees of freedom: the base has moved, and one cause besides. A lost zero of axis 6 is taken
    for a slipped mount: the reflector is off in the same direction, and one of both is wrong.
    """
    weights = inverse_covariance(covariance_mm2)
    moved = motion_levers(forward(arm, joints_rad)[:, :3, 3])[:, :, :6].reshape(-1, 6)
    alone, _ = left_by(difference_mm, weights, moved)
    found = [
        (cause, columns.shape[1], *left_by(difference_mm, weights, columns, besides=moved))
        for cause, columns, *_ in patterns(arm, joints_rad)
    ]
    (shift_mm,) = (size for cause, _, _, size in found if cause is Cause.MOUNT_SLIPPED)
    cause, parameters, left, _ = min(found, key=lambda each: each[2] + PENALTY * each[1])
    most = parameters * SPREAD * f_quantile(1.0 - RISK, parameters, freedom)
    return Mount(shift_mm, cause is Cause.MOUNT_SLIPPED and not alone - left <= most)


def slipped_mount(log: Log) -> Suspicion | None:
    """A reflector that is elsewhere on the flange than in the calibration of a re-calibration."""
    mount = mount_since(log)
    if mount is None or not mount.slipped:
        return None
    run = log.happened(ArmCarried)[-1].run
    return Suspicion(Cause.MOUNT_SLIPPED, mount.shift_mm, "mm", f"circles of run {run}")


def unfit(calibration: Calibration, cell: Cell) -> Iterator[str]:
    """Yield why a cell cannot be re-calibrated from a calibration."""
    valid = calibration.validity
    again = "run calibrate without --from"
    model = calibration.learnt_model()
    if not isinstance(model, Kinematic):
        yield f"it corrects by {calibration.model.name}, which knows no arm; {again}"
    elif not (model.decision.used and model.kinematics.curves):
        yield f"it has no curves of the gears (axis sweeps), which are carried; {again}"
    elif model.kinematics.reflectors != len(cell.robot.seats_mm):
        yield (
            f"it measured {model.kinematics.reflectors} reflectors on the flange, this cell has "
            f"{len(cell.robot.seats_mm)}; {again}"
        )
    centre, half_mm = cell.grid.centre.matrix(), np.array(cell.grid.size_mm) / 2
    beyond_mm = max(
        float((np.array(valid.low_mm) - (centre[:3, 3] - half_mm)).max()),
        float((centre[:3, 3] + half_mm - np.array(valid.high_mm)).max()),
    )
    rounding_mm = 1e-6
    if not beyond_mm <= rounding_mm:
        yield f"the grid's cube leaves the calibrated volume by {beyond_mm:.0f} mm; {again}"
    turned = float(turned_deg(np.array(valid.orientation), centre[None])[0])
    most_deg = valid.orientation_tolerance_deg
    if not turned + cell.plan.tilt_deg <= most_deg:
        yield (
            f"the grid's orientation and plan.tilt_deg turn the tool by {turned:.1f} + "
            f"{cell.plan.tilt_deg:g} deg, calibrated within {most_deg:g} deg; {again}"
        )
    if cell.plan.grid_orientations:
        yield f"plan.grid_orientations are measured with the whole grid; {again}"
