"""FANUC TP programs as listings (``.ls``): positions read and corrected, a station written.

Corrected are the Cartesian positions of ``/POS`` that motions ``J`` and ``L`` use. Every other
statement must be known neither to move the robot nor to shift what follows; all else is refused, by
line. A position states its user frame (UF 0 is the controller's world frame, {B}), its tool (UT)
and its posture; W, P, R turn about the fixed X, Y, Z, so that they are Z-Y-X angles c, b, a.

``CONFIG : 'N U T, 0, 0, 0'`` is wrist (flip or not: bent up or down with axis 4 at 0), elbow (up or
down), front or back, and three turn numbers: 0 from -180 to 180 deg, 1 and -1 beyond. They are of
axes 1, 4, 6 unless the controller is set otherwise ($SCR_GRP.$TURN_AXIS), so no axis may pass
180 deg. The trap: a correction that takes an axis through 180 deg leaves the old turn number, which
then means a position one revolution away.

Facts are those of public listings and of notes by others: roboception's pose formats, airo-fanuc's
pose configurations, and a worked example of onerobotics ("The perils of six-axis robots", 2013).
Nothing was tried on a real controller.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.program_text import (
    ASCII,
    ENCODING,
    MARK,
    Edit,
    Number,
    edited,
    fixed,
    formatted,
    module_name,
    plain,
    source_text,
    tool_number,
)
from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import Places, StatedTool, StationProgram
from hilcell.compensation.targets import Stamp
from hilcell.errors import bounded
from hilcell.geometry.frames import inverse, poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import BEHIND, BEYOND, FLIPPED, inverse_kinematics, status_of
from hilcell.geometry.kinematics import Arm, forward
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import clean

SUFFIX = ".ls"
USUAL_TOOL = 1  # of the reflector, unless robot.options has another
POSE = ("X", "Y", "Z", "R", "P", "W")  # in the order of targets: x, y, z, a, b, c
LENGTHS, ANGLES = ("mm",), ("deg",)
UNITS = dict(zip(POSE, (*[LENGTHS] * 3, *[ANGLES] * 3), strict=True))
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
JOINTS = {f"J{n}" for n in range(1, 10)}
REMARK = 32  # characters that a remark has at most
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"


class TpError(HilcellError):
    """A statement or position that is refused; its reader adds where."""


# -- statements and positions ----------------------------------------------------------------------


class Section(NamedTuple):
    """A section: the line of its head, the characters behind its name, and those of the next."""

    line: int
    begin: int
    end: int


def sections(text: str) -> dict[str, Section]:
    """Return the sections by name, in their order."""
    found = list(re.finditer(rf"^(?:{MARK})?/([A-Z]+)\b", text, re.MULTILINE))
    ends = [*(each.start() for each in found[1:]), len(text)]
    return {
        match[1]: Section(text.count("\n", 0, match.start()) + 1, match.end(), end)
        for match, end in zip(found, ends, strict=False)
    }


class Statement(NamedTuple):
    """A statement of ``/MN``: its line and its number, its ``code`` in capitals, without names in
    brackets and strings, and its ``source``.
    """

    line: int
    number: str
    code: str
    source: str

    @property
    def remark(self) -> str | None:
        """Return the text of a remark, None for all else."""
        match = _REMARK.match(self.source)
        return self.source[match.end() :].strip() if match else None


_REMARK = re.compile(r"!|//|--[A-Z]{2}:", re.IGNORECASE | re.ASCII)
_LINE = re.compile(r"\s*(\d*)\s*:(.*)", re.ASCII)
_NAMED = re.compile(r"\[([^\[\]:]*):[^\[\]]*\]")
_TEXT = re.compile(r"'[^']*'|\"[^\"]*\"|(?<=^MESSAGE\[)[^\n]*(?=\])", re.IGNORECASE)


def statements(text: str, line: int) -> Iterator[Statement]:
    """Yield the statements of ``/MN``, which begins at ``line``; raises `TpError` for one without
    its semicolon.

    A statement may go on in lines without a number.
    """
    begun, own, parts = 0, "", list[str]()
    for number, whole in enumerate(text.split("\n"), start=line):
        match = _LINE.match(whole)
        if match is None and not whole.strip():
            continue
        if parts and match is not None and match[1]:
            break
        if not parts:
            begun, own = number, match[1] if match is not None else ""
        parts.append((whole if match is None else match[2]).strip())
        if parts[-1].endswith(";"):
            source = " ".join(parts)[:-1].strip()
            bare = _TEXT.sub("", _NAMED.sub(r"[\1]", source))
            yield Statement(begun, own, bare.upper(), source)
            parts = []
    if parts:
        raise TpError(f"{_place(begun, own)}: {clean(parts[0])[:40]}: expected ';' at its end")


def _place(line: int, number: str | None) -> str:
    """Return a line of the file, with the number of its statement on the pendant."""
    return f"line {line} (statement {number})" if number else f"line {line}"


@dataclass(frozen=True, slots=True)
class Position:
    """``P[n]`` of ``/POS``: the text between its braces, which begins at ``start``."""

    index: int
    file: str
    line: int
    text: str = field(repr=False)
    start: int

    @property
    def where(self) -> str:
        return f"P[{self.index}] ({self.file} line {self.line})"

    def fields(self) -> dict[str, Number]:
        """Return its values by name, as text; raises `TpError`."""
        heads = list(_GROUP.finditer(self.text))
        if [head[1] for head in heads] != ["1"]:
            groups = ", ".join(head[1] for head in heads) or "none"
            raise TpError(
                f"P[{self.index}] states motion groups {groups}: expected the robot's alone, GP1"
            )
        behind, left = heads[0].end(), ""
        found: dict[str, Number] = {}
        for match in _FIELD.finditer(self.text, behind):
            name, text = match[1].upper(), match[2]
            if name in found:
                raise TpError(f"P[{self.index}] states {match[1]} twice")
            at = self.start + match.start(2)
            found[name] = Number(text, at, at + len(text))
            left += self.text[behind : match.start()]
            behind = match.end()
        if left := (left + self.text[behind:]).strip(" \t\r\n,"):
            raise TpError(f"P[{self.index}]: {clean(left)[:40]} is not understood")
        if any("*" in each.text for each in found.values()):
            raise TpError(f"P[{self.index}] is not taught: its values are {'*' * 8}")
        return found


_POSITION = re.compile(
    r"P\[\s*(\d{1,6})\s*(?::\s*\"[^\"\n]*\"\s*)?\]\s*\{((?:[^}']|'[^'\n]*')*)\}\s*;?", re.ASCII
)
_GROUP = re.compile(r"GP(\d+)\s*:", re.ASCII)
_FIELD = re.compile(r"(\w+)\s*[:=]\s*('[^'\n]*'|[^\s,'][^\n,']*?)(?=\s*(?:,|\n|\Z))", re.ASCII)
_VALUE = re.compile(rf"({NUMBER})\s*(mm|deg)", re.ASCII | re.IGNORECASE)
_CONFIG = re.compile(
    r"'\s*([NF])\s*([UD])\s*([TB])\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*,\s*(-?\d+)\s*'", re.ASCII
)


@dataclass(frozen=True, slots=True)
class Target:
    """A Cartesian position that motions use. ``posture``: the letters of
    CONFIG; ``frame`` and ``tool``: UF and UT; None is ``F``, the
    one in force. ``external``: values and units of external axes.
    """

    position: Position
    numbers: Mapping[str, Number] = field(repr=False)
    config: str
    posture: str
    frame: int | None
    tool: int | None
    external: Mapping[str, tuple[float, str]]

    @property
    def where(self) -> str:
        return self.position.where

    @classmethod
    def of(cls, position: Position, fields: Mapping[str, Number]) -> Target:
        """Return the target; raises `TpError`."""
        name = f"P[{position.index}]"
        if missing := [each for each in (*POSE, "UF", "UT", "CONFIG") if each not in fields]:
            raise TpError(f"{name} states no {', '.join(missing)}")
        config = fields["CONFIG"].text
        match = _CONFIG.fullmatch(config)
        if match is None:
            raise TpError(
                f"{name} has the CONFIG {clean(config)}: expected N or F, U or D, T or B, and "
                "three turn numbers"
            )
        if match[3] == "B":
            raise TpError(f"{name} is behind axis 1 (CONFIG {config}): only T is corrected")
        frame, tool = (cls._numbered(name, key, fields[key].text) for key in ("UF", "UT"))
        numbers = {key: _value(name, key, fields[key], UNITS[key])[0] for key in POSE}
        external = external_axes(name, fields)
        known = {*POSE, "UF", "UT", "CONFIG", *external}
        if other := [each for each in fields if each not in known]:
            raise TpError(f"{name} states {', '.join(other)}, which hilcell does not read")
        return cls(position, numbers, config, "".join(match.group(1, 2, 3)), frame, tool, external)

    @staticmethod
    def _numbered(name: str, key: str, text: str) -> int | None:
        if text.upper() == "F":
            return None
        if not (text.isdecimal() and len(text) <= 3):
            raise TpError(f"{name}: {key} {clean(text)} is no number of a frame")
        return int(text)


def external_axes(name: str, fields: Mapping[str, Number]) -> dict[str, tuple[float, str]]:
    """Return the values and units of the external axes of a position; raises `TpError`."""
    return {
        key: (number.value, unit)
        for key in EXTERNAL
        if key in fields
        for number, unit in [_value(name, key, fields[key], LENGTHS + ANGLES)]
    }


def _value(name: str, key: str, stated: Number, units: tuple[str, ...]) -> tuple[Number, str]:
    match = _VALUE.fullmatch(stated.text)
    if match is None or match[2].lower() not in units or not math.isfinite(float(match[1])):
        expected = f"expected a number of {' or '.join(units)}"
        raise TpError(f"{name}: {key} = {clean(stated.text)}: {expected}")
    number = Number(match[1], stated.start, stated.start + len(match[1]))
    return number, match[2].lower()


def posture(arm: Arm, status: int) -> str:
    """Return the letters of CONFIG for a status of ``arm`` in front of axis 1.

    The letters are of the arm's shape; the bits are signs of its joints.
    """
    flip = "F" if bool(status & FLIPPED) == (arm.sign[4] > 0) else "N"
    elbow = "U" if bool(status & BEYOND) == (arm.sign[2] > 0) else "D"
    return f"{flip}{elbow}T"


def frame_text(values: Array) -> str:
    """Return a frame (6,) as the pendant has it: X, Y, Z in mm, W, P, R in deg."""
    x, y, z, r, p, w = (fixed(each, 3) for each in values)
    return f"X {x} Y {y} Z {z} W {w} P {p} R {r}"


# -- a program -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Program(programs.Program):
    """The text of a file, its targets in the order of their first motion, and remarks on them.
    ``frame``: UF of all, None where no statement sets it.
    """

    file: str
    text: str = field(repr=False)
    name: str
    targets: list[Target]
    statements: list[Statement] = field(repr=False)
    frame: int | None
    notes: list[str]
    tool: StatedTool | None = None
    suffixes = (SUFFIX,)
    needs_arm = "postures and turn numbers (CONFIG)"

    @property
    def in_root(self) -> bool:
        return self.frame == 0

    @property
    def names(self) -> list[str]:
        return [target.where for target in self.targets]

    @property
    def remarks(self) -> list[str]:
        """Return its remarks; those in lines that follow one another are one."""
        blocks = [""]
        for statement in self.statements:
            if statement.remark is None:
                blocks.append("")
            else:
                blocks[-1] = f"{blocks[-1]} {statement.remark}".strip()
        return [each for each in blocks if each]

    @property
    def slide(self) -> tuple[str, float] | None:
        value, unit = self.targets[0].external.get("E1", (0.0, ""))
        return (self.targets[0].where, value) if unit == "mm" else None

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, R, P, W in deg, as the program states them."""
        return np.array([[t.numbers[name].value for name in POSE] for t in self.targets])

    def statuses(self, expected: int, arm: Arm) -> list[tuple[str, int]]:
        known = {posture(arm, status): status for status in range(0, 8, 2)}  # in front of axis 1
        return [
            (f"{each.where}, CONFIG {each.config}", known[each.posture]) for each in self.targets
        ]

    def check_joints(self, arm: Arm, T_W_B: Array, command: Array) -> tuple[str, ...]:
        """Raise `TurnError` naming the positions that ``command`` (N, 6) takes through 180 deg.

        The nominal ``arm`` at ``T_W_B`` gives the joints.
        """
        T_B_W = inverse(T_W_B)
        nominal, poses = (T_B_W @ poses_from_zyx(each) for each in (self.values(), command))
        statuses = np.array([status for _, status in self.statuses(0, arm)])
        problems = list[str]()
        for status in np.unique(statuses).tolist():
            at = np.flatnonzero(statuses == status)
            before_rad = inverse_kinematics(arm, nominal[at], status)
            after_rad = inverse_kinematics(arm, poses[at], status)
            for n, axis in np.argwhere(~(np.abs(after_rad - before_rad) < np.pi)).tolist():
                before, after = np.degrees([before_rad[n, axis], after_rad[n, axis]])
                where = self.targets[at[n]].where
                problems.append(f"  {where}: J{axis + 1} goes from {before:.3f} to {after:.3f} deg")
        if problems:
            raise TurnError(
                "the correction takes axes through 180 deg, where CONFIG would mean a whole turn; "
                "teach these positions with the axis on one side of it\n" + "\n".join(problems)
            )
        return ()

    def frame_text(self, values: Array) -> str:
        return frame_text(values)

    def reflector_number(self, options: Mapping[str, Any]) -> int | None:
        number: int = options.get("tool", USUAL_TOOL)
        return number

    def misnamed(self, stem: str) -> list[str]:
        """Return a note where the controller loads the file under another name than ``stem``."""
        if stem.lower() == self.name.lower():
            return []
        note = (
            f"/PROG of {stem}{SUFFIX} names it {self.name}, and the controller loads it under that "
            f"name: it replaces a program {self.name} there, unless /PROG is changed"
        )
        return [note]

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """The file by its name, with other X, Y, Z (N, 3), or also R, P, W (N, 6), and a remark
        below its last statement. Numbers keep the column of their end where they have room.
        """
        edits = list[Edit]()
        for target, position in zip(self.targets, positions, strict=True):
            for name, value in zip(POSE[: len(position)], position, strict=True):
                number = target.numbers[name]
                text = formatted(float(value), number.text, decimals=3)
                begin = number.start
                while len(text) > number.end - begin and self.text[begin - 2 : begin] == "  ":
                    begin -= 1
                edits.append(Edit(begin, number.end, text.rjust(number.end - begin)))
        edits += self._remark(remark) if remark else []
        return {self.file: edited(self.text, edits).encode(ENCODING)}

    def _remark(self, remark: str) -> Iterator[Edit]:
        """Yield lines below the last statement, and their count: all others keep their number."""
        lines, begin = remark_lines(remark), sections(self.text)["MN"].end
        end = "\r\n" if self.text[:begin].endswith("\r\n") else "\n"
        numbers = re.findall(r"^\s*(\d{1,9})\s*:", self.text[:begin], re.ASCII | re.MULTILINE)
        first = int(numbers[-1]) + 1 if numbers else 0
        heads = (f"{first + n:4d}:  " if numbers else " :  " for n in range(len(lines)))
        text = "".join(f"{head}{each}{end}" for head, each in zip(heads, lines, strict=False))
        yield Edit(begin, begin, text)
        if count := re.search(r"^LINE_COUNT\s*=\s*(\d{1,9})\b", self.text, re.ASCII | re.MULTILINE):
            yield Edit(count.start(1), count.end(1), str(int(count[1]) + len(lines)))


