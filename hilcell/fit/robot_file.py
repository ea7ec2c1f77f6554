"""Files of ``hilcell fit``: a robot's nominal kinematics and measured targets.

``robot.toml``: standard DH rows, ``Rz(sign q + offset) Tz(d) Tx(a) Rx(alpha)``. Measurements: one
row a measured target, with commanded joints and the position in the tracker's frame. Joints
read back while the robot moves spoil a fit; give the commanded ones.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from hilcell.cell.file import Joint, arm_from_joints
from hilcell.cell.settings import SettingsError, convert, read_file, read_text, unreadable
from hilcell.compensation.targets import MOST, MOST_DEG, CsvText, header_of, numbers
from hilcell.geometry.kinematics import Arm, Array

HEADER = ["pose", "target", *(f"j{n}_deg" for n in range(1, 7)), "x_mm", "y_mm", "z_mm"]
LABELS = 2
Length = Annotated[float, Meta(ge=-MOST, le=MOST)]
Angle = Annotated[float, Meta(ge=-MOST_DEG, le=MOST_DEG)]


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot's nominal kinematics, from whatever file.

    ``arm`` has its tool point on the flange behind the sixth row, ``base`` (4, 4) is where it
    stands in the robot's root frame, ``tool`` (4, 4) on the flange the frame that targets are meant
    for. The joints' limits (2, 6) are infinite where none are stated.
    """

    name: str
    arm: Arm
    base: Array = field(default_factory=lambda: np.eye(4))
    tool: Array = field(default_factory=lambda: np.eye(4))
    limits_rad: Array = field(default_factory=lambda: np.array([[-np.inf] * 6, [np.inf] * 6]))


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One DH row of ``robot.toml``."""

    a_mm: Length
    alpha_deg: Angle
    d_mm: Length
    offset_deg: Angle
    sign: Annotated[int, Meta(ge=-1, le=1)] = 1


class RobotModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table of ``robot.toml``; targets are meant for the flange."""

    name: str
    convention: Literal["standard-dh"]
    joint: list[Row]

    def __post_init__(self) -> None:
        if len(self.joint) != 6:
            raise ValueError(f"expected six joints, got {len(self.joint)}")
        for number, row in enumerate(self.joint, start=1):
            if not row.sign:
                raise ValueError(f"joint {number}: sign must be 1 or -1")

    def robot(self) -> Robot:
        joints = [Joint(**msgspec.structs.asdict(row)) for row in self.joint]
        return Robot(self.name, arm_from_joints(joints, np.eye(4)))


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    robot: RobotModel


@dataclass(frozen=True, eq=False)
class Measurements:
    """N measured targets: labels, joints (N, 6) in rad, positions (N, 3) in the tracker's frame.

    ``source`` names them in messages: a file, and ``lines`` (N) are the rows' in it.
    """

    pose: list[str]
    target: list[str]
    joints_rad: Array
    xyz_mm: Array
    source: str = "the measurements"
    lines: Sequence[int] = ()

    def __len__(self) -> int:
        return len(self.pose)

    def where(self, rows: Iterable[int]) -> str:
        """Return where these rows are, for messages: the source, with their lines if known."""
        lines = sorted(self.lines[n] for n in rows) if self.lines else []
        if not lines:
            return self.source
        named = 5
        listed = ", ".join(map(str, lines[:named])) + ", .." * (len(lines) > named)
        return f"{self.source} line{'s' * (len(lines) > 1)} {listed}"

    def of(self, target: str) -> list[int]:
        """Return the numbers of the rows that measure a target."""
        return [n for n, each in enumerate(self.target) if each == target]

    def once(self) -> Measurements:
        """Return the rows without copies: no reading repeats joints and position exactly."""
        values = np.column_stack([self.joints_rad, self.xyz_mm]).tolist()
        first: dict[tuple[object, ...], int] = {}
        for n, (target, row) in enumerate(zip(self.target, values, strict=True)):
            first.setdefault((target, *row), n)
        return self.at(first.values())

    def at(self, rows: Iterable[int]) -> Measurements:
        chosen = list(rows)
        return Measurements(
            [self.pose[n] for n in chosen],
            [self.target[n] for n in chosen],
            self.joints_rad[chosen],
            self.xyz_mm[chosen],
            self.source,
            [self.lines[n] for n in chosen] if self.lines else (),
        )


def read_robot(path: Path) -> Robot:
    """Read ``robot.toml``; raises `SettingsError` naming all problems at once."""
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(str(path), [f"not valid TOML: {error}"]) from error
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(str(path), error) from error
    return convert(values, _File, str(path)).robot.robot()


def read_measurements(path: Path) -> Measurements:
    """Read measured targets; raises `SettingsError` naming the lines that are not good."""
    text = CsvText.read(path, read_file(path), LABELS)
    header_of(path, text, [HEADER])
    problems: list[str] = []
    labels, rows, lines = [], [], []
    for line, cells in text.rows[1:]:
        if not cells:
            continue
        try:
            rows.append(_numbers(cells, text))
            labels.append([cell.strip() for cell in cells[:LABELS]])
            lines.append(line)
        except ValueError as error:
            problems.append(f"line {line}: {error}")
    if not (labels or problems):
        problems.append("no measured target follows the header")
    if problems:
        raise SettingsError(str(path), problems)
    poses, targets = map(list, zip(*labels, strict=True))
    values = np.array(rows)
    joints_rad = np.radians(values[:, :6])
    return Measurements(poses, targets, joints_rad, values[:, 6:], str(path), lines)


def _numbers(cells: list[str], text: CsvText) -> list[float]:
    """Return the nine numbers of a line; raises ValueError."""
    if len(cells) != len(HEADER):
        more = text.surplus(len(cells), len(HEADER))
        raise ValueError(f"{len(cells)} fields, expected {len(HEADER)}{more}")
    for name, cell in zip(HEADER[:LABELS], cells, strict=False):
        if not cell.strip():
            raise ValueError(f"{name} is empty")
    return numbers(HEADER[LABELS:], cells[LABELS:], text.decimal)
