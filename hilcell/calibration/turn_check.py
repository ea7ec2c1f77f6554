"""Whether a corrected point still means the same whole turns of the joints.

A motion by joints to a point with T goes to the turn that T's bits state: bit i set means that
axis i + 1 stands below zero. The trap: a correction of a millimetre that takes an axis through
zero leaves the old bit to stand for a place one whole turn away.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.form import Calibration
from hilcell.cell.file import Cell
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.inverse import inverse_kinematics, turn_of
from hilcell.krl.program import Program
from hilcell.ports import Array, HilcellError


class TurnError(HilcellError):
    """Points whose T would mean another turn after the correction."""


def check_turns(
    cell: Cell, calibration: Calibration, station: str, program: Program, command: Array
) -> None:
    """Raise `TurnError` naming the points that ``command`` (N, 6) in {W} takes through a zero.

    The cell's nominal arm and its reflector as tool say where the joints stand.
    """
    T_B_W = inverse(np.array(calibration.stations[station].T_W_B))
    problems = []
    for target, before, after in zip(program.targets, program.values(), command, strict=True):
        if target.posture is None:
            continue
        poses = T_B_W @ np.array([pose_from_zyx(*before), pose_from_zyx(*after)])
        joints = inverse_kinematics(cell.robot.arm(), poses, target.posture)
        changed = int(np.bitwise_xor.reduce(turn_of(joints)))
        degrees = np.degrees(joints)
        problems += [
            f"  {target.where}: A{axis + 1} goes from {degrees[0, axis]:.3f} to "
            f"{degrees[1, axis]:.3f} deg"
            for axis in range(6)
            if changed >> axis & 1
        ]
    if problems:
        raise TurnError(
            "the correction takes axes through zero, where T would mean a whole turn; move to "
            "these points with LIN, or leave out S and T\n" + "\n".join(problems)
        )
