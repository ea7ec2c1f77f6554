"""KRL programs: targets as read, files with other positions, files of a station.

A motion by joints to a point with T goes to the turn of T's bits: bit i is set where axis i + 1 is
below zero. The trap: a correction of a millimetre that takes an axis through zero leaves the old
bit, which then means a position one revolution away.

Points of a written station are E6POS with S and T, in the base {W} as calibrated, without external
axes, which keep their position.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.kuka.krl import POSE
from drivers.kuka.program_krl.data import statements
from drivers.program_text import (
    ENCODING,
    Edit,
    Number,
    edited,
    fixed,
    formatted,
    line_below,
    module_name,
    plain,
    tool_number,
)
from hilcell.compensation import programs
from hilcell.compensation.programs import Places, StatedBase, StatedTool, StationProgram, Stroke
from hilcell.compensation.targets import Stamp
from hilcell.geometry.frames import inverse, poses_from_zyx
from hilcell.geometry.inverse import inverse_kinematics
from hilcell.geometry.kinematics import Arm
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import clean

SOURCE, DATA = ".src", ".dat"
USUAL_TOOL = 1  # of a cell that states none in robot.options, as the driver takes it


@dataclass(frozen=True, slots=True)
class Target:
    """A point that motions use: its name, position, and numbers.

    ``posture``: S where a motion by joints uses it and S and T fix its joints to whole revolutions;
    ``status``: S where such a motion uses it.
    """

    name: str
    file: str
    line: int
    numbers: dict[str, Number] = field(repr=False)
    posture: int | None = None
    status: int | None = None

    @property
    def where(self) -> str:
        return f"{self.name} ({self.file} line {self.line})"


class Kept(NamedTuple):
    """A target that is reached in a posture of which the ``known`` bits are those of ``status``."""

    where: str
    known: int
    status: int


@dataclass(frozen=True, slots=True)
class Program(programs.Program):
    """Texts by file name, targets in the order of their first motion, and remarks on them.

    ``strokes`` start at one of the targets; ``base``: the one whose place the program states;
    ``tool``: the one that it sets; ``slide``: the first target at a known E1, and its value, mm;
    ``kept``: postures of earlier motions in which targets are reached.
    """

    texts: dict[str, str] = field(repr=False)
    targets: list[Target]
    notes: list[str]
    strokes: list[Stroke] = field(default_factory=list)
    base: StatedBase | None = None
    tool: StatedTool | None = None
    slide: tuple[str, float] | None = None
    kept: list[Kept] = field(default_factory=list)
    suffixes = (SOURCE, DATA)

    @property
    def names(self) -> list[str]:
        return [target.where for target in self.targets]

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, A, B, C in deg, as the program states them."""
        return np.array([[t.numbers[name].value for name in POSE] for t in self.targets])

    @property
    def needs_arm(self) -> str:
        """Return what only an arm's joints show, where a motion by joints states S and T."""
        if any(each.posture is not None for each in self.targets):
            return "posture (S) and turns (T)"
        stated = self.kept or any(each.status is not None for each in self.targets)
        return "postures (S)" if stated else ""

    def statuses(self, expected: int, arm: Arm) -> list[tuple[str, int]]:
        """Targets whose posture the program states, and their S. Unknown bits of a kept posture are
        the ``expected`` ones.
        """
        stated = [(target.where, target.status) for target in self.targets]
        own = [(where, status) for where, status in stated if status is not None]
        return own + [(each.where, expected & ~each.known | each.status) for each in self.kept]

    def check_joints(self, arm: Arm, T_W_B: Array, command: Array) -> tuple[str, ...]:
        """Raise `TurnError` naming the points that ``command`` (N, 6) takes through a zero.

        Targets and ``command`` are in {W}; the nominal ``arm`` at ``T_W_B`` gives the joints. The
        bits of S are those of a posture's status in `hilcell.geometry.inverse`.
        """
        T_B_W = inverse(T_W_B)
        nominal, poses = (T_B_W @ poses_from_zyx(each) for each in (self.values(), command))
        postures = np.array([-1 if each.posture is None else each.posture for each in self.targets])
        problems = list[tuple[int, str]]()  # with the targets' numbers
        for posture in np.unique(postures[postures >= 0]).tolist():
            at = np.flatnonzero(postures == posture)
            before_rad = inverse_kinematics(arm, nominal[at], posture)
            after_rad = inverse_kinematics(arm, poses[at], posture)
            for n, axis in np.argwhere((before_rad < 0.0) != (after_rad < 0.0)).tolist():
                before, after = np.degrees([before_rad[n, axis], after_rad[n, axis]])
                text = f"A{axis + 1} goes from {before:.3f} to {after:.3f} deg"
                problems.append((at[n], f"  {self.targets[at[n]].where}: {text}"))
        if problems:
            raise TurnError(
                "the correction takes axes through zero, where T would mean a whole turn; move to "
                "these points with LIN, or leave out S and T\n"
                + "\n".join(text for _, text in sorted(problems))
            )
        return ()

    def frame_text(self, values: Array) -> str:
        return _frame(values)

    def misnamed(self, stem: str) -> list[str]:
        """Return notes on modules whose name in the text is not the files' ``stem``."""
        return [
            f"{word} of {stem}{Path(file).suffix} names the module {name} (line {line}), and a "
            f"KUKA wants module and file alike: name the file {name}, or change {word}"
            for file, text in self.texts.items()
            for word, name, line in self._module(text)
            if name.lower() != stem.lower()
        ]

    def reflector_number(self, options: Mapping[str, Any]) -> int | None:
        """Return the number of the calibrated tool, as the driver takes it."""
        number: int = options.get("tool", USUAL_TOOL)
        return number

    @property
    def remarks(self) -> list[str]:
        lines = [line for text in self.texts.values() for line in text.splitlines()]
        return [remark for _, sign, remark in (line.partition(";") for line in lines) if sign]

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """Files by name, with other X, Y, Z (N, 3), or also A, B, C (N, 6), and a remark below
        their headers.
        """
        edits: dict[str, list[Edit]] = {name: [] for name in self.texts}
        for target, position in zip(self.targets, positions, strict=True):
            for name, value in zip(POSE[: len(position)], position, strict=True):
                number = target.numbers[name]
                text = formatted(float(value), number.text, decimals=3)
                edits[target.file].append(Edit(number.start, number.end, text))
        for name, text in self.texts.items():
            edits[name] += [self._remark(text, remark)] if remark and text else []
        return {
            name: edited(text, edits[name]).encode(ENCODING) for name, text in self.texts.items()
        }

    @staticmethod
    def _module(text: str) -> Iterator[tuple[str, str, int]]:
        """Yield the word that begins the module, the module's name, and the line; once at most."""
        for statement in statements(text):
            words = [each for each in statement.tokens if each.word != "GLOBAL"]
            if words[0].word in ("DEF", "DEFDAT") and len(words) > 1:
                yield words[0].word, words[1].text, statement.line
                return

    @staticmethod
    def _remark(text: str, remark: str) -> Edit:
        """Return a comment below ``DEF`` or ``DEFDAT``, the first statement; on top without one."""
        first = next(statements(text), None)
        line = f"; {plain(remark)}"
        return line_below(text, first.tokens[0].start, line) if first else Edit(0, 0, f"{line}\n")


