"""Whether a corrected point still means the same whole turns of the joints.

A motion by joints to a point with T goes to the turn that T's bits state: bit i set means that
axis i + 1 stands below zero. The trap: a correction of a millimetre that takes an axis through
zero leaves the old bit to stand for a place one whole turn away.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.inverse import inverse_kinematics
from hilcell.geometry.kinematics import Arm
from hilcell.ports import Array, HilcellError


class TurnError(HilcellError):
    """Points whose T would mean another turn after the correction."""


def turn_of(joints_rad: ArrayLike) -> NDArray[np.int_]:
    """Return T (...) of joints (..., 6): bit i is set when axis i + 1 is below 0."""
    negative = np.asarray(joints_rad) < 0
    turn: NDArray[np.int_] = np.sum(negative << np.arange(6), axis=-1)
    return turn


def check_turns(
    arm: Arm, T_W_B: Array, postures: Sequence[tuple[str, int | None]], before: Array, after: Array
) -> None:
    """Raise `TurnError` naming the points that the correction takes through a zero.

    ``before`` and ``after`` (N, 6) stand in {W}, the nominal ``arm`` at ``T_W_B`` says where the
    joints stand. A point is its name and its S, None where T does not matter; the bits of S are
    those of a posture's status in `hilcell.geometry.inverse`.
    """
    T_B_W = inverse(T_W_B)
    problems = []
    for (name, status), *values in zip(postures, before, after, strict=True):
        if status is None:
            continue
        poses = T_B_W @ np.array([pose_from_zyx(*each) for each in values])
        joints = inverse_kinematics(arm, poses, status)
        changed = int(np.bitwise_xor.reduce(turn_of(joints)))
        degrees = np.degrees(joints)
        problems += [
            f"  {name}: A{axis + 1} goes from {degrees[0, axis]:.3f} to {degrees[1, axis]:.3f} deg"
            for axis in range(6)
            if changed >> axis & 1
        ]
    if problems:
        raise TurnError(
            "the correction takes axes through zero, where T would mean a whole turn; move to "
            "these points with LIN, or leave out S and T\n" + "\n".join(problems)
        )
