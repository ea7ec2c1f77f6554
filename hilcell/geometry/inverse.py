"""Inverse kinematics: closed form where the arm has one, refined for others.

A pose has up to eight postures; its status picks one: bit 0 the wrist centre lies behind axis 1,
bit 1 axis 3 is at or beyond the stretched arm (including the elbow's offset), bit 2 A5 < 0.
Revolutions are chosen nearest to a reference, within the limits, as a robot does.

Closed form for two families: a shoulder about the vertical, two parallel links in a plane, and a
last part that rotates by ``Rz(q) Ry(-theta 5) Rz(theta 6)`` within it. With a spherical wrist axes
4 to 6 meet in the wrist centre, and q is theta 4. With three parallel axes (Universal Robots) axis
4 is parallel to 2 and 3, q is the sum of these angles, and the arm is beside the plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hilcell.errors import HilcellError
from hilcell.geometry.frames import inverse, to_rotvec
from hilcell.geometry.kinematics import MM, Arm, Array, Bools, Ints, forward, link_transforms

BEHIND, BEYOND, FLIPPED = 1, 2, 4  # status bits


class ReachError(HilcellError):
    """Poses that the arm cannot take, or an arm that this inverse does not cover."""

    code = "HC-C10"


def solved(arm: Arm, poses: Array, status: int) -> tuple[Array, Array]:
    """Joints (..., 6) in -pi..pi for {T} in {B} (..., 4, 4), and the excess (...), mm.

    The excess is the distance out of reach, at most 0 within. Raises `ReachError` for an arm of
    neither family.
    """
    family = _family(arm)
    if status not in range(8):
        raise ReachError(f"status {status}: expected 0 .. 7")
    theta, excess_mm = family.solve(arm, poses @ inverse(arm.tool), status)
    return wrapped(arm.joints(arm.sign * (theta - arm.offset_rad))), excess_mm


def status_of(arm: Arm, joints_rad: Array) -> Ints:
    """Return the status bits (...) of joints (..., 6); raises `ReachError` as `solved`."""
    family = _family(arm)
    theta = arm.theta(joints_rad)
    behind = family.ahead_mm(arm, joints_rad) < 0
    beyond = arm.sign[2] * wrapped(theta[..., 2] + family.bend_rad(arm)) >= 0
    flipped = joints_rad[..., 4] < 0
    status: Ints = BEHIND * behind + BEYOND * beyond + FLIPPED * flipped
    return status


def wrapped(angle: Array) -> Array:
    """Return angles in -pi < angle <= pi."""
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


_RX_BACK: Array = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # Rx(-90)


def _rz(angle: Array) -> Array:
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(angle)
    R[..., 1, 0] = np.sin(angle)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1.0
    return R


class _Family(Protocol):
    """Arms with these angles alpha, and zeros in these rows of a and d."""

    name: str
    alpha_rad: Array
    zero_a: tuple[int, ...]
    zero_d: tuple[int, ...]

    def solve(self, arm: Arm, flange: Array, status: int) -> tuple[Array, Array]:
        """Return theta (..., 6) and the excess (...), mm, for the flange in {B} (..., 4, 4)."""

    def ahead_mm(self, arm: Arm, joints_rad: Array) -> Array:
        """Return how far the arm reaches before axis 1, (...); below 0 it lies behind."""

    def bend_rad(self, arm: Arm) -> float:
        """Return the angle of the forearm's line against its link."""

    def oddities(self, arm: Arm) -> list[str]:
        """Return the parameters that are not those of this family."""
        rounding = 1e-12  # of parameters in mm and rad
        zeros = (("a", self.zero_a, arm.a_mm), ("d", self.zero_d, arm.d_mm))
        return [
            name
            for name, found, expected in (
                ("alpha", arm.alpha_rad, self.alpha_rad),
                ("beta", arm.beta_rad, np.zeros(6)),
                *(
                    (", ".join(f"{letter}{row + 1}" for row in rows), values[list(rows)], 0.0)
                    for letter, rows, values in zeros
                ),
                ("offset of axis 5", arm.offset_rad[4], 0.0),
            )
            if not bool(np.all(np.abs(found - expected) <= rounding))
        ]

    def elbow(
        self, arm: Arm, forearm_mm: float, u: Array, v: Array, status: int
    ) -> tuple[Array, Array, Array]:
        """Return theta 2, the elbow's angle and the excess for a point (u, v) in the plane."""
        upper_mm = arm.a_mm[1]
        distance = np.hypot(u, v)
        reach = abs(upper_mm) + abs(forearm_mm)
        far, near = distance - reach, abs(abs(upper_mm) - abs(forearm_mm)) - distance
        cosine = (distance**2 - upper_mm**2 - forearm_mm**2) / (2 * upper_mm * forearm_mm)
        turn = arm.sign[2] if status & BEYOND else -arm.sign[2]
        elbow = turn * np.arccos(np.clip(cosine, -1.0, 1.0))
        theta_2 = np.arctan2(v, u) - np.arctan2(
            forearm_mm * np.sin(elbow), upper_mm + forearm_mm * np.cos(elbow)
        )
        return theta_2, elbow, np.maximum(far, near)

    def turns(
        self, arm: Arm, front: Array, flange: Array, status: int, singular_rad: float
    ) -> Array:
        """q, theta 5, theta 6 (..., 3) of the flange against ``front``. At a straight wrist q is
        ``singular_rad``: only its sum with theta 6 is determined.
        """
        R = np.swapaxes(front, -1, -2) @ flange[..., :3, :3]
        side = arm.sign[4] * (1.0 if status & FLIPPED else -1.0)
        singular = 1e-12  # sine of A5 below which A4 and A6 turn about one line
        straight = np.hypot(R[..., 0, 2], R[..., 1, 2]) < singular
        q = np.arctan2(side * R[..., 1, 2], side * R[..., 0, 2])
        q = np.where(straight, singular_rad, q)
        M = np.swapaxes(_rz(q), -1, -2) @ R
        theta_5 = np.arctan2(-M[..., 0, 2], M[..., 2, 2])
        theta_6 = np.arctan2(M[..., 1, 0], M[..., 1, 1])
        return np.stack([q, theta_5, theta_6], axis=-1)


