"""``plant``: records of all cells in one database: make it, ship runs to it, ask it."""

from __future__ import annotations

import argparse
import importlib.util
import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import msgspec

from hilcell.cell.settings import did_you_mean
from hilcell.clean import clean, encodable, harmless
from hilcell.commands.output import (
    harmless_lines,
    print_answer,
    print_data,
    print_json,
    print_message,
    print_table,
)
from hilcell.errors import HilcellError
from hilcell.run.exits import EXIT_OK, EXIT_STORAGE

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from hilcell.plant.database import Database
    from hilcell.plant.shipper import Behind

URL = "HILCELL_PLANT"
PACKAGES = ("sqlalchemy", "alembic", "psycopg")  # of the database
NAMED = 3  # runs, in a message


def init(args: argparse.Namespace) -> int:
    """Make the tables of a plant's database, where they are not there."""
    with closing(open_database(args.plant)) as database:
        before = database.make()
    from hilcell.plant.tables import HEAD

    words = "is up to date" if before else "made"
    print_answer(
        {"plant": database.name, "schema": HEAD, "before": before or None},
        f"plant database {database.name}: {words}, schema {HEAD}",
        as_json=args.json,
    )
    return EXIT_OK


def ship(args: argparse.Namespace) -> int:
    """Ship the runs of a folder that are over; exit code 7 where one could not be."""
    from hilcell.plant.shipper import ship as ship_runs

    with closing(open_database(args.plant)) as database:
        done = ship_runs(args.runs, database)
    for reason in done.refused.values():
        print_message(f"hilcell: {reason}")
    if done.waiting:
        print_message(f"hilcell: not over yet, shipped after their end: {_names(done.waiting)}")
    if done.behind:
        print_message(f"hilcell: {_behind_words(done.behind)}")
    if not (done.runs or done.before or done.waiting or done.refused):
        print_message(f"hilcell: no runs in {clean(str(args.runs))}")
    print_answer(
        {
            "plant": database.name,
            "shipped": done.runs,
            "points": done.points,
            "before": done.before,
            "waiting": list(map(encodable, done.waiting)),
            "refused": {encodable(run): encodable(why) for run, why in done.refused.items()},
            "behind": {encodable(run): each._asdict() for run, each in done.behind.items()},
        },
        f"{done.runs} runs shipped with {done.points} points, {done.before} were there, "
        f"{len(done.waiting)} not over yet, {len(done.refused)} refused",
        as_json=args.json,
    )
    return EXIT_STORAGE if done.refused else EXIT_OK


def _names(every: Sequence[str]) -> str:
    more = f" and {len(every) - NAMED} more" if len(every) > NAMED else ""
    return ", ".join(map(clean, every[:NAMED])) + more


def _behind_words(behind: Mapping[str, Behind]) -> str:
    named = _names(
        [
            f"{run} (here up to record {each.here}, there {each.plant})"
            for run, each in behind.items()
        ]
    )
    return (
        f"the plant has later records of {len(behind)} runs than this folder: {named}; it was "
        "restored from an older backup, or is a copy: restore a newer one before these runs are "
        "used or resumed"
    )


def show(args: argparse.Namespace) -> int:
    """Show what the plant's records say of cells, robots, stations, instruments and alarms."""
    with closing(open_database(args.plant)) as database:
        database.check()
        with database.transaction() as connection:
            found = _answers(connection, args)
    if args.json:
        print_json(found)
        return EXIT_OK
    if not found["cells"]:
        print_message(f"plant database {database.name}: no runs were shipped yet")
        return EXIT_OK
    _print_cells(found["cells"])
    _print_robots(found["robots"])
    _print_equipment(found)
    for doubt in found["doubts"]:
        print_data(harmless_lines(f"note: {doubt}"))
    return EXIT_OK


def require_packages(names: Sequence[str]) -> None:
    """Raise `HilcellError` where optional packages are missing."""
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        raise HilcellError(
            f"hilcell plant: {', '.join(missing)} is not installed; "
            "in a clone, `pip install '.[plant]'` installs what it needs"
        )


def open_database(url: str | None) -> Database:
    """Return the database; raises `HilcellError` where the packages or the URL are missing."""
    require_packages(PACKAGES)
    url = url or os.environ.get(URL, "")
    if not url:
        raise HilcellError(
            f"hilcell plant: no database is named; say its URL by --to or --from, or set {URL}: "
            "postgresql://USER@HOST/DATABASE or sqlite:///FILE"
        )
    from hilcell.plant.database import Database

    return Database(url)


