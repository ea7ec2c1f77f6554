"""Rotations and frames of the simulated cell, by its own mathematics.

Nothing here comes from `hilcell.geometry`: a calibration is worth something only if truth and
controller do not share its code. Frames are (4, 4), lengths mm, angles rad unless named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from hilcell.cell.tables import Pose

Array = NDArray[np.float64]
UNTURNED = np.eye(3)


def turned(axes: Array, angles_rad: Array) -> Array:
    """Return rotations (..., 3, 3) by angles (...) about unit axes (..., 3), after Rodrigues."""
    return turned_by(*generators(axes), angles_rad)


def generators(axes: Array) -> tuple[Array, Array]:
    """Return the matrices (..., 3, 3) of the cross product with unit axes (..., 3), and squares."""
    K = np.zeros((*axes.shape, 3))
    x, y, z = axes[..., 0], axes[..., 1], axes[..., 2]
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -z, y, -x
    K[..., 1, 0], K[..., 2, 0], K[..., 2, 1] = z, -y, x
    return K, K @ K


def turned_by(K: Array, squares: Array, angles_rad: Array) -> Array:
    """Return what `turned` does, for axes of which the `generators` are known."""
    sine = np.sin(angles_rad)[..., None, None]
    versine = (1.0 - np.cos(angles_rad))[..., None, None]
    return UNTURNED + sine * K + versine * squares


def rotation(vector_rad: Array) -> Array:
    """Return the rotation (3, 3) of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector_rad))
    axis = vector_rad / angle if angle > 0 else np.array([0.0, 0.0, 1.0])
    return turned(axis, np.array(angle))


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,) of a rotation (3, 3), of an angle up to pi.

    By the quaternion, from its largest component (Shepperd 1978); in plain numbers, for a
    controller states it hundreds of times a second.
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
        return reduce(np.ndarray.dot, frames)  # the same for single ones, in a third of the time
    return reduce(np.matmul, frames)


def frame(pose: Pose) -> Array:
    """Return the matrix (4, 4) of a stated frame: Rz(A) Ry(B) Rx(C)."""
    angles = np.radians([pose.a_deg, pose.b_deg, pose.c_deg])
    Rz, Ry, Rx = turned(np.eye(3)[::-1], angles)
    return rigid(Rz @ Ry @ Rx, np.array([pose.x_mm, pose.y_mm, pose.z_mm]))


def components(T: Array) -> Array:
    """Return X, Y, Z in mm and A, B, C in deg (6,) of a frame (4, 4); A = 0 at B = +-90."""
    R = T[:3, :3]
    cos_b = float(np.hypot(R[0, 0], R[1, 0]))
    b = np.arctan2(-R[2, 0], cos_b)
    gimbal = 1e-9  # cosine of B below which A and C turn about one line
    if cos_b > gimbal:
        a, c = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(R[2, 1], R[2, 2])
    else:
        a, c = 0.0, np.arctan2(-R[1, 2], R[1, 1])
    return np.array([*T[:3, 3], *np.degrees([a, b, c])])


def inverse(T: Array) -> Array:
    """Return the inverse of a rigid motion (4, 4)."""
    return rigid(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def carried(T: Array, point_mm: Array) -> Array:
    """Return a point (3,) carried by a rigid motion (4, 4)."""
    return T[:3, :3] @ point_mm + T[:3, 3]
