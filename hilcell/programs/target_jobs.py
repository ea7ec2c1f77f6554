"""Targets of one list or program: read, corrected at a station, written under another name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from hilcell.calibration.controller_pose import check_links
from hilcell.calibration.influence import NoBound
from hilcell.calibration.programs import (
    STEP_MM,
    StrokeLimits,
    check_base,
    check_posture,
    check_slide,
    check_strokes,
    root_of,
    taken_in,
)
from hilcell.calibration.tip import Tip, tip_named, tip_of_program
from hilcell.cell.devices import rides_on_robot
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.programs import (
    Program,
    load_program,
    notes_of,
    setting_tool,
    slide_of,
    stands_in_root,
    statuses_of,
    suffixes,
    write_program,
)
from hilcell.compensation.targets import HEADER, csv_of, read_targets, target_rows
from hilcell.errors import bounded
from hilcell.geometry.frames import inverse
from hilcell.geometry.rotations import from_zyx
from hilcell.ports import Array
from hilcell.programs.corrected import Corrected, Released, drill_mm_of
from hilcell.run.order import Release
from hilcell.writing import CSV, NotWritten, check_output, write_whole

STROKE_MISS_MM = 0.05  # that strokes may miss by where nothing else is stated
LISTS = ("", ".csv", ".txt")  # suffixes of what is read as a list of targets without a remark


@dataclass(frozen=True, eq=False)
class TargetFiles:
    """Corrected targets, to be written as the list or the ``program`` at ``source`` states them.

    ``positions`` (N, 3), or poses (N, 6), stand in the program, ``header`` and ``rows`` in the
    list; ``frame`` says in words what they are taken in.
    """

    source: Path
    program: Program | None
    targets: Corrected
    frame: str
    positions: Array
    header: list[str]
    rows: list[list[str]]

    def write_files(
        self, out: Path, bounds: Path | None, inputs: Iterable[Path]
    ) -> tuple[str, list[str]]:
        """Write the file of bounds, and the list or program; return their paths, and notes.

        ``inputs`` are the files that were read besides the source. Raises `NotWritten`, `NoBound`.
        """
        read, program, stamp = [self.source, *inputs], self.program, self.targets.stamp
        form = (CSV, "a list") if program is None else (tuple(program.suffixes), "a program")
        check_output(out, *form, inputs=read)  # before the bounds are written
        if bounds is not None:
            content = self.targets.list_of_bounds()
            if os.path.realpath(bounds) == os.path.realpath(out):
                raise NotWritten(
                    f"{bounds} is where the corrected targets go; name another file of bounds"
                )
            check_output(bounds, CSV, "a list", inputs=read)
            write_whole(bounds, content, inputs=read)
            read.append(bounds)
        if program is None:
            write_whole(out, csv_of(self.header, self.rows, stamp), inputs=read)
            return str(out), []
        written = write_program(program, self.positions, self.source, out, stamp=stamp, inputs=read)
        notes = notes_of(program, self.frame, self.source, written)
        return " and ".join(map(str, written)), [f"{self.source.name}: {note}" for note in notes]


class Strokes(NamedTuple):
    """How far a program's relative motions may lead, and by how far they may miss, mm.

    None is the 95 % bound of their point.
    """

    longest_mm: float
    miss_mm: float | None


@dataclass(frozen=True, eq=False)
class StationTargets(TargetFiles):
    """Targets that a calibration corrects for one of its stations.

    ``points`` are nominal and corrected ones, each (N, 3), in the frames in which they may be read
    again; ``remarks`` say where targets and bounds hold.
    """

    released: Released
    tool: str
    points: list[tuple[Array, Array]]
    remarks: list[str]

    @classmethod
    def plan(
        cls,
        cell: Cell | None,
        calibration: str,
        source: Path,
        release: Release,
        *,
        station: str,
        tool: str,
        strokes: Strokes,
        say: Callable[[str], object],
    ) -> Self:
        """Return the targets of a list or a program, corrected; ``say`` takes warnings.

        ``calibration`` names a run or a file, ``tool`` one of the cell's, "" its only one. Raises
        `HilcellError` where the calibration must not be used, or a target not be corrected.
        """
        released = Released.named(calibration, release, cell)
        program = load_program(source)
        if program is not None:
            check_links(released.calibration, source.name)
        root = root_of(released.calibration, station, program)
        if program is None:
            names, listed = _listed(source, say)
        else:
            names, listed = program.names, program.values()
        nominal = taken_in(root, listed)  # in {W}
        released.refuse_corrected(source, names, nominal[:, :3], listed[:, :3])
        known = released.cell if cell is None and program is None else cell
        tip = _tip(known, tool, program, source)
        if program is not None and station in released.calibration.stations:
            check_base(released.calibration, station, program.base, nominal)  # a cause of the next
        targets = released.corrected(station, names, nominal, tip, known)
        if program is not None:
            _check_program(released, targets, program, source, cell, tip, strokes, say)
        stated = targets.command if root is None else taken_in(inverse(root), targets.command)
        points = [(nominal[:, :3], targets.command[:, :3])]
        if root is not None:  # as the program has them, which another station's correction reads
            points.append((listed[:, :3], stated[:, :3]))
        remarks = list(_where(known, tip))
        setting = setting_tool(program)
        if cell is not None and setting is not None and setting.tool is None:
            note = f"{source.name}: it sets no tool: taken to run with that of {tip.name}"
            remarks.insert(0, note)
        return cls(
            source,
            program,
            targets,
            f"{{B}}, the robot's base, at {station}" if stands_in_root(program) else "{W}",
            stated if released.calibration.orients else stated[:, :3],
            HEADER,
            list(target_rows(names, stated)),
            released,
            tip.name,
            points,
            remarks,
        )

    @property
    def summary(self) -> dict[str, object]:
        """Return the facts of the job."""
        return {
            "calibration": self.released.calibration.provenance.latest,
            "station": self.targets.stamp.station,
            "targets": len(self.targets.names),
            "tool": self.tool,
            "standing": self.released.stands,
            "stamp": self.targets.stamp.text,
            "notes": list(self.released.notes()),
        }

    def write(self, out: Path, bounds: Path | None, inputs: Iterable[Path]) -> list[str]:
        """Write all files, and keep the points, to be known again; return in words what was done.

        Raises `NotWritten`, `NoBound`.
        """
        read = [self.released.path, *inputs]
        written, notes = self.write_files(out, bounds, read)
        count, stamp = len(self.targets.names), self.targets.stamp
        return [
            *notes,
            *self.released.remember(stamp, *self.points),
            f"{count} target{'s' * (count != 1)} corrected for {stamp.station} into {written}",
            self.targets.summary,
            *self.remarks,
            *self.released.notes(),
        ]


def _where(cell: Cell | None, tip: Tip) -> Iterator[str]:
    """Yield where targets and bounds hold, where that is not the reflector's centre."""
    if cell is None:
        yield f"{tip.words}: no tool is known without --cell CELL"
    if tip.table is not None:
        yield tip.words
    elif (drill_mm := drill_mm_of(cell)) is not None:
        at_mm = " ".join(f"{each:g}" for each in drill_mm)
        yield f"they hold at the drill, ({at_mm}) mm from the reflector in {{T}}"