def _answers(connection: Connection, args: argparse.Namespace) -> dict[str, Any]:
    from hilcell.plant.cells import cells
    from hilcell.plant.doubts import doubts
    from hilcell.plant.equipment import alarms, instruments, worse_stations
    from hilcell.plant.robots import robots

    cell, robot = args.cell or "", args.robot or ""
    states = cells(connection, datetime.now(UTC), args.max_age)
    names = sorted({state.cell for state in states})
    if cell and cell not in names:
        raise HilcellError(f"cell {cell[:80]!r} has shipped no run{did_you_mean(cell, names)}")
    courses = robots(connection, robot, cell)
    if robot and not courses:
        raise HilcellError(f"robot {robot[:80]!r} has no calibration in these records")
    places = {(each.cell, each.serial, each.machine) for each in courses}
    states = [
        state
        for state in states
        if cell in ("", state.cell)
        and (not robot or (state.cell, state.serial, state.machine) in places)
    ]
    found = {
        "cells": states,
        "robots": courses,
        "stations": worse_stations(connection, cell, robot),
        "instruments": instruments(connection, cell, robot),
        "alarms": alarms(connection, cell, robot),
        "doubts": doubts(connection, {state.cell for state in states}),
    }
    plain: dict[str, Any] = msgspec.to_builtins(found)
    return plain


def _print_cells(cells: list[dict[str, Any]]) -> None:
    headers = ["cell", "serial", "machine", "calibration", "made", "valid until", "days left"]
    rows = [
        [
            _word(each["cell"]), _word(each["serial"]), _word(each["machine"]),
            _word(each["calibration"] or each["condition"]), _day(each["calibrated"]),
            _day(each["valid_until"]), _days(each),
            f"{_word(each['last_run'])}, {_word(each['last_state'])}, {_day(each['last_ended'])}",
        ]
        for each in cells
    ]  # fmt: skip
    print_table(([*headers, "last run"], rows))


def _days(cell: dict[str, Any]) -> str:
    if cell["condition"] == "valid":
        return f"{cell['days_left']:.0f}"
    return _word(cell["condition"]) if cell["calibration"] else ""


def _print_robots(robots: list[dict[str, Any]]) -> None:
    headers = ["robot", "cell", "calibrations", "of", "mm a year", "U", "drifts", "noise mm"]
    rows = [
        [
            _word(each["robot"]), _word(each["cell"]), str(each["calibrations"]), drift["what"],
            f"{drift['mm_per_year']:+z.4f}", f"{drift['U_mm_per_year']:.4f}",
            "yes" if drift["drifts"] else "no", f"{drift['noise_mm']:.4f}",
        ]
        for each in robots
        for drift in each["drift"]
    ]  # fmt: skip
    if rows:
        print_table((headers, rows))
    for each in robots:
        for what, reason in each["not_judged"].items():
            who = f"robot {_word(each['robot'])} in {_word(each['cell'])}"
            print_data(f"{who}: no drift stated of {what}: {reason}")
    steps = [(each, change) for each in robots for change in each["changes"]]
    if steps:
        changes = [
            [
                _word(each["robot"]), _word(each["cell"]), change["what"],
                f"{_day(change['since'])} .. {_day(change['until'])}",
                f"{change['size_mm']:+z.3f}", f"{change['U_mm']:.3f}",
                _word(change["before"]) + ("" if change["confirmed"] else " (one run only)"),
                "\n".join(map(_word, change["said"])),
            ]
            for each, change in steps
        ]  # fmt: skip
        headers = ["robot", "cell", "step of", "between", "mm", "U", "first seen by", "said then"]
        print_table((headers, changes))


def _print_equipment(found: dict[str, Any]) -> None:
    if found["stations"]:
        headers = ["station that gets worse", "cell", "mean mm", "tolerance", "mm a year", "95 %"]
        rows = [
            [
                _word(each["station"]), _word(each["cell"]), f"{each['mean_mm']:.3f}",
                "" if each["tolerance_mm"] is None else f"{each['tolerance_mm']:g}",
                f"{each['mm_per_year']:+z.3f}",
                f"{each['low_mm_per_year']:+z.3f} .. {each['high_mm_per_year']:+z.3f}",
                "" if each["out_in_years"] is None else f"{each['out_in_years']:.1f}",
            ]
            for each in found["stations"]
        ]  # fmt: skip
        print_table(([*headers, "out in years"], rows))
    headers = ["instrument", "serial", "model", "cells", "runs", "last", "scale ppm", "u ppm"]
    rows = [
        [
            _word(each["kind"]), _word(each["serial"]), _word(each["model"]),
            _word(", ".join(each["cells"])), str(each["runs"]), _day(each["last"]),
            "" if each["scale_ppm"] is None else f"{each['scale_ppm']:+z.1f}",
            "" if each["u_ppm"] is None else f"{each['u_ppm']:.1f}",
            _word(", ".join(each["disagrees_with"])),
        ]
        for each in found["instruments"]
    ]  # fmt: skip
    print_table(([*headers, "disagrees with"], rows))
    if found["alarms"]:
        headers = ["alarm", "title", "severity", "count", "cells", "last"]
        rows = [
            [
                _word(each["code"]), _word(each["title"]), each["severity"], str(each["count"]),
                _word(", ".join(each["cells"])), _day(each["last"]),
            ]
            for each in found["alarms"]
        ]  # fmt: skip
        print_table((headers, rows))


def _word(text: str) -> str:
    return harmless(text)


def _day(moment: str | None) -> str:
    return (moment or "")[:10]
