"""Writes a run's record into the plant's database: all of it in one transaction, and once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import date
from uuid import UUID

from sqlalchemy import Connection, func, select
from sqlalchemy.dialects import postgresql, sqlite

from hilcell.plant.database import POSTGRESQL, PlantError
from hilcell.plant.record import RunRecord
from hilcell.plant.rows import rows_of
from hilcell.plant.tables import RUN

BATCH = 500  # keys of one question

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
    rows = rows_of(record)
    (run,) = rows.pop(RUN)
    done = connection.execute(added, run)
    if not done.rowcount:
        return False
    for table, every in rows.items():
        if every:
            connection.execute(table.insert(), every)
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
