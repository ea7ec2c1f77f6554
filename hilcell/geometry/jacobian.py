"""Motion of the tool by errors of link parameters: the differential error model, eqs 3-7.

Each link's error is a small shift and rotation of its own frame {i}, ``dA_i = A_i deltaA_i``;
``U_{i+1} = A_{i+1} .. A_n {tool}`` carries it into {T}. Eq 7's vectors have the axes of {T}; a
tracker's have those of {B} and are rotated by R_T. Eq 5 is a product, not a sum; eq 6 follows to
first order, with U behind the last link being the tool frame alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.frames import cross_matrix
from hilcell.geometry.kinematics import Arm, Array, link_transforms, rotation_y

KINDS = ("a_mm", "alpha_rad", "d_mm", "offset_rad", "beta_rad")
PARAMETERS = (
    *(f"{kind}[{row}]" for kind in KINDS for row in range(6)),
    *(f"tool_{axis}_mm" for axis in "xyz"),
)
"""Names of the columns: fields of `Arm` by row, then the tool point on the flange."""


def link_errors(arm: Arm) -> Array:
    """Each link's error in its frame {i} per unit of each parameter, (6 links, 6, 5).

    The second axis is (d, delta) of eq 4: shift in mm, rotation vector in rad; the last is `KINDS`.
    With eq 2: d = (da, a cos(alpha) dtheta + sin(alpha) dd, -a sin(alpha) dtheta + cos(alpha) dd)
    and delta = (dalpha, sin(alpha) dtheta, cos(alpha) dtheta), before Hayati's Rot(y, beta), which
    rotates both into its frame and adds dbeta about y. Joint angles do not matter: in {i}, a
    rotation of joint i precedes the whole link.
    """
    ca, sa = np.cos(arm.alpha_rad), np.sin(arm.alpha_rad)
    errors = np.zeros((6, 6, 5))
    a, alpha, d, offset, beta = range(5)
    errors[:, 0, a] = 1.0
    errors[:, 3, alpha] = 1.0
    errors[:, 1, d], errors[:, 2, d] = sa, ca
    errors[:, 1, offset], errors[:, 2, offset] = arm.a_mm * ca, -arm.a_mm * sa
    errors[:, 4, offset], errors[:, 5, offset] = sa, ca
    R = rotation_y(-arm.beta_rad)
    errors[:, :3], errors[:, 3:] = R @ errors[:, :3], R @ errors[:, 3:]
    errors[:, 4, beta] = 1.0
    return errors


def tool_and_jacobian(arm: Arm, joints_rad: ArrayLike) -> tuple[Array, Array]:
    """{T} in {B}, (..., 4, 4), as `forward`, and its motion by each of `PARAMETERS`.

    d(shift in mm, rotation vector in rad)/d(`PARAMETERS`), (..., 6, 33), axes of {T}, for joints
    (..., 6): the columns are d^n and delta^n of eq 7, link by link ``U_{i+1}^-1 deltaA_i U_{i+1}``
    of eq 6.
    """
    links = link_transforms(arm, np.asarray(joints_rad, dtype=float))
    errors = link_errors(arm)
    shape = links.shape[:-3]
    columns = np.zeros((*shape, 6, len(PARAMETERS)))
    U: Array = np.broadcast_to(arm.tool, (*shape, 4, 4))
    for row in reversed(range(6)):
        moved = _carrier(U).reshape(-1, 6) @ errors[row]
        columns[..., row:30:6] = moved.reshape(*shape, 6, 5)
        U = links[..., row, :, :] @ U
    columns[..., :3, 30:] = arm.tool[:3, :3].T
    return U, columns


def parameter_jacobian(arm: Arm, joints_rad: ArrayLike) -> Array:
    """Return the columns with the axes of {B}, (..., 6, 33): d in {B} is R_T d^n."""
    T, turned = tool_and_jacobian(arm, joints_rad)
    R = T[..., :3, :3]
    turned[..., :3, :] = R @ turned[..., :3, :]
    turned[..., 3:, :] = R @ turned[..., 3:, :]
    return turned


def moved(arm: Arm, column: int, step: float) -> Arm:
    """Return the arm with one of `PARAMETERS` changed by ``step``."""
    if column >= 30:
        tool = arm.tool.copy()
        tool[column - 30, 3] += step
        return replace(arm, tool=tool)
    kind, row = divmod(column, 6)
    values: Array = getattr(arm, KINDS[kind]).copy()
    values[row] += step
    return replace(arm, coupling=arm.coupling, **{KINDS[kind]: values})


def _carrier(U: Array) -> Array:
    """Return the (..., 6, 6) that carries (d, delta) through U^-1 . U, for U (..., 4, 4)."""
    back = np.swapaxes(U[..., :3, :3], -1, -2)
    carrier = np.zeros((*U.shape[:-2], 6, 6))
    carrier[..., :3, :3] = carrier[..., 3:, 3:] = back
    carrier[..., :3, 3:] = -back @ cross_matrix(U[..., :3, 3])  # delta x p
    return carrier