class _SphericalWrist(_Family):
    """Axes 4 to 6 meet in the wrist centre."""

    name = "a spherical wrist"
    alpha_rad = np.radians([-90.0, 0.0, -90.0, 90.0, -90.0, 0.0])
    zero_a, zero_d = (3, 4, 5), (1, 2, 4)

    def solve(self, arm: Arm, flange: Array, status: int) -> tuple[Array, Array]:
        centre = flange[..., :3, 3] - arm.d_mm[5] * flange[..., :3, 2]
        side = -1.0 if status & BEHIND else 1.0
        theta = np.empty((*flange.shape[:-2], 6))
        theta[..., 0] = np.arctan2(side * centre[..., 1], side * centre[..., 0])
        u = side * np.hypot(centre[..., 0], centre[..., 1]) - arm.a_mm[0]
        v = arm.d_mm[0] - centre[..., 2]
        forearm_mm, bend_rad = self.forearm(arm)
        theta[..., 1], elbow, excess_mm = self.elbow(arm, forearm_mm, u, v, status)
        theta[..., 2] = elbow - bend_rad
        front = _rz(theta[..., 0]) @ _RX_BACK @ _rz(theta[..., 1] + theta[..., 2]) @ _RX_BACK
        theta[..., 3:] = self.turns(arm, front, flange, status, arm.offset_rad[3])
        return theta, excess_mm

    def ahead_mm(self, arm: Arm, joints_rad: Array) -> Array:
        """Return how far the wrist centre lies before axis 1, (...)."""
        theta = arm.theta(joints_rad)
        forearm_mm, bend_rad = self.forearm(arm)
        elbow = theta[..., 1] + theta[..., 2] + bend_rad
        return np.asarray(
            arm.a_mm[0] + arm.a_mm[1] * np.cos(theta[..., 1]) + forearm_mm * np.cos(elbow)
        )

    def bend_rad(self, arm: Arm) -> float:
        return self.forearm(arm)[1]

    def forearm(self, arm: Arm) -> tuple[float, float]:
        """Return length and angle of the line from axis 3 to the wrist centre."""
        a, d = float(arm.a_mm[2]), float(arm.d_mm[3])
        return float(np.hypot(a, d)), float(np.arctan2(d, a))


