"""``prepare``: holes in; for each station a list and a program out, and a sheet for all of them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from operator import attrgetter
from pathlib import Path

import msgspec

from hilcell.calibration.corrected import memories, refuse_known
from hilcell.calibration.form import Validity
from hilcell.calibration.influence import NoBound
from hilcell.calibration.part import Part
from hilcell.calibration.tip import Tip, tip_named
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.calibration.volume import Volume
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.cell.tool import STANDOFF_MORE_MM
from hilcell.commands.bounds import summary
from hilcell.commands.files import check_settings, drill_mm_of, remember
from hilcell.commands.orders import Prepare
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.commands.output_place import KNOWN
from hilcell.commands.prepared import Job, Prepared, prepared, standoff_remarks, unknown_drill
from hilcell.commands.released import Released, released
from hilcell.errors import bounded
from hilcell.geometry.frames import zyx_from_pose
from hilcell.geometry.statistics import lengths_mm
from hilcell.planning.holes import read_holes, twins
from hilcell.planning.plan import HolePlan, plan
from hilcell.present.table import Column, Table
from hilcell.report.sheet import Sheet, SheetHole, SheetStation, sheet_html
from hilcell.writing import NotWritten, write_together

SHEET = "sheet.html"
TRUE_ANGLE = "of the true angle; a measured one has the readings' noise, too"
INVALID = (
    "a collision, a new mastering, an exchanged motor, gear, drill spindle or reflector mount",
    "the rail, the strip or its head was moved, or the slide does not come to its strip reading",
    "the part or the floor was moved: {W} is no longer where it was",
    "the calibration was revoked or superseded since: `hilcell runs` says so",
    "a re-check (`hilcell run recheck`) that does not say valid",
    "tool, base, approach or points of a program were changed by hand",
)


def sheet_of(
    found: Released,
    cell: Cell,
    source: str,
    max_age_days: float,
    temperature_c: float | None,
    job: Job,
    stations: Sequence[Prepared],
    twins: Sequence[str],
) -> Sheet:
    """Return the sheet of stations in order of visit; holes come from the file ``source``.

    ``twins`` are the warnings of holes that are listed twice.
    """
    made, validity = found.calibration.provenance, found.calibration.validity
    until = _until(made.written, max_age_days)
    air = _air(validity, temperature_c)
    count = sum(len(each.plan.holes) for each in stations)
    places = "station" if len(stations) == 1 else "stations"
    standoff, side, depth = standoff_remarks(job.standoff_mm)
    facts = [
        ("Holes", source),
        ("Cell", f"{cell.name}, serial {cell.serial}, robot {cell.robot.name}"),
        ("Calibration", f"{made.named}, written {_local(made.written)}"),
        ("Standing", _standing(found)),
        ("Use until", f"{until}, {max_age_days:g} days after it was written"),
        ("Air", air),
        ("Orientation", f"as calibrated, within {validity.orientation_tolerance_deg:g}°"),
        ("Tool", _tool_of(job.tip)),
        ("Bounds hold at", _bounds_at(cell, job.tip)),
        ("Stand-off", standoff),
        ("Side and depth", f"{side}; {depth}"),
        ("Prepared", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"),
    ]
    if any(each.turns_deg is not None for each in stations):
        facts.append(("Bounds in degrees", TRUE_ANGLE))
    refusals = [each.bounds.reason for each in stations if isinstance(each.bounds, NoBound)]
    return Sheet(
        title=f"Drilling sheet: {count} hole{'s' * (count != 1)} at {len(stations)} {places}",
        simulated=made.simulated,
        has_rail=cell.has_rail,
        facts=facts,
        checks=list(_checks(cell, air)),
        stations=[_station(cell, each) for each in stations],
        no_bounds=refusals[0] if refusals else "",
        warnings=[
            *(note for note in found.notes() if "SIMULATED" not in note),
            *unknown_drill(job),
            *bounded(twins),
        ],
        invalid=[f"air outside of {air}", f"the time after {until}", *INVALID],
        footer=f"calibration {made.latest}, holes {source}",
    )


def _tool_of(tip: Tip) -> str:
    """Return which tool the controller must have, so that a person can compare it."""
    number = "" if tip.number is None else f", number {tip.number}"
    values = zyx_from_pose(tip.T_F_D[None])[0] + 0.0
    frame = " ".join(f"{axis} {each:.3f}" for axis, each in zip("XYZABC", values, strict=True))
    return (
        f"{tip.name}{number}; in the flange: {frame} (mm, deg); the controller's must be the same"
    )


def _bounds_at(cell: Cell, tip: Tip) -> str:
    """Return where points, corrections and bounds hold."""
    drill_mm = drill_mm_of(cell)
    if tip.table is None and drill_mm is not None:
        at_mm = " ".join(f"{each:g}" for each in drill_mm)
        return f"the drill, ({at_mm}) mm from the reflector"
    return tip.words.removeprefix("they hold at ")


def _standoff_mm(tip: Tip, ordered_mm: float | None) -> float:
    """Return the stand-off; raises `SettingsError` for one that the drill is longer than."""
    if ordered_mm is None:
        return tip.standoff_mm
    if not ordered_mm >= tip.least_standoff_mm:
        problem = (
            f"{ordered_mm:g} mm: expected at least {tip.least_standoff_mm:g} mm: the drill of "
            f"{tip.name} and {STANDOFF_MORE_MM:g} mm"
        )
        raise SettingsError("--standoff", [problem])
    return ordered_mm


def _station(cell: Cell, each: Prepared) -> SheetStation:
    nominal, bounds_mm = each.plan.poses[:, :3], each.bounds95_mm
    turns_deg = None if each.turns_deg is None else each.turns_deg.tolist()
    moved_mm = lengths_mm(each.command[:, :3] - nominal).tolist()
    holes = [
        SheetHole(
            name,
            (x, y, z),
            moved_mm[n],
            None if bounds_mm is None else bounds_mm[n],
            None if turns_deg is None else turns_deg[n],
        )
        for n, (name, (x, y, z)) in enumerate(zip(each.plan.holes, nominal.tolist(), strict=True))
    ]
    station = each.plan.station
    return SheetStation(
        station.name, station.rail_mm, station.strip_mm, cell.rail.strip_tolerance_mm,
        next((Path(name).stem for name in each.program), each.file), [*each.program, each.file],
        holes, each.stroke,
    )  # fmt: skip


def _standing(found: Released) -> str:
    if found.accepted:
        return f"{found.stands}; OUT OF TOLERANCE, accepted"
    return "not known to be current" if found.standing is None else found.standing.text


def _checks(cell: Cell, air: str) -> Iterator[str]:
    """Yield what is ticked before the first hole."""
    yield "The right cell, robot and part; the part clamped, its place in {W} as it was planned"
    yield "Tool and drill as in the cell file; the drill is drawn back while the robot moves"
    yield f"Air at the cell {air}"
    if cell.has_rail:
        yield (
            f"At each station: robot at its safe pose, slide moved, held, strip within "
            f"{cell.rail.strip_tolerance_mm:g} mm, then the station's own program"
        )
    yield "Programs copied to the controller as they are, all files of a station together"
    yield "First hole of each station at reduced speed, a hand at the emergency stop"


def _air(validity: Validity, temperature_c: float | None) -> str:
    """Return the temperatures at which the bounds hold."""
    if validity.temperature_c is None:
        return "not measured by the calibration"
    low_c, high_c = validity.temperature_c
    allowed = f"{low_c - TEMPERATURE_MARGIN_K:.1f} to {high_c + TEMPERATURE_MARGIN_K:.1f} °C"
    return allowed if temperature_c is None else f"{allowed}, bounds for {temperature_c:.1f} °C"


def _until(written: str, max_age_days: float) -> str:
    """Return the last day of use; days beyond any calendar are no limit."""
    try:
        last = _time(written) + timedelta(days=max_age_days)
    except OverflowError:
        return "any day"
    return f"{last.astimezone():%Y-%m-%d}"


def _local(written: str) -> str:
    return f"{_time(written).astimezone():%Y-%m-%d %H:%M %Z}"


def _time(written: str) -> datetime:
    return datetime.strptime(written, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)


SUMMARY = "summary.json"


def prepare(args: Prepare) -> int:
    """Plan the holes where the calibration corrects, correct them, and write all files."""
    check_settings(args.cell, dict(args.settings))
    cell = load_cell(args.cell, dict(args.settings))
    found, source, folder = (
        released(args.calibration, args.release, cell),
        Path(args.holes),
        Path(args.output),
    )
    tip = tip_named(cell, args.tool, cell.robot.options.get("tool"))
    standoff_mm = _standoff_mm(tip, args.standoff)
    holes = read_holes(source, tip.T_D_T)
    refuse_known(memories(args.release.runs, found.path), source.name, holes.names, holes.points_mm)
    for warning in bounded(warnings := twins(holes)):
        print_message(warning)
    whole = plan(cell, holes, calibrated=Volume(found.calibration), heard=print_message)
    job = Job(tip, Part(holes.points_mm, holes.outward), standoff_mm)
    stations = [prepared(args, cell, found, job, each) for each in whole.stations]
    facts = _summary(found, source, tip, whole, stations, warnings)
    contents = {SUMMARY: msgspec.json.format(msgspec.json.encode(facts), indent=1) + b"\n"}
    sheet = sheet_of(
        found,
        cell,
        source.name,
        args.release.max_age,
        args.release.temperature,
        job,
        stations,
        warnings,
    )
    contents[SHEET] = sheet_html(sheet).encode()
    for each in stations:
        contents |= {each.file: each.content, **each.program}
    _check_names(stations)
    _make(folder)
    write_together(
        {folder / name: content for name, content in contents.items()},
        inputs=[source, found.path, Path(args.cell)],
    )
    for each in stations:
        moved_mm = (each.command - each.plan.poses)[:, :3]
        for points in (each.command, *each.written):
            remember(found, each.stamp, points[:, :3] - moved_mm, points[:, :3])
    if args.json:
        print_json(facts)
    else:
        print_table(Table(STATIONS, stations))
    for each in stations:
        words = summary(each.bounds, each.plan.holes, each.turns_deg)
        print_message(f"{each.plan.station.name}: {words}; {each.stroke}")
    _print_written(cell, stations, folder)
    for note in found.notes():
        print_message(note)
    return 0


def _summary(
    found: Released,
    source: Path,
    tip: Tip,
    whole: HolePlan,
    stations: list[Prepared],
    warnings: list[str],
) -> dict[str, object]:
    made = found.calibration.provenance
    return {
        "calibration": made.latest,
        "cell": made.cell,
        "digest": made.digest,
        "simulated": made.simulated,
        "standing": found.stands,
        "holes": source.name,
        "tool": tip.name,
        "notes": list(found.notes()),
        "warnings": warnings,
        "sheet": SHEET,
        "stations": [each.facts for each in stations],
        "travel_mm": whole.travel_mm,
        "bound_mm": whole.bound_mm,
    }


def _check_names(stations: list[Prepared]) -> None:
    """Refuse stations whose files would have one name: controllers and PCs may ignore case."""
    files = (name for each in stations for name in (each.file, *each.program))
    twice = [name for name, count in Counter(map(str.lower, files)).items() if count > 1]
    if twice:
        raise NotWritten(
            f"two stations would both write {', '.join(twice)}: name them apart, by letters, "
            "digits and underscores in the first 24 characters"
        )


def _make(folder: Path) -> None:
    """Make a folder, or take an empty one: files of another job in it would be taken for these."""
    if folder.suffix.lower() in KNOWN and not folder.exists():
        raise NotWritten(f"{folder} is a file by its name; name a folder, as {folder.stem}")
    if os.path.lexists(folder) and not os.path.isdir(folder):  # noqa: PTH112 - as in `released`
        raise NotWritten(f"{folder} is a file; name a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise NotWritten(f"{folder} is not empty; name a new folder")
    except OSError as error:
        raise NotWritten(f"{folder}: cannot be used: {error.strerror or error}") from error


STATIONS: tuple[Column[Prepared], ...] = (
    Column("station", attrgetter("plan.station.name")),
    Column("rail", attrgetter("plan.station.rail_mm"), "mm", ".2f"),
    Column("holes", lambda each: len(each.plan.holes), form="d"),
    Column("bound95 max", lambda each: max(each.bounds95_mm or [], default=None), "mm", ".3f"),
    Column("file", attrgetter("file")),
    Column("program", lambda each: " ".join(each.program)),
)


def _print_written(cell: Cell, stations: list[Prepared], folder: Path) -> None:
    print_message(
        f"files of corrected targets for {len(stations)} station{'s' * (len(stations) != 1)}, "
        f"{SUMMARY} and {SHEET} for the "
        f"shop floor in {folder}"
    )
    if any(each.program for each in stations):
        print_message(
            "one program a station, in the order of the sheet; each holds for its station only"
        )
    else:
        print_message(f"no programs: no writer is installed for robots of {cell.robot.driver}")
