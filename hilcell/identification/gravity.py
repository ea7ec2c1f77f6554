"""How gravity loads the axes: by the arm's own weight, and by the weight of a tool.

The base's z is taken as vertical, up or down. A link whose mass lies on its line loads an axis
behind it by the cosine of its slope against the horizontal; mass beside the line adds the sine. A
tool loads every axis, by a lever to the flange and by one from there to its centre of mass, of
which nothing is known: one coefficient for each of its coordinates. A coefficient is a joint's
deflection (rad) where its load is greatest.
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
TOOL_AXES = tuple(axis for axis in range(6) for _ in range(4))
TOOL_NAMES = tuple(
    f"axis {axis + 1}: tool {lever}" for axis in range(6) for lever in ("flange", "x", "y", "z")
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


def tool_basis(arm: Arm, joints_rad: Array) -> Array:
    """Return a tool's loads (..., 24), -1 .. 1: of each axis in turn by the flange's lever, over
    the longest there is, and by a mass off the flange along its x, y and z.
    """
    links = link_transforms(arm, joints_rad)
    frames = [np.broadcast_to(np.eye(4), links[..., 0, :, :].shape)]
    for row in range(6):
        frames.append(frames[-1] @ links[..., row, :, :])
    lengths_mm = np.abs(arm.a_mm) + np.abs(arm.d_mm)
    flange, columns = frames[6], []
    least_reach_mm = 1.0
    for row in range(6):
        reach_mm = max(float(lengths_mm[row:].sum()), least_reach_mm)
        axis = frames[row][..., :3, 2]
        columns.append(_lever(axis, (flange[..., :3, 3] - frames[row][..., :3, 3]) / reach_mm))
        columns += [_lever(axis, flange[..., :3, n]) for n in range(3)]
    return np.stack(columns, axis=-1)


def _lever(axis: Array, link: Array) -> Array:
    """Return how fast a link's tip rises per turn about an axis: the cosine of its slope."""
    return axis[..., 0] * link[..., 1] - axis[..., 1] * link[..., 0]


def _direction(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Array = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return unit
