"""Serial arms after Denavit-Hartenberg: forward kinematics of many poses at once.

Standard form (eq 2): ``A_i = Rot(z, theta_i) Trans(0, 0, d_i) Trans(a_i, 0, 0) Rot(x, alpha_i)``,
``theta_i = sign_i q_i + offset_i``, with Hayati's ``Rot(y, beta_i)`` appended, because plain DH is
singular for parallel neighbours (axes 2 and 3). Lengths mm, angles rad.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _zeros() -> Array:
    return np.zeros(6)


@dataclass(frozen=True, slots=True)
class Arm:
    """Link parameters of six rows, each (6,), and the tool point's frame (4, 4) on the flange."""

    a_mm: Array
    alpha_rad: Array
    d_mm: Array
    offset_rad: Array
    sign: Array
    tool: Array
    beta_rad: Array = field(default_factory=_zeros)


def link_transforms(arm: Arm, joints_rad: Array) -> Array:
    """Return A_1..A_6 of eq 2, (..., 6, 4, 4), for ``joints_rad`` (..., 6)."""
    theta = arm.sign * joints_rad + arm.offset_rad
    ct, st = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(arm.alpha_rad), np.sin(arm.alpha_rad)
    cb, sb = np.cos(arm.beta_rad), np.sin(arm.beta_rad)
    links = np.zeros((*theta.shape, 4, 4))
    # Rot(z, theta) Rot(x, alpha) Rot(y, beta), written out.
    links[..., 0, 0] = ct * cb - st * sa * sb
    links[..., 0, 1] = -st * ca
    links[..., 0, 2] = ct * sb + st * sa * cb
    links[..., 1, 0] = st * cb + ct * sa * sb
    links[..., 1, 1] = ct * ca
    links[..., 1, 2] = st * sb - ct * sa * cb
    links[..., 2, 0] = -ca * sb
    links[..., 2, 1] = sa
    links[..., 2, 2] = ca * cb
    links[..., 0, 3] = arm.a_mm * ct
    links[..., 1, 3] = arm.a_mm * st
    links[..., 2, 3] = arm.d_mm
    links[..., 3, 3] = 1.0
    return links


def forward(arm: Arm, joints_rad: Array) -> Array:
    """Return the tool frame {T} in {B}, (..., 4, 4), for ``joints_rad`` (..., 6), eq 1."""
    links = link_transforms(arm, np.asarray(joints_rad, dtype=float))
    pose = links[..., 0, :, :]
    for row in range(1, 6):
        pose = pose @ links[..., row, :, :]
    return pose @ arm.tool
