"""Inverse kinematics: closed form where the arm has one (`closed_form`), refined for others.

A pose has up to eight postures; its status picks one: bit 0 the wrist centre lies behind axis 1,
bit 1 axis 3 is at or beyond the stretched arm (the elbow's offset counts), bit 2 A5 < 0. A posture
leaves whole turns open; `posture` takes those nearest to a reference that keep within the limits,
as a robot does that goes there from the reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.closed_form import ReachError, solved
from hilcell.geometry.kinematics import Arm, Array, Bools, forward, link_transforms
from hilcell.geometry.rotations import to_rotvec

ROUNDING_MM = 1e-6
NAMED = 3  # poses that one message names


def inverse_kinematics(arm: Arm, poses: ArrayLike, status: int) -> Array:
    """Return joints (..., 6), each within -pi..pi, for {T} in {B} (..., 4, 4) by ``status``.

    Raises `ReachError` naming the first unreachable poses and by how many mm they are so, or
    when the arm has no closed form (use `refine_inverse`).
    """
    joints, excess_mm = solved(arm, np.asarray(poses, dtype=float), status)
    _refuse_unreachable(excess_mm)
    return joints


def posture(
    arm: Arm, poses: ArrayLike, status: int, limits_rad: Array, reference_rad: ArrayLike
) -> Array:
    """Return joints (..., 6) as `inverse_kinematics`, turned towards a reference within limits.

    Raises `ReachError` also where a joint leaves ``limits_rad`` (2, 6).
    """
    joints = nearest_turns(inverse_kinematics(arm, poses, status), limits_rad, reference_rad)
    degrees, limits = np.degrees(joints.reshape(-1, 6)), np.degrees(limits_rad)
    bad = np.argwhere(~((joints >= limits_rad[0]) & (joints <= limits_rad[1])).reshape(-1, 6))
    if len(bad):
        named = ", ".join(
            f"pose {n + 1} A{j + 1} {degrees[n, j]:.2f} deg "
            f"(limits {limits[0, j]:.2f} .. {limits[1, j]:.2f})"
            for n, j in bad[:NAMED]
        )
        raise ReachError(
            f"{len(set(bad[:, 0]))} of {len(degrees)} poses are beyond joint limits: {named}"
            f"{', ...' if len(bad) > NAMED else ''}; choose another status, target or station"
        )
    return joints


def reachable(
    arm: Arm, poses: ArrayLike, status: int, limits_rad: Array, reference_rad: ArrayLike
) -> Bools:
    """Return which poses (..., 4, 4) `posture` would accept, (...)."""
    joints, excess_mm = solved(arm, np.asarray(poses, dtype=float), status)
    turned = nearest_turns(joints, limits_rad, reference_rad)
    inside = (turned >= limits_rad[0]) & (turned <= limits_rad[1])
    ok: Bools = (excess_mm <= ROUNDING_MM) & inside.all(axis=-1)
    return ok


def reach_excess_mm(arm: Arm, poses: ArrayLike, status: int) -> Array:
    """Return by how many mm the wrist centre is too far (or too near), (...); 0 if reachable."""
    excess_mm = solved(arm, np.asarray(poses, dtype=float), status)[1]
    return np.where(excess_mm <= ROUNDING_MM, 0.0, excess_mm)


@dataclass(frozen=True, eq=False)
class NominalRobot:
    """A nominal arm, the status bits of its posture, limits (2, 6) and home joints (6,) in rad."""

    arm: Arm
    status: int
    limits_rad: Array
    reference_rad: Array

    def joints_for(self, poses: Array) -> Array:
        """Return joints (N, 6) in rad for {T} in {B} (N, 4, 4); raises `ReachError`."""
        return posture(self.arm, poses, self.status, self.limits_rad, self.reference_rad)

    def reachable(self, poses: Array) -> Bools:
        """Return which poses (N, 4, 4) `joints_for` accepts, (N,)."""
        return reachable(self.arm, poses, self.status, self.limits_rad, self.reference_rad)


def nearest_turns(joints_rad: Array, limits_rad: Array, reference_rad: ArrayLike) -> Array:
    """Return the joints (..., 6) plus whole turns: within limits if possible, then nearest."""
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    options = joints_rad[..., None, :] + turns
    beyond = np.maximum(limits_rad[0] - options, options - limits_rad[1]).clip(min=0.0)
    cost = np.abs(options - np.asarray(reference_rad)) + 1e6 * beyond
    best = np.argmin(cost, axis=-2)
    return np.take_along_axis(options, best[..., None, :], axis=-2)[..., 0, :]


def joint_jacobian(arm: Arm, joints_rad: ArrayLike) -> Array:
    """Return d({T} shift in mm, rotation vector in rad)/d(joints), (..., 6, 6), axes of {B}."""
    joints = np.asarray(joints_rad, dtype=float)
    links = link_transforms(arm, joints)
    frame = np.broadcast_to(np.eye(4), links[..., 0, :, :].shape)
    tip = forward(arm, joints)[..., :3, 3]
    columns = []
    for row in range(6):
        axis = arm.sign[row] * frame[..., :3, 2]
        columns.append(np.concatenate([np.cross(axis, tip - frame[..., :3, 3]), axis], axis=-1))
        frame = frame @ links[..., row, :, :]
    return np.stack(columns, axis=-1)


def refine_inverse(arm: Arm, pose: ArrayLike, start_rad: ArrayLike) -> Array:
    """Return joints (..., 6) of any six-axis arm for poses (..., 4, 4), from a start (..., 6).

    Levenberg-Marquardt with damping by the residual, so it also leaves singular starts. Raises
    `ReachError` where it does not arrive.
    """
    poses = np.asarray(pose, dtype=float)
    start = np.broadcast_to(np.asarray(start_rad, dtype=float), (*poses.shape[:-2], 6))
    flat = poses.reshape(-1, 4, 4)
    joints, arrived = refined(arm, flat, start.reshape(-1, 6))
    left_mm = np.linalg.norm(_pose_error(flat, forward(arm, joints))[:, :3], axis=-1)
    _refuse_unreachable(np.where(arrived, 0.0, left_mm))
    return joints.reshape(start.shape)


def refined(arm: Arm, poses: Array, start_rad: Array) -> tuple[Array, Bools]:
    """Return joints (N, 6) as `refine_inverse`, and which of them have arrived (N,)."""
    joints, arrived = start_rad.copy(), np.zeros(len(poses), dtype=bool)
    length_mm = max(float(np.abs(arm.a_mm).max()), 1.0)
    scale = np.array([1.0, 1.0, 1.0, *[length_mm] * 3]) / length_mm
    refine_steps = 100
    refined_mm, refined_rad = 1e-7, 1e-10
    for _ in range(refine_steps + 1):
        error = _pose_error(poses[~arrived], forward(arm, joints[~arrived]))
        shift, turn = (np.linalg.norm(each, axis=-1) for each in (error[:, :3], error[:, 3:]))
        there = (shift <= refined_mm) & (turn <= refined_rad)
        arrived[~arrived] = there
        if arrived.all():
            break
        left = joints[~arrived]
        J = joint_jacobian(arm, left) * scale[:, None]
        scaled = error[~there] * scale
        damping = 0.5 * np.sum(scaled**2, axis=-1) + 1e-15
        normal = np.swapaxes(J, -1, -2) @ J + damping[..., None, None] * np.eye(6)
        gradient = np.einsum("...ij,...i->...j", J, scaled)
        joints[~arrived] = left + np.linalg.solve(normal, gradient[..., None])[..., 0]
    return joints, arrived


def _pose_error(wanted: Array, found: Array) -> Array:
    """Return (shift in mm, rotation vector in rad) from found to wanted, (..., 6)."""
    turn = wanted[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
    shift = wanted[..., :3, 3] - found[..., :3, 3]
    return np.concatenate([shift, to_rotvec(turn)], axis=-1)


def _refuse_unreachable(excess_mm: Array) -> None:
    excess = np.atleast_1d(excess_mm).ravel()
    bad = np.flatnonzero(~(excess <= ROUNDING_MM))
    if len(bad):
        named = ", ".join(f"pose {n + 1} by {excess[n]:.3f} mm" for n in bad[:NAMED])
        raise ReachError(
            f"{len(bad)} of {excess.size} poses are out of reach: {named}"
            f"{', ...' if len(bad) > NAMED else ''}; move the target or choose another station"
        )
