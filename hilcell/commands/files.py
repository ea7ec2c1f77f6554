"""``compensate``: targets or programs in, corrected ones out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hilcell.calibration.controller_pose import check_links
from hilcell.calibration.corrected import memories, memory_of, note_corrected, refuse_known
from hilcell.calibration.file import compensate_targets
from hilcell.calibration.form import Calibration
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
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.bounds import (
    Found,
    bounds_of_targets,
    summary,
    turns_of_targets,
    write_bounds,
)
from hilcell.commands.orders import Compensate
from hilcell.commands.output import print_json, print_message
from hilcell.commands.output_place import CSV, check_output
from hilcell.commands.released import Released, released
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
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.targets import read_targets, write_targets
from hilcell.errors import bounded
from hilcell.geometry.frames import inverse
from hilcell.geometry.rotations import from_zyx
from hilcell.ports import Array

STROKE_MISS_MM = 0.05  # that strokes may miss by where nothing else is stated
DRILL_KEY = "uncertainty.drill_offset_mm"
LISTS = ("", ".csv", ".txt")  # suffixes of what is read as a list of targets without a remark


def compensate(args: Compensate) -> int:
    """Write corrected targets, or a corrected program, for one station."""
    check_settings(args.cell, dict(args.settings))
    cell = load_cell(args.cell, dict(args.settings)) if args.cell else None
    found = released(args.calibration, args.release, cell)
    calibration = found.calibration
    source, out = Path(args.targets), Path(args.output)
    inputs = [source, found.path, Path(args.cell or source)]
    program = load_program(source)
    if program is not None:
        check_links(calibration, source.name)
    root = root_of(calibration, args.station, program)
    names, listed = _listed(source) if program is None else (program.names, program.values())
    targets = taken_in(root, listed)  # in {W}
    folders = memories(args.release.runs, found.path)
    refuse_known(folders, source.name, names, targets[:, :3], listed[:, :3])
    known = found.cell if cell is None and program is None else cell
    tip, drill_mm = _tip(known, args.tool, program, source), drill_mm_of(known)
    if program is not None and args.station in calibration.stations:
        check_base(calibration, args.station, program.base, targets)  # names a cause of the next
    command = compensate_targets(calibration, args.station, targets, names, tip)
    bounds = bounds_of_targets(
        calibration, args.station, targets, args.release.temperature, tip, drill_mm
    )
    if program is not None:
        limits = _stroke_limits(args, bounds)
        _check_program(calibration, args, program, targets, command, cell, limits, tip)
    turns_deg = turns_of_targets(calibration, args.station, targets, tip)
    form = (CSV, "a list") if program is None else (tuple(program.suffixes), "a program")
    check_output(out, *form, inputs=inputs)  # before the bounds are written
    if args.bounds:
        where = Path(args.bounds)
        write_bounds(where, bounds, names, out, inputs=inputs, turns_deg=turns_deg)
        inputs.append(Path(args.bounds))
    stamp = found.stamp(args.station)
    stated = command if root is None else taken_in(inverse(root), command)
    turned = calibration.orients
    written = _write(program, names, stated, source, out, stamp, inputs, turned=turned)
    remember(found, stamp, targets[:, :3], command[:, :3])
    if root is not None:  # as the program has them, which another station's correction reads
        remember(found, stamp, listed[:, :3], stated[:, :3])
    if args.json:
        print_json(
            {
                "calibration": calibration.provenance.latest,
                "station": args.station,
                "targets": len(names),
                "tool": tip.name,
                "standing": found.stands,
                "stamp": stamp.text,
                "notes": list(found.notes()),
            }
        )
    print_message(
        f"{len(names)} target{'s' * (len(names) != 1)} corrected for {args.station} into {written}"
    )
    print_message(summary(bounds, names, turns_deg))
    setting = setting_tool(program)
    if cell is not None and setting is not None and setting.tool is None:
        print_message(f"{source.name}: it sets no tool: taken to run with that of {tip.name}")
    for note in (*_where(known, tip, drill_mm), *found.notes()):
        print_message(note)
    return 0


def _where(
    cell: Cell | None, tip: Tip, drill_mm: tuple[float, float, float] | None
) -> Iterator[str]:
    """Yield where targets and bounds hold, where that is not the reflector's centre."""
    if cell is None:
        yield f"{tip.words}: no tool is known without --cell CELL"
    if tip.table is not None:
        yield tip.words
    elif drill_mm is not None:
        at_mm = " ".join(f"{each:g}" for each in drill_mm)
        yield f"they hold at the drill, ({at_mm}) mm from the reflector in {{T}}"


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


