"""Targets of one list or program: read, corrected at a station, written under another name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, isnan
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from hilcell.atomic_files import CSV, NotWritten, check_output, write_whole
from hilcell.calibration.controller_pose import check_links
from hilcell.calibration.file import Calibration
from hilcell.calibration.influence import NoBound
from hilcell.calibration.tool_point import AT_REFLECTOR, Tip, tip_named, tip_of_program
from hilcell.cell.devices import is_robot_driven
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.grid import ROUNDING_MM, OutsideGrid
from hilcell.compensation.programs import (
    Program,
    Stroke,
    load_program,
    program_notes,
    suffixes,
    write_program,
)
from hilcell.compensation.targets import HEADER, csv_content, read_targets, target_rows, unit_hint
from hilcell.errors import indented
from hilcell.geometry.frames import (
    apply,
    from_zyx,
    inverse,
    pose_from_zyx,
    poses_from_zyx,
    zyx_from_pose,
)
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import Array, HilcellError
from hilcell.programs.corrected import Corrected, UsableCalibration, drill_mm_of
from hilcell.run.order import Release
from hilcell.sanitize import counted


@dataclass(frozen=True, eq=False)
class TargetFiles:
    """Corrected targets, to be written in the form of the list or ``program`` at ``source``.

    ``positions`` (N, 3), or poses (N, 6), are those of the program, ``header`` and ``rows`` of the
    list; ``frame`` names their frame.
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
        """Write all files; return paths and notes; raises `NotWritten`, `NoBound`."""
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
            write_whole(out, csv_content(self.header, self.rows, stamp), inputs=read)
            return str(out), []
        written = write_program(program, self.positions, self.source, out, stamp=stamp, inputs=read)
        notes = program_notes(program, self.frame, self.source, written)
        return " and ".join(map(str, written)), [f"{self.source.name}: {note}" for note in notes]


