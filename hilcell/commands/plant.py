"""``plant``: the records of all cells in one database: create, fill, query, export, verify."""

from __future__ import annotations

import getpass
import importlib.util
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, Self, TypeVar

import msgspec

from hilcell.alarms.catalogue import SEVERITIES
from hilcell.atomic_files import write_whole
from hilcell.cell.settings import did_you_mean
from hilcell.commands.console import (
    print_answer,
    print_data,
    print_json,
    print_message,
    print_table,
)
from hilcell.commands.signatures import (
    PlantArchive,
    PlantAssign,
    PlantExport,
    PlantHeld,
    PlantInit,
    PlantShip,
    PlantShow,
    PlantVerify,
)
from hilcell.errors import EXIT_OK, EXIT_OUT_OF_TOLERANCE, EXIT_STORAGE, HilcellError
from hilcell.present.table import Column, Table
from hilcell.sanitize import clean, counted, encodable, harmless, harmless_lines

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from hilcell.plant.cells import CellState, Doubt
    from hilcell.plant.database import Database
    from hilcell.plant.decisions import Claim, HeldRun
    from hilcell.plant.equipment import (
        AlarmCount,
        Change,
        Drift,
        Instrument,
        RobotTrend,
        StationTrend,
    )

T = TypeVar("T")
SOON_DAYS = 14
RECENT = timedelta(days=365)  # steps before the last calibration
MOST_ALARMS = 20  # kinds that `show` prints
MOST_OF_CELL = 100  # rows of one cell in each list of `show --json`


def init(args: PlantInit) -> int:
    """Create the tables of a plant's database, unless they exist."""
    with closing(_open_database(args.plant)) as database:
        before = database.create()
    from hilcell.plant.tables import HEAD

    state = "is up to date" if before else "created"
    office = "" if database.has_logins else "; SQLite has no logins: for the cells of one office"
    print_answer(
        {"plant": database.name, "schema": HEAD, "before": before or None},
        f"plant database {database.name}: {state}, schema {HEAD}{office}",
        as_json=args.json,
    )
    return EXIT_OK


def ship(args: PlantShip) -> int:
    """Ship the ended runs of a folder; exit code 7 if one was refused."""
    with closing(_open_database(args.plant)) as database:
        from hilcell.plant.shipper import ship as ship_runs  # needs optional packages

        done = ship_runs(args.runs, database)
    for reason in done.refused.values():
        print_message(f"hilcell: {reason}")
    if done.waiting:
        print_message(f"hilcell: not ended yet, to be shipped later: {_names(done.waiting)}")
    if done.behind:
        behind = [
            f"{run} (record {each.here} in the folder, {each.plant} in the database)"
            for run, each in done.behind.items()
        ]
        print_message(
            f"hilcell: the database has later records of {counted(len(behind), 'run')} than this "
            f"folder: {_names(behind)}; the folder is an old backup or a copy: restore a newer one "
            "before using or resuming these runs"
        )
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
        f"{counted(done.runs, 'run')} shipped with {counted(done.points, 'point')}, "
        f"{done.before} shipped before, "
        f"{len(done.waiting)} not ended yet, {len(done.refused)} refused",
        as_json=args.json,
    )
    return EXIT_STORAGE if done.refused else EXIT_OK


def _names(names: Sequence[str]) -> str:
    most = 3
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(map(clean, names[:most])) + more


def show(args: PlantShow) -> int:
    """Print what the records say; with --check, exit code 1 for a cell without a valid one."""
    with closing(_open_database(args.plant)) as database:
        database.check()
        with database.transaction() as connection:
            overview = Overview.queried(connection, args)
    if args.metrics is not None:
        write_whole(args.metrics, _metrics(overview.cells).encode())
    overdue = args.check and any(each.condition != "valid" for each in overview.cells)
    if args.json:
        print_json(msgspec.to_builtins(overview))
    elif overview.cells:
        _print_overview(overview, whole=bool(args.all or args.cell or args.robot))
    else:
        print_message(f"plant database {database.name}: no runs were shipped yet")
    return EXIT_OUT_OF_TOLERANCE if overdue else EXIT_OK


def _metrics(cells: Sequence[CellState]) -> str:
    """Return the states of cells as a text file of Prometheus, as node_exporter reads it."""
    lines: list[str] = []
    for name, text, value in METRICS:
        metric = f"hilcell_plant_{name}"
        lines += [f"# HELP {metric} {text}", f"# TYPE {metric} gauge"]
        for each in cells:
            found = value(each)
            if found is not None:
                names = {"cell": each.cell, "serial": each.serial, "machine": each.machine}
                labels = ",".join(f'{key}="{_label(word)}"' for key, word in names.items())
                lines.append(f"{metric}{{{labels}}} {found!r}")
    return "\n".join([*lines, ""])