class TurnError(HilcellError):
    """Positions whose turn numbers would mean another turn after the correction."""


def remark_lines(text: str) -> list[str]:
    """Return a text as statements of remarks."""
    bare = plain(clean(text), ASCII).replace(";", ",")
    return [f"!{each} ;" for each in textwrap.wrap(bare, REMARK, break_on_hyphens=False)]


# -- the reader ------------------------------------------------------------------------------------

_MOTION = re.compile(r"[A-Z]\s*PR?\[", re.ASCII)
_UNSURE = re.compile(r"[A-Z]\s*PR?\[|LBL|JMP|IF|SELECT|FOR|CALL|RUN", re.ASCII)
_MOVE = re.compile(
    r"([JL])\s*(PR?)\[\s*(.*?)\s*\]\s+"
    rf"(?:(?:{NUMBER}|A?R\[\d+\])\s*(?:%|MM/SEC|CM/MIN|INCH/MIN|DEG/SEC|SEC|MSEC)"
    r"|MAX_SPEED|WELD_SPEED)"
    r"\s+(FINE|CNT\s*(?:\d+|A?R\[\d+\]))(?:\s+(.*))?",
    re.ASCII,
)
_PORT = r"(?:DO|RO|GO|AO|SO|UO|WO|F|M)\[.*?\]"
_OPTION = re.compile(  # of a motion: its acceleration, its path, and what is switched on its way
    r"ACC\s*(?:\d+|A?R\[\d+\])|PTH|WJNT|MROT|BREAK|(?:IND\.)?EV\s*\d+%|(?:RT|AP)_LD\s*\d+"
    rf"|(?:T[AB]|TIME (?:BEFORE|AFTER))\s*{NUMBER}\s*SEC\s*,\s*"
    rf"(?:{_PORT}\s*=\s*(?:\([^()]*\)|[^\s()]+)|CALL (?P<called>\w+)(?:\([^()]*\))?)|\s+",
    re.ASCII,
)
_FRAME = re.compile(r"(UFRAME|UTOOL)_NUM\s*(?:\[GP1\])?\s*=\s*(.*)", re.ASCII)
_CALL = re.compile(r"(?:CALL|RUN)\s+([^\s(]+)\s*(?:\(.*\))?", re.ASCII)
_BRANCH = re.compile(r"IF\b|SELECT\b|=|ELSE\s*,", re.ASCII)
_HARMLESS = re.compile(
    r"(?:(?:JMP )?LBL|MESSAGE|UALM|PAYLOAD)\[.*\]|(?:WAIT|FOR|COL (?:DETECT|GUARD)|TC_ONLINE)\b.*"
    r"|ENDFOR|ELSE|ENDIF|END|ABORT|PAUSE|(?:UN)?LOCK PREG"
    rf"|(?:{_PORT}|[SP]?R\[.*?\]|TIMER\[.*?\]|OVERRIDE|\$WAITTMOUT)\s*=.*|",
    re.ASCII,
)