@dataclass(frozen=True, eq=False)
class StationTargets(TargetFiles):
    """Targets that a calibration corrects for one of its stations.

    ``points``: nominal and corrected ones, each (N, 3), in all frames in which they may be read
    again; ``remarks``: where targets and bounds are valid.
    """

    released: UsableCalibration
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
        strokes: tuple[float, float | None],
        say: Callable[[str], object],
    ) -> Self:
        """Corrected targets of a list or a program; ``say`` takes warnings.

        A program's ``strokes``: allowed length and error (mm); None is the 95 % bound of their
        point. Raises `HilcellError` where the calibration must not be used, or a target not be
        corrected.
        """
        released = UsableCalibration.named(calibration, release, cell)
        program = load_program(source)
        if program is not None:
            check_links(released.calibration, source.name)
        known_station = station in released.calibration.stations
        root = None
        in_root = program is not None and program.in_root
        if in_root and known_station:
            root = released.calibration.base(station)
        if program is None:
            names, listed = cls._listed(source, say)
        else:
            names, listed = program.names, program.values()
        nominal = cls._taken_in(root, listed)  # in {W}
        released.refuse_corrected(source, names, nominal[:, :3], listed[:, :3])
        known = released.cell if cell is None and program is None else cell
        tip = cls._tip(known, tool, program, source)
        if program is not None and known_station:  # else the next refusal would hide its cause
            cls._check_base(released.calibration, station, program, nominal)
        try:
            targets = released.corrected(station, names, nominal, tip, known)
        except OutsideGrid as error:  # the unit of a program is that of its format
            hint = unit_hint(listed[:, :3]) if program is None else ""
            raise OutsideGrid(f"{source.name}: {error}{hint}") from error
        if program is not None:
            cls._check_program(released, targets, program, source, cell, tip, strokes, say)
        stated = targets.command if root is None else cls._taken_in(inverse(root), targets.command)
        points = [(nominal[:, :3], targets.command[:, :3])]
        if root is not None:  # as the program has them, which another station's correction reads
            points.append((listed[:, :3], stated[:, :3]))
        remarks = list(cls._where(known, tip))
        if cell is not None and program is not None and program.tool is None:
            note = f"{source.name}: it sets no tool: taken to run with that of {tip.name}"
            remarks.insert(0, note)
        if program is not None and program.base is None and not in_root:
            world = zyx_from_pose(inverse(released.calibration.base(station))[None])[0]
            remarks.insert(
                0,
                f"{source.name}: its base is in the controller, which must have {{W}} as "
                f"calibrated at {station}, in {{B}}: {program.frame_text(world)}",
            )
        return cls(
            source,
            program,
            targets,
            f"{{B}}, the robot's base, at {station}" if in_root else "{W}",
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
        return {
            "calibration": self.released.calibration.provenance.latest,
            "station": self.targets.stamp.station,
            "targets": len(self.targets.names),
            "tool": self.tool,
            "standing": self.released.status_text,
            "stamp": self.targets.stamp.text,
            "notes": list(self.released.notes()),
        }

    def write(self, out: Path, bounds: Path | None, inputs: Iterable[Path]) -> list[str]:
        """Write all, store the points; return messages; raises `NotWritten`, `NoBound`."""
        read = [self.released.path, *inputs]
        written, notes = self.write_files(out, bounds, read)
        count, stamp = len(self.targets.names), self.targets.stamp
        return [
            *notes,
            *self.released.remember(stamp, *self.points),
            f"{counted(count, 'target')} corrected for {stamp.station} into {written}",
            self.targets.summary,
            *self.remarks,
            *self.released.notes(),
        ]

    @staticmethod
    def _where(cell: Cell | None, tip: Tip) -> Iterator[str]:
        """Yield where targets and bounds are valid, where that is not the reflector's centre."""
        if cell is None:
            yield f"{tip.scope}: no tool is known without --cell CELL"
        if tip.table is not None:
            yield tip.scope
        elif (drill_mm := drill_mm_of(cell)) is not None:
            at_mm = " ".join(f"{each:g}" for each in drill_mm)
            yield f"they hold at the drill, ({at_mm}) mm from the reflector in {{T}}"

    @staticmethod
    def _listed(source: Path, say: Callable[[str], object]) -> tuple[list[str], Array]:
        from hilcell.programs.holes import Holes  # scipy's neighbours, which no program needs

        try:
            names, targets = read_targets(source)
        except SettingsError as error:
            suffix = source.suffix.lower()
            if suffix in ("", ".csv", ".txt"):  # read as a list of targets without a remark
                raise
            known = ", ".join(suffixes()) or "none"
            hint = f"no format of programs is installed for {suffix} (installed: {known})"
            raise SettingsError(error.source, [*error.problems, hint]) from error
        holes = Holes(names, targets[:, :3], from_zyx(targets[:, 3:])[:, None])
        for warning in holes.warnings:
            say(warning)
        return names, targets

    @staticmethod
    def _tip(cell: Cell | None, name: str, program: Program | None, source: Path) -> Tip:
        """Tip of a program's tool, else the named one; raises `SettingsError`."""
        if cell is None or program is None:
            return tip_named(cell, name)
        number = program.reflector_number(cell.robot.options)
        if program.tool is None:
            return tip_named(cell, name, number)
        return tip_of_program(cell, name, program.tool, number, source.name)

    @staticmethod
    def _check_program(
        released: UsableCalibration,
        targets: Corrected,
        program: Program,
        source: Path,
        cell: Cell | None,
        tip: Tip,
        strokes: tuple[float, float | None],
        say: Callable[[str], object],
    ) -> None:
        stroke_miss_mm = 0.05  # that strokes may miss by where nothing else is stated
        station, name, (longest_mm, miss_mm) = targets.stamp.station, source.name, strokes
        if miss_mm is not None:
            limits = StrokeLimits(longest_mm, miss_mm, "--stroke-tolerance")
        elif isinstance(targets.bounds, NoBound):
            why = "as no 95 % bound can be stated"
            limits = StrokeLimits(longest_mm, stroke_miss_mm, why)
        else:  # within which no difference is sure
            bound_mm = targets.bounds.radii_mm
            limits = StrokeLimits(longest_mm, bound_mm, "the point's 95 % bound")
        missed = check_strokes(
            released.calibration, station, targets.nominal, targets.command, program.strokes,
            limits, tip,
        )  # fmt: skip
        if program.strokes:
            say(
                f"{name}: strokes keep the correction of the point before them, and miss by at "
                f"most {missed.across_mm:.3f} mm across (the hole's position) and "
                f"{missed.along_mm:.3f} mm along (its depth), by the model every {STEP_MM:g} mm; "
                f"allowed: {limits.source}"
            )
        if cell is None and program.tool is not None:
            say(f"{name}: its tool ({program.tool.text}) was not checked; --cell CELL does")
        for note in StationTargets._check_slide(cell, station, program.slide):
            say(f"{name}: {note}")
        if cell is not None:
            status = cell.robot.status
            check_posture(status, program.statuses(status, cell.robot.arm()))
            T_W_B, command = released.calibration.base(station), targets.command
            if program.in_root:
                command, T_W_B = StationTargets._taken_in(inverse(T_W_B), command), np.eye(4)
            for note in program.check_joints(tip.arm(cell.robot.arm()), T_W_B, command):
                say(f"{name}: {note}")
        elif program.needs_arm:
            say(f"{name}: {program.needs_arm} were not checked; --cell CELL does")

    @staticmethod
    def _taken_in(T: Array | None, values: Array) -> Array:
        """Targets (N, 6) of the frame ``T``; None leaves them, to the last digit."""
        return values if T is None else zyx_from_pose(T @ poses_from_zyx(values))

    @staticmethod
    def _check_base(
        calibration: Calibration, station: str, program: Program, targets: Array
    ) -> None:
        """Raise `HilcellError` where a base set by numbers is not {W}, at ``targets`` (N, 6). A
        controller's base is relative to its own root, {B}: {W} is the inverse of T_W_B.
        """
        stated = program.base
        if stated is None:
            return
        expected = inverse(calibration.base(station))
        places = targets[:, :3]
        off_mm = lengths_mm(apply(pose_from_zyx(*stated.values), places) - apply(expected, places))
        worst = float(off_mm.max())
        base_mm = 0.05  # at the targets: numbers of a program are rounded
        if not worst <= base_mm:
            numbers = program.frame_text(zyx_from_pose(expected[None])[0])
            raise HilcellError(
                f"{stated.where}: the base set there is not the world frame {{W}} of the targets "
                f"at {station}: it puts them up to {worst:.3f} mm elsewhere, expected <= "
                f"{base_mm:g} mm; set {numbers}, as calibrated, and take the targets in {{W}}",
                code="HC-C10",
            )

    @staticmethod
    def _check_slide(
        cell: Cell | None, name: str, stated: tuple[str, float] | None
    ) -> Iterator[str]:
        """Raise `HilcellError` where a program moves the slide away from its station; yield a
        note on a place that is not checked.
        """
        if stated is None:
            return
        where, place_mm = stated
        if cell is None or not is_robot_driven(cell):
            why = "this cell's slide is not moved by the robot's controller"
            if not isnan(place_mm):
                yield (
                    f"{where}: its external axis at {place_mm:g} mm is left as it is and not "
                    f"checked: {'--cell CELL is not given' if cell is None else why}"
                )
            return
        station = cell.station_named(name)
        # A program's place is the drive's, and the strip's decides: no other station is so near.
        slide_mm = 5.0
        if not abs(place_mm - station.rail_mm) <= slide_mm:
            place = "a place not known" if isnan(place_mm) else f"{place_mm:g} mm"
            raise HilcellError(
                f"{where} moves the slide to {place}, expected {station.rail_mm:g} mm, as at "
                f"{station.name}: correct the program for the station that it drives to",
                code="HC-C10",
            )


STEP_MM = 1.0  # between places of a stroke where the model is asked
POSTURE_BITS = 7  # of a status: behind axis 1, elbow, wrist; the others are no posture


class StrokeError(HilcellError):
    """Strokes over which the correction of the point before them is not valid."""

    code = "HC-C10"


def check_posture(status: int, stated: Sequence[tuple[str, int]]) -> None:
    """Raise `HilcellError` for targets in another posture, where a robot has other errors."""
    other = [f"{where}: S {s}" for where, s in stated if s & POSTURE_BITS != status & POSTURE_BITS]
    if other:
        raise HilcellError(
            f"{len(other)} of {counted(len(stated), 'target')} in another posture than the "
            f"calibrated one, S {status}: no correction is known there; state them in that posture,"
            f" or measure theirs (robot.status of a cell)\n{indented(other)}",
            code="HC-C10",
        )


class StrokeLimits(NamedTuple):
    """Allowed length of strokes, and allowed error of each of N targets', by ``source``,
    as text.
    """

    longest_mm: float
    miss_mm: Array | float
    source: str

    def worst_miss(
        self, paths: Sequence[Array], missed_mm: Sequence[Array], most_mm: Array,
        names: Sequence[str],
    ) -> StrokeMiss:  # fmt: skip
        """Largest error of all; raises `StrokeError` naming those over ``most_mm`` (N,)."""
        bad, worst = list[str](), StrokeMiss()
        for path, missed, most, name in zip(paths, missed_mm, most_mm.tolist(), names, strict=True):
            path_mm = path[-1] - path[0]
            direction = path_mm / max(float(np.linalg.norm(path_mm)), ROUNDING_MM)
            along_mm = missed @ direction
            across_mm = lengths_mm(missed - along_mm[:, None] * direction)
            found = StrokeMiss(float(across_mm.max()), float(np.abs(along_mm).max()))
            worst = StrokeMiss(*map(max, worst, found))
            if not (found.across_mm <= most and found.along_mm <= most):
                depth_mm = float(lengths_mm(path)[across_mm.argmax()])
                bad.append(
                    f"{name}: {found.across_mm:.3f} mm across at {depth_mm:.0f} mm from the point, "
                    f"{found.along_mm:.3f} mm along; expected <= {most:.3f} mm, {self.source}"
                )
        if bad:
            raise StrokeError(
                f"{len(bad)} of {len(names)} strokes miss their line, on which they keep the "
                f"correction of the point before them: by up to {worst.across_mm:.3f} mm across "
                f"(the hole's position) and {worst.along_mm:.3f} mm along (its depth); shorten "
                "them, state their end as a point, which is corrected by itself, or state what the "
                f"drilling allows with --stroke-tolerance MM\n{indented(bad)}"
            )
        return worst


class StrokeMiss(NamedTuple):
    """Largest error of strokes: across (a hole's position) and along (its depth)."""

    across_mm: float = 0.0
    along_mm: float = 0.0


def check_strokes(
    calibration: Calibration,
    station: str,
    targets: Array,
    command: Array,
    strokes: Sequence[Stroke],
    limits: StrokeLimits,
    tip: Tip = AT_REFLECTOR,
) -> StrokeMiss:
    """Errors of strokes from the line of their target's nominal pose.

    A stroke keeps the correction of the target before it, so it errs by the difference of the error
    on its path from that at the target, and, where angles are corrected, by the rotation of the
    stroke with them. The model is evaluated every `STEP_MM`: the ripple of gears passes within some
    millimetres, an end can be good by chance. ``targets`` (N, 6) are nominal, ``command`` (N, 6)
    corrected, poses of the ``tip`` in {W}. Raises `StrokeError` naming the strokes that are too
    long, end outside of the calibrated volume, or exceed ``limits``.
    """
    if not strokes:
        return StrokeMiss()
    names, at = [each.where for each in strokes], np.array([each.target for each in strokes])
    shifts_mm = np.array([each.shift_mm for each in strokes])
    long_mm = lengths_mm(shifts_mm)
    if len(bad := np.flatnonzero(~(long_mm <= limits.longest_mm + ROUNDING_MM))):
        lines = [f"{names[n]}: {long_mm[n]:.3f} mm" for n in bad.tolist()]
        raise StrokeError(
            f"{len(bad)} of {len(names)} strokes lead away from their point by more than "
            f"{limits.longest_mm:.6g} mm; shorten them, or declare their length with "
            f"--allow-stroke MM\n{indented(lines)}"
        )
    T_B_W = inverse(calibration.base(station))
    ends = poses_from_zyx(targets[at])
    ends[:, :3, 3] += shifts_mm
    ends_mm = (T_B_W @ ends @ tip.T_D_T)[:, :3, 3]
    try:
        calibration.grid().check_inside(ends_mm, names)
    except OutsideGrid as error:
        raise StrokeError(f"strokes that end outside: {error}") from error
    paths = [_places(each) for each in strokes]
    missed_mm = _missed(calibration, T_B_W, targets[at], command[at], paths, tip)
    most_mm = np.broadcast_to(limits.miss_mm, len(targets))[at]
    return limits.worst_miss(paths, missed_mm, most_mm, names)


def _places(stroke: Stroke) -> Array:
    """Positions (K, 3) of a stroke, relative to its target, in {W}, `STEP_MM` apart."""
    length_mm = float(np.linalg.norm(np.subtract(stroke.shift_mm, stroke.from_mm)))
    return np.linspace(stroke.from_mm, stroke.shift_mm, max(2, ceil(length_mm / STEP_MM) + 1))


def _missed(
    calibration: Calibration,
    T_B_W: Array,
    starts: Array,
    command: Array,
    paths: Sequence[Array],
    tip: Tip,
) -> list[Array]:
    """Errors in {W} of positions of ``paths`` (K, 3) from nominal ``starts`` (N, 6)."""
    counts = [len(each) for each in paths]
    places = np.repeat(starts, counts, axis=0)
    places[:, :3] += np.concatenate(paths)
    model = calibration.error_model()
    errors_mm = model.predict(T_B_W @ poses_from_zyx(places) @ tip.T_D_T).error_mm
    at_start_mm = model.predict(T_B_W @ poses_from_zyx(starts) @ tip.T_D_T).error_mm
    change_mm = (errors_mm - np.repeat(at_start_mm, counts, axis=0)) @ T_B_W[:3, :3]  # in {W}
    turn = poses_from_zyx(command)[:, :3, :3] @ poses_from_zyx(starts)[:, :3, :3].swapaxes(1, 2)
    sent_mm = [path @ each.T for path, each in zip(paths, turn, strict=True)]
    total_mm = change_mm + np.concatenate(sent_mm) - np.concatenate(paths)
    return np.split(total_mm, np.cumsum(counts)[:-1])
