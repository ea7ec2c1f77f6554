"""``plan`` and ``prepare``: holes in; stations, orders of visit and files for the robot out."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path

from hilcell.atomic_files import CSV, check_output
from hilcell.calibration.tool_point import tip_named
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import SettingsError
from hilcell.commands.console import print_json, print_message, print_table
from hilcell.commands.signatures import Plan, Prepare
from hilcell.commands.targets import check_settings
from hilcell.compensation.targets import as_listed, write_rows
from hilcell.present.table import Column, Table
from hilcell.programs.corrected import UsableCalibration
from hilcell.programs.holes import read_holes
from hilcell.programs.plan import HolePlan, Volume, ratio
from hilcell.programs.plan import plan as plan_holes
from hilcell.programs.station_jobs import StationJobs


def prepare(args: Prepare) -> int:
    """Plan the holes where the calibration corrects, correct them, and write all files."""
    check_settings(args.cell, dict(args.settings))
    jobs = StationJobs.plan(
        load_cell(args.cell, dict(args.settings)),
        args.calibration,
        Path(args.holes),
        args.release,
        tool=args.tool,
        standoff_mm=args.standoff,
        say=print_message,
    )
    said = jobs.write(Path(args.output), inputs=[Path(args.cell)])
    if args.json:
        print_json(jobs.summary)
    else:
        print_table(jobs.table)
    print_message("\n".join(said))
    return 0


def plan(args: Plan) -> int:
    """Print the fewest stations for the holes, and their orders with a lower bound on travel."""
    cell = load_cell(args.cell, dict(args.settings))
    calibrated = _calibrated(args, cell)
    holes = read_holes(Path(args.holes), tip_named(cell, args.tool).T_D_T)
    for warning in holes.warnings:
        print_message(warning)
    found = plan_holes(cell, holes, free=args.free, calibrated=calibrated, say=print_message)
    if args.output:
        out, inputs = Path(args.output), [Path(args.holes), Path(args.cell)]
        check_output(out, CSV, "a list", inputs=inputs)
        rows = (
            [each.station.name, str(order), name]
            for each in found.stations
            for order, name in enumerate(each.holes, start=1)
        )
        write_rows(out, ["station", "order", "name"], rows, inputs=inputs)
    if args.json:
        print_json(_facts(found))
    else:
        _print(cell, found)
    return 0


def _calibrated(args: Plan, cell: Cell) -> Volume | None:
    """Return where the calibration that is named corrects; refused as `compensate` refuses it."""
    if not args.calibration:
        print_message("not asked where a calibration corrects: --calibration RUN does")
        return None
    if args.free:
        raise SettingsError("--free", ["stations that are not calibrated; leave out one of both"])
    found = UsableCalibration.named(args.calibration, args.release, cell)
    for note in found.notes():
        print_message(note)
    return Volume(found.calibration)


def _facts(found: HolePlan) -> dict[str, object]:
    stations = [
        {
            "name": each.station.name,
            "rail_mm": each.station.rail_mm,
            "holes": each.holes,
            "targets": as_listed(each.poses).tolist(),  # x, y, z, a, b, c in {W}, in the same order
            **_travel(each.travel_mm, each.bound_mm),
        }
        for each in found.stations
    ]
    unreached: list[str] = []  # a plan that leaves holes out is refused
    travel = _travel(found.travel_mm, found.bound_mm)
    return {"stations": stations, **travel, "unreached": unreached}


def _travel(travel_mm: float, bound_mm: float) -> dict[str, object]:
    return {"travel_mm": travel_mm, "bound_mm": bound_mm, "ratio": ratio(travel_mm, bound_mm)}


def _print(cell: Cell, found: HolePlan) -> None:
    rows = [
        (each.station.name, each.station.rail_mm, len(each.holes), each.travel_mm, each.bound_mm)
        for each in found.stations
    ]
    count = sum(len(each.holes) for each in found.stations)
    print_table(Table(STATIONS, [*rows, ("all", None, count, found.travel_mm, found.bound_mm)]))
    new = [each.station.name for each in found.stations if each.station not in cell.station]
    if new:
        print_message(
            f"not in the cell file yet: {', '.join(new)}; add them, with the strip's readings"
        )


# Of each station, and of all: name, rail (mm), holes, travel (mm), its lower bound (mm).
STATIONS: tuple[Column[tuple[str, float | None, int, float, float]], ...] = (
    Column("station", itemgetter(0)),
    Column("rail", itemgetter(1), "mm", ".2f"),
    Column("holes", itemgetter(2), form="d"),
    Column("travel", itemgetter(3), "mm", ".1f"),
    Column("lower bound", itemgetter(4), "mm", ".1f"),
    Column("ratio", lambda row: ratio(row[3], row[4]), form=".4f"),
)