def _label(text: str) -> str:
    """Return a text as the value of a label, so that different texts stay different."""
    doubled = text.replace("\\", "\\\\")  # a single one is of a character that is not visible
    visible = (each if harmless(each) == each else f"\\u{ord(each):04x}" for each in doubled)
    return "".join(visible).replace("\\", "\\\\").replace('"', '\\"')


METRICS: tuple[tuple[str, str, Callable[[CellState], float | None]], ...] = (
    ("calibration_valid", "1 if the cell has a valid calibration, else 0.",
        lambda each: float(each.condition == "valid")),
    ("calibration_days_left", "Days until the current calibration is too old.",
        attrgetter("days_left")),
    ("last_shipped_timestamp_seconds", "When the newest run of the cell arrived, by the server.",
        lambda each: each.last_shipped.timestamp()),
)  # fmt: skip


def _print_overview(overview: Overview, *, whole: bool) -> None:
    """Print all cells, those that ask for an act first, and of the other tables the rows that ask
    for one; ``whole``: all rows.
    """
    robots = overview.robots
    valid = [each for each in overview.cells if each.condition == "valid"]
    valid.sort(key=attrgetter("days_left"))
    others = [each for each in overview.cells if each.condition != "valid"]
    soon = sum(each.days_left is not None and each.days_left <= SOON_DAYS for each in valid)
    print_data(
        f"{counted(len(overview.cells), 'cell')}: {len(others)} without a valid calibration, "
        f"{soon} with one for {SOON_DAYS} days or less"
    )
    print_table(Table(CELLS, others + valid))

    def part(
        columns: Sequence[Column[T]], rows: Sequence[T], asks: Callable[[T], bool], others: str
    ) -> None:
        shown = rows if whole else [row for row in rows if asks(row)]
        print_table(Table(columns, shown))
        if count := len(rows) - len(shown):
            print_data(f"not shown: {others}: {count}; --cell NAME or --all prints all")

    drifts = [(each, drift) for each in robots for drift in each.drift]
    part(DRIFTS, drifts, lambda row: row[1].drifts, "drifts that are not significant")
    unknown = [(each, *why) for each in robots for why in each.not_judged.items()]
    part(UNKNOWN, unknown, lambda _: False, "drifts that are not judged")
    steps = [(each, step) for each in robots for step in each.changes]
    steps.sort(key=lambda row: row[1].until, reverse=True)
    part(STEPS, steps, _is_recent, "steps followed by a year of calibrations")
    print_table(Table(STATIONS, sorted(overview.stations, key=_years_left)))
    disagrees = attrgetter("disagrees_with")
    part(INSTRUMENTS, overview.instruments, disagrees, "instruments that disagree with no other")
    rank: dict[str, int] = {severity: -n for n, severity in enumerate(SEVERITIES)}
    gravest = sorted(overview.alarms, key=lambda each: rank[each.severity])
    part(ALARMS, gravest, gravest[:MOST_ALARMS].__contains__, "alarms that are less grave or rarer")
    for table, count in overview.left_out.items():
        if count:
            print_data(
                f"{table}: {count} left out, beyond {MOST_OF_CELL} of one cell; --robot SERIAL "
                "shows those of a robot"
            )
    for doubt in overview.doubts:
        print_data(harmless_lines(f"note: {doubt}"))


def _is_recent(row: tuple[RobotTrend, Change]) -> bool:
    robot, step = row
    return robot.last - step.until < RECENT


def _is_out(station: StationTrend) -> bool:
    return station.tolerance_mm is not None and station.out_in_years is None


def _years_left(station: StationTrend) -> float:
    """Return the years until a station is out of tolerance; infinite without a tolerance."""
    without = 0.0 if _is_out(station) else math.inf
    return without if station.out_in_years is None else station.out_in_years


def _require_packages(*names: str) -> None:
    """Raise `HilcellError` where optional packages are missing."""
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        raise HilcellError(
            f"plant: not installed: {', '.join(missing)}; in a clone, run `pip install '.[plant]'`"
        )


def _open_database(url: str | None) -> Database:
    """Return the database; raises `HilcellError` where the packages or the URL are missing."""
    _require_packages("sqlalchemy", "alembic", "psycopg")
    url = url or os.environ.get("HILCELL_PLANT", "")
    if not url:
        raise HilcellError(
            "plant: expected a database in --to, --from or HILCELL_PLANT: "
            "postgresql://USER@HOST/DATABASE or sqlite:///FILE"
        )
    from hilcell.plant.database import Database

    return Database(url)


