"""A URScript program that was read: its poses, and its file's text with others.

Poses are those of the TCP in the robot's base {B}; URScript knows no other base.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.kuka.program_krl.comments import ASCII, plain
from drivers.program_text import ENCODING, Edit, Number, edited, formatted, line_below
from drivers.universal_robots.program_urscript.lines import comments, statements
from hilcell.compensation.programs import StatedTool, Stroke
from hilcell.geometry.frames import matrix, poses_from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.rotations import from_rotvec, to_rotvec
from hilcell.ports import Array

SUFFIX = ".script"
MM = 1000.0
DECIMALS = 6  # of m and rad


@dataclass(frozen=True, slots=True)
class Target:
    """A pose that motions use: its name, its line, its numbers x, y, z, rx, ry, rz."""

    name: str
    line: int
    numbers: list[Number] = field(repr=False)

    @property
    def values(self) -> list[float]:
        """Return the pose's numbers, m and rad."""
        return [number.value for number in self.numbers]


@dataclass(frozen=True, slots=True)
class Program:
    """The text of a file, its targets in the order of their first motion, and remarks on them.

    ``tcp`` is the pose that the program sets, in m and rad, if it sets one.
    """

    file: str
    text: str = field(repr=False)
    targets: list[Target]
    notes: list[str]
    tcp: Target | None = None
    in_root: bool = True
    base: None = None
    suffixes = (SUFFIX,)

    @property
    def strokes(self) -> list[Stroke]:
        """Return none: relative motions are refused."""
        return []

    @property
    def names(self) -> list[str]:
        """Return the targets' names with file and line."""
        return [f"{target.name} ({self.file} line {target.line})" for target in self.targets]

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, A, B, C in deg, in {B}."""
        return zyx_from_pose(_frames([target.values for target in self.targets]))

    @property
    def tool(self) -> StatedTool | None:
        """Return the TCP that the program sets."""
        if self.tcp is None:
            return None
        numbers = ", ".join(each.text for each in self.tcp.numbers)
        frame = _frames([self.tcp.values])[0]
        return StatedTool(
            f"{self.file} line {self.tcp.line}", f"set_tcp(p[{numbers}])", None, frame
        )

    @property
    def needs_arm(self) -> str:
        """Return nothing: whole turns do not matter, the controller moves to the nearest joints."""
        return ""

    def reflector_number(self, options: Mapping[str, Any]) -> None:
        """Return none: a TCP has no number."""

    def check_joints(self, arm: Arm, T_W_B: Array, command: Array) -> None:
        """Do nothing, as `needs_arm` says."""

    @property
    def remarks(self) -> list[str]:
        """Return the comments of the file."""
        return list(comments(self.text))

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """Return the file by its name, with other X, Y, Z (N, 3), or poses (N, 6), in {B}, and a
        remark below its first statement; nothing else differs.
        """
        edits = [_remark(self.text, remark)] if remark else []
        for target, position in zip(self.targets, positions, strict=True):
            numbers = list(position[:3] / MM)
            if len(position) > 3:
                numbers += _nearest(position, np.array(target.values[3:]))
            edits += [
                Edit(each.start, each.end, formatted(float(value), each.text, DECIMALS))
                for each, value in zip(target.numbers, numbers, strict=False)
            ]
        return {self.file: edited(self.text, edits).encode(ENCODING)}


def _frames(poses: list[list[float]]) -> Array:
    """Return frames (N, 4, 4), mm, of poses (N, 6) of URScript."""
    rows = np.array(poses)
    return matrix(from_rotvec(rows[:, 3:]), MM * rows[:, :3])


def _nearest(position: Array, before_rad: Array) -> list[float]:
    """Return the rotation vector of a pose (6,): of the two that mean it, the nearer one."""
    vector = to_rotvec(poses_from_zyx(position[None])[0, :3, :3])
    angle = float(np.linalg.norm(vector))
    other = vector * (1.0 - 2.0 * np.pi / angle) if angle else vector
    nearer = min((vector, other), key=lambda each: float(np.linalg.norm(each - before_rad)))
    found: list[float] = nearer.tolist()
    return found


def _remark(text: str, remark: str) -> Edit:
    line = f"# {plain(remark, ASCII)}"
    first = next(statements(text))
    return line_below(text, first.start, f"  {line}")
