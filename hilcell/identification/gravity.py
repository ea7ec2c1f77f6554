"""How gravity loads axes 2 and 3: the slopes of upper arm and forearm against the horizontal.

The base's z is taken as vertical, up or down. A link whose mass lies on its line loads an axis
behind it by the cosine of its slope; mass beside the line adds the sine. So a coefficient is the
joint's deflection (rad) where its load is greatest.
"""

from __future__ import annotations

import numpy as np

from hilcell.geometry.kinematics import Arm, Array, link_transforms

AXES = (1, 1, 1, 1, 2, 2)
NAMES = (
    "axis 2: cos upper arm",
    "axis 2: sin upper arm",
    "axis 2: cos forearm",
    "axis 2: sin forearm",
    "axis 3: cos forearm",
    "axis 3: sin forearm",
)


def gravity_basis(arm: Arm, joints_rad: Array) -> Array:
    """Return the loads (..., 6), -1 .. 1, that deflect `AXES`, in the order of `NAMES`."""
    links = link_transforms(arm, joints_rad)
    shoulder = links[..., 0, :, :]
    elbow = shoulder @ links[..., 1, :, :]
    wrist = elbow @ links[..., 2, :, :] @ links[..., 3, :, :]
    upper = _direction(elbow[..., :3, 3] - shoulder[..., :3, 3])
    fore = _direction(wrist[..., :3, 3] - elbow[..., :3, 3])
    axis_2, axis_3 = shoulder[..., :3, 2], elbow[..., :3, 2]
    columns = [
        _lever(axis_2, upper),
        upper[..., 2],
        _lever(axis_2, fore),
        fore[..., 2],
        _lever(axis_3, fore),
        fore[..., 2],
    ]
    return np.stack(columns, axis=-1)


def _lever(axis: Array, link: Array) -> Array:
    """Return how fast a link's tip rises per turn about an axis: the cosine of its slope."""
    lever: Array = axis[..., 0] * link[..., 1] - axis[..., 1] * link[..., 0]
    return lever


def _direction(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return unit