@dataclass(frozen=True)
class Overview:
    """The tables that `show` prints."""

    cells: list[CellState]
    robots: list[RobotTrend]
    stations: list[StationTrend]
    instruments: list[Instrument]
    alarms: list[AlarmCount]
    doubts: list[str]
    left_out: dict[str, int]  # rows by table

    @classmethod
    def queried(cls, connection: Connection, args: PlantShow) -> Self:
        from hilcell.plant.cells import cells, inconsistencies
        from hilcell.plant.equipment import alarms, instruments, robots, worse_stations

        cell, robot = args.cell or "", args.robot or ""
        left_out: list[Doubt] = []
        states = cells(connection, datetime.now(UTC), args.max_age, left_out)
        names = sorted({state.cell for state in states})
        if cell and cell not in names:
            raise HilcellError(f"unknown cell {cell[:80]!r}{did_you_mean(cell, names)}")
        trends = robots(connection, robot, cell, left_out)
        if robot and not trends:
            where = f"in cell {cell[:80]!r}" if cell else "in these records"
            unread = f"; {counted(len(left_out), 'run')} cannot be read: `show` names them"
            raise HilcellError(
                f"robot {robot[:80]!r} has no calibration {where}{unread * bool(left_out)}"
            )
        places = {(each.cell, each.serial, each.machine) for each in trends}
        states = [
            state
            for state in states
            if cell in ("", state.cell)
            and (not robot or (state.cell, state.serial, state.machine) in places)
        ]
        found: dict[str, Sequence[Any]] = {
            "robots": trends,
            "stations": worse_stations(connection, cell, robot),
            "instruments": instruments(connection, cell, robot),
            "alarms": alarms(connection, cell, robot),
        }
        kept = {name: _of_each_cell(rows, ASKS[name]) for name, rows in found.items()}
        return cls(
            cells=states,
            **kept,
            doubts=inconsistencies(connection, {state.cell for state in states}, left_out),
            left_out={name: len(rows) - len(kept[name]) for name, rows in found.items()},
        )


ASKS: Mapping[str, Callable[[Any], bool]] = {  # whether a row asks for an act
    "robots": lambda each: (
        any(drift.drifts for drift in each.drift)
        or any(_is_recent((each, step)) for step in each.changes)
    ),
    "stations": lambda _: True,
    "instruments": lambda each: bool(each.disagrees_with),
    "alarms": lambda each: bool(each.severity == "fault"),
}


def _of_each_cell(rows: Sequence[Any], asks: Callable[[Any], bool]) -> list[Any]:
    """Return some rows of each cell, in their order; of too many those that ask for an act.

    A login that writes ever new names hides no row of another's cell.
    """
    known: Counter[str] = Counter()
    kept = []
    for n in sorted(range(len(rows)), key=lambda n: not asks(rows[n])):
        cells = rows[n].cells if hasattr(rows[n], "cells") else [rows[n].cell]
        below = [cell for cell in cells if known[cell] < MOST_OF_CELL]
        if below:
            known.update(below)
            kept.append(n)
    return [rows[n] for n in sorted(kept)]


def _day(moment: datetime | None) -> str:
    return "" if moment is None else f"{moment:%Y-%m-%d}"


def _days(cell: CellState) -> str:
    if cell.condition == "valid":
        return f"{cell.days_left:.0f}"
    return cell.condition if cell.calibration else ""


