"""Serial chains of six revolute joints as URDF states them, and the same arms after Denavit and
Hartenberg.

In a chain each joint has an origin, its frame at q = 0 in the link before, and an axis in that
frame: ``T = O_1 Rot(axis_1, q_1) ... O_6 Rot(axis_6, q_6) tip``. Every chain is an `Arm` between a
base and a tool frame, exactly. Row i carries axis i into axis i + 1 (row 6: into the tip's z). Two
lines have a common normal, which standard DH follows with beta = 0; it runs off to infinity as they
become parallel. There Hayati's form takes over, in which d is free: the row meets the next axis at
the next joint's origin. A chain has more numbers than its motion needs: an arm that returns has
its frames elsewhere on the same axes, and `beside` puts them near the nominal ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.frames import cross_matrix, inverse, matrix
from hilcell.geometry.kinematics import Arm, Array, link_transforms

NEARLY_PARALLEL = 0.1  # sine of the angle between axes: below it Hayati's form is used
Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Chain:
    """Origins (6, 4, 4) in mm, unit axes (6, 3), and the tip's frame (4, 4) in the last link."""

    origins: Array
    axes: Array
    tip: Array

    @property
    def frames(self) -> Array:
        """Return the joints' frames and the tip's in the root link at q = 0, (7, 4, 4)."""
        frames = [self.origins[0]]
        for step in (*self.origins[1:], self.tip):
            frames.append(frames[-1] @ step)
        return np.array(frames)


def arm_of(chain: Chain) -> tuple[Array, Arm]:
    """Return base (4, 4) and arm: ``base @ forward(arm, q)`` is the chain's tip in its root."""
    frames = chain.frames
    along = np.vstack([chain.axes, Z])
    base = frame = frames[0] @ matrix(_turn(Z, chain.axes[0]), np.zeros(3))
    rows = np.zeros((6, 5))
    for row in range(6):
        seen = inverse(frame) @ frames[row + 1]
        rows[row] = _row(seen[:3, 3], seen[:3, :3] @ along[row + 1])
        frame = frame @ link_transforms(_arm(rows, np.eye(4)), np.zeros(6))[row]
    return base, _arm(rows, inverse(frame) @ frames[6])


def chain_of(base: Array, arm: Arm) -> Chain:
    """Return the chain that moves as ``base @ forward(arm, q)``; its axes are z or -z."""
    links = link_transforms(arm, np.zeros(6))
    axes = np.zeros((6, 3))
    axes[:, 2] = arm.sign
    return Chain(np.concatenate([base[None], links[:5]]), axes, links[5] @ arm.tool)


def beside(chain: Chain, nominal: Chain) -> Chain:
    """Return a chain that moves as ``chain``, with the axes of ``nominal`` and frames near its own.

    Each joint's frame is the nominal one, turned the least that brings its axis parallel to the
    wanted one, and shifted the least that brings its origin onto it.
    """
    found, near = chain.frames, nominal.frames
    frames = found.copy()
    for joint in range(6):
        wanted = found[joint, :3, :3] @ chain.axes[joint]
        R = near[joint, :3, :3]
        on_axis, origin = found[joint, :3, 3], near[joint, :3, 3]
        frames[joint] = matrix(
            _turn(R @ nominal.axes[joint], wanted) @ R,
            on_axis + np.dot(origin - on_axis, wanted) * wanted,
        )
    steps = inverse(frames[:6]) @ frames[1:]
    return Chain(np.concatenate([frames[:1], steps[:5]]), nominal.axes, steps[5])


def _arm(rows: Array, tool: Array) -> Arm:
    offset, d, a, alpha, beta = rows.T
    return Arm(a, alpha, d, offset, np.ones(6), tool, beta)


def _row(point_mm: Array, along: Array) -> tuple[float, float, float, float, float]:
    """Return theta, d, a, alpha, beta of the row that carries the z axis into a line.

    The line is given by a point (3,) on it and its unit direction (3,), in the row's frame.
    """
    no_length_mm = 1e-10  # rounding, whose direction means nothing
    if not np.hypot(along[0], along[1]) > NEARLY_PARALLEL:
        a = float(np.hypot(point_mm[0], point_mm[1]))
        a = a if a > no_length_mm else 0.0
        theta = float(np.arctan2(point_mm[1], point_mm[0])) if a else 0.0
        x, y, z = _seen_along(theta, along)
        beta = float(np.arctan2(x, np.hypot(y, z)))
        return theta, float(point_mm[2]), a, float(np.arctan2(-y, z)), beta
    normal = np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])
    a = float(normal @ point_mm)
    a = a if abs(a) > no_length_mm else 0.0
    # No row goes a negative way, nor, where it goes none, turns by over 90 deg.
    aback = normal[0] < -no_length_mm or (normal[0] < no_length_mm and normal[1] < 0.0)
    if a < 0.0 or (a == 0.0 and aback):
        normal, a = -normal, abs(a)
    theta = float(np.arctan2(normal[1], normal[0]))
    _, y, z = _seen_along(theta, along)
    _, aside, height = _seen_along(theta, point_mm)
    return theta, height - aside / y * z, a, float(np.arctan2(-y, z)), 0.0


def _seen_along(theta: float, vector: Array) -> tuple[float, float, float]:
    """Return a vector (3,) as a frame sees it that is turned about z by ``theta``."""
    c, s = np.cos(theta), np.sin(theta)
    x, y, z = vector
    return float(c * x + s * y), float(c * y - s * x), float(z)


def _turn(start: Array, end: Array) -> Array:
    """Return a rotation (3, 3) from one unit vector (3,) to another, the smallest up to 90 deg."""
    cosine = float(start @ end)
    if cosine < 0.0:
        aside = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        aside /= np.linalg.norm(aside)
        return _turn(-start, end) @ (2.0 * np.outer(aside, aside) - np.eye(3))
    K = cross_matrix(np.cross(start, end))
    return np.eye(3) + K + K @ K / (1.0 + cosine)
