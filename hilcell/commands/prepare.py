"""``prepare``: holes in; a file of corrected targets for each station out, in order of visit."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from hilcell.calibration.file import compensate_targets
from hilcell.calibration.influence import NoBound
from hilcell.calibration.volume import Volume
from hilcell.cell.file import Cell, load_cell
from hilcell.commands.bounds import Found, bounds_of_targets, summary, turns_of_targets
from hilcell.commands.files import check_settings, drill_mm_of
from hilcell.commands.output import print_json, print_message, print_table
from hilcell.commands.released import Released, released
from hilcell.compensation.stamp import Stamp
from hilcell.compensation.targets import HEADER, csv_of, target_rows
from hilcell.planning.holes import read_holes
from hilcell.planning.plan import HolePlan, StationPlan, plan
from hilcell.ports import Array
from hilcell.writing import NotWritten, write_together

SUMMARY = "summary.json"


@dataclass(frozen=True, eq=False)
class Prepared:
    """The holes of one station: its plan, commands (N, 6) in {W}, bounds, and their stamp.

    ``turns_deg`` (N,) are the bounds of orientation, where it is corrected.
    """

    plan: StationPlan
    command: Array
    bounds: Found
    stamp: Stamp
    turns_deg: Array | None

    @property
    def file(self) -> str:
        """Return the name of its file."""
        return f"{self.plan.station.name}.csv"

    @property
    def content(self) -> bytes:
        """Return its file: corrected targets in the order of visit, each with the stamp."""
        return csv_of(HEADER, target_rows(self.plan.holes, self.command), self.stamp)

    @property
    def facts(self) -> dict[str, object]:
        """Return its part of the summary; bounds are None where none can be stated."""
        radii_mm = None if isinstance(self.bounds, NoBound) else self.bounds.radii_mm
        turns_deg = self.turns_deg
        turned = {} if turns_deg is None else {"bound95_max_deg": float(turns_deg.max())}
        return {
            "name": self.plan.station.name,
            "rail_mm": self.plan.station.rail_mm,
            "strip_mm": self.plan.station.strip_mm,
            "file": self.file,
            "stamp": self.stamp.text,
            "holes": self.plan.holes,
            "travel_mm": self.plan.travel_mm,
            "bound95_median_mm": None if radii_mm is None else float(np.median(radii_mm)),
            "bound95_max_mm": None if radii_mm is None else float(radii_mm.max()),
            **turned,
        }


def prepare(args: argparse.Namespace) -> int:
    """Plan the holes where the calibration corrects, correct them, and write all files."""
    check_settings(args.cell, dict(args.set))
    cell = load_cell(args.cell, dict(args.set))
    found, source, folder = released(args, cell), Path(args.holes), Path(args.output)
    whole = plan(cell, read_holes(source), calibrated=Volume(found.calibration))
    stations = [_prepared(args, cell, found, each) for each in whole.stations]
    facts = _summary(found, source, whole, stations)
    _make(folder)
    contents = {folder / each.file: each.content for each in stations}
    contents[folder / SUMMARY] = msgspec.json.format(msgspec.json.encode(facts), indent=1) + b"\n"
    write_together(contents, inputs=[source, found.path, Path(args.cell)])
    if args.json:
        print_json(facts)
    else:
        _print(stations)
    for each in stations:
        print_message(
            f"{each.plan.station.name}: {summary(each.bounds, each.plan.holes, each.turns_deg)}"
        )
    print_message(f"{len(stations)} files of corrected targets and {SUMMARY} in {folder}")
    for note in found.notes():
        print_message(note)
    return 0


def _prepared(args: argparse.Namespace, cell: Cell, found: Released, each: StationPlan) -> Prepared:
    name, calibration = each.station.name, found.calibration
    command = compensate_targets(calibration, name, each.poses, each.holes)
    bounds = bounds_of_targets(calibration, name, each.poses, args.temperature, drill_mm_of(cell))
    turns_deg = turns_of_targets(calibration, name, each.poses)
    return Prepared(each, command, bounds, found.stamp(name), turns_deg)


def _summary(
    found: Released, source: Path, whole: HolePlan, stations: list[Prepared]
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
        "stations": [each.facts for each in stations],
        "travel_mm": whole.travel_mm,
        "bound_mm": whole.bound_mm,
    }


def _make(folder: Path) -> None:
    """Make a folder, or take an empty one: files of another job in it would be taken for these."""
    if os.path.lexists(folder) and not os.path.isdir(folder):  # noqa: PTH112 - as in `released`
        raise NotWritten(f"{folder} is a file; name a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise NotWritten(f"{folder} is not empty; name a new folder")
    except OSError as error:
        raise NotWritten(f"{folder}: cannot be used: {error.strerror or error}") from error


def _print(stations: list[Prepared]) -> None:
    print_table((["station", "rail mm", "holes", "file"], list(_rows(stations))))


def _rows(stations: list[Prepared]) -> Iterator[list[str]]:
    for each in stations:
        station = each.plan.station
        yield [station.name, f"{station.rail_mm:.2f}", str(len(each.plan.holes)), each.file]
