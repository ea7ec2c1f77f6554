"""Writes a run's record into the plant's database: all of it in one transaction, and once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from datetime import date, datetime
from typing import Any
from uuid import UUID

import msgspec
from sqlalchemy import Connection, Table, func, select
from sqlalchemy.dialects import postgresql, sqlite

from hilcell.journal.index import RunRow
from hilcell.plant.database import POSTGRESQL, PlantError
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
)

BATCH = 500  # keys of one question
YEARS = (1980, 2200)  # a PC whose battery is empty begins with the first

Key = tuple[UUID, int]  # of a run and its revision


class Forked(PlantError):
    """The database has other records of this run: its journal was changed, or resumed twice."""

    code = "HC-J22"


def newest_there(connection: Connection, keys: Iterable[Key]) -> dict[UUID, int]:
    """Return the newest revision that the database has of each of these runs."""
    return dict(sorted(there(connection, keys)))  # the last one stays


def there(connection: Connection, keys: Iterable[Key]) -> set[Key]:
    """Return which revisions of runs the database has."""
    runs = sorted({run for run, _ in keys})
    found: set[Key] = set()
    for start in range(0, len(runs), BATCH):
        asked = RUN.c.run_key.in_(runs[start : start + BATCH])
        rows = connection.execute(select(RUN.c.run_key, RUN.c.revision).where(asked))
        found |= {(row.run_key, row.revision) for row in rows}
    return found


def write(connection: Connection, record: RunRecord, heads: Sequence[str], ended: int = 0) -> bool:
    """Write a run in the transaction of ``connection``; return whether it was not there yet.

    ``heads`` are the hashes of its journal after each record, ``ended`` is the index of its first
    end: no earlier one was ever shipped. Raises `Forked`.
    """
    if not _continues(connection, record, heads):
        _check_name(connection, record, heads[ended:])
    on_postgresql = connection.dialect.name == POSTGRESQL
    if on_postgresql:
        connection.execute(select(func.plant_month(date.fromisoformat(record.month))))
    insert = postgresql.insert if on_postgresql else sqlite.insert
    added = insert(RUN).on_conflict_do_nothing().execution_options(preserve_rowcount=True)
    done = connection.execute(added, _run(record))
    if not done.rowcount:
        return False
    for table, rows in _parts(record):
        if rows:
            connection.execute(table.insert(), rows)
    return True


def _continues(connection: Connection, record: RunRecord, heads: Sequence[str]) -> bool:
    """Return whether the run was shipped before.

    Refuses a journal that does not go on from, or lead to, what was shipped.
    """
    asked = select(RUN.c.revision, RUN.c.head).where(RUN.c.run_key == record.run_key)
    found = connection.execute(asked).all()
    for revision, head in found:
        if revision <= len(heads) and heads[revision - 1] != head:
            raise Forked(
                f"run {record.row.name}: the plant has another record {revision} of it: its "
                "journal was changed, or its folder was copied and resumed twice; ship the right "
                "one"
            )
    return bool(found)


def _check_name(connection: Connection, record: RunRecord, heads: Sequence[str]) -> None:
    """Refuse a journal that was shipped under another name: its measurements would count twice."""
    for start in range(0, len(heads), BATCH):
        same = RUN.c.head.in_(heads[start : start + BATCH])
        asked = select(RUN.c.revision).where(same, RUN.c.run_key != record.run_key).limit(1)
        if connection.execute(asked).first() is not None:
            raise Forked(
                f"run {record.row.name}: the plant has its journal under another name: its folder "
                "was renamed, or is a copy or a link; keep one, under the name that was shipped"
            )


def _run(record: RunRecord) -> dict[str, Any]:
    row = record.row
    return {
        "digest": record.digest,
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


def _parts(record: RunRecord) -> Iterator[tuple[Table, list[dict[str, Any]]]]:
    """Yield the rows of each table besides the run's own."""
    digest = {"digest": record.digest}
    plain = msgspec.to_builtins
    keyed: tuple[tuple[Table, Sequence[msgspec.Struct]], ...] = (
        (FRAME, record.frames),
        (VERDICT, record.verdicts),
        (STREAM, record.streams),
        (DOCUMENT, record.documents),
    )
    for table, entries in keyed:
        yield table, [digest | plain(each) for each in entries]
    for table, rows in ((DEVICE, record.devices), (LENGTH, record.lengths)):
        kept = {column.name for column in table.columns}
        own = (plain(row) for row in rows)
        yield (
            table,
            [
                digest | {"n": n} | {name: value for name, value in each.items() if name in kept}
                for n, each in enumerate(own)
            ],
        )
    yield (
        ALARM,
        [
            digest | {"n": n} | plain(each) | {"t": _moment(each.t)}
            for n, each in enumerate(record.alarms)
        ],
    )
    yield GRID, [digest | plain(record.grid)] if record.grid is not None else []
    partition = digest | {"month": date.fromisoformat(record.month)}
    yield POINT, [partition | _point(each) for each in record.points]


def _point(entry: PointEntry) -> dict[str, Any]:
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
