"""Loads of revolute axes by the arm's own weight and by a tool's, under which they deflect.

Gravity acts along the first revolute axis, up or down. A link whose mass lies on its line loads an
axis behind it by the cosine of its slope against the horizontal; mass beside the line adds the
sine. Of six revolute joints, on prismatic ones or not, axes 2 and 3 bear upper arm and forearm.
Other chains are not divided so: each axis bears every link before it, by cosines. A tool loads
every axis, by a lever to the flange and one from there to its unknown centre of mass: one
coefficient for each coordinate. A coefficient is a joint's deflection (rad) at the greatest load.
"""

from __future__ import annotations

import numpy as np

from hilcell.geometry.kinematics import MM, Arm, Array, link_transforms

SIX_REVOLUTE = ((1, "upper arm"), (1, "forearm"), (2, "forearm"))  # axis, and what loads it
LEVERS = ("flange", "x", "y", "z")


def gravity_loads(arm: Arm) -> list[tuple[int, str]]:
    """Return axis and name of each column of `gravity_basis`."""
    first = _first_of_six(arm)
    if first is None:
        return [(axis, f"cos link {link + 1}") for axis, link in _bearings(arm)]
    return [(first + axis, f"{w} {link}") for axis, link in SIX_REVOLUTE for w in ("cos", "sin")]


def gravity_basis(arm: Arm, joints_rad: Array) -> Array:
    """Return the loads (..., G) of `gravity_loads`, about -1 .. 1."""
    frames, first = _frames(arm, joints_rad), _first_of_six(arm)
    if first is None:
        return _all_bearings(arm, frames)
    shoulder, elbow, wrist = frames[first + 1], frames[first + 2], frames[first + 4]
    upper = _direction(elbow[..., :3, 3] - shoulder[..., :3, 3])
    fore = _direction(wrist[..., :3, 3] - elbow[..., :3, 3])
    axis_2, axis_3 = shoulder[..., :3, 2], elbow[..., :3, 2]
    pairs = ((axis_2, upper), (axis_2, fore), (axis_3, fore))
    columns = [each for axis, link in pairs for each in (_lever(axis, link), link[..., 2])]
    return np.stack(columns, axis=-1)


def tool_loads(arm: Arm) -> list[tuple[int, str]]:
    """Return axis and name of each column of `tool_basis`."""
    return [(axis, f"tool {lever}") for axis in _revolute(arm) for lever in LEVERS]


def tool_basis(arm: Arm, joints_rad: Array) -> Array:
    """A tool's loads (..., T), about -1 .. 1: of each revolute axis, by the flange's lever, over
    the longest there is, and by a mass off the flange along its x, y and z.
    """
    frames = _frames(arm, joints_rad)
    lengths_mm = np.abs(arm.a_mm) + np.abs(arm.d_mm)
    flange = frames[-1]
    columns = [np.zeros((*flange.shape[:-2], 0))]
    for row in _revolute(arm):
        reach_mm = max(float(lengths_mm[row:].sum()), 1.0)
        axis = frames[row][..., :3, 2]
        arms = [(flange[..., :3, 3] - frames[row][..., :3, 3]) / reach_mm]
        arms += [flange[..., :3, n] for n in range(3)]
        columns.append(np.stack([_lever(axis, each) for each in arms], axis=-1))
    return np.concatenate(columns, axis=-1)


def flange_levers_mm(arm: Arm, joints_rad: Array) -> Array:
    """Return the level distances (M, n) of the flange from each row's axis."""
    frames = _frames(arm, joints_rad)
    origins_mm = np.stack([frame[..., :3, 3] for frame in frames], axis=-2)
    along_mm = origins_mm[..., -1:, :2] - origins_mm[..., :-1, :2]
    return np.asarray(np.linalg.norm(along_mm, axis=-1), dtype=float)


def _first_of_six(arm: Arm) -> int | None:
    """Return the first of six revolute joints behind prismatic ones, None for other chains."""
    first = len(arm) - 6
    return first if arm.prismatic == tuple(range(first)) and first >= 0 else None


def _revolute(arm: Arm) -> list[int]:
    return [row for row in range(len(arm)) if row not in arm.prismatic]


def _bearings(arm: Arm) -> list[tuple[int, int]]:
    """Return each revolute axis with the links, from 0, that load it."""
    least_mm = 1.0  # of a link
    aside, along = np.abs(arm.a_mm) > least_mm, np.abs(arm.d_mm) > least_mm
    along[list(arm.prismatic)] = True
    return [
        (axis, link)
        for axis in _revolute(arm)
        for link in range(axis, len(arm))
        if aside[link] or (along[link] and link > axis)
    ]


def _all_bearings(arm: Arm, frames: list[Array]) -> Array:
    columns = [np.zeros((*frames[0].shape[:-2], 0))]
    for axis, link in _bearings(arm):
        along = frames[link + 1][..., :3, 3] - frames[link][..., :3, 3]
        length = along / MM if link in arm.prismatic else _direction(along)
        columns.append(_lever(frames[axis][..., :3, 2], length)[..., None])
    return np.concatenate(columns, axis=-1)


def _frames(arm: Arm, joints_rad: Array) -> list[Array]:
    """Return the frames (..., 4, 4) of base and rows, seen with the first revolute axis upright."""
    links, upright = link_transforms(arm, joints_rad), np.eye(4)
    below = min(_revolute(arm), default=0)
    for link in link_transforms(arm, np.zeros(len(arm)))[:below]:
        upright = upright @ link
    upright[:3, :3], upright[:3, 3] = upright[:3, :3].T, 0.0
    frames = [np.broadcast_to(upright, links[..., 0, :, :].shape)]
    for row in range(len(arm)):
        frames.append(frames[-1] @ links[..., row, :, :])
    return frames


def _lever(axis: Array, link: Array) -> Array:
    """Rise of a link's tip per rotation about an axis: the cosine of its slope."""
    return axis[..., 0] * link[..., 1] - axis[..., 1] * link[..., 0]


def _direction(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0))