class _ParallelAxes(_Family):
    """Axes 2 to 4 are parallel (Universal Robots); the arm is beside the plane of its links."""

    name = "three parallel axes"
    alpha_rad = np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
    zero_a, zero_d = (0, 3, 4, 5), ()

    def solve(self, arm: Arm, flange: Array, status: int) -> tuple[Array, Array]:
        wrist = flange[..., :3, 3] - arm.d_mm[5] * flange[..., :3, 2]  # on axis 5
        beside_mm = float(arm.d_mm[1:4].sum())
        radius_mm = np.hypot(wrist[..., 0], wrist[..., 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = np.arcsin(np.clip(np.nan_to_num(beside_mm / radius_mm), -1.0, 1.0))
        theta = np.empty((*flange.shape[:-2], 6))
        theta[..., 0] = np.arctan2(wrist[..., 1], wrist[..., 0])
        theta[..., 0] += np.pi - turn if status & BEHIND else turn
        front = _rz(theta[..., 0]) @ _RX_BACK.T
        last = self.turns(arm, front, flange, status, 0.0)
        theta[..., 4:] = last[..., 1:]
        # From axis 5 back along d5, which points along Rz(q)'s -y in the plane.
        in_plane = np.swapaxes(front, -1, -2) @ wrist[..., None]
        u = in_plane[..., 0, 0] - arm.d_mm[4] * np.sin(last[..., 0])
        v = in_plane[..., 1, 0] - arm.d_mm[0] + arm.d_mm[4] * np.cos(last[..., 0])
        theta[..., 1], theta[..., 2], excess_mm = self.elbow(arm, float(arm.a_mm[2]), u, v, status)
        theta[..., 3] = last[..., 0] - theta[..., 1] - theta[..., 2]
        return theta, np.maximum(excess_mm, abs(beside_mm) - radius_mm)

    def ahead_mm(self, arm: Arm, joints_rad: Array) -> Array:
        """Return how far the point on axis 5 lies along link 1's x, (...)."""
        links = link_transforms(arm, joints_rad)
        at = links[..., 1, :, :] @ links[..., 2, :, :] @ links[..., 3, :, :] @ links[..., 4, :, :]
        return at[..., 0, 3]

    def bend_rad(self, arm: Arm) -> float:
        """Return 0: the forearm is its link."""
        return 0.0


def _family(arm: Arm) -> _Family:
    if len(arm) != 6 or arm.prismatic:
        raise ReachError("closed-form inverse kinematics: expected six revolute joints")
    families: tuple[_Family, ...] = (_SphericalWrist(), _ParallelAxes())
    odd = [family.oddities(arm) for family in families]
    family, least = min(zip(families, odd, strict=True), key=lambda pair: len(pair[1]))
    if not least:
        return family
    raise ReachError(
        f"closed-form inverse kinematics: {', '.join(least)} are not those of an arm with "
        f"{family.name}"
    )


ROUNDING_MM = 1e-6
NAMED = 3  # poses that one message names


def inverse_kinematics(arm: Arm, poses: ArrayLike, status: int) -> Array:
    """Joints (..., 6), each within -pi..pi, for {T} in {B} (..., 4, 4) by ``status``.

    Raises `ReachError` naming the first unreachable poses and their distance, or for an arm without
    closed form (see `refined`).
    """
    joints, excess_mm = solved(arm, np.asarray(poses, dtype=float), status)
    excess = np.atleast_1d(excess_mm).ravel()
    bad = np.flatnonzero(~(excess <= ROUNDING_MM))
    if len(bad):
        named = ", ".join(f"pose {n + 1} by {excess[n]:.3f} mm" for n in bad[:NAMED])
        raise ReachError(
            f"{len(bad)} of {excess.size} poses are out of reach: {named}"
            f"{', ...' if len(bad) > NAMED else ''}; move the target or choose another station"
        )
    return joints


@dataclass(frozen=True, eq=False)
class NominalRobot:
    """A nominal arm, the status bits of its posture, limits (2, 6) and home joints (6,) in rad."""

    arm: Arm
    status: int
    limits_rad: Array
    reference_rad: Array

    def excess_mm(self, poses: ArrayLike) -> Array:
        """Return by how many mm the wrist centre is too far or too near, (...); 0 in reach."""
        excess_mm = solved(self.arm, np.asarray(poses, dtype=float), self.status)[1]
        return np.where(excess_mm <= ROUNDING_MM, 0.0, excess_mm)

    def nearest(self, poses: ArrayLike) -> Array:
        """Joints (..., 6) as `inverse_kinematics`, in the revolution nearest to home, within limits
        if possible.
        """
        joints = inverse_kinematics(self.arm, poses, self.status)
        return nearest_revolutions(joints, self.limits_rad, self.reference_rad)

    def joints_for(self, poses: ArrayLike) -> Array:
        """Return `nearest`; raises `ReachError` also where a joint leaves its limits."""
        joints = self.nearest(poses)
        degrees, limits = np.degrees(joints.reshape(-1, 6)), np.degrees(self.limits_rad)
        bad = np.argwhere(~self._within(joints).reshape(-1, 6))
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

    def reachable(self, poses: ArrayLike) -> Bools:
        """Return which poses (..., 4, 4) `joints_for` accepts, (...)."""
        joints, excess_mm = solved(self.arm, np.asarray(poses, dtype=float), self.status)
        turned = nearest_revolutions(joints, self.limits_rad, self.reference_rad)
        return np.asarray((excess_mm <= ROUNDING_MM) & self._within(turned).all(axis=-1))

    def _within(self, joints_rad: Array) -> Bools:
        low_rad, high_rad = self.limits_rad
        return np.asarray((joints_rad >= low_rad) & (joints_rad <= high_rad))


def nearest_revolutions(joints_rad: Array, limits_rad: Array, reference_rad: ArrayLike) -> Array:
    """Return the joints (..., 6) plus whole turns: within limits if possible, then nearest."""
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    options = joints_rad[..., None, :] + turns
    beyond = np.maximum(limits_rad[0] - options, options - limits_rad[1]).clip(min=0.0)
    cost = np.abs(options - np.asarray(reference_rad)) + 1e6 * beyond
    best = np.argmin(cost, axis=-2)
    return np.take_along_axis(options, best[..., None, :], axis=-2)[..., 0, :]


def joint_jacobian(arm: Arm, joints_rad: ArrayLike) -> Array:
    """Return d({T} shift in mm, rotation vector in rad)/d(joints), (..., 6, n), axes of {B}."""
    joints = np.asarray(joints_rad, dtype=float)
    links = link_transforms(arm, joints)
    frame = np.broadcast_to(np.eye(4), links[..., 0, :, :].shape)
    tip = forward(arm, joints)[..., :3, 3]
    columns = []
    for row in range(len(arm)):
        axis = arm.sign[row] * frame[..., :3, 2]
        if row in arm.prismatic:
            shift, turn = MM * axis, np.zeros_like(axis)
        else:
            shift, turn = np.cross(axis, tip - frame[..., :3, 3]), axis
        columns.append(np.concatenate([shift, turn], axis=-1))
        frame = frame @ links[..., row, :, :]
    if arm.coupling:
        second, third = arm.coupled_rows
        columns[second] = columns[second] + arm.coupling * columns[third]
    return np.stack(columns, axis=-1)


def refined(arm: Arm, poses: Array, start_rad: Array) -> tuple[Array, Bools]:
    """Joints (N, n) of any arm for poses (N, 4, 4), and which converged (N,).

    From a start (N, n), by Levenberg-Marquardt with damping by the residual, so that it also leaves
    singular starts. An arm of more than six joints stays near the start; one of fewer takes the
    position, and the orientation as far as it can.
    """
    takes_turns = len(arm) >= 6
    turn_weight = 1.0 if takes_turns else 1e-4
    joints, arrived = start_rad.copy(), np.zeros(len(poses), dtype=bool)
    length_mm = max(float(np.abs(arm.a_mm).max()), 1.0)
    scale = np.array([1.0, 1.0, 1.0, *[turn_weight * length_mm] * 3]) / length_mm
    refined_mm, refined_rad = 1e-7, 1e-10
    for _ in range(101):
        target, found = poses[~arrived], forward(arm, joints[~arrived])
        rotation = target[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
        error = np.hstack([target[..., :3, 3] - found[..., :3, 3], to_rotvec(rotation)])
        shift, turn = (np.linalg.norm(each, axis=-1) for each in (error[:, :3], error[:, 3:]))
        there = (shift <= refined_mm) & ((turn <= refined_rad) if takes_turns else True)
        arrived[~arrived] = there
        if arrived.all():
            break
        left = joints[~arrived]
        J = joint_jacobian(arm, left) * scale[:, None]
        scaled = error[~there] * scale
        damping = 0.5 * np.sum(scaled**2, axis=-1) + 1e-15
        joints[~arrived] = left + _damped(J, scaled, damping)
    return joints, arrived


def _damped(J: Array, error: Array, damping: Array) -> Array:
    """Return steps (N, n) of Levenberg and Marquardt, by the smaller of J'J and JJ'."""
    J_T = np.swapaxes(J, -1, -2)
    if J.shape[-1] > J.shape[-2]:
        normal = J @ J_T + damping[..., None, None] * np.eye(J.shape[-2])
        return np.asarray((J_T @ np.linalg.solve(normal, error[..., None]))[..., 0])
    normal = J_T @ J + damping[..., None, None] * np.eye(J.shape[-1])
    gradient = np.einsum("...ij,...i->...j", J, error)
    return np.asarray(np.linalg.solve(normal, gradient[..., None])[..., 0])
