"""Angles of Mecademic: alpha, beta, gamma in deg about the moving x, y and z, in this order.

Backwards they are hilcell's Z-Y-X angles: Rx(a) Ry(b) Rz(c) is the inverse of Rz(-c) Ry(-b) Rx(-a).
"""

from __future__ import annotations

import numpy as np

from hilcell.geometry.frames import from_zyx, matrix, zyx_from_pose
from hilcell.ports import Array


def rotations(angles_deg: Array) -> Array:
    """Return rotations (..., 3, 3) of angles (..., 3)."""
    return np.swapaxes(from_zyx(-angles_deg[..., ::-1]), -1, -2)


def angles(R: Array) -> Array:
    """Return the angles (3,) in deg of a rotation (3, 3)."""
    return -zyx_from_pose(matrix(R.T, np.zeros(3)))[:2:-1]
