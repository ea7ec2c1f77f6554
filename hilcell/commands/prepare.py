"""``plan`` and ``prepare``: from holes to stations, orders of visits and files for the robot."""

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
    """Plan the holes within the calibration's volume, correct them, and write all files."""
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
    messages = jobs.write(Path(args.output), inputs=[Path(args.cell)])
    if args.json:
        print_json(jobs.summary)
    else:
        print_table(jobs.table)
    print_message("\n".join(messages))
    return 0


def plan(args: Plan) -> int:
    """Print the fewest stations for the holes, and their orders with a lower bound on travel."""
    cell = load_cell(args.cell, dict(args.settings))
    volume = _calibrated_volume(args, cell)
    holes = read_holes(Path(args.holes), tip_named(cell, args.tool).T_D_T)
    for warning in holes.warnings:
        print_message(warning)
    planned = plan_holes(cell, holes, free=args.free, calibrated=volume, say=print_message)
    if args.output:
        out, inputs = Path(args.output), [Path(args.holes), Path(args.cell)]
        check_output(out, CSV, "a list", inputs=inputs)
        rows = (
            [each.station.name, str(order), name]
            for each in planned.stations
            for order, name in enumerate(each.holes, start=1)
        )
        write_rows(out, ["station", "order", "name"], rows, inputs=inputs)
    if args.json:
        print_json(_facts(planned))
    else:
        _print(cell, planned)
    return 0


def _calibrated_volume(args: Plan, cell: Cell) -> Volume | None:
    """Return the volume of the given calibration; refuses what `compensate` refuses."""
    if not args.calibration:
        print_message("planned without a calibration; --calibration RUN plans within its volume")
        return None
    if args.free:
        raise SettingsError("--free", ["cannot be combined with --calibration"])
    usable = UsableCalibration.named(args.calibration, args.release, cell)
    for note in usable.notes():
        print_message(note)
    return Volume(usable.calibration)


def _facts(planned: HolePlan) -> dict[str, object]:
    def travel(travel_mm: float, bound_mm: float) -> dict[str, object]:
        return {"travel_mm": travel_mm, "bound_mm": bound_mm, "ratio": ratio(travel_mm, bound_mm)}

    stations = [
        {
            "name": each.station.name,
            "rail_mm": each.station.rail_mm,
            "holes": each.holes,
            "targets": as_listed(each.poses).tolist(),  # x, y, z, a, b, c in {W}, in the same order
            **travel(each.travel_mm, each.bound_mm),
        }
        for each in planned.stations
    ]
    unreached: list[str] = []  # a plan that misses holes is refused
    total = travel(planned.travel_mm, planned.bound_mm)
    return {"stations": stations, **total, "unreached": unreached}


def _print(cell: Cell, planned: HolePlan) -> None:
    rows = [
        (each.station.name, each.station.rail_mm, len(each.holes), each.travel_mm, each.bound_mm)
        for each in planned.stations
    ]
    count = sum(len(each.holes) for each in planned.stations)
    print_table(Table(STATIONS, [*rows, ("all", None, count, planned.travel_mm, planned.bound_mm)]))
    new = [each.station.name for each in planned.stations if each.station not in cell.station]
    if new:
        print_message(f"not in the cell file: {', '.join(new)}; add them with their strip readings")


# For each station, and for all: name, rail (mm), holes, travel (mm), its lower bound (mm).
STATIONS: tuple[Column[tuple[str, float | None, int, float, float]], ...] = (
    Column("station", itemgetter(0)),
    Column("rail", itemgetter(1), "mm", ".2f"),
    Column("holes", itemgetter(2), form="d"),
    Column("travel", itemgetter(3), "mm", ".1f"),
    Column("lower bound", itemgetter(4), "mm", ".1f"),
    Column("ratio", lambda row: ratio(row[3], row[4]), form=".4f"),
)