def remember(found: Released, stamp: Stamp, nominal_mm: Array, command_mm: Array) -> None:
    """Keep corrected points (N, 3), to be known again without their stamp."""
    folder, why = memory_of(found.runs, found.path), f"{found.runs} is not there"
    if folder is not None:
        try:
            note_corrected(folder, stamp.text, nominal_mm, command_mm)
        except OSError as error:
            why = f"{folder} cannot be written ({error.strerror})"
        else:
            return
    print_message(f"warning: {why}: these targets are known as corrected by their stamp alone")


def check_settings(cell: str | None, settings: dict[str, str]) -> None:
    """Refuse settings that would change nothing; raises `SettingsError`."""
    if settings and not cell:
        raise SettingsError("--set", ["it changes the cell of --cell CELL; none is given"])
    unused = [key for key in settings if key.startswith("uncertainty.") and key != DRILL_KEY]
    if unused:
        raise SettingsError(
            "--set",
            [
                f"{key}: the calibration states its own budget; only {DRILL_KEY} is the cell's"
                for key in unused
            ],
        )


def drill_mm_of(cell: Cell | None) -> tuple[float, float, float] | None:
    """Return where the cell states that its drill is, if it does."""
    if cell is None or not any(cell.uncertainty.drill_offset_mm):
        return None
    return cell.uncertainty.drill_offset_mm


def _listed(source: Path) -> tuple[list[str], Array]:
    """Read a list of targets, and warn of one hole under two names.

    A file that is no list may be a program of an unknown format.
    """
    from hilcell.planning.holes import Holes, twins  # scipy's neighbours, which no program needs

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
        print_message(warning)
    return names, targets


def _check_program(
    calibration: Calibration,
    args: Compensate,
    program: Program,
    targets: Array,
    command: Array,
    cell: Cell | None,
    limits: StrokeLimits,
    tip: Tip,
) -> None:
    """Refuse a program whose strokes or joints do not agree with its corrected targets."""
    station, name = args.station, Path(args.targets).name
    missed = check_strokes(calibration, station, targets, command, program.strokes, limits, tip)
    if program.strokes:
        print_message(
            f"{name}: strokes keep the correction of the point before them, and miss by at most "
            f"{missed.across_mm:.3f} mm across (the hole's position) and {missed.along_mm:.3f} mm "
            f"along (its depth), by the model every {STEP_MM:g} mm; allowed: {limits.source}"
        )
    setting = setting_tool(program)
    if cell is None and setting is not None and setting.tool is not None:
        print_message(f"{name}: its tool ({setting.tool.text}) was not checked; --cell CELL does")
    if cell is not None:
        T_W_B = np.array(calibration.stations[station].T_W_B)
        status = cell.robot.status
        check_posture(status, statuses_of(program, status))
        if rides_on_robot(cell):
            check_slide(cell.station_named(station), slide_of(program))
        program.check_joints(tip.arm(cell.robot.arm()), T_W_B, command)
    elif program.needs_arm:
        print_message(f"{name}: {program.needs_arm} were not checked; --cell CELL does")


def _stroke_limits(args: Compensate, bounds: Found) -> StrokeLimits:
    """Return the tolerance that is stated; else the bounds, within which no difference is sure."""
    if args.stroke_tolerance is not None:
        return StrokeLimits(args.allow_stroke, args.stroke_tolerance, "--stroke-tolerance")
    if isinstance(bounds, NoBound):
        return StrokeLimits(args.allow_stroke, STROKE_MISS_MM, "as no 95 % bound can be stated")
    return StrokeLimits(args.allow_stroke, bounds.radii_mm, "the point's 95 % bound")


def _write(
    program: Program | None,
    names: list[str],
    command: Array,
    source: Path,
    out: Path,
    stamp: Stamp,
    inputs: list[Path],
    *,
    turned: bool,
) -> str:
    """Write the list or the program, print its notes, and return in words where it was written."""
    if program is None:
        write_targets(out, names, command, stamp=stamp, inputs=inputs)
        return str(out)
    numbers = command if turned else command[:, :3]
    written = write_program(program, numbers, source, out, stamp=stamp, inputs=inputs)
    frame = f"{{B}}, the robot's base, at {stamp.station}" if stands_in_root(program) else "{W}"
    for note in notes_of(program, frame, source, written):
        print_message(f"{source.name}: {note}")
    return " and ".join(map(str, written))