class TurnError(HilcellError):
    """Points whose T would mean another turn after the correction."""


def turn_of(joints_rad: ArrayLike) -> NDArray[np.int_]:
    """Return T (...) of joints (..., 6): bit i is set when axis i + 1 is below 0."""
    negative = np.asarray(joints_rad) < 0
    turn: NDArray[np.int_] = np.sum(negative << np.arange(6), axis=-1)
    return turn


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    name = module_name(program.station)
    texts = {
        f"{name}{SOURCE}": _source(name, program, stamp),
        f"{name}{DATA}": _data(name, program, stamp),
    }
    return {
        file: "".join(f"{line}\r\n" for line in lines).encode(ENCODING)
        for file, lines in texts.items()
    }


def comment(text: str) -> str:
    """Return a line of comment, which `ENCODING` can write."""
    return f"; {plain(clean(text))}"


def _source(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEF {name}( )")
    yield f"; {plain(stamp.text)}"
    yield from map(comment, program.remarks)
    yield "BAS (#INITMOV,0 )"
    yield f"BAS (#TOOL,{tool_number(program, USUAL_TOOL)} )"
    yield f"BAS (#VEL_PTP,{max(1, round(program.speed_percent))} )"
    yield "BAS (#ACC_PTP,50 )"
    yield "BAS (#VEL_CP,0.1 )"  # m/s, in to a hole and out of it
    yield comment("{W} as calibrated, in the robot's root")
    yield f"$BASE={_frame(program.base)}"
    yield "PTP XHOME"
    yield comment("slide held, strip as the sheet says, drill drawn back: start goes on")
    yield "HALT"
    for number, hole in enumerate(program.names, start=1):
        yield comment(f"{number} of {len(program.names)}: {hole}")
        yield from (f"PTP {name}" for name in _via(program, number))
        yield f"PTP XA{number}"
        yield f"PTP XS{number}"
        yield f"LIN XP{number}"
        yield comment("drill here")
        yield f"LIN XS{number}"
    yield from (f"PTP {name}" for name in _via(program, len(program.names) + 1))
    yield "PTP XHOME"
    yield "END"


def _data(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield from ("&ACCESS RVP", "&REL 1", f"DEFDAT  {name}", f"; {plain(stamp.text)}")
    safe = ",".join(f"A{axis} {deg:.6f}" for axis, deg in enumerate(program.safe_deg, start=1))
    yield f"DECL E6AXIS XHOME={{{safe}}}"
    places = (program.approach, program.standoff, program.command)
    for number, points in enumerate(zip(*map(_points, places), strict=True), start=1):
        for letter, point in zip("ASP", points, strict=True):
            yield f"DECL E6POS X{letter}{number}={point}"
    for number, places_of in enumerate(program.via, start=1):
        for name, point in zip(_via(program, number), _points(places_of), strict=True):
            yield f"DECL E6POS {name}={point}"
    yield "ENDDAT"


def _via(program: StationProgram, number: int) -> list[str]:
    """Return the names of the points of the path to a hole, counted from 1, or to the safe pose."""
    count = len(program.via[number - 1].values)
    return [f"XV{number}_{n}" for n in range(1, count + 1)]


def _points(places: Places) -> Iterator[str]:
    """Yield the points; one with an axis at zero leaves out S and T, whose bit rounding could
    change.
    """
    turns = turn_of(places.joints_rad)
    sure = np.abs(places.joints_rad).min(axis=1) >= 1e-4  # rad
    for values, status, turn, is_sure in zip(
        places.values, places.status, turns, sure, strict=True
    ):
        posture = f",S {status},T {turn}" if is_sure else ""
        yield f"{_frame(values)[:-1]}{posture}}}"


def _frame(values: Array | Sequence[float]) -> str:
    decimals = (4, 4, 4, 6, 6, 6)
    parts = zip(POSE, values, decimals, strict=True)
    return "{" + ",".join(f"{axis} {fixed(value, places)}" for axis, value, places in parts) + "}"
