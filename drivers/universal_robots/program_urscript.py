"""URScript programs: poses read and corrected, and the program of a station written.

Corrected are the poses of ``movej`` and ``movel`` that the program states as six numbers, or in a
variable that is assigned once and used by motions only. Every other statement must be known neither
to move the robot nor to change its TCP; all else is refused, by line. Poses are those of the TCP in
the robot's base {B}. A statement is a line without its comment, its strings blanked, with the
columns of its line, so that numbers are replaced byte for byte. Names are case sensitive.

A written program moves by joints of the cell's arm, as commanded in the calibration: the controller
would compute the joints of a pose by its own factory-calibrated kinematics.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.program_text import (
    ASCII,
    ENCODING,
    MARK,
    Edit,
    Number,
    edited,
    fixed,
    formatted,
    line_below,
    module_name,
    plain,
    source_text,
)
from hilcell.cell.settings import SettingsError
from hilcell.compensation import programs
from hilcell.compensation.programs import StatedTool, StationProgram
from hilcell.compensation.targets import Stamp
from hilcell.geometry.frames import from_rotvec, from_zyx, matrix, to_rotvec, zyx_from_pose
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import clean

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
POSE = re.compile(r"p\[\s*" + r"\s*,\s*".join(f"({NUMBER})" for _ in range(6)) + r"\s*\]", re.ASCII)
_QUIET = re.compile(r"\"[^\"]*\"|#.*")
_SIGN = re.compile(r"[\[\](),]")


class UrScriptError(HilcellError):
    """A statement that is refused; the message states why, its reader adds where."""


class Statement(NamedTuple):
    """The code of one line, and the character of the file at which it starts."""

    line: int
    start: int
    code: str
    source: str  # as the file has it, for messages


def statements(text: str) -> Iterator[Statement]:
    def blank(match: re.Match[str]) -> str:
        text = match.group()
        return " " * len(text) if text.startswith("#") else f'"{" " * (len(text) - 2)}"'

    start = 0
    for line, whole in enumerate(text.split("\n"), start=1):
        code = _QUIET.sub(blank, whole)
        if not start and code.startswith(MARK):
            code = " " * len(MARK) + code[len(MARK) :]
        bare = code.strip()
        if bare:
            at = len(code) - len(code.lstrip())
            source = whole[at : at + len(bare)]
            yield Statement(line, start + at, bare, source)
        start += len(whole) + 1


def split(text: str) -> list[str]:
    """Split arguments at commas outside of all brackets; raises `UrScriptError`."""
    parts, depth, begin = list[str](), 0, 0
    for match in _SIGN.finditer(text):
        sign = match.group()
        depth += (sign in "([") - (sign in ")]")
        if depth < 0:
            break
        if sign == "," and not depth:
            parts.append(text[begin : match.start()])
            begin = match.end()
    if depth:
        raise UrScriptError("its brackets do not close on its line")
    return [*parts, text[begin:]]


def pose(text: str, start: int) -> list[Number] | None:
    """Return the numbers of ``p[x, y, z, rx, ry, rz]``, None where it is no such pose.

    ``text`` begins at the character ``start`` of its file. Raises `UrScriptError` for a number
    beyond any range.
    """
    match = POSE.fullmatch(text)
    if match is None:
        return None
    found = [Number(match[n], start + match.start(n), start + match.end(n)) for n in range(1, 7)]
    if not all(math.isfinite(each.value) for each in found):
        raise UrScriptError("a number of its pose is not finite")
    return found


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
class Program(programs.Program):
    """The text of a file, its targets in the order of their first motion, and remarks on them.

    Revolutions do not matter: the controller moves to the nearest joints. ``tcp``: the pose that
    the program sets, in m and rad, or None.
    """

    file: str
    text: str = field(repr=False)
    targets: list[Target]
    notes: list[str]
    tcp: Target | None = None
    in_root = True
    suffixes = (SUFFIX,)

    @property
    def names(self) -> list[str]:
        return [f"{target.name} ({self.file} line {target.line})" for target in self.targets]

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, A, B, C in deg, in {B}."""
        return zyx_from_pose(_frames([target.values for target in self.targets]))

    @property
    def tool(self) -> StatedTool | None:
        if self.tcp is None:
            return None
        numbers = ", ".join(each.text for each in self.tcp.numbers)
        frame = _frames([self.tcp.values])[0]
        return StatedTool(
            f"{self.file} line {self.tcp.line}", f"set_tcp(p[{numbers}])", None, frame
        )

    @property
    def remarks(self) -> list[str]:
        quiet = (each for line in self.text.split("\n") for each in _QUIET.findall(line))
        return [each[1:] for each in quiet if each.startswith("#")]

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """The file by its name, with other X, Y, Z (N, 3), or poses (N, 6), in {B}, and a remark
        below its first statement.
        """
        edits = list[Edit]()
        if remark:
            first = next(statements(self.text))
            edits.append(line_below(self.text, first.start, f"  # {plain(remark, ASCII)}"))
        rows = positions[:, :3] / MM
        if positions.shape[1] > 3:
            before_rad = np.array([target.values[3:] for target in self.targets])
            rows = np.hstack([rows, _nearest(positions, before_rad)])
        for target, row in zip(self.targets, rows.tolist(), strict=True):
            edits += [
                Edit(each.start, each.end, formatted(value, each.text, DECIMALS))
                for each, value in zip(target.numbers, row, strict=False)
            ]
        return {self.file: edited(self.text, edits).encode(ENCODING)}


