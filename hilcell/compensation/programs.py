"""Robot programs: formats that read them, and writers that make them from targets.

A format is a function that reads a file, and its companions, into a `Program`; the entry point
group ``hilcell.programs`` names it by the file's suffix, in lower case without its dot: ``src =
"package.module:load_program"``. It raises `SettingsError` with everything, by file and line, that
cannot be corrected safely.

A writer is a function from a `StationProgram` and a stamp to files by name; the group
``hilcell.program_writers`` names it by the robot's driver, or by a name of its own that
`robot.program` of a cell states: ``my-robot = "package.module:write"``.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from hilcell.atomic_files import NotWritten, is_stream, write_together
from hilcell.cell.devices import load_entry
from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import Stamp, refuse_corrected
from hilcell.decoding import Json
from hilcell.geometry.kinematics import Arm, Ints
from hilcell.ports import Array


class Stroke(NamedTuple):
    """A relative motion that keeps the correction of a target, an index into the program's.

    ``shift_mm`` leads from that target to the motion's end, ``from_mm`` to its start, in the
    targets' frame; ``where`` is for messages.
    """

    where: str
    target: int
    shift_mm: tuple[float, ...]
    from_mm: tuple[float, ...] = (0.0, 0.0, 0.0)


class StatedBase(NamedTuple):
    """A base that a program sets by numbers: x, y, z in mm, Z-Y-X angles a, b, c in deg."""

    where: str
    values: tuple[float, ...]


class StatedTool(NamedTuple):
    """The tool that a program sets: its number in the controller, or its frame (4, 4) in the flange
    if known. ``where`` and ``text`` are for messages.
    """

    where: str
    text: str
    number: int | None
    frame: Array | None = None


@runtime_checkable
class Program(Protocol):
    """A robot program: its targets, and its files with other positions. A format inherits from it
    what its language does not have.
    """

    @property
    def in_root(self) -> bool:
        """Whether targets are in the robot's root {B}, else in {W}."""
        return False

    @property
    def names(self) -> list[str]:
        """Return the targets' names, each with its place in the files, for messages."""

    @property
    def notes(self) -> list[str]:
        """Notes for the user: parts left unchanged."""

    @property
    def suffixes(self) -> Sequence[str]:
        """Return the suffixes, in lower case, of the files that may make one program."""

    @property
    def remarks(self) -> Sequence[str]:
        """Return the comments in the files, where a stamp may be."""

    def values(self) -> Array:
        """Return the targets (N, 6): x, y, z in mm, Z-Y-X angles a, b, c in deg."""

    def with_positions(self, positions: Array, remark: str = "") -> Mapping[str, bytes]:
        """Files by name, with other x, y, z (N, 3), or also a, b, c (N, 6). A non-empty remark is a
        comment in each; nothing else differs.
        """

    @property
    def strokes(self) -> Sequence[Stroke]:
        """Return the relative motions in the files, each from every target it may start at."""
        return ()

    @property
    def base(self) -> StatedBase | None:
        """The base that the program sets by numbers, or None."""
        return None

    @property
    def tool(self) -> StatedTool | None:
        """The tool that the program sets, or None."""
        return None

    def reflector_number(self, options: Json) -> int | None:
        """Return the controller's number of the reflector's tool, by the options of the robot."""
        return None

    @property
    def slide(self) -> tuple[str, float] | None:
        """First target that moves the slide, an external axis of the robot, and its position, mm.
        All are equal.
        """
        return None

    def statuses(self, expected: int, arm: Arm) -> Sequence[tuple[str, int]]:
        """Targets with a stated posture, with place and status; open bits are the ``expected``
        ones. A status counts the joints of ``arm``, whose signs a language may not share.
        """
        return ()

    @property
    def needs_arm(self) -> str:
        """Plural of what `check_joints` checks; may be empty."""
        return ""

    def check_joints(self, arm: Arm, T_W_B: Array, command: Array) -> Sequence[str]:
        """Raise `HilcellError` where ``command`` (N, 6) would need other revolutions of the joints;
        return notes on the program's own.

        It is in the targets' frame, as the pose ``T_W_B`` (4, 4) of the arm's base.
        """
        return ()

    def frame_text(self, values: Array) -> str:
        """Return a frame, x, y, z in mm and Z-Y-X angles a, b, c in deg, as its language does."""
        return " ".join(f"{axis} {each:.4f}" for axis, each in zip("XYZABC", values, strict=True))

    def misnamed(self, stem: str) -> Sequence[str]:
        """Notes where a controller would not accept its files under this stem."""
        return ()


