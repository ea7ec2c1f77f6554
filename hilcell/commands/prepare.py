"""``prepare``: holes in; for each station a list and a program out, and a sheet for all of them."""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import msgspec

from hilcell.calibration.volume import Volume
from hilcell.cell.file import Cell, load_cell
from hilcell.commands.bounds import summary
from hilcell.commands.files import check_settings
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.commands.output_place import KNOWN
from hilcell.commands.prepare_sheet import SHEET, sheet_of
from hilcell.commands.prepared import Prepared, prepared
from hilcell.commands.released import Released, released
from hilcell.errors import bounded
from hilcell.planning.holes import read_holes, twins
from hilcell.planning.plan import HolePlan, plan
from hilcell.report.sheet import sheet_html
from hilcell.writing import NotWritten, write_together

SUMMARY = "summary.json"


def prepare(args: argparse.Namespace) -> int:
    """Plan the holes where the calibration corrects, correct them, and write all files."""
    check_settings(args.cell, dict(args.set))
    cell = load_cell(args.cell, dict(args.set))
    found, source, folder = released(args, cell), Path(args.holes), Path(args.output)
    holes = read_holes(source)
    for warning in bounded(warnings := twins(holes)):
        print_message(warning)
    whole = plan(cell, holes, calibrated=Volume(found.calibration), heard=print_message)
    stations = [prepared(args, cell, found, each) for each in whole.stations]
    facts = _summary(found, source, whole, stations, warnings)
    contents = {SUMMARY: msgspec.json.format(msgspec.json.encode(facts), indent=1) + b"\n"}
    sheet = sheet_of(found, cell, source.name, args.max_age, args.temperature, stations, warnings)
    contents[SHEET] = sheet_html(sheet).encode()
    for each in stations:
        contents |= {each.file: each.content, **each.program}
    _check_names(stations)
    _make(folder)
    write_together(
        {folder / name: content for name, content in contents.items()},
        inputs=[source, found.path, Path(args.cell)],
    )
    if args.json:
        print_json(facts)
    else:
        _print(stations)
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


def _print(stations: list[Prepared]) -> None:
    headers = ["station", "rail mm", "holes", "bound95 max mm", "file", "program"]
    print_table((headers, list(_rows(stations))))


def _rows(stations: list[Prepared]) -> Iterator[list[str]]:
    for each in stations:
        station, bounds_mm = each.plan.station, each.bounds95_mm
        largest = "" if bounds_mm is None else f"{max(bounds_mm):.3f}"
        place = [station.name, f"{station.rail_mm:.2f}", str(len(each.plan.holes))]
        yield [*place, largest, each.file, " ".join(each.program)]


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