def _frames(poses: list[list[float]]) -> Array:
    """Return frames (N, 4, 4), mm, of poses (N, 6) of URScript."""
    rows = np.array(poses)
    return matrix(from_rotvec(rows[:, 3:]), MM * rows[:, :3])


def _nearest(positions: Array, before_rad: Array) -> Array:
    """Return rotation vectors (N, 3) of poses (N, 6): of the two that mean one, the nearer to
    ``before_rad``.
    """
    vectors = to_rotvec(from_zyx(positions[:, 3:]))
    angles = np.linalg.norm(vectors, axis=1, keepdims=True)
    others = vectors * (
        1.0 - np.divide(2.0 * np.pi, angles, out=np.zeros_like(angles), where=angles > 0.0)
    )
    off_rad, other_off_rad = (
        np.linalg.norm(each - before_rad, axis=1) for each in (vectors, others)
    )
    return np.where((off_rad <= other_off_rad)[:, None], vectors, others)


def read_program(file: str, text: str) -> Program:
    """Return the program; raises `SettingsError` with all that is refused, by line."""
    reader = _Reader()
    if problems := reader.read(list(statements(text))):
        raise SettingsError(file, [f"{file} {problem}" for problem in problems])
    if not reader.targets:
        raise SettingsError(
            file, [f"{file}: no movej or movel to a pose p[...]: nothing to correct"]
        )
    return Program(file, text, list(reader.targets.values()), reader.notes(), reader.tcp)


