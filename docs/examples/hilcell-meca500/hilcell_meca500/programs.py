"""Programs of Mecademic, ``*.mxprog``: poses read, corrected, and written back.

A program is a list of commands, one a line. Targets are `MovePose` and `MoveLin`, in the robot's
base. A motion by other means, or to other places than the program states, is refused by its line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.program_text import ENCODING, Edit, Number, edited, formatted, source_text
from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import StatedTool
from hilcell.geometry.frames import matrix, poses_from_zyx, zyx_from_pose
from hilcell.ports import Array
from hilcell.sanitize import clean
from hilcell_meca500.euler import angles, rotations

SUFFIX = ".mxprog"
DECIMALS = 4  # of mm and deg
MOVES = ("movepose", "movelin")
HARMLESS = (
    "setjointvel", "setjointacc", "setcartlinvel", "setcartangvel", "setcartacc", "setconf",
    "setautoconf", "setconfturn", "setautoconfturn", "setcheckpoint", "delay", "gripperopen",
    "gripperclose", "setgripperforce", "setgrippervel", "movegripper", "setvalvestate",
)  # fmt: skip
_COMMENT = re.compile(r"//[^\r\n]*|/\*.*?\*/", re.DOTALL)
_COMMAND = re.compile(r"\s*(\w+)\s*(?:\(([^()]*)\))?\s*", re.ASCII)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


class Command(NamedTuple):
    """One command: its line, its name, its numbers."""

    line: int
    name: str
    numbers: list[Number]

    @property
    def values(self) -> list[float]:
        """Return its numbers."""
        return [number.value for number in self.numbers]


@dataclass(frozen=True, slots=True)
class Program(programs.Program):
    """Targets stand in {B}; relative motions are refused, and turns of joints do not matter."""

    file: str
    text: str = field(repr=False)
    targets: list[Command]
    trf: Command | None
    notes: list[str]
    in_root = True
    suffixes = (SUFFIX,)

    @property
    def names(self) -> list[str]:
        """Return the targets' names with file and line."""
        return [f"{each.name} ({self.file} line {each.line})" for each in self.targets]

    @property
    def remarks(self) -> list[str]:
        """Return the comments of the file: a stamp may be among them."""
        return [match.group() for match in _COMMENT.finditer(self.text)]

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, Z-Y-X angles A, B, C in deg."""
        rows = np.array([each.values for each in self.targets])
        return zyx_from_pose(matrix(rotations(rows[:, 3:]), rows[:, :3]))

    @property
    def tool(self) -> StatedTool | None:
        """Return the tool that the program sets."""
        if self.trf is None:
            return None
        numbers = np.array(self.trf.values)
        T = matrix(rotations(numbers[3:]), numbers[:3])
        words = ", ".join(each.text for each in self.trf.numbers)
        return StatedTool(f"{self.file} line {self.trf.line}", f"SetTrf({words})", None, T)

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """Return the file by its name, with other X, Y, Z (N, 3), or poses (N, 6)."""
        edits = [Edit(0, 0, f"// {remark}\n")] if remark else []
        for target, position in zip(self.targets, positions, strict=True):
            numbers = list(position[:3])
            if len(position) > 3:
                numbers += list(angles(poses_from_zyx(position[None])[0, :3, :3]))
            edits += [
                Edit(each.start, each.end, formatted(float(value), each.text, DECIMALS))
                for each, value in zip(target.numbers, numbers, strict=False)
            ]
        return {self.file: edited(self.text, edits).encode(ENCODING)}


def load_program(path: Path) -> Program:
    """Read a program; raises `SettingsError` with all that cannot be corrected, by line."""
    text = source_text(path, "Mecademic")
    targets, tool, problems = list[Command](), list[Command](), list[str]()
    stops = frames = False
    for command in _commands(text):
        name, values = command.name.lower(), command.values
        if name in MOVES and len(values) == 6 and stops:
            targets.append(command)
        elif name == "setblending" and values == [0.0]:
            stops = True
        elif name == "setwrf" and values == [0.0] * 6 and not targets:
            frames = True
        elif name == "settrf" and len(values) == 6 and not (targets or tool):
            tool.append(command)
        elif name not in HARMLESS:
            problems.append(f"line {command.line}: {command.name[:40]}: {_refusal(name, stops)}")
    if not targets and not problems:
        problems.append("no MovePose or MoveLin: nothing to correct")
    if problems:
        raise SettingsError(path.name, [f"{path.name} {clean(problem)}" for problem in problems])
    notes = [] if frames else ["it sets no WRF: that of the robot must be its base"]
    notes += [] if tool else ["it sets no TRF: that of the robot must be the calibrated one"]
    return Program(path.name, text, targets, tool[0] if tool else None, notes)


def _refusal(name: str, stops: bool) -> str:
    """Return why a command cannot stand in a program that is corrected."""
    if name in MOVES and not stops:
        return "the robot blends past this target; expected is SetBlending(0) above"
    if name in MOVES:
        return "expected are six numbers"
    if name == "setblending":
        return "the robot passes its targets, and the correction changes where; expected is 0"
    if name == "movejoints":
        return "a joint target: nothing there can be corrected"
    if name == "setwrf":
        return "targets must stand in the robot's base; expected are six zeros, above all targets"
    if name == "settrf":
        return "expected is one tool of six numbers, above all targets"
    return "it is not known to leave the targets where they are"


def _commands(text: str) -> Iterator[Command]:
    """Yield the commands of a text, whose comments are blanked so that places stay."""
    code = _COMMENT.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), text)
    at = 0
    for line, content in enumerate(code.split("\n"), start=1):
        match = _COMMAND.fullmatch(content)
        words = match and match[2] and match[2].split(",")
        if match is None or not all(_NUMBER.fullmatch(word.strip()) for word in words or ()):
            if content.strip():
                yield Command(line, content.strip(), [])
        else:
            found = _NUMBER.finditer(content, match.start(2), match.end(2)) if words else ()
            places = [Number(each.group(), at + each.start(), at + each.end()) for each in found]
            yield Command(line, match[1], places)
        at += len(content) + 1
