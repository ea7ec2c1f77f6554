"""A serial arm as a product of exponentials: six joint axes where they lie at joints zero.

``T(q) = exp(s1 q1) .. exp(s6 q6) T(0)`` (Brockett 1984): each joint turns everything behind it
about a line that is stated once, in the robot's base frame. Lengths mm, angles rad. A joint's
positive sense is its axis's direction; there are no signs or offsets beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fakes.truth.transforms import Array, generators, product, rigid, turned, turned_by
from hilcell.ports import HilcellError

SCALE_MM = 1000.0  # a radian counts as much as this


@dataclass(frozen=True, slots=True)
class Chain:
    """Joint axes, unit vectors (6, 3), a point (6, 3) on each, the last frame (4, 4) at zero."""

    axes: Array
    points_mm: Array
    last: Array
    _generators: tuple[Array, Array] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_generators", generators(self.axes))

    def pose(self, joints_rad: Array, strain: float = 0.0) -> Array:
        """Return the last frame (..., 4, 4) at joints (..., 6).

        All lengths of the arm are longer by a share ``strain``.
        """
        points_mm, last = self.points_mm, self.last
        if strain:
            points_mm, last = points_mm * (1.0 + strain), last.copy()
            last[:3, 3] *= 1.0 + strain
        return product([*self._turns(joints_rad, points_mm), last])

    def axis(self, number: int, joints_rad: Array) -> tuple[Array, Array]:
        """Return direction (..., 3) and a point (..., 3) of one axis, counted from 0."""
        return self.lines(joints_rad)[number]

    def lines(self, joints_rad: Array) -> list[tuple[Array, Array]]:
        """Return direction (..., 3) and a point (..., 3) of each axis."""
        moved = zip(self._moved(joints_rad)[:-1], self.axes, self.points_mm, strict=True)
        return [(T[..., :3, :3] @ axis, _at(T, point_mm)) for T, axis, point_mm in moved]

    def levers(self, joints_rad: Array) -> Array:
        """Return the vectors (..., 6, 3) from the point on each axis to the last frame."""
        moved = self._moved(joints_rad)
        tip_mm = (moved[-1] @ self.last)[..., :3, 3]
        pairs = zip(moved[:-1], self.points_mm, strict=True)
        return np.stack([tip_mm - _at(T, point_mm) for T, point_mm in pairs], axis=-2)

    def jacobian(self, joints_rad: Array) -> Array:
        """Return d(shift in mm, turn in rad) / d(joints) of the last frame, (..., 6, 6)."""
        moved = self._moved(joints_rad)
        tip_mm = (moved[-1] @ self.last)[..., :3, 3]
        columns = []
        for number, T in enumerate(moved[:-1]):
            direction = T[..., :3, :3] @ self.axes[number]
            lever_mm = tip_mm - _at(T, self.points_mm[number])
            columns.append(np.concatenate([np.cross(direction, lever_mm), direction], axis=-1))
        return np.stack(columns, axis=-1)

    def solve(self, poses: Array, start_rad: Array) -> Array:
        """Return joints (N, 6) for poses (N, 4, 4) by damped least squares from a start (6,).

        The posture is the start's. Raises `HilcellError` where it does not arrive.
        """
        joints = np.tile(start_rad, (len(poses), 1))
        longest_step_rad = 0.3
        steps = 60
        arrived = 1e-10  # of SCALE_MM
        for _ in range(steps):
            found = self.pose(joints)
            # (shift / SCALE_MM, about the turn) from found to wanted, (N, 6)
            shift = (poses[:, :3, 3] - found[:, :3, 3]) / SCALE_MM
            columns = np.swapaxes(found[:, :3, :3], -1, -2), np.swapaxes(poses[:, :3, :3], -1, -2)
            error = np.concatenate([shift, 0.5 * np.cross(*columns).sum(axis=1)], axis=-1)
            if np.abs(error).max() < arrived:
                return joints
            J = self.jacobian(joints)
            J[..., :3, :] /= SCALE_MM
            damping = (0.1 * np.sum(error**2, axis=-1))[:, None, None] * np.eye(6)
            transposed = np.swapaxes(J, -1, -2)
            step = np.linalg.solve(transposed @ J + damping, transposed @ error[..., None])[..., 0]
            joints = joints + step.clip(-longest_step_rad, longest_step_rad)
        raise HilcellError("simulated robot: a reference pose of the machine is out of reach")

    def _moved(self, joints_rad: Array) -> list[Array]:
        """Return the motion (..., 4, 4) of bodies behind 0, 1, .. 6 joints."""
        moved = [np.broadcast_to(np.eye(4), (*joints_rad.shape[:-1], 4, 4))]
        for each in self._turns(joints_rad, self.points_mm):
            moved.append(moved[-1] @ each)
        return moved

    def _turns(self, joints_rad: Array, points_mm: Array) -> list[Array]:
        """Return the motion (..., 4, 4) of each joint alone, about its axis through a point."""
        R = turned_by(*self._generators, joints_rad)
        single = np.zeros((*joints_rad.shape, 4, 4))
        single[..., :3, :3], single[..., 3, 3] = R, 1.0
        single[..., :3, 3] = points_mm - (R @ points_mm[..., None])[..., 0]
        return [single[..., number, :, :] for number in range(6)]


def from_rows(
    a_mm: Array, alpha_rad: Array, d_mm: Array, offset_rad: Array, sign: Array
) -> tuple[Array, Array, Array]:
    """Return axes, points and the flange of Denavit-Hartenberg rows, each (6,).

    Walks along the rows at joints zero: each joint turns about the z axis on which it stands.
    """
    T, axes, points_mm = np.eye(4), np.zeros((6, 3)), np.zeros((6, 3))
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    for row in range(6):
        axes[row], points_mm[row] = sign[row] * T[:3, 2], T[:3, 3]
        T = T @ rigid(turned(z, offset_rad[row]), d_mm[row] * z)
        T = T @ rigid(turned(x, alpha_rad[row]), a_mm[row] * x)
    return axes, points_mm, T


def _at(T: Array, point_mm: Array) -> Array:
    return T[..., :3, :3] @ point_mm + T[..., :3, 3]
