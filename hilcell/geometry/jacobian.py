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
from hilcell.geometry.kinematics import MM, Arm, Array, link_transforms, rotation_y

KINDS = ("a_mm", "alpha_rad", "d_mm", "offset_rad", "beta_rad")


def parameters(arm: Arm) -> list[str]:
    """Names of the columns (5 n + 3): fields of `Arm` by row, then the tool point on the flange."""
    links = [f"{kind}[{row}]" for kind in KINDS for row in range(len(arm))]
    return links + [f"tool_{axis}_mm" for axis in "xyz"]


def by_joints(arm: Arm, columns: Array) -> Array:
    """Return the motion (..., n) by the arm's joint values, of that by its parameters (..., P).

    A joint rotates the arm as its offset does, a prismatic one shifts it as its d.
    """
    rows = len(arm)
    offset = KINDS.index("offset_rad") * rows
    rotated = columns[..., offset : offset + rows]
    if not arm.prismatic:
        return np.asarray(arm.sign * rotated)
    shifted = MM * columns[..., offset - rows : offset]  # d is the kind before
    return np.asarray(arm.sign * np.where(arm.turning, rotated, shifted))


def link_errors(arm: Arm) -> Array:
    """Each link's error in its frame {i} per unit of each parameter, (n links, 6, 5).

    The second axis is (d, delta) of eq 4: shift in mm, rotation vector in rad; the last is `KINDS`.
    With eq 2: d = (da, a cos(alpha) dtheta + sin(alpha) dd, -a sin(alpha) dtheta + cos(alpha) dd)
    and delta = (dalpha, sin(alpha) dtheta, cos(alpha) dtheta), before Hayati's Rot(y, beta), which
    rotates both into its frame and adds dbeta about y. Joint angles do not matter: in {i}, a
    rotation of joint i precedes the whole link.
    """
    ca, sa = np.cos(arm.alpha_rad), np.sin(arm.alpha_rad)
    errors = np.zeros((len(arm), 6, 5))
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
    """{T} in {B}, (..., 4, 4), as `forward`, and its motion by each of `parameters`.

    d(shift in mm, rotation vector in rad)/d(`parameters`), (..., 6, P), axes of {T}, for joints
    (..., n): the columns are d^n and delta^n of eq 7, link by link ``U_{i+1}^-1 deltaA_i U_{i+1}``
    of eq 6.
    """
    links = link_transforms(arm, np.asarray(joints_rad, dtype=float))
    errors = link_errors(arm)
    shape = links.shape[:-3]
    rows = len(arm)
    tool = len(KINDS) * rows
    columns = np.zeros((*shape, 6, tool + 3))
    U: Array = np.broadcast_to(arm.tool, (*shape, 4, 4))
    for row in reversed(range(rows)):
        moved = _carrier(U).reshape(-1, 6) @ errors[row]
        columns[..., row:tool:rows] = moved.reshape(*shape, 6, 5)
        U = links[..., row, :, :] @ U
    columns[..., :3, tool:] = arm.tool[:3, :3].T
    return U, columns


def parameter_jacobian(arm: Arm, joints_rad: ArrayLike) -> Array:
    """Return the columns with the axes of {B}, (..., 6, P): d in {B} is R_T d^n."""
    T, turned = tool_and_jacobian(arm, joints_rad)
    R = T[..., :3, :3]
    turned[..., :3, :] = R @ turned[..., :3, :]
    turned[..., 3:, :] = R @ turned[..., 3:, :]
    return turned


def moved(arm: Arm, column: int, step: float) -> Arm:
    """Return the arm with one of `parameters` changed by ``step``."""
    kind, row = divmod(column, len(arm))
    if kind >= len(KINDS):
        tool = arm.tool.copy()
        tool[column - len(KINDS) * len(arm), 3] += step
        return replace(arm, tool=tool)
    values: Array = getattr(arm, KINDS[kind]).copy()
    values[row] += step
    return replace(arm, coupling=arm.coupling, prismatic=arm.prismatic, **{KINDS[kind]: values})


def _carrier(U: Array) -> Array:
    """Return the (..., 6, 6) that carries (d, delta) through U^-1 . U, for U (..., 4, 4)."""
    back = np.swapaxes(U[..., :3, :3], -1, -2)
    carrier = np.zeros((*U.shape[:-2], 6, 6))
    carrier[..., :3, :3] = carrier[..., 3:, 3:] = back
    carrier[..., :3, 3:] = -back @ cross_matrix(U[..., :3, 3])  # delta x p
    return carrier