class _Reader:
    """Goes through the statements once for names, and once more for their uses."""

    MOTIONS = ("movej", "movel")
    PARAMETERS = ("a", "v", "t", "r")  # behind the target, in their order
    WORDS = ("and", "or", "not", "xor", "True", "False", "return", "global", "local")
    HARMLESS = (
        "sleep", "sync", "textmsg", "popup", "halt", "to_num", "to_str", "str_cat", "str_len",
        "abs", "sqrt", "floor", "ceil", "pow", "sin", "cos", "tan", "d2r", "r2d", "random",
        "length", "get_steptime", "is_steady", "stopj", "stopl", "force", "get_tcp_force",
        "set_digital_out", "set_analog_out", "set_standard_digital_out", "set_standard_analog_out",
        "set_configurable_digital_out", "set_tool_digital_out", "set_tool_voltage", "set_flag",
        "get_flag", "get_digital_in", "get_digital_out", "get_analog_in", "get_standard_digital_in",
        "get_standard_digital_out", "get_standard_analog_in", "get_configurable_digital_in",
        "get_configurable_digital_out", "get_tool_digital_in", "get_tool_digital_out",
        "get_tool_analog_in", "read_input_boolean_register", "read_input_integer_register",
        "read_input_float_register", "write_output_boolean_register",
        "write_output_integer_register", "write_output_float_register", "set_payload",
        "set_target_payload", "set_gravity",
    )  # fmt: skip
    _DEF = re.compile(r"def\s+(\w+)\s*\(([\w\s,]*)\)\s*:", re.ASCII)
    _BRANCH = re.compile(r"(?:if|elif|while)\b(.+):", re.ASCII)
    _ASSIGN = re.compile(
        r"(?:(?:global|local)\s+)?(\w+)\s*(\[[^\[\]]*\])?\s*=(?!=)\s*(.*)", re.ASCII
    )
    _CALL = re.compile(r"(\w+)\s*\(\s*(.*)\)", re.ASCII)
    _NAME = re.compile(r"(?<![\w.])([A-Za-z_]\w*)\s*(\()?", re.ASCII)

    def __init__(self) -> None:
        self.targets: dict[str, Target] = {}
        self.tcp: Target | None = None
        self._poses: dict[str, Target] = {}
        self._assigned: dict[str, list[int]] = defaultdict(list)
        self._functions = set[str]()
        self._moved = 0
        self._open = list[int]()  # lines of the blocks around a statement
        self._main = 0  # the line of the first def

    def read(self, found: list[Statement]) -> list[str]:
        problems = dict[int, str]()
        for take in (self._name, self._use):
            for statement in found:
                try:
                    if statement.line not in problems:
                        take(statement)
                except UrScriptError as error:
                    source = clean(statement.source)
                    quoted = source if len(source) <= 80 else f"{source[:77]}..."
                    problems[statement.line] = f"{quoted}: {error}"
        if not problems:
            problems = dict.fromkeys(self._open, "its block has no end")
        return [f"line {line}: {problems[line]}" for line in sorted(problems)]

    def notes(self) -> list[str]:
        """Return notes on all that was left, and on conditions that are not checked."""
        left = [name for name in self._poses if name not in self.targets]
        notes = [f"not used by a motion, left: {', '.join(left)}"] if left else []
        if self.tcp is None:
            notes.append("it sets no TCP: that of the installation must be the calibrated one")
        notes.append(
            "the controller computes the joints of a pose by its own calibrated kinematics: the "
            "correction holds as far as these are the cell file's; `prepare` writes joints, which "
            "do not depend on them"
        )
        return notes

    def _name(self, statement: Statement) -> None:
        """Collect the names that a statement defines; refuse those that have a meaning already."""
        code = statement.code
        if ";" in code or code.count('"') % 2:
            raise UrScriptError("expected one statement a line, and strings that end on it")
        split(code)
        if match := self._DEF.fullmatch(code):
            self._functions.add(match[1])
            for parameter in filter(None, (each.strip() for each in match[2].split(","))):
                self._assigned[parameter].append(statement.line)
            if match[1] in (*self.HARMLESS, *self.MOTIONS, "set_tcp"):
                raise UrScriptError(f"it gives {match[1]} another meaning")
        elif (match := self._ASSIGN.fullmatch(code)) and not self._BRANCH.fullmatch(code):
            self._assigned[match[1]].append(statement.line)
            numbers = pose(match[3], statement.start + match.start(3))
            if numbers is not None and match[2] is None:
                self._poses.setdefault(match[1], Target(match[1], statement.line, numbers))
        for word, _ in self._NAME.findall(code):
            if word in ("thread", "run", "join", "kill", "enter_critical", "exit_critical"):
                raise UrScriptError(f"{word}: several threads may move the robot at once")

    def _use(self, statement: Statement) -> None:
        code = statement.code
        plain = r"else\s*:|halt|break|continue|pass|return|\$\s*\d+[\s\"]*"
        if self._DEF.fullmatch(code):
            self._main = self._main or statement.line
            self._open.append(statement.line)
        elif match := self._BRANCH.fullmatch(code):
            self._check(match[1])
            if not code.startswith("elif"):
                self._open.append(statement.line)
        elif code == "end":
            if not self._open:
                raise UrScriptError("no block is open")
            self._open.pop()
        elif match := self._ASSIGN.fullmatch(code):
            self._assign(match[1], match[2] or "", match[3])
        elif match := self._CALL.fullmatch(code):
            self._call(statement, match[1], split(match[2]), statement.start + match.start(2))
        elif code.startswith("return "):
            self._check(code)
        elif not re.fullmatch(plain, code, re.ASCII):
            raise UrScriptError("it is no statement that hilcell reads")

    def _assign(self, name: str, index: str, value: str) -> None:
        if name in self._poses and index:
            raise UrScriptError(f"it changes the pose {name} at run time")
        if name not in self._poses or pose(value, 0) is None:
            self._check(value)
        self._check(index)

    def _call(self, statement: Statement, name: str, arguments: list[str], at: int) -> None:
        """Take a call whose first argument begins at the character ``at`` of the file."""
        if name in self.MOTIONS:
            self._move(statement, name, arguments, at)
        elif name == "set_tcp":
            self._set_tcp(statement, arguments, at)
        else:
            self._check(statement.code)

    def _move(self, statement: Statement, name: str, arguments: list[str], at: int) -> None:
        if self.tcp is not None and self._open[:1] != [self._main]:
            raise UrScriptError(
                f"it moves outside of the program whose line {self.tcp.line} sets the TCP"
            )
        stated = arguments[0].strip()
        numbers = pose(stated, at)
        if numbers is not None:
            where = f"{name} target"
            self.targets[f"{where} {statement.start}"] = Target(where, statement.line, numbers)
        else:
            self.targets.setdefault(stated, self._variable(stated))
        for position, argument in enumerate(arguments[1:]):
            named = re.fullmatch(r"(\w+)\s*=(?!=)\s*(.*)", argument.strip(), re.ASCII)
            if named is None and position >= len(self.PARAMETERS):
                raise UrScriptError("it has more arguments than a, v, t, r behind its target")
            key = named[1] if named else self.PARAMETERS[position]
            value = named[2] if named else argument.strip()
            if key not in self.PARAMETERS:
                raise UrScriptError(f"{key} is no argument of {name} behind its target")
            if key == "r" and not (re.fullmatch(NUMBER, value) and float(value) == 0.0):
                raise UrScriptError(
                    f"blend radius {value}: the robot passes the pose, and the correction changes "
                    "where; expected r=0"
                )
            self._check(value)
        self._moved = self._moved or statement.line

    def _variable(self, stated: str) -> Target:
        """Return the pose that a variable holds; raises `UrScriptError`."""
        if stated.startswith("["):
            raise UrScriptError("a joint target: nothing there can be corrected; state a pose p[]")
        if called := self._CALL.match(stated):
            raise UrScriptError(f"its target is computed at run time, by {called[1]}")
        if stated not in self._poses:
            raise UrScriptError("its target is no pose that stands in the program as six numbers")
        lines = self._assigned[stated]
        if len(lines) != 1:
            stands = ", ".join(map(str, lines))
            raise UrScriptError(f"{stated} is assigned in lines {stands}, expected in one")
        return self._poses[stated]

    def _set_tcp(self, statement: Statement, arguments: list[str], at: int) -> None:
        numbers: list[Number] | None = pose(arguments[0].strip(), at)
        if numbers is None or any(not each.strip().startswith('"') for each in arguments[1:]):
            raise UrScriptError("its TCP does not stand there as six numbers p[...]")
        found = Target("set_tcp", statement.line, numbers)
        if self._open != [self._main]:
            raise UrScriptError("it sets the TCP elsewhere than in the program's own statements")
        if self._moved:
            raise UrScriptError(f"it sets the TCP below the motion of line {self._moved}")
        if self.tcp is not None and self.tcp.values != found.values:
            raise UrScriptError(f"it changes the TCP that line {self.tcp.line} has set")
        self.tcp = self.tcp or found

    def _check(self, code: str) -> None:
        """Refuse an expression that has to do with poses, or calls a function that is not known."""
        if re.search(r"(?<!\w)p\s*\[", code, re.ASCII):
            raise UrScriptError("a pose stands where hilcell does not follow it")
        for word, called in self._NAME.findall(code):
            if word in self._poses:
                raise UrScriptError(f"the pose {word} is used besides the motions to it")
            if not called or word in self.WORDS or word in self.HARMLESS or word in self._functions:
                continue
            if word in self.MOTIONS:
                raise UrScriptError(f"{word} must be a statement of its own")
            raise UrScriptError(f"{word}() is not known to leave robot, TCP and poses as they are")