def load_program(path: Path) -> Program:
    """Read a program; raises `SettingsError`."""
    return read_program(path.name, source_text(path, "TP"))


def read_program(file: str, text: str) -> Program:
    """Return the program; raises `SettingsError` with all that is refused, by line."""
    found = sections(text)
    if [name for name in found if name in ("PROG", "MN", "POS")] != ["PROG", "MN", "POS"]:
        raise SettingsError(file, [f"{file}: expected the sections /PROG, /MN, /POS of a listing"])
    reader = _Reader(file, text, found)
    if problems := reader.read():
        raise SettingsError(file, [f"{file} {each}" for each in problems])
    return reader.program()


class _Reader:
    """Goes through the statements once; homes, frames and external axes are judged after them."""

    HOME = "only a home move J before the first or after the last corrected position may lead there"

    def __init__(self, file: str, text: str, found: Mapping[str, Section]) -> None:
        self._file, self._text, self._sections = file, text, found
        self._problems = list[tuple[int, str]]()
        self._statements = list[Statement]()
        self._positions = dict[int, Position]()
        self._targets: dict[int, Target] = {}
        self._moves = list[int]()  # lines of motions to a target
        self._homes: dict[int, str] = {}  # by line
        self._external_at: dict[int, tuple[str, Mapping[str, tuple[float, str]]]] = {}  # of homes
        self._passed = list[int]()  # lines of motions that do not stop at their target
        self._set: dict[str, dict[int, int]] = {"UFRAME": {}, "UTOOL": {}}  # numbers by line
        self._called: dict[str, int] = {}  # other programs, by their first line
        self._sure = 0  # line of the first motion, label, branch or call
        self._frame: int | None = None
        self._tool: int | None = None

    def read(self) -> list[str]:
        part = self._sections["MN"]
        try:
            self._positions = {each.index: each for each in self._all_positions()}
            self._statements = list(statements(self._text[part.begin : part.end], part.line))
        except TpError as error:
            return [str(error)]
        self._check_group()
        for statement in self._statements:
            try:
                if ";" in statement.source:
                    raise TpError("expected one statement a line")
                if statement.remark is None:
                    self._take(statement)
            except TpError as error:
                source = clean(statement.source)
                quoted = source if len(source) <= 80 else f"{source[:77]}..."
                self._problems.append((statement.line, f"{quoted}: {error}"))
        self._check_homes()
        if not self._problems and not self._targets:
            problem = "no motion to a position with X, Y, Z: nothing to correct"
            self._problems.append((part.line, problem))
        if not self._problems:
            self._frame = self._one_number("UFRAME", "UF", lambda target: target.frame)
            self._tool = self._one_number("UTOOL", "UT", lambda target: target.tool)
            self._check_external()
        numbers = {each.line: each.number for each in self._statements}
        problems = sorted(self._problems)
        return [f"{_place(line, numbers.get(line))}: {problem}" for line, problem in problems]

    def program(self) -> Program:
        targets, tool, head = list(self._targets.values()), None, self._sections["PROG"]
        if self._tool is not None:
            where = f"{self._file} line {targets[0].position.line}"
            frame = None if self._tool else np.eye(4)
            tool = StatedTool(where, f"UT {self._tool}", self._tool, frame)
        name = (self._text[head.begin : head.end].split() or [""])[0]
        notes, found = self._notes(), self._statements
        return Program(self._file, self._text, name, targets, found, self._frame, notes, tool)

    def _notes(self) -> list[str]:
        """Return notes on all that was left, and on conditions that are not checked."""
        root = "the controller's world frame, whose origin is usually at the height of axis 2"
        notes = [f"its positions are in UF 0, {root}: it must be {{B}}"]
        if self._frame != 0:
            frame = "the frame in force" if self._frame is None else f"UF {self._frame}"
            notes = [f"its positions are in {frame}"]
        if self._tool is not None:
            notes.append(f"its tool is UT {self._tool}: it must be that of the targets")
        if self._passed:
            lines = ", ".join(bounded(map(str, self._passed)))
            notes.append(f"CNT passes positions without a stop there, line {lines}")
        homes = {what: line for line, what in reversed(self._homes.items())}
        notes += [f"home move (line {n}) left unchanged: {what}" for what, n in homes.items()]
        notes += [
            f"{name} (line {line}) is another program: its motions are not corrected, and it must "
            "leave frames, tool and slide as they are"
            for name, line in self._called.items()
        ]
        left = [f"P[{n}]" for n in self._positions if n not in self._targets]
        return notes + ([f"not corrected, left: {', '.join(bounded(left))}"] if left else [])

    def _all_positions(self) -> Iterator[Position]:
        """Yield the positions of /POS; raises `TpError`."""
        part, at = self._sections["POS"], 0
        text, line, indices = self._text[part.begin : part.end], part.line, set[int]()
        for match in _POSITION.finditer(text):
            line, at = line + text.count("\n", at, match.start()), match.start()
            index = int(match[1])
            if index in indices:
                raise TpError(f"line {line}: P[{index}] is in /POS twice")
            indices.add(index)
            yield Position(index, self._file, line, match[2], part.begin + match.start(2))
        if left := _POSITION.sub("", text).strip():
            raise TpError(f"line {line}: {clean(left)[:40]}: it is no position P[n]{{...}}")

    def _check_group(self) -> None:
        for match in re.finditer(r"^DEFAULT_GROUP\s*=([^;\n]*)", self._text, re.MULTILINE):
            groups = [each.strip() for each in match[1].split(",")]
            if [n for n, each in enumerate(groups, start=1) if each != "*"] != [1]:
                line = self._text.count("\n", 0, match.start()) + 1
                stated = f"DEFAULT_GROUP is {match[1].strip()}"
                self._problems.append((line, f"{stated}: expected the robot's alone, 1,*,*,*,*"))

    # -- statements -------------------------------------------------------------------------------

    def _take(self, statement: Statement) -> None:
        code = statement.code
        if not self._sure and _UNSURE.match(code):
            self._sure = statement.line
        if _MOTION.match(code):
            self._motion(statement)
        else:
            self._other(statement.line, code)

    def _motion(self, statement: Statement) -> None:
        if statement.code[0] not in "JL":
            raise TpError("a motion through auxiliary points is not corrected")
        match = _MOVE.fullmatch(statement.code)
        if match is None:
            raise TpError("expected J or L, a position P[n], a speed, FINE or CNT, and options")
        kind, register, index, stop, options = match.groups()
        name = f"{register}[{index}]"
        self._check_options(options or "", name, statement.line)
        if register == "PR":
            self._home(kind, statement.line, name, "is a register: its place is not known")
            return
        position = self._positions.get(int(index)) if re.fullmatch(r"\d{1,6}", index) else None
        if position is None:
            raise TpError(f"{name} is no position of /POS")
        if position.index not in self._targets:
            fields = position.fields()
            if JOINTS & fields.keys():
                self._home(kind, statement.line, name, "is given as joint angles")
                self._external_at[statement.line] = name, external_axes(name, fields)
                return
            self._targets[position.index] = Target.of(position, fields)
        self._moves.append(statement.line)
        if stop != "FINE":
            self._passed.append(statement.line)

    def _home(self, kind: str, line: int, name: str, why: str) -> None:
        """Keep a move to what is not corrected; raises `TpError` unless it is by joints."""
        if kind != "J":
            raise TpError(f"{name} {why}: {self.HOME}")
        self._homes[line] = f"{name} {why}"

    def _check_homes(self) -> None:
        for line, what in self._homes.items():
            if self._moves and self._moves[0] < line < self._moves[-1]:
                self._problems.append((line, f"{what}: {self.HOME}"))

    def _check_options(self, options: str, name: str, line: int) -> None:
        at = 0
        while match := _OPTION.match(options, at):
            at = match.end()
            if match["called"]:
                self._called.setdefault(match["called"], line)
        if left := options[at:]:
            raise TpError(f"{left}: the robot may go elsewhere than to {name}, or stop before it")

    def _other(self, line: int, code: str) -> None:
        if re.search(r"(?<![A-Z])P\[", code):
            raise TpError("a position is used besides the motions to it")
        if re.match(r"(?:UFRAME|UTOOL)\s*\[", code):
            raise TpError("it changes a frame at run time")
        if _BRANCH.match(code):
            _, *action = _split(code)
            if action:
                self._other(line, ",".join(action).strip())
            elif not re.fullmatch(r"IF\b.*\bTHEN", code):
                raise TpError("expected a condition, and JMP or CALL")
        elif match := _FRAME.fullmatch(code):
            if not (match[2].isdecimal() and len(match[2]) <= 3):
                raise TpError(f"{match[1]}_NUM is not known before the program runs")
            self._set[match[1]][line] = int(match[2])
        elif match := _CALL.fullmatch(code):
            self._called.setdefault(match[1], line)
        elif not _HARMLESS.fullmatch(code):
            raise TpError(
                "it is not known to leave the robot, its frames and positions as they are"
            )

    # -- one frame, one tool, one station ---------------------------------------------------------

    def _one_number(
        self, word: str, key: str, number: Callable[[Target], int | None]
    ) -> int | None:
        """Return the number of the frame of all targets; None where no statement says which ``F``
        is.
        """
        stated, first = self._set[word], next(iter(self._targets.values()))
        in_force = next(iter(stated.values()), None)
        numbers = [(each, number(each)) for each in self._targets.values()]
        if stated and min(stated) >= self._sure > 0 and any(n is None for _, n in numbers):
            problem = (
                f"{word}_NUM={in_force}, which positions with {key} F take, is below line "
                f"{self._sure}: set it where the program begins"
            )
            self._problems.append((min(stated), problem))
        found = [(each, in_force if n is None else n) for each, n in numbers]
        expected = f"expected {key} {found[0][1]}, as {first.where} has"
        self._problems += [
            (each.position.line, f"P[{each.position.index}] is in {key} {n}, {expected}")
            for each, n in found
            if n != found[0][1]
        ]
        self._problems += [
            (line, f"{word}_NUM={n}, {expected}") for line, n in stated.items() if n != found[0][1]
        ]
        return found[0][1]

    def _check_external(self) -> None:
        first, *others = self._targets.values()
        for each in others:
            if each.external != first.external:
                axes = f"has {_axes(each.external)}, {first.where} has {_axes(first.external)}"
                problem = f"P[{each.position.index}] {axes}: a program is corrected for one station"
                self._problems.append((each.position.line, problem))
        for line, (name, external) in self._external_at.items():
            if external.keys() - first.external.keys():
                problem = (
                    f"{name} has {_axes(external)}, and {first.where} has {_axes(first.external)}: "
                    "where the slide stands there is not known; state it in both, or in none"
                )
                self._problems.append((line, problem))


