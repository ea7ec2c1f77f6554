"""Inverse kinematics: closed form for six-axis arms with a spherical wrist, refined for others.

A pose has up to eight postures; its status picks one: bit 0 the wrist centre lies behind axis 1,
bit 1 axis 3 is at or beyond the stretched arm (the elbow's offset counts), bit 2 A5 < 0. A posture
leaves whole turns open; `posture` takes those nearest to a reference that keep within the limits,
as a robot does that goes there from the reference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilcell.errors import HilcellError
from hilcell.geometry.frames import inverse
from hilcell.geometry.kinematics import Arm, Array, forward, link_transforms
from hilcell.geometry.rotations import to_rotvec

Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]

FAMILY_ALPHA_RAD = np.radians([-90.0, 0.0, -90.0, 90.0, -90.0, 0.0])
BEHIND, BEYOND, FLIPPED = 1, 2, 4  # status bits
ROUNDING_MM = 1e-6
SINGULAR = 1e-12  # sine of A5 below which A4 and A6 turn about one line
REFINE_STEPS = 100
REFINED_MM, REFINED_RAD = 1e-7, 1e-10
NAMED = 3  # poses that one message names


class ReachError(HilcellError):
    """Poses that the arm cannot take, or an arm that this inverse does not cover."""

    code = "HC-C10"


def inverse_kinematics(arm: Arm, poses: ArrayLike, status: int) -> Array:
    """Return joints (..., 6), each within -pi..pi, for {T} in {B} (..., 4, 4) by ``status``.

    Raises `ReachError` naming the first unreachable poses and by how many mm they are so, or
    when the arm is not of the family (use `refine_inverse`).
    """
    joints, excess_mm = _solved(arm, np.asarray(poses, dtype=float), status)
    _refuse_unreachable(excess_mm)
    return joints


def posture(
    arm: Arm, poses: ArrayLike, status: int, limits_rad: Array, reference_rad: ArrayLike
) -> Array:
    """Return joints (..., 6) as `inverse_kinematics`, turned towards a reference within limits.

    Raises `ReachError` also where a joint leaves ``limits_rad`` (2, 6).
    """
    joints = nearest_turns(inverse_kinematics(arm, poses, status), limits_rad, reference_rad)
    _refuse_beyond_limits(joints, limits_rad)
    return joints


def reachable(
    arm: Arm, poses: ArrayLike, status: int, limits_rad: Array, reference_rad: ArrayLike
) -> Bools:
    """Return which poses (..., 4, 4) `posture` would accept, (...)."""
    joints, excess_mm = _solved(arm, np.asarray(poses, dtype=float), status)
    turned = nearest_turns(joints, limits_rad, reference_rad)
    inside = (turned >= limits_rad[0]) & (turned <= limits_rad[1])
    ok: Bools = (excess_mm <= ROUNDING_MM) & inside.all(axis=-1)
    return ok


def reach_excess_mm(arm: Arm, poses: ArrayLike, status: int) -> Array:
    """Return by how many mm the wrist centre is too far (or too near), (...); 0 if reachable."""
    excess_mm = _solved(arm, np.asarray(poses, dtype=float), status)[1]
    return np.where(excess_mm <= ROUNDING_MM, 0.0, excess_mm)


def nearest_turns(joints_rad: Array, limits_rad: Array, reference_rad: ArrayLike) -> Array:
    """Return the joints (..., 6) plus whole turns: within limits if possible, then nearest."""
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    options = joints_rad[..., None, :] + turns
    beyond = np.maximum(limits_rad[0] - options, options - limits_rad[1]).clip(min=0.0)
    cost = np.abs(options - np.asarray(reference_rad)) + 1e6 * beyond
    best = np.argmin(cost, axis=-2)
    return np.take_along_axis(options, best[..., None, :], axis=-2)[..., 0, :]


def status_of(arm: Arm, joints_rad: ArrayLike) -> Ints:
    """Return the status bits (...) of joints (..., 6)."""
    _check_family(arm)
    joints = np.asarray(joints_rad, dtype=float)
    theta = arm.sign * joints + arm.offset_rad
    forearm_mm, bend_rad = _forearm(arm)
    elbow = theta[..., 2] + bend_rad
    radius_mm = (
        arm.a_mm[0]
        + arm.a_mm[1] * np.cos(theta[..., 1])
        + forearm_mm * np.cos(theta[..., 1] + elbow)
    )
    behind = radius_mm < 0
    beyond = arm.sign[2] * _wrapped(elbow) >= 0
    flipped = joints[..., 4] < 0
    status: Ints = BEHIND * behind + BEYOND * beyond + FLIPPED * flipped
    return status


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
    for _ in range(REFINE_STEPS + 1):
        error = _pose_error(poses[~arrived], forward(arm, joints[~arrived]))
        there = _arrived(error)
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


def _solved(arm: Arm, poses: Array, status: int) -> tuple[Array, Array]:
    """Return joints (..., 6) and by how many mm the wrist centre is out of reach (...)."""
    _check_family(arm)
    if status not in range(8):
        raise ReachError(f"status {status}: wanted 0 .. 7")
    flange = poses @ inverse(arm.tool)
    wrist = flange[..., :3, 3] - arm.d_mm[5] * flange[..., :3, 2]
    side = -1.0 if status & BEHIND else 1.0
    theta = np.empty((*poses.shape[:-2], 6))
    theta[..., 0] = np.arctan2(side * wrist[..., 1], side * wrist[..., 0])
    u = side * np.hypot(wrist[..., 0], wrist[..., 1]) - arm.a_mm[0]
    v = arm.d_mm[0] - wrist[..., 2]
    theta[..., 1], theta[..., 2], excess_mm = _elbow(arm, u, v, status)
    theta[..., 3:] = _wrist(arm, theta, flange[..., :3, :3], status)
    return _wrapped(arm.sign * (theta - arm.offset_rad)), excess_mm


def _elbow(arm: Arm, u: Array, v: Array, status: int) -> tuple[Array, Array, Array]:
    """Return theta 2, theta 3 and the excess for the wrist centre (u, v) in the arm's plane."""
    upper_mm = arm.a_mm[1]
    forearm_mm, bend_rad = _forearm(arm)
    distance = np.hypot(u, v)
    far, near = distance - (upper_mm + forearm_mm), abs(upper_mm - forearm_mm) - distance
    cosine = (distance**2 - upper_mm**2 - forearm_mm**2) / (2 * upper_mm * forearm_mm)
    turn = arm.sign[2] if status & BEYOND else -arm.sign[2]
    elbow = turn * np.arccos(np.clip(cosine, -1.0, 1.0))
    theta_2 = np.arctan2(v, u) - np.arctan2(
        forearm_mm * np.sin(elbow), upper_mm + forearm_mm * np.cos(elbow)
    )
    return theta_2, elbow - bend_rad, np.maximum(far, near)


