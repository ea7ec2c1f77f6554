"""Rotations of frames, as matrices: from Z-Y-X angles, from and to rotation vectors.

scipy has these too, but its import takes longer than all else that starts an engine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.kinematics import Array


def from_zyx(angles_deg: ArrayLike) -> Array:
    """Return Rz(A) Ry(B) Rx(C) (..., 3, 3) of angles A, B, C (..., 3)."""
    angles_rad = np.radians(np.asarray(angles_deg, dtype=float))
    sines, cosines = np.sin(angles_rad), np.cos(angles_rad)
    sa, sb, sc = sines[..., 0], sines[..., 1], sines[..., 2]
    ca, cb, cc = cosines[..., 0], cosines[..., 1], cosines[..., 2]
    R = np.empty((*angles_rad.shape, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 0, 2] = (
        ca * cb,
        ca * sb * sc - sa * cc,
        ca * sb * cc + sa * sc,
    )
    R[..., 1, 0], R[..., 1, 1], R[..., 1, 2] = (
        sa * cb,
        sa * sb * sc + ca * cc,
        sa * sb * cc - ca * sc,
    )
    R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -sb, cb * sc, cb * cc
    return R


def from_rotvec(vectors_rad: ArrayLike) -> Array:
    """Return the rotations (..., 3, 3) about vectors (..., 3) by their lengths, by Rodrigues."""
    v = np.asarray(vectors_rad, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = np.cross(np.eye(3), v[..., None, :])
    small_rad = 1e-4  # below, series in the angle: their next term is beyond a double
    safe = np.where(angle < small_rad, 1.0, angle)
    first = np.where(angle < small_rad, 1.0 - angle**2 / 6.0, np.sin(angle) / safe)
    half = np.where(angle < small_rad, 0.5 - angle**2 / 48.0, np.sin(0.5 * angle) / safe)
    rotation: Array = np.eye(3) + first * K + 2.0 * half**2 * (K @ K)
    return rotation


def to_rotvec(rotations: Array) -> Array:
    """Return the rotation vectors (..., 3), of at most pi, of rotations (..., 3, 3).

    By the quaternion of its largest component, so that it is exact near 0 and near pi.
    """
    R = np.asarray(rotations, dtype=float)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(R, (-2, -1), (0, 1))
    rows = [  # 4 q q^T, q = (x, y, z, w)
        [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
    ]
    Q = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(Q, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True) * np.where(q[..., 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    scale = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 0.0)
    vector: Array = q[..., :3] * scale
    return vector


def turned_deg(orientation: Array, poses: Array) -> Array:
    """Return by how much poses (N, 4, 4) are turned from an orientation (3, 3), deg (N,)."""
    cosine = (np.einsum("nij,ij->n", poses[:, :3, :3], orientation) - 1.0) / 2.0
    turned: Array = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return turned