def _axes(external: Mapping[str, tuple[float, str]]) -> str:
    found = (f"{name} {value:g} {unit}" for name, (value, unit) in external.items())
    return ", ".join(found) or "no external axis"


def _split(code: str) -> list[str]:
    """Split a statement at commas outside of all brackets."""
    parts, depth = [""], 0
    for sign in code:
        depth += (sign in "([") - (sign in ")]")
        if sign == "," and not depth:
            parts.append("")
        else:
            parts[-1] += sign
    return parts


# -- a station's program ---------------------------------------------------------------------------

SURE_RAD = 1e-4  # from a boundary of CONFIG: rounding could take an axis across it
EOL = "\r\n"
HEAD = """/PROG  {name}
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "hilcell";
PROG_SIZE\t= 0;
FILE_NAME\t= ;
VERSION\t\t= 0;
LINE_COUNT\t= {lines};
MEMORY_SIZE\t= 0;
PROTECT\t\t= READ_WRITE;
TCD:  STACK_SIZE\t= 0,
      TASK_PRIORITY\t= 50,
      TIME_SLICE\t= 0,
      BUSY_LAMP_OFF\t= 0,
      ABORT_REQUEST\t= 0,
      PAUSE_REQUEST\t= 0;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
/MN"""


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    """Files of a station by name. Raises `SettingsError` for a tool without a number,
    `HilcellError` for a position whose posture CONFIG does not say.

    Positions, the safe pose too, are in UF 0, so that neither joints nor a frame of the controller
    count. Turn numbers are of axes 1, 4, 6 as the cell file counts them.
    """
    name = module_name(program.station).upper()
    points = _Points(program)
    lines = [
        f"{number:4d}:{'' if each[:2] in ('J ', 'L ') else '  '}{each}"
        for number, each in enumerate(_statements(program, stamp, points), start=1)
    ]
    text = [HEAD.format(name=name, lines=len(lines)), *lines, "/POS", *points.written, "/END", ""]
    return {f"{name}{SUFFIX}": "\n".join(text).replace("\n", EOL).encode(ENCODING)}


