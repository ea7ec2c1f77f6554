"""The rows of a run's record in the plant's tables, and the digest of what they say.

The digest follows from the rows alone: it is the same of those that are about to be written and of
those that were read back, from either store. So it shows whether they are as they were shipped.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import date, datetime
from typing import Any
from uuid import UUID

import msgspec
from sqlalchemy import Double, Table

from hilcell.journal.index import RunRow
from hilcell.plant.record import ROBOT, TRACKER, PointEntry, RunRecord, short
from hilcell.plant.tables import (
    ALARM,
    DEVICE,
    DOCUMENT,
    FRAME,
    GRID,
    LENGTH,
    POINT,
    RUN,
    STREAM,
    VERDICT,
    Utc,
)

YEARS = (1980, 2200)  # a PC whose battery is empty begins with the first
OWN = {"digest", "shipped"}  # columns that the digest is not of: itself, and the server's clock

Values = dict[str, Any]  # of a row, by column


def rows_of(record: RunRecord) -> dict[Table, list[Values]]:
    """Return the rows of a record by their table, that of runs first; they have their digest."""
    rows = {RUN: [_run(record)]} | dict(_parts(record))
    digest = {"digest": digest_of(rows)}
    return {table: [digest | each for each in every] for table, every in rows.items()}


def digest_of(rows: Mapping[Table, Iterable[Mapping[str, Any]]]) -> UUID:
    """Return the digest of a run's rows, in any order."""
    lines = sorted(line for table, every in rows.items() for line in _lines(table, every))
    return short("\n".join(lines).encode())


def _lines(table: Table, rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a line of each row: its values by column, floats to their last digit."""
    numbers = {each.name for each in table.columns if isinstance(each.type, Double)}
    moments = {each.name for each in table.columns if isinstance(each.type, Utc)}
    encode = json.JSONEncoder(sort_keys=True, default=str).encode
    for row in rows:
        values = {name: value for name, value in row.items() if name not in OWN}
        for name in numbers & values.keys():
            if isinstance(values[name], int | float):
                values[name] = float(values[name]) + 0.0  # SQLite keeps no -0.0
        for name in moments & values.keys():
            values[name] = Utc.in_utc(values[name])
        yield f"{table.name} {encode(values)}"


def _run(record: RunRecord) -> Values:
    row = record.row
    return {
        "run_key": record.run_key,
        "revision": record.revision,
        "head": record.head,
        "month": date.fromisoformat(record.month),
        "cell_key": short(msgspec.json.encode((row.cell, row.serial, _machine(row)))),
        "name": row.name,
        "cell": row.cell,
        "serial": row.serial,
        "simulated": row.simulated,
        "machine": _machine(row),
        "procedure": row.procedure,
        "state": row.state,
        "exit": row.exit,
        "begun": _moment(row.begun),
        "ended": _moment(row.ended),
        "points": sum(not each.superseded for each in record.points),
        "proven": _proven(record),
        "robot": record.serial(ROBOT),
        "tracker": record.serial(TRACKER),
        "version": record.versions.get("hilcell", ""),
        "row": msgspec.to_builtins(row),
    }


def _machine(row: RunRow) -> str:
    """Return which simulated machine it was: each is a cell of its own; "" for a real one."""
    if not row.simulated:
        return ""
    return "simulated" if row.machine_seed is None else f"simulated {row.machine_seed}"


def _proven(record: RunRecord) -> bool:
    """Whether the run made a calibration that supersedes those before it."""
    facts = record.row.facts
    made = facts.kind == "made" and record.row.calibrates
    return made and facts.validated and record.row.exit == 0 and not facts.revoked


def _parts(record: RunRecord) -> Iterator[tuple[Table, list[Values]]]:
    """Yield the rows of each table besides the run's own."""
    plain = msgspec.to_builtins
    keyed: tuple[tuple[Table, Sequence[msgspec.Struct]], ...] = (
        (FRAME, record.frames),
        (VERDICT, record.verdicts),
        (STREAM, record.streams),
        (DOCUMENT, record.documents),
    )
    for table, entries in keyed:
        yield table, [plain(each) for each in entries]
    for table, rows in ((DEVICE, record.devices), (LENGTH, record.lengths)):
        kept = {column.name for column in table.columns}
        own = (plain(row) for row in rows)
        yield (
            table,
            [
                {"n": n} | {name: value for name, value in each.items() if name in kept}
                for n, each in enumerate(own)
            ],
        )
    yield (
        ALARM,
        [{"n": n} | plain(each) | {"t": _moment(each.t)} for n, each in enumerate(record.alarms)],
    )
    yield GRID, [plain(record.grid)] if record.grid is not None else []
    month = {"month": date.fromisoformat(record.month)}
    yield POINT, [month | _point(each) for each in record.points]


def _point(entry: PointEntry) -> Values:
    point = entry.point
    nominal_mm = point.nominal_mm or (None, None, None)
    return {
        "seq": entry.seq,
        "t": _moment(entry.t),
        "key": point.key,
        "kind": point.group,
        "station": point.station,
        "frame": point.frame,
        "reflector": point.reflector,
        **dict(zip(("x_mm", "y_mm", "z_mm"), point.xyz_mm, strict=True)),
        **dict(zip(("std_x_mm", "std_y_mm", "std_z_mm"), point.std_mm, strict=True)),
        "samples": point.samples,
        "session": point.session,
        "set_up": point.set_up,
        "retaken": point.retaken,
        "superseded": entry.superseded,
        "temperature_c": point.temperature_c,
        "pressure_mbar": point.pressure_mbar,
        "humidity_percent": point.humidity_percent,
        "strip_mm": point.strip_mm,
        "rail_mm": point.rail_mm,
        **dict(zip(("nominal_x_mm", "nominal_y_mm", "nominal_z_mm"), nominal_mm, strict=True)),
        "commanded_deg": point.commanded_deg,
        "joints_deg": point.joints_deg,
    }


def _moment(t: str) -> datetime:
    """Return a time; raises `ValueError` where no clock of a cell can have said it."""
    found = datetime.fromisoformat(t)
    if not YEARS[0] <= found.year < YEARS[1]:
        raise ValueError(f"it says the time {t}, wanted are years of {YEARS[0]} to {YEARS[1]}")
    return found
