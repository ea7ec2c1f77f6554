"""The tip of the targets: of a tool of the cell file, or the reflector's centre.

A calibration has the reflector's frame {T}. A tool's tip {D} has a fixed pose in {T}, so a target
of {D} is corrected as one of {T}: in orientation too, where several reflectors were measured. With
one reflector the flange's rotation is unknown; with the lever to the tip it is a part of the
bounds. (Correcting by the rotation that one reflector's kinematics predict is mostly prior: it
moved the tip .3 mm away, against .03 to .1 mm without.)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hilcell.cell.file import Cell, ToolTable
from hilcell.cell.robot import REFLECTOR, STANDOFF_MORE_MM
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import StatedTool
from hilcell.geometry.frames import inverse, to_rotvec
from hilcell.geometry.kinematics import Arm
from hilcell.ports import Array

SAME_MM, SAME_RAD = 0.01, 1e-4  # between a stated frame and a tool's: numbers are rounded


@dataclass(frozen=True, eq=False)
class Tip:
    """A tip: its name, its frame {D} in {T} (4, 4) and in the flange, and the tool's table.
    ``table``: None for the reflector; ``number``: the controller's, None where it has none.
    """

    name: str
    T_T_D: Array
    T_F_D: Array
    number: int | None = None
    table: ToolTable | None = None

    REFLECTOR_STANDOFF_MM = 100.0  # where nothing is known of a drill

    @property
    def T_D_T(self) -> Array:  # noqa: N802 - the frame's symbol
        """{T} in {D} (4, 4)."""
        return inverse(self.T_T_D)

    @property
    def lever_mm(self) -> Array:
        """Position of the tip in {T}, (3,)."""
        return self.T_T_D[:3, 3]

    @property
    def u_mm(self) -> float:
        return 0.0 if self.table is None else self.table.u_mm

    @property
    def standoff_mm(self) -> float:
        """Stand-off from the part between holes, unless another is given."""
        if self.table is None:
            return self.REFLECTOR_STANDOFF_MM
        return self.table.standoff_mm or self.table.least_standoff_mm

    @property
    def least_standoff_mm(self) -> float:
        return STANDOFF_MORE_MM if self.table is None else self.table.least_standoff_mm

    @property
    def scope(self) -> str:
        """Label: the point for which targets, corrections and bounds are valid."""
        if self.table is None:
            return "they hold at the reflector's centre"
        return (
            f"they hold at the tip of {self.name}, {np.linalg.norm(self.lever_mm):.1f} mm from the "
            f"reflector ({self.table.measured}, 1 sigma {self.u_mm:g} mm): errors of position and "
            "of orientation, over that lever, are in the bounds"
        )

    def arm(self, arm: Arm) -> Arm:
        return arm if self.table is None else replace(arm, tool=self.T_F_D)

    def is_stated(self, stated: StatedTool) -> bool:
        if stated.frame is None:
            return stated.number is not None and stated.number == self.number
        off = inverse(self.T_F_D) @ stated.frame
        off_mm = float(np.linalg.norm(off[:3, 3]))
        off_rad = float(np.linalg.norm(to_rotvec(off[:3, :3])))
        return off_mm <= SAME_MM and off_rad <= SAME_RAD


AT_REFLECTOR = Tip(REFLECTOR, np.eye(4), np.eye(4))  # of a cell that is not known


def tool_tips(cell: Cell, number: int | None = None) -> list[Tip]:
    """Reflector and tools; raises `SettingsError` for a tool with the reflector's number."""
    T_F_T = cell.robot.arm().tool
    tips = [Tip(REFLECTOR, np.eye(4), T_F_T, number)]
    for table in cell.tool:
        if number is not None and table.number == number:
            problem = f"number: {number} is the reflector's in the controller: expected another one"
            raise SettingsError(f"tool {table.name}", [problem])
        T_F_D = table.matrix()
        tips.append(Tip(table.name, inverse(T_F_T) @ T_F_D, T_F_D, table.number, table))
    return tips


def tip_named(cell: Cell | None, name: str, number: int | None = None) -> Tip:
    """A tool's tip; "" is the only tool, or the reflector. Raises `SettingsError` for an unknown
    name, and for "" among several tools.
    """
    if cell is None:
        if name not in ("", REFLECTOR):
            raise SettingsError("--tool", [f"{name!r} is a tool of a cell: name it with --cell"])
        return AT_REFLECTOR
    known = tool_tips(cell, number)
    if not name:
        if len(known) > 2:
            problem = f"the cell has {_listed(known[1:])}: name one, or {REFLECTOR}"
            raise SettingsError("--tool", [problem])
        return known[-1]
    for tip in known:
        if tip.name == name:
            return tip
    raise SettingsError("--tool", [f"unknown tool {name!r}; known: {_listed(known)}"])


def tip_of_program(
    cell: Cell, name: str, stated: StatedTool, number: int | None, source: str
) -> Tip:
    """The tip that a program states; raises `SettingsError` for another one, or unknown."""
    known = tool_tips(cell, number)
    found = next((tip for tip in known if tip.is_stated(stated)), None)
    if found is None:
        problem = (
            f"{stated.where}: the tool is {stated.text}, expected one that the cell file states "
            f"({_listed(known)}): the correction holds at its tip only; state the tool as "
            "[[tool]], or the targets for the reflector's tool"
        )
        raise SettingsError(source, [problem])
    if name and found.name != name:
        problem = f"{stated.where}: the tool is {found.name}, and --tool names {name}"
        raise SettingsError(source, [problem])
    return found


def _listed(tips: Iterable[Tip]) -> str:
    return ", ".join(
        tip.name if tip.number is None else f"{tip.name} ({tip.number})" for tip in tips
    )
