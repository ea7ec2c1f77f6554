"""Rotations, frames and serial arms of the simulated cell, with mathematics of their own.

Nothing comes from `hilcell.geometry`: a calibration is tested only if truth and controller do not
share its code. Frames are (4, 4), lengths mm, angles rad unless named.

An arm is a product of exponentials, ``T(q) = exp(s1 q1) .. exp(s6 q6) T(0)`` (Brockett 1984): each
joint rotates all distal bodies about its line at joints zero, given in the robot's base frame. The
axis's direction is the joint's positive sense; there are no other signs or offsets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from hilcell.cell.tables import Pose
from hilcell.ports import HilcellError

Array = NDArray[np.float64]
_EYE = np.eye(3)


def axis_rotation(axes: Array, angles_rad: Array) -> Array:
    """Return rotations (..., 3, 3) by angles (...) about unit axes (..., 3), after Rodrigues."""
    return axis_rotation_by(*axis_generators(axes), angles_rad)


def axis_generators(axes: Array) -> tuple[Array, Array]:
    """Return the matrices (..., 3, 3) of the cross product with unit axes (..., 3), and squares."""
    K = np.zeros((*axes.shape, 3))
    x, y, z = axes[..., 0], axes[..., 1], axes[..., 2]
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -z, y, -x
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = z, -y, x
    return K, K @ K


def axis_rotation_by(K: Array, squares: Array, angles_rad: Array) -> Array:
    """Return as `axis_rotation`, from known `axis_generators`."""
    sine = np.sin(angles_rad)[..., None, None]
    versine = (1.0 - np.cos(angles_rad))[..., None, None]
    rotated: Array = _EYE + sine * K + versine * squares
    return rotated


def rotation(vector_rad: Array) -> Array:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector_rad))
    axis = vector_rad / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    return axis_rotation(axis, np.array(angle))


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,) of a rotation (3, 3), of an angle up to pi.

    By the quaternion, from its largest component (Shepperd 1978); in plain numbers, which is
    faster: a controller sends it hundreds of times a second.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()
    w, x, y, z = max(
        (1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1.0 + xx - yy - zz, yx + xy, xz + zx),
        (xz - zx, yx + xy, 1.0 - xx + yy - zz, zy + yz),
        (yx - xy, xz + zx, zy + yz, 1.0 - xx - yy + zz),
        key=lambda row: sum(each * each for each in row),
    )
    sine = math.copysign(math.hypot(x, y, z), w)
    angle = 2.0 * math.atan2(abs(sine), abs(w))
    return np.array([x, y, z]) * (angle / sine if sine else 0.0)


def rigid(R: Array, shift_mm: Array) -> Array:
    """Return the frame (4, 4) of a rotation and a shift (3,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, shift_mm
    return T


def product(frames: Sequence[Array]) -> Array:
    """Return the product of frames (..., 4, 4), the first the outermost."""
    if frames[0].ndim == 2:
        return reduce(np.ndarray.dot, frames)  # a third of the time of matmul
    return reduce(np.matmul, frames)


def frame(pose: Pose) -> Array:
    """Return the matrix (4, 4) of a pose: Rz(A) Ry(B) Rx(C)."""
    angles = np.radians([pose.a_deg, pose.b_deg, pose.c_deg])
    Rz, Ry, Rx = axis_rotation(np.eye(3)[::-1], angles)
    return rigid(Rz @ Ry @ Rx, np.array([pose.x_mm, pose.y_mm, pose.z_mm]))


def components(T: Array) -> Array:
    """Return X, Y, Z in mm and A, B, C in deg (6,) of a frame (4, 4); A = 0 at B = +-90."""
    R = T[:3, :3]
    cos_b = float(np.hypot(R[0, 0], R[1, 0]))
    b = np.arctan2(-R[2, 0], cos_b)
    gimbal = 1e-9  # cosine of B below which A and C rotate about the same line
    if cos_b > gimbal:
        a, c = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2])
    else:
        a, c = 0.0, np.arctan2(-R[1, 2], R[1, 1])
    return np.array([*T[:3, 3], *np.degrees([a, b, c])])