def load_program(path: Path) -> Program | None:
    """Read a program by its suffix, if known; raises `SettingsError`, `CorrectedBefore`."""
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in entry_points(group="hilcell.programs").names:
        return None
    program = load_entry("programs", suffix)(path)
    if not isinstance(program, Program):
        found = f"expected a {Program.__module__}.Program, got {type(program).__name__}"
        raise SettingsError("programs", [f"format {suffix!r}: {found}"])
    refuse_corrected(str(path), program.remarks)
    return program


def suffixes() -> list[str]:
    return sorted(f".{name}" for name in entry_points(group="hilcell.programs").names)


def program_notes(program: Program, frame: str, source: Path, written: Sequence[Path]) -> list[str]:
    base = "" if program.in_root else f", its base must be {frame}"
    stems = dict.fromkeys(path.stem for path in (source, *written))
    names = [note for stem in stems for note in program.misnamed(stem)]
    return [*program.notes, f"its targets were taken in {frame}{base}", *names]


def write_program(
    program: Program,
    positions: Array,
    source: Path,
    out: Path,
    *,
    stamp: Stamp,
    inputs: Iterable[Path] = (),
) -> list[Path]:
    """Write the program with positions (N, 3) or poses (N, 6) and the stamp under another stem.

    ``out`` may have a suffix of it. Raises `NotWritten`; the nominal program is an input too, so
    that it cannot be overwritten and corrected twice.
    """
    if os.path.isdir(out):  # noqa: PTH112 - Path.is_dir raises for a name too long
        raise NotWritten(f"{out} is a folder; name a program in it")
    if is_stream(out):
        raise NotWritten(f"{out} is no file, and a program is one of several; name a file")
    files = program.with_positions(positions, stamp.text)
    stem = out.stem if out.suffix.lower() in program.suffixes else out.name
    contents = {out.with_name(stem + Path(name).suffix): data for name, data in files.items()}
    write_together(contents, inputs=[source, *map(source.with_name, files), *inputs])
    return list(contents)


# -- programs of one station, for the writer of a robot's language ---------------------------------


@dataclass(frozen=True, eq=False)
class Places:
    """N poses of a tool's tip in {W}, ``values`` (N, 6): x, y, z in mm, Z-Y-X angles in deg. The
    nominal arm there: ``joints_rad`` (N, 6), ``status`` (N,).
    """

    values: Array
    joints_rad: Array
    status: Ints


@dataclass(frozen=True, eq=False)
class StationProgram:
    """N targets in order of visit, by ``names``; ``command``: where the tool's tip is sent.

    From the hole before, or the safe pose, the robot goes by joints through ``via`` (N + 1, the
    last before the safe pose at the end; each may be empty) to ``approach``, then to ``standoff``,
    in front of the target, so that every axis comes from below, as in the calibration; then
    straight to ``command``, and straight back to ``standoff``. ``base`` (6,) is {W} in {B};
    ``tool`` (6,) is the tip in the flange, ``tool_name`` its name in the cell file, ``tool_number``
    its number in the controller, or None. The program begins and ends at ``safe_deg`` (6,).
    ``arm``: the nominal one, with the tip as its tool point; ``options``: of the robot's driver;
    ``remarks``: comments for its head.
    """

    station: str
    names: Sequence[str]
    command: Places
    standoff: Places
    approach: Places
    via: Sequence[Places]
    base: Array
    tool: Array
    tool_name: str
    tool_number: int | None
    safe_deg: Sequence[float]
    arm: Arm
    speed_percent: float
    options: Json
    remarks: Sequence[str]


Writer = Callable[[StationProgram, Stamp], Mapping[str, bytes]]


def program_writer(driver: str, form: str | None = None) -> Writer | None:
    """The writer of a form of programs; without a form that of a robot's driver, None where none is
    installed. Raises `SettingsError` for an unknown form.
    """
    group = "program_writers"
    known = entry_points(group=f"hilcell.{group}").names
    if form and form not in known:
        installed = ", ".join(sorted(known)) or "none"
        raise SettingsError("robot.program", [f"unknown form {form!r}; installed: {installed}"])
    if not form and driver not in known:
        return None
    writer: Writer = load_entry(group, form or driver)
    return writer