CELLS: tuple[Column[CellState], ...] = (
    Column("cell", attrgetter("cell")),
    Column("serial", attrgetter("serial")),
    Column("machine", attrgetter("machine")),
    Column("calibration", lambda each: each.calibration or each.condition),
    Column("made", lambda each: _day(each.calibrated)),
    Column("valid until", lambda each: _day(each.valid_until)),
    Column("days left", _days),
    Column("last run", lambda each: f"{each.last_run}, {each.last_state}, {_day(each.last_ended)}"),
)
DRIFTS: tuple[Column[tuple[RobotTrend, Drift]], ...] = (
    Column("robot", lambda row: row[0].robot),
    Column("cell", lambda row: row[0].cell),
    Column("calibrations", lambda row: row[0].calibrations, form="d"),
    Column("of", lambda row: row[1].what),
    Column("mm a year", lambda row: row[1].mm_per_year, form="+z.4f"),
    Column("U", lambda row: row[1].U_mm_per_year, form=".4f"),
    Column("significant", lambda row: "yes" if row[1].drifts else "no"),
    Column("noise", lambda row: row[1].noise_mm, "mm", ".4f"),
)
UNKNOWN: tuple[Column[tuple[RobotTrend, str, str]], ...] = (
    Column("robot", lambda row: row[0].robot),
    Column("cell", lambda row: row[0].cell),
    Column("no drift of", itemgetter(1)),
    Column("because", itemgetter(2)),
)
STEPS: tuple[Column[tuple[RobotTrend, Change]], ...] = (
    Column("robot", lambda row: row[0].robot),
    Column("cell", lambda row: row[0].cell),
    Column("step of", lambda row: row[1].what),
    Column("between", lambda row: f"{_day(row[1].since)} .. {_day(row[1].until)}"),
    Column("mm", lambda row: row[1].size_mm, form="+z.3f"),
    Column("U", lambda row: row[1].U_mm, form=".3f"),
    Column(
        "first in",
        lambda row: row[1].before if row[1].confirmed else f"{row[1].before} (one run only)",
    ),
    Column("messages then", lambda row: "\n".join(map(harmless, row[1].said))),
)
STATIONS: tuple[Column[StationTrend], ...] = (
    Column("station with rising errors", attrgetter("station")),
    Column("cell", attrgetter("cell")),
    Column("mean", attrgetter("mean_mm"), "mm", ".3f"),
    Column("tolerance", attrgetter("tolerance_mm"), form="g"),
    Column("mm a year", attrgetter("mm_per_year"), form="+z.3f"),
    Column("95 %", lambda each: f"{each.low_mm_per_year:+z.3f} .. {each.high_mm_per_year:+z.3f}"),
    Column(
        "out in years",
        lambda each: "out" if _is_out(each) else f"{_years_left(each):.1f}".replace("inf", ""),
    ),
)


def _newest_urad(axis: str, instrument: Instrument) -> float | None:
    return next((each.urad for each in instrument.axes if each.axis == axis), None)


INSTRUMENTS: tuple[Column[Instrument], ...] = (
    Column("instrument", attrgetter("kind")),
    Column("serial", attrgetter("serial")),
    Column("model", attrgetter("model")),
    Column("cells", lambda each: _names(each.cells)),
    Column("runs", attrgetter("runs"), form="d"),
    Column("last", lambda each: _day(each.last)),
    Column("scale", attrgetter("scale_ppm"), "ppm", "+z.1f"),
    Column("u", attrgetter("u_ppm"), "ppm", ".1f"),
    *(
        Column(axis, partial(_newest_urad, axis), "µrad", "+z.1f")
        for axis in ("collimation", "transit", "index")
    ),
    Column("disagrees with", lambda each: _names(each.disagrees_with)),
)
ALARMS: tuple[Column[AlarmCount], ...] = (
    Column("alarm", attrgetter("code")),
    Column("title", attrgetter("title")),
    Column("severity", attrgetter("severity")),
    Column("count", attrgetter("count"), form="d"),
    Column("cells", lambda each: _names(each.cells)),
    Column("last", lambda each: _day(each.last)),
)


# -- decisions of the database's owner ------------------------------------------------------------


def assign(args: PlantAssign) -> int:
    """Assign a cell to a login, or list the logins of all cells."""
    if bool(args.cell) != bool(args.login):
        raise HilcellError("plant assign: expected CELL and --login NAME, or neither")
    with closing(_open_database(args.plant)) as database:
        from hilcell.plant.decisions import assign as assign_cell
        from hilcell.plant.decisions import claims

        database.check()
        with database.transaction() as connection:
            if args.cell:
                known = [assign_cell(connection, args.cell, args.serial, args.login)]
            else:
                known = claims(connection)
    none = f"plant database {database.name}: no cell has a login"
    return _listed({"claims": known}, CLAIMS, none, as_json=args.json)


def held(args: PlantHeld) -> int:
    """List the runs held apart, or accept or remove one."""
    if args.accept and args.remove:
        raise HilcellError("plant held: expected --accept or --remove, got both")
    with closing(_open_database(args.plant)) as database:
        from hilcell.plant.decisions import decide
        from hilcell.plant.decisions import held as held_runs

        database.check()
        with database.transaction() as connection:
            if args.accept or args.remove:
                decide(connection, args.accept or args.remove, accepted=bool(args.accept))
            runs = held_runs(connection)
    none = f"plant database {database.name}: no run is held apart"
    return _listed({"held": runs}, HELD, none, as_json=args.json)