def _listed(source: Path, say: Callable[[str], object]) -> tuple[list[str], Array]:
    """Read a list of targets, and warn of one hole under two names.

    A file that is no list may be a program of an unknown format.
    """
    from hilcell.programs.holes import Holes, twins  # scipy's neighbours, which no program needs

    try:
        names, targets = read_targets(source)
    except SettingsError as error:
        suffix = source.suffix.lower()
        if suffix in LISTS:
            raise
        known = ", ".join(suffixes()) or "none"
        hint = f"no format of programs is installed for {suffix} (installed: {known})"
        raise SettingsError(error.source, [*error.problems, hint]) from error
    for warning in bounded(twins(Holes(names, targets[:, :3], from_zyx(targets[:, 3:])[:, None]))):
        say(warning)
    return names, targets


def _tip(cell: Cell | None, name: str, program: Program | None, source: Path) -> Tip:
    """Return the tip that the targets are given at; raises `SettingsError`.

    A program's own tool decides; of a list, and of a program without one, the named tool does.
    """
    setting = setting_tool(program)
    if cell is None or setting is None:
        return tip_named(cell, name)
    number = setting.reflector_number(cell.robot.options)
    if setting.tool is None:
        return tip_named(cell, name, number)
    return tip_of_program(cell, name, setting.tool, number, source.name)


def _check_program(
    released: Released,
    targets: Corrected,
    program: Program,
    source: Path,
    cell: Cell | None,
    tip: Tip,
    strokes: Strokes,
    say: Callable[[str], object],
) -> None:
    """Refuse a program whose strokes or joints do not agree with its corrected targets."""
    station, name = targets.stamp.station, source.name
    if strokes.miss_mm is not None:
        limits = StrokeLimits(strokes.longest_mm, strokes.miss_mm, "--stroke-tolerance")
    elif isinstance(targets.bounds, NoBound):
        why = "as no 95 % bound can be stated"
        limits = StrokeLimits(strokes.longest_mm, STROKE_MISS_MM, why)
    else:  # within which no difference is sure
        bound_mm = targets.bounds.radii_mm
        limits = StrokeLimits(strokes.longest_mm, bound_mm, "the point's 95 % bound")
    missed = check_strokes(
        released.calibration, station, targets.nominal, targets.command, program.strokes, limits,
        tip,
    )  # fmt: skip
    if program.strokes:
        say(
            f"{name}: strokes keep the correction of the point before them, and miss by at most "
            f"{missed.across_mm:.3f} mm across (the hole's position) and {missed.along_mm:.3f} mm "
            f"along (its depth), by the model every {STEP_MM:g} mm; allowed: {limits.source}"
        )
    setting = setting_tool(program)
    if cell is None and setting is not None and setting.tool is not None:
        say(f"{name}: its tool ({setting.tool.text}) was not checked; --cell CELL does")
    if cell is not None:
        status = cell.robot.status
        check_posture(status, statuses_of(program, status))
        if rides_on_robot(cell):
            check_slide(cell.station_named(station), slide_of(program))
        T_W_B = np.array(released.calibration.stations[station].T_W_B)
        program.check_joints(tip.arm(cell.robot.arm()), T_W_B, targets.command)
    elif program.needs_arm:
        say(f"{name}: {program.needs_arm} were not checked; --cell CELL does")