class _Points:
    """Numbers the positions of a program; ``written``: their texts."""

    def __init__(self, program: StationProgram) -> None:
        self._arm, self._tool = program.arm, tool_number(program, USUAL_TOOL)
        self._T_B_W = poses_from_zyx(program.base[None])[0]
        self.written = list[str]()

    @property
    def tool(self) -> int:
        return self._tool

    def add(self, name: str, places: Places) -> list[str]:
        """Add positions, named with their number behind ``name``; return them as statements do."""
        values = zyx_from_pose(self._T_B_W @ poses_from_zyx(places.values))
        return [
            self._added(f"{name}{n}", *each)
            for n, each in enumerate(zip(values, places.joints_rad, places.status, strict=True), 1)
        ]

    def _added(self, name: str, values: Array, joints_rad: Array, status: int) -> str:
        config = self._config(name, joints_rad, status)
        x, y, z, r, p, w = (fixed(each, 3).rjust(9) for each in values)
        label = f"P[{len(self.written) + 1}:"
        self.written.append(
            f"{label}\"{name}\"]{{\n   GP1:\n\tUF : 0, UT : {self._tool},\t\tCONFIG : '{config}',\n"
            f"\tX = {x}  mm,\tY = {y}  mm,\tZ = {z}  mm,\n"
            f"\tW = {w} deg,\tP = {p} deg,\tR = {r} deg\n}};"
        )
        return f"{label}{name}]"

    def _config(self, name: str, joints_rad: Array, status: int) -> str:
        turned = joints_rad[[0, 3, 5]] + np.pi
        turns = np.floor(turned / (2.0 * np.pi)).astype(int)
        near = np.abs(turned - 2.0 * np.pi * np.round(turned / (2.0 * np.pi))) < SURE_RAD
        unsure = [f"axis {n} at 180 deg" for n in np.array([1, 4, 6])[near]]
        unsure += ["axis 5 at 0 deg"] * bool(abs(joints_rad[4]) < SURE_RAD)
        unsure += ["the arm behind axis 1"] * bool(status & BEHIND)
        if unsure:
            raise HilcellError(
                f"{name}: {', '.join(unsure)}: CONFIG does not say its posture; change "
                "robot.safe_deg, robot.home_deg or the holes' angles about the drill",
                code="HC-C10",
            )
        return f"{' '.join(posture(self._arm, status))}, {', '.join(map(str, turns))}"