def _listed(
    answer: dict[str, list[T]], columns: Sequence[Column[T]], none: str, *, as_json: bool
) -> int:
    """Print the one list of an answer, or ``none`` where it is empty."""
    (rows,) = answer.values()
    if as_json:
        print_json(msgspec.to_builtins(answer))
    elif rows:
        print_table(Table(columns, rows))
    else:
        print_message(none)
    return EXIT_OK


CLAIMS: tuple[Column[Claim], ...] = (
    Column("cell", attrgetter("cell")),
    Column("serial", attrgetter("serial")),
    Column("login", attrgetter("login")),
    Column("since", lambda each: _day(each.since)),
)
HELD: tuple[Column[HeldRun], ...] = (
    Column("run", attrgetter("run")),
    Column("digest", lambda each: each.digest[:12]),
    Column("cell", attrgetter("cell")),
    Column("serial", attrgetter("serial")),
    Column("machine", attrgetter("machine")),
    Column("shipped by", attrgetter("shipped_by")),
    Column("arrived", lambda each: f"{each.shipped:%Y-%m-%d %H:%M}"),
    Column("ended", lambda each: f"{each.ended:%Y-%m-%d %H:%M}"),
    Column("decision", lambda each: "removed" if each.removed else ""),
)


# -- archive, export and verify --------------------------------------------------------------------


def archive(args: PlantArchive) -> int:
    """Move the points of old runs to files; exit code 7 if a run was refused."""
    _require_packages("pyarrow")
    with closing(_open_database(args.plant)) as database:
        from hilcell.plant.archive import archive as archive_points

        database.check()
        moved = archive_points(database, args.before, args.out)
    for reason in moved.refused.values():
        print_message(f"hilcell: {reason}")
    print_answer(
        {"plant": database.name, "runs": moved.runs, "points": moved.points,
         "bytes": moved.size_bytes, "out": harmless(str(args.out)),
         "refused": {encodable(run): encodable(why) for run, why in moved.refused.items()}},
        f"{counted(moved.points, 'point')} of {counted(moved.runs, 'run')} moved to "
        f"{harmless(str(args.out))}, {len(moved.refused)} refused",
        as_json=args.json,
    )  # fmt: skip
    return EXIT_STORAGE if moved.refused else EXIT_OK


def export(args: PlantExport) -> int:
    _require_packages("cryptography", *(["pyarrow"] if args.archive else []))
    from hilcell.plant.audit import read_private_key
    from hilcell.plant.export import export as export_cell

    key = read_private_key(args.key, _passphrase)
    with closing(_open_database(args.plant)) as database:
        database.check()
        with database.transaction() as connection:
            found = export_cell(connection, args.cell, args.serial, args.out, key, args.archive)
    simulated = f", {found.simulated_runs} of them simulated" if found.simulated_runs else ""
    print_answer(
        {"cell": found.cell, "serials": found.serials, "runs": found.runs,
         "files": len(found.files), "key": found.key, "out": harmless(str(args.out))},
        f"cell {harmless(found.cell)}: {counted(found.runs, 'run')}{simulated}, "
        f"{counted(len(found.files), 'file')} written to {harmless(str(args.out))}, "
        f"signed by {found.key}",
        as_json=args.json,
    )  # fmt: skip
    return EXIT_OK


def verify(args: PlantVerify) -> int:
    """Verify an exported record; exit code 1 where a file differs, is missing or is extra."""
    _require_packages("cryptography")
    from hilcell.plant.audit import read_public_key
    from hilcell.plant.audit import verify as verify_record

    manifest, findings = verify_record(args.record, read_public_key(args.public_key))
    for file, what in findings.items():
        print_message(f"{harmless(file)}: {harmless(what)}")
    count = len(manifest.files)
    text = f"all {counted(count, 'file')} verified"
    if findings:
        text = f"{counted(len(findings), 'file')} not as signed"
    print_answer(
        {"cell": manifest.cell, "serials": manifest.serials, "runs": manifest.runs,
         "files": count, "made": manifest.made, "key": manifest.key, "holds": not findings,
         "findings": {encodable(file): encodable(what) for file, what in findings.items()}},
        f"cell {harmless(manifest.cell)}: {text}, on {harmless(manifest.made)} by {manifest.key}",
        as_json=args.json,
    )  # fmt: skip
    return EXIT_OUT_OF_TOLERANCE if findings else EXIT_OK


def _passphrase() -> bytes | None:
    if not (sys.stdin is not None and sys.stdin.isatty()):
        return None
    try:
        return getpass.getpass("passphrase of the key: ").encode()
    except (EOFError, UnicodeError):
        return b""