def inverse(T: Array) -> Array:
    """Return the inverse of a rigid motion (4, 4)."""
    return rigid(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def transform_point(T: Array, point_mm: Array) -> Array:
    """Return a point (3,) transformed by rigid motions (..., 4, 4)."""
    return T[..., :3, :3] @ point_mm + T[..., :3, 3]


@dataclass(frozen=True, slots=True)
class Chain:
    """Joint axes, unit vectors (6, 3), a point (6, 3) on each, the last frame (4, 4) at zero.

    Joints are the controller's: axis 3 also turns by ``coupling`` times axis 2, so that -1 makes
    joint 3 the forearm's angle to the horizontal.
    """

    axes: Array
    points_mm: Array
    last: Array
    coupling: float = 0.0
    _generators: tuple[Array, Array] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_generators", axis_generators(self.axes))

    def pose(self, joints_rad: Array, strain: float = 0.0) -> Array:
        """Return the last frame (..., 4, 4) at joints (..., 6).

        All lengths of the arm are longer by a share ``strain``.
        """
        points_mm, last = self.points_mm, self.last
        if strain:
            points_mm, last = points_mm * (1.0 + strain), last.copy()
            last[:3, 3] *= 1.0 + strain
        return product([*self._joint_motions(joints_rad, points_mm), last])

    def commands(self, turned_rad: Array) -> Array:
        """Return the controller's joints (..., 6) for turns (..., 6) about the axes."""
        joints_rad = turned_rad.copy()
        joints_rad[..., 2] -= self.coupling * turned_rad[..., 1]
        return joints_rad

    def turns(self, joints_rad: Array) -> Array:
        """Return the turns (..., 6) about the axes at joints (..., 6)."""
        if not self.coupling:
            return joints_rad
        turned_rad = joints_rad.copy()
        turned_rad[..., 2] += self.coupling * joints_rad[..., 1]
        return turned_rad

    def lines(self, joints_rad: Array) -> tuple[list[tuple[Array, Array]], Array]:
        """Return direction (..., 3) and a point (..., 3) of each axis, and the last frame's."""
        moved = [np.broadcast_to(np.eye(4), (*joints_rad.shape[:-1], 4, 4))]  # of bodies 0 .. 6
        for each in self._joint_motions(joints_rad, self.points_mm):
            moved.append(moved[-1] @ each)
        placed = zip(moved[:-1], self.axes, self.points_mm, strict=True)
        lines = [
            (T[..., :3, :3] @ axis, transform_point(T, point_mm)) for T, axis, point_mm in placed
        ]
        return lines, (moved[-1] @ self.last)[..., :3, 3]

    def levers(self, joints_rad: Array) -> Array:
        """Return the vectors (..., 6, 3) from the point on each axis to the last frame."""
        lines, tip_mm = self.lines(joints_rad)
        return np.stack([tip_mm - point_mm for _, point_mm in lines], axis=-2)

    def jacobian(self, joints_rad: Array) -> Array:
        """Return d(shift in mm, rotation in rad) / d(joints) of the last frame, (..., 6, 6)."""
        lines, tip_mm = self.lines(joints_rad)
        columns = [
            np.concatenate([np.cross(direction, tip_mm - point_mm), direction], axis=-1)
            for direction, point_mm in lines
        ]
        columns[1] = columns[1] + self.coupling * columns[2]
        return np.stack(columns, axis=-1)

    def solve(self, poses: Array, start_rad: Array) -> Array:
        """Return joints (N, 6) for poses (N, 4, 4) by damped least squares from a start (6,).

        The posture is the start's. Raises `HilcellError` where it does not converge.
        """
        joints = np.tile(start_rad, (len(poses), 1))
        longest_step_rad = 0.3
        steps = 60
        scale_mm = 1000.0  # weighs as much as a radian
        converged = 1e-10
        for _ in range(steps):
            actual = self.pose(joints)
            # (shift / scale_mm, small rotation) to the target pose, (N, 6)
            shift = (poses[:, :3, 3] - actual[:, :3, 3]) / scale_mm
            columns = np.swapaxes(actual[:, :3, :3], -1, -2), np.swapaxes(poses[:, :3, :3], -1, -2)
            error = np.concatenate([shift, 0.5 * np.cross(*columns).sum(axis=1)], axis=-1)
            if np.abs(error).max() < converged:
                return joints
            J = self.jacobian(joints)
            J[..., :3, :] /= scale_mm
            damping = (0.1 * np.sum(error**2, axis=-1))[:, None, None] * np.eye(6)
            transposed = np.swapaxes(J, -1, -2)
            step = np.linalg.solve(transposed @ J + damping, transposed @ error[..., None])[..., 0]
            joints = joints + step.clip(-longest_step_rad, longest_step_rad)
        raise HilcellError("simulated robot: a reference pose of the machine is out of reach")

    def _joint_motions(self, joints_rad: Array, points_mm: Array) -> list[Array]:
        """Return the rotation (..., 4, 4) of each joint about its axis through a point."""
        R = axis_rotation_by(*self._generators, self.turns(joints_rad))
        single = np.zeros((*joints_rad.shape, 4, 4))
        single[..., :3, :3], single[..., 3, 3] = R, 1.0
        single[..., :3, 3] = points_mm - (R @ points_mm[..., None])[..., 0]
        return [single[..., number, :, :] for number in range(6)]


def axes_from_dh(
    a_mm: Array, alpha_rad: Array, d_mm: Array, offset_rad: Array, sign: Array
) -> tuple[Array, Array, Array]:
    """Return axes, points and the flange of Denavit-Hartenberg rows, each (6,).

    At joints zero; each joint rotates about the z axis of the frame before it.
    """
    T, axes, points_mm = np.eye(4), np.zeros((6, 3)), np.zeros((6, 3))
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    for row in range(6):
        axes[row], points_mm[row] = sign[row] * T[:3, 2], T[:3, 3]
        T = T @ rigid(axis_rotation(z, offset_rad[row]), d_mm[row] * z)
        T = T @ rigid(axis_rotation(x, alpha_rad[row]), a_mm[row] * x)
    return axes, points_mm, T
