"""RAPID programs: targets as read, a file with other positions, the file of a station.

A robtarget states the quarter turns of axes 1, 4 and 6 (cf1, cf4, cf6: 0 from 0 to 90 deg, -1 from
-90 to 0 deg) and one of eight postures (cfx). Where the configuration is controlled (ConfJ, ConfL,
on unless a program switches it off), the controller stops at a target that it cannot reach in it.
A correction of a millimetre that takes an axis through a quarter leaves the old number there.

cfx counts 4 for a wrist centre behind axis 1, 2 for one behind the lower arm, 1 for A5 < 0.
(Technical reference manual, RAPID Instructions, Functions and Data types, 3HAC050917: confdata,
ConfJ, ConfL.)

A written program has its tool, and {W} as calibrated as its work object, in the file. Its points
state no external axes, which keep their position. The load of its tool is not known here, and a
load below the true one overloads the arm and makes it overshoot (tooldata, loaddata): the routine
ends before its first motion until a mass is entered. Not tried on a real controller.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from drivers.program_text import (
    ASCII,
    ENCODING,
    Edit,
    Number,
    edited,
    fixed,
    formatted,
    line_below,
    module_name,
    plain,
)
from hilcell.compensation import programs
from hilcell.compensation.programs import Places, StatedBase, StatedTool, StationProgram, Stroke
from hilcell.compensation.targets import Stamp
from hilcell.errors import bounded
from hilcell.geometry.frames import (
    from_rotvec,
    from_zyx,
    inverse,
    matrix,
    poses_from_zyx,
    to_rotvec,
    zyx_from_pose,
)
from hilcell.geometry.inverse import BEHIND, BEYOND, FLIPPED, inverse_kinematics
from hilcell.geometry.kinematics import Arm, Ints
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import clean

SUFFIX = ".mod"
DECIMALS, QUATERNION_DECIMALS = 3, 8
COUNTED = (0, 3, 5)  # axes whose quarters a configuration states
NOT_THERE = "9E9"  # an external axis that a system does not have
CONTRARY = "configurations that their position contradicts, without the correction too, stay"


@dataclass(frozen=True, slots=True)
class Target:
    """A robtarget that motions use: its numbers x, y, z and q1 to q4, and its configuration.

    ``is_controlled``: whether a motion reaches it with its configuration checked; ``external``:
    eax_a to eax_f, None where it states none.
    """

    name: str
    line: int
    numbers: Sequence[Number] = field(repr=False)
    quarters: tuple[int, int, int]
    cfx: int
    external: tuple[float | None, ...]
    is_controlled: bool = False

    def status(self, arm: Arm) -> int:
        """Return the status of its posture, as in `hilcell.geometry.inverse`."""
        is_beyond = (not self.cfx & 2) == bool(arm.sign[2] > 0)
        return BEHIND * (self.cfx // 4) + BEYOND * is_beyond + FLIPPED * (self.cfx % 2)


def cfx_of(status: int, arm: Arm) -> int:
    """Return cfx of a status, whose bit 1 counts as axis 3 of the arm does: down, or up."""
    is_in_front = bool(status & BEYOND) == bool(arm.sign[2] > 0)
    return 4 * bool(status & BEHIND) + 2 * (not is_in_front) + bool(status & FLIPPED)


@dataclass(frozen=True, slots=True)
class Program(programs.Program):
    """The text of a file, its targets in the order of their first motion, and remarks on them.

    ``head_end``: the character behind the module's head; ``strokes``: motions to places beside a
    target.
    """

    file: str
    text: str = field(repr=False)
    targets: Sequence[Target]
    head_end: int
    notes: list[str]
    strokes: Sequence[Stroke] = ()
    base: StatedBase | None = None
    tool: StatedTool | None = None
    suffixes = (SUFFIX, ".sys")

    @property
    def names(self) -> list[str]:
        return [self._where(target) for target in self.targets]

    def _where(self, target: Target) -> str:
        return f"{target.name} ({self.file} line {target.line})"

    def values(self) -> Array:
        """Return the targets (N, 6): X, Y, Z in mm, A, B, C in deg, in their work object."""
        rows = np.array([[number.value for number in t.numbers] for t in self.targets])
        return zyx_from_pose(matrix(from_quaternions(rows[:, 3:]), rows[:, :3]))

    @property
    def slide(self) -> tuple[str, float] | None:
        """First target, and eax_a, of a track by usual order; the reader refuses others."""
        first = self.targets[0]
        slide_mm = first.external[0]
        return None if slide_mm is None else (f"{self._where(first)} by eax_a", slide_mm)

    @property
    def needs_arm(self) -> str:
        is_any = any(each.is_controlled for each in self.targets)
        return "axis configurations (confdata)" if is_any else ""

    def statuses(self, expected: int, arm: Arm) -> list[tuple[str, int]]:
        controlled = (each for each in self.targets if each.is_controlled)
        return [(self._where(each), each.status(arm)) for each in controlled]

    def check_joints(self, arm: Arm, T_W_B: Array, command: Array) -> list[str]:
        """Raise `QuarterError` naming the points that ``command`` (N, 6) takes out of the quarter
        turn that they state, as `Offs` and `RelTool` of them do.

        Targets and ``command`` are in {W}; the nominal ``arm`` at ``T_W_B`` gives the joints. A
        stated quarter that the nominal target does not have either is the program's own: it is
        noted.
        """
        nominal = self.values()
        shifted = [(each.where, each.target, each.shift_mm) for each in self.strokes]
        ends = [(self._where(t), n, (0.0, 0.0, 0.0)) for n, t in enumerate(self.targets)]
        by_status: dict[int, list[tuple[str, int, tuple[float, ...]]]] = {}
        for end in (*ends, *shifted):
            target = self.targets[end[1]]
            if target.is_controlled:
                by_status.setdefault(target.status(arm), []).append(end)
        problems, contrary = list[str](), list[str]()
        for status, found in by_status.items():
            at = [n for _, n, _ in found]
            poses = inverse(T_W_B) @ np.array([
                _moved(values[at], np.array([shift_mm for *_, shift_mm in found]))
                for values in (nominal, command)
            ])  # fmt: skip
            joints_deg = np.degrees(inverse_kinematics(arm, poses, status))[..., list(COUNTED)]
            stated = np.array([self.targets[n].quarters for n in at])
            before, after = np.floor(joints_deg / 90.0) % 4 == stated % 4
            problems += [
                f"  {found[n][0]}: axis {COUNTED[k] + 1} goes from {joints_deg[0, n, k]:.3f} to "
                f"{joints_deg[1, n, k]:.3f} deg, stated cf{COUNTED[k] + 1} {stated[n, k]}"
                for n, k in np.argwhere(before & ~after).tolist()
            ]
            contrary += [
                f"{found[n][0]} cf{COUNTED[k] + 1} {stated[n, k]}, axis {COUNTED[k] + 1} at "
                f"{joints_deg[0, n, k]:.1f} deg"
                for n, k in np.argwhere(~before & ~after).tolist()
            ]
        if problems:
            raise QuarterError(
                "the correction takes axes into another quarter turn than the configuration of "
                "their target states, where the controller would stop; state that quarter there, "
                "or switch the control off (ConfJ\\Off, ConfL\\Off)\n" + "\n".join(problems)
            )
        return ["; ".join((CONTRARY, *bounded(contrary)))] if contrary else []

    def frame_text(self, values: Array) -> str:
        return _frame(values)

    @property
    def remarks(self) -> list[str]:
        lines = (line.partition("!") for line in self.text.split("\n"))
        return [remark for _, sign, remark in lines if sign]

    def with_positions(self, positions: Array, remark: str = "") -> dict[str, bytes]:
        """The file by its name, with other X, Y, Z (N, 3), or poses (N, 6), and a remark below the
        head of its module.
        """
        edits = list[Edit]()
        if remark:
            edits.append(line_below(self.text, self.head_end - 1, f"  ! {plain(remark, ASCII)}"))
        numbers = positions
        if positions.shape[1] > 3:
            turns = to_quaternions(from_zyx(positions[:, 3:]))
            before = np.array([[each.value for each in t.numbers[3:]] for t in self.targets])
            turns *= np.where(np.sum(turns * before, axis=1) < 0.0, -1.0, 1.0)[:, None]
            numbers = np.hstack([positions[:, :3], turns])
        for target, row in zip(self.targets, numbers.tolist(), strict=True):
            edits += [
                Edit(number.start, number.end, formatted(value, number.text, decimals))
                for number, value, decimals in zip(
                    target.numbers, row, [DECIMALS] * 3 + [QUATERNION_DECIMALS] * 4, strict=False
                )
            ]
        return {self.file: edited(self.text, edits).encode(ENCODING)}


class QuarterError(HilcellError):
    """Targets whose stated quarter turns are others after the correction."""


def _moved(values: Array, shifts_mm: Array) -> Array:
    poses = poses_from_zyx(values)
    poses[:, :3, 3] += shifts_mm
    return poses


def from_quaternions(q: ArrayLike) -> Array:
    """Return rotations (N, 3, 3) of quaternions (N, 4), the real part first, of any length."""
    rows = np.asarray(q, dtype=float)
    sine = np.linalg.norm(rows[:, 1:], axis=1)
    scale = np.divide(
        2.0 * np.arctan2(sine, rows[:, 0]), sine, out=np.zeros_like(sine), where=sine > 0.0
    )
    return from_rotvec(rows[:, 1:] * scale[:, None])


def to_quaternions(rotations: Array) -> Array:
    """Return quaternions (N, 4), the real part first and not negative, of rotations (N, 3, 3)."""
    vectors = to_rotvec(rotations)
    half = 0.5 * np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.hstack([np.cos(half), 0.5 * vectors * np.sinc(half / np.pi)])


# -- the program of a station ----------------------------------------------------------------------

TOOL, WORLD, SAFE = "tHilcell", "wHilcell", "jSafe"
NO_MASS_KG = 0.001  # of the controller's load0; a tool of it is not moved
NO_LOAD = f"[{NO_MASS_KG},[0,0,0.001],[1,0,0,0],0,0,0]"


def write_station(program: StationProgram, stamp: Stamp) -> dict[str, bytes]:
    name = module_name(program.station)
    text = "".join(f"{line}\r\n" for line in _lines(name, program, stamp))
    return {f"{name}{SUFFIX}": text.encode(ENCODING)}


def _lines(name: str, program: StationProgram, stamp: Stamp) -> Iterator[str]:
    yield f"MODULE {name}"
    yield _comment(stamp.text)
    yield from map(_comment, program.remarks)
    yield _comment(f"tool {program.tool_name}; enter its load below: mass in kg, centre of gravity")
    yield f"  LOCAL PERS tooldata {TOOL}:=[TRUE,{_frame(program.tool)},{NO_LOAD}];"
    yield _comment("{W} as calibrated, in the robot's base; the controller's base frame is zero")
    world = f'[FALSE,TRUE,"",{_frame(program.base)},[[0,0,0],[1,0,0,0]]]'
    yield f"  LOCAL PERS wobjdata {WORLD}:={world};"
    none = ",".join([NOT_THERE] * 6)
    safe = ",".join(fixed(deg, 6) for deg in program.safe_deg)
    yield f"  LOCAL CONST jointtarget {SAFE}:=[[{safe}],[{none}]];"
    percent = program.speed_percent
    yield f"  LOCAL CONST speeddata vFree:=[{10 * percent:g},{percent:g},1000,1000];"
    yield "  LOCAL CONST speeddata vHole:=[100,50,1000,1000];"
    ways = (program.approach, program.standoff, program.command)
    count = len(program.names)
    written = [_points(each, program.arm) for each in ways]
    for number, points in enumerate(zip(*written, strict=True), start=1):
        for letter, point in zip("ASP", points, strict=True):
            yield f"  LOCAL CONST robtarget X{letter}{number}:=[{point},[{none}]];"
    for number, places in enumerate(program.via, start=1):
        for via, point in zip(_via(program, number), _points(places, program.arm), strict=True):
            yield f"  LOCAL CONST robtarget {via}:=[{point},[{none}]];"
    yield f"  PROC drill_{name}()"
    switch = "On" if _is_sure((*ways, *program.via)) else "Off"
    yield f"    IF {TOOL}.tload.mass <= {NO_MASS_KG} THEN"
    yield f'      TPWrite "enter the load of {TOOL} in module {name}: its mass is not stated";'
    yield "      EXIT;"
    yield "    ENDIF"
    yield f"    ConfJ\\{switch};"
    yield f"    ConfL\\{switch};"
    yield f"    MoveAbsJ {SAFE}\\NoEOffs,vFree,fine,{TOOL}\\WObj:={WORLD};"
    yield '    TPWrite "slide held, strip as the sheet says, drill drawn back: start goes on";'
    yield "    Stop;"
    for number, hole in enumerate(program.names, start=1):
        yield f"  {_comment(f'{number} of {count}: {hole}')}"
        yield from (_move("MoveJ", point, "vFree") for point in _via(program, number))
        yield _move("MoveJ", f"XA{number}", "vFree")
        yield _move("MoveJ", f"XS{number}", "vFree")
        yield _move("MoveL", f"XP{number}", "vHole")
        yield f"  {_comment('drill here')}"
        yield _move("MoveL", f"XS{number}", "vHole")
    yield from (_move("MoveJ", point, "vFree") for point in _via(program, count + 1))
    yield f"    MoveAbsJ {SAFE}\\NoEOffs,vFree,fine,{TOOL}\\WObj:={WORLD};"
    yield "  ENDPROC"
    yield "ENDMODULE"


def _comment(text: str) -> str:
    return f"  ! {plain(clean(text), ASCII)}"


def _move(word: str, point: str, speed: str) -> str:
    return f"    {word} {point},{speed},fine,{TOOL}\\WObj:={WORLD};"


def _via(program: StationProgram, number: int) -> list[str]:
    """Return the names of the points of the path to a hole, counted from 1, or to the safe pose."""
    count = len(program.via[number - 1].values)
    return [f"XV{number}_{n}" for n in range(1, count + 1)]


def _is_sure(places: Sequence[Places]) -> bool:
    """Whether no axis is so near to a quarter turn that rounding could change its number."""
    joints_deg = np.degrees(np.concatenate([each.joints_rad for each in places]))
    off_deg = np.abs((joints_deg[:, COUNTED] + 45.0) % 90.0 - 45.0)
    return bool(off_deg.min() >= 0.01)


def _points(places: Places, arm: Arm) -> Iterator[str]:
    """Yield place, orientation and configuration of each point."""
    quarters: Ints = np.floor(np.degrees(places.joints_rad[:, COUNTED]) / 90.0).astype(int)
    for values, status, quarter in zip(places.values, places.status, quarters, strict=True):
        yield f"{_frame(values)[1:-1]},[{','.join(map(str, quarter))},{cfx_of(status, arm)}]"


def _frame(values: Array) -> str:
    (turns,) = to_quaternions(from_zyx(values[None, 3:]))
    place = ",".join(fixed(each, 4) for each in values[:3])
    turn = ",".join(fixed(each, QUATERNION_DECIMALS) for each in turns)
    return f"[[{place}],[{turn}]]"