def _statements(program: StationProgram, stamp: Stamp, points: _Points) -> Iterator[str]:
    safe_rad = np.radians([program.safe_deg])
    poses = inverse(poses_from_zyx(program.base[None])[0]) @ forward(program.arm, safe_rad)
    places = Places(zyx_from_pose(poses), safe_rad, status_of(program.arm, safe_rad))
    (safe,) = points.add("SAFE", places)
    speed = f"{max(1, round(program.speed_percent))}% FINE    ;"
    straight = "100mm/sec FINE    ;"  # in to a hole and out of it
    below, off, at = (
        points.add(name, each)
        for name, each in (
            ("XA", program.approach), ("XS", program.standoff), ("XP", program.command)
        )
    )  # fmt: skip
    for remark in (stamp.text, *program.remarks):
        yield from remark_lines(remark)
    yield "UFRAME_NUM=0 ;"
    yield f"UTOOL_NUM={points.tool} ;"
    yield from remark_lines(f"UT {points.tool} must be {frame_text(program.tool)}")
    yield from remark_lines(
        f"UF 0 must be hilcell's {{B}}, whose origin is {program.arm.d_mm[0]:.0f} mm below axis 2; "
        "a FANUC's own is usually at axis 2: compare, then start"
    )
    yield "PAUSE ;"
    yield f"J {safe} {speed}"
    yield from remark_lines("slide held, strip as the sheet says, drill drawn back: start goes on")
    yield "PAUSE ;"
    for n, hole in enumerate(program.names):
        yield from remark_lines(f"{n + 1} of {len(program.names)}: {hole}")
        for stop in (*points.add(f"XV{n + 1}_", program.via[n]), below[n], off[n]):
            yield f"J {stop} {speed}"
        yield f"L {at[n]} {straight}"
        yield "!drill here ;"
        yield f"L {off[n]} {straight}"
    for stop in (*points.add(f"XV{len(program.names) + 1}_", program.via[-1]), safe):
        yield f"J {stop} {speed}"