def _wrist(arm: Arm, theta: Array, flange: Array, status: int) -> Array:
    """Return theta 4 .. 6 (..., 3): the wrist turns by Rz(theta 4) Ry(-theta 5) Rz(theta 6)."""
    front = _rz(theta[..., 0]) @ _RX_BACK @ _rz(theta[..., 1] + theta[..., 2]) @ _RX_BACK
    R = np.swapaxes(front, -1, -2) @ flange
    side = arm.sign[4] * (1.0 if status & FLIPPED else -1.0)
    singular = np.hypot(R[..., 0, 2], R[..., 1, 2]) < SINGULAR
    theta_4 = np.arctan2(side * R[..., 1, 2], side * R[..., 0, 2])
    theta_4 = np.where(singular, arm.offset_rad[3], theta_4)
    M = np.swapaxes(_rz(theta_4), -1, -2) @ R
    theta_5 = np.arctan2(-M[..., 0, 2], M[..., 2, 2])
    theta_6 = np.arctan2(M[..., 1, 0], M[..., 1, 1])
    return np.stack([theta_4, theta_5, theta_6], axis=-1)


_RX_BACK: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # Rx(-90)


def _rz(angle: Array) -> Array:
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(angle)
    R[..., 1, 0] = np.sin(angle)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1.0
    return R


def _forearm(arm: Arm) -> tuple[float, float]:
    """Return length and angle of the line from axis 3 to the wrist centre."""
    a, d = float(arm.a_mm[2]), float(arm.d_mm[3])
    return float(np.hypot(a, d)), float(np.arctan2(d, a))


def _wrapped(angle: Array) -> Array:
    """Return angles in -pi < angle <= pi."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def _check_family(arm: Arm) -> None:
    odd = [
        name
        for name, found, wanted in (
            ("alpha", arm.alpha_rad, FAMILY_ALPHA_RAD),
            ("beta", arm.beta_rad, np.zeros(6)),
            ("a4 .. a6", arm.a_mm[3:], np.zeros(3)),
            ("d2, d3, d5", arm.d_mm[[1, 2, 4]], np.zeros(3)),
            ("offset of axis 5", arm.offset_rad[4], 0.0),
        )
        if not np.allclose(found, wanted, rtol=0.0, atol=1e-12)
    ]
    if odd:
        raise ReachError(
            f"closed-form inverse kinematics: {', '.join(odd)} are not those of a spherical-wrist "
            "arm with parallel axes 2 and 3; start from a nominal arm and use refine_inverse"
        )


def _pose_error(wanted: Array, found: Array) -> Array:
    """Return (shift in mm, rotation vector in rad) from found to wanted, (..., 6)."""
    turn = wanted[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
    shift = wanted[..., :3, 3] - found[..., :3, 3]
    return np.concatenate([shift, to_rotvec(turn)], axis=-1)


def _arrived(error: Array) -> Bools:
    shift = np.linalg.norm(error[..., :3], axis=-1)
    turn = np.linalg.norm(error[..., 3:], axis=-1)
    there: Bools = (shift <= REFINED_MM) & (turn <= REFINED_RAD)
    return there


def _refuse_unreachable(excess_mm: Array) -> None:
    excess = np.atleast_1d(excess_mm).ravel()
    bad = np.flatnonzero(~(excess <= ROUNDING_MM))
    if len(bad):
        named = ", ".join(f"pose {n + 1} by {excess[n]:.3f} mm" for n in bad[:NAMED])
        raise ReachError(
            f"{len(bad)} of {excess.size} poses are out of reach: {named}"
            f"{', ...' if len(bad) > NAMED else ''}; move the target or choose another station"
        )


def _refuse_beyond_limits(joints_rad: Array, limits_rad: Array) -> None:
    degrees, limits = np.degrees(joints_rad.reshape(-1, 6)), np.degrees(limits_rad)
    bad = np.argwhere(
        ~((joints_rad >= limits_rad[0]) & (joints_rad <= limits_rad[1])).reshape(-1, 6)
    )
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
