"""Serial arms after Denavit-Hartenberg: forward kinematics of many poses at once.

Standard form (eq 2): ``A_i = Rot(z, theta_i) Trans(0, 0, d_i) Trans(a_i, 0, 0) Rot(x, alpha_i)``,
``theta_i = sign_i q_i + offset_i``, with Hayati's ``Rot(y, beta_i)`` appended, because plain DH is
singular for parallel neighbours (axes 2 and 3). Lengths mm, angles rad.

A prismatic joint shifts along z in place of a rotation about it: ``d_i + 1000 sign_i q_i``. Its
values are m, as in a URDF: a radian moves an arm's tool by about a metre, so values, errors and
scatter of both kinds of joints are of one size. Names say ``_rad``, whatever the kind.

Some controllers count axis 3 from the horizontal or from link 1, not from link 2: a motion of their
joint 2 alone turns axis 3 as well. `Arm.angles` and `Arm.joints` alone convert between joints as
the controller counts them and angles of the axes, ``q_3 + coupling q_2`` on axis 3. All errors of
an arm (zeros, waves, lost motion, scatter) are errors of single axes, hence of its angles.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int_]

MM = 1000.0  # in a metre


@dataclass(frozen=True)
class Arm:
    """Link parameters of n rows, each (n,), and the tool point's frame (4, 4) on the flange.

    ``prismatic``: rows, from 0, whose joint is prismatic.
    ``coupling``: turns of axis 3 by one turn of the controller's joint 2 alone; 0, 1 or -1, so that
    whole turns of a joint leave the pose as it is. These are the second and the third revolute
    joint, the arm's own where it stands on prismatic ones.
    """

    a_mm: Array
    alpha_rad: Array
    d_mm: Array
    offset_rad: Array
    sign: Array
    tool: Array
    beta_rad: Array = field(default_factory=lambda: np.zeros(6))
    coupling: float = 0.0
    prismatic: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.a_mm)

    def angles(self, joints_rad: ArrayLike) -> Array:
        """Return the angles of the axes (..., n) at joints as the controller counts them."""
        return self._coupled(np.asarray(joints_rad, dtype=float), self.coupling)

    def joints(self, angles_rad: ArrayLike) -> Array:
        """Return the joints (..., n) as the controller counts them: the inverse of `angles`."""
        return self._coupled(np.asarray(angles_rad, dtype=float), -self.coupling)

    def theta(self, joints_rad: ArrayLike) -> Array:
        """Return theta (..., n) of eq 2."""
        return np.asarray(self.turning * self.angles(joints_rad) + self.offset_rad)

    @cached_property
    def turning(self) -> Array:
        """The signs of the revolute joints (n,), 0 of prismatic ones."""
        turning = np.array(self.sign, dtype=float)
        turning[list(self.prismatic)] = 0.0
        return turning

    @cached_property
    def by_angles(self) -> Arm:
        """The same arm with joints that are the `angles` of its axes."""
        return replace(self, coupling=0.0) if self.coupling else self

    @cached_property
    def coupled_rows(self) -> tuple[int, int]:
        """Rows, from 0, of the axes 2 and 3 of ``coupling``."""
        _, second, third, *_ = np.flatnonzero(self.turning).tolist()
        return second, third

    def _coupled(self, values_rad: Array, coupling: float) -> Array:
        if not coupling:
            return values_rad
        second, third = self.coupled_rows
        turned = values_rad.copy()
        turned[..., third] += coupling * values_rad[..., second]
        return turned

    @cached_property
    def link_parts(self) -> tuple[Array, Array, Array]:
        """Return of eq 2 the parts (n, 4, 4) without theta, with its cosine and with its sine."""
        ca, sa = np.cos(self.alpha_rad), np.sin(self.alpha_rad)
        cb, sb = np.cos(self.beta_rad), np.sin(self.beta_rad)
        fixed, cosine, sine = np.zeros((3, len(self), 4, 4))
        # Rot(z, theta) Rot(x, alpha) Rot(y, beta), written out.
        cosine[:, 0, 0], cosine[:, 0, 2], cosine[:, 0, 3] = cb, sb, self.a_mm
        cosine[:, 1, 0], cosine[:, 1, 1], cosine[:, 1, 2] = sa * sb, ca, -sa * cb
        sine[:, 0, 0], sine[:, 0, 1], sine[:, 0, 2] = -sa * sb, -ca, sa * cb
        sine[:, 1, 0], sine[:, 1, 2], sine[:, 1, 3] = cb, sb, self.a_mm
        fixed[:, 2, 0], fixed[:, 2, 1], fixed[:, 2, 2] = -ca * sb, sa, ca * cb
        fixed[:, 2, 3], fixed[:, 3, 3] = self.d_mm, 1.0
        return fixed, cosine, sine


def rotation_y(angle_rad: Array) -> Array:
    """Return Ry (..., 3, 3), of Hayati's term for example."""
    R = np.zeros((*np.shape(angle_rad), 3, 3))
    R[..., 0, 0] = R[..., 2, 2] = np.cos(angle_rad)
    R[..., 0, 2] = np.sin(angle_rad)
    R[..., 2, 0] = -R[..., 0, 2]
    R[..., 1, 1] = 1.0
    return R


def link_transforms(arm: Arm, joints_rad: Array) -> Array:
    """Return A_1..A_n of eq 2, (..., n, 4, 4), for ``joints_rad`` (..., n)."""
    theta = arm.theta(joints_rad)[..., None, None]
    fixed, cosine, sine = arm.link_parts
    links: Array = fixed + np.cos(theta) * cosine + np.sin(theta) * sine
    for row in arm.prismatic:
        links[..., row, 2, 3] += MM * arm.sign[row] * joints_rad[..., row]
    return links


def forward(arm: Arm, joints_rad: Array) -> Array:
    """Return the tool frame {T} in {B}, (..., 4, 4), for ``joints_rad`` (..., n), eq 1."""
    links = link_transforms(arm, np.asarray(joints_rad, dtype=float))
    if links.ndim == 3:  # of one pose, half the time of matmul
        return reduce(np.ndarray.dot, [*links, arm.tool])
    return reduce(np.matmul, [*np.moveaxis(links, -3, 0), arm.tool])