def load_program(path: Path) -> Program:
    """Read a program; raises `SettingsError`."""
    return read_program(path.name, source_text(path, "URScript"))


JOINT_DECIMALS = 7  # of rad and m


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    name = module_name(program.station)
    text = "".join(f"{line}\n" for line in _lines(name, program, stamp))
    return {f"{name}{SUFFIX}": text.encode(ENCODING)}


def _lines(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    full_rad_s = 1.05  # of the joint that moves farthest, the usual speed of movej
    how = f"a=0.7, v={full_rad_s * program.speed_percent / 100.0:.4f}"  # rad/s^2, rad/s
    safe = _joints(np.radians(program.safe_deg))
    yield f"def {name}():"
    yield _comment(stamp.text)
    yield from map(_comment, program.remarks)
    yield _comment("joints as calibrated: base and TCP have a part in the straight ways alone")
    tcp = [*(program.tool[:3] / 1000.0), *to_rotvec(from_zyx(program.tool[3:]))]
    yield f"  set_tcp(p{_joints(tcp)})"
    yield f"  movej({safe}, {how})"
    yield _comment("slide held, strip as the sheet says, drill drawn back: Continue goes on")
    yield '  popup("slide held, strip read, drill drawn back?", "hilcell", blocking=True)'
    straight = "a=0.5, v=0.1"  # m/s^2 and m/s: in to a hole and out of it
    ways = (program.approach, program.standoff, program.command)
    places = zip(program.names, *(each.joints_rad for each in ways), strict=True)
    for number, (hole, below, off, at) in enumerate(places, start=1):
        yield _comment(f"{number} of {len(program.names)}: {hole}")
        for stop in program.via[number - 1].joints_rad:
            yield f"  movej({_joints(stop)}, {how})"
        yield f"  movej({_joints(below)}, {how})"
        yield f"  movej({_joints(off)}, {how})"
        yield f"  movel({_joints(at)}, {straight})"
        yield _comment("drill here")
        yield f"  movel({_joints(off)}, {straight})"
    for stop in program.via[-1].joints_rad:
        yield f"  movej({_joints(stop)}, {how})"
    yield f"  movej({safe}, {how})"
    yield "end"


def _comment(text: str) -> str:
    return f"  # {plain(clean(text), ASCII)}"


def _joints(joints_rad: ArrayLike) -> str:
    return f"[{', '.join(fixed(each, JOINT_DECIMALS) for each in np.asarray(joints_rad))}]"
