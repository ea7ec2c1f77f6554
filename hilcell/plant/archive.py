"""Points of old runs in files, one Parquet file a run; all else of a run stays in the database.

A file is named by the run's digest, and its SHA-256 is kept in the table ``archive``. It holds the
rows of ``point``, so with it the rows of the run still have their digest. A run is moved in one
transaction, after its file is on the disk and was read back.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import secrets
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy import Connection, Select, Table, func, select

from hilcell.atomic_files import as_not_written
from hilcell.plant.database import Database, PlantError
from hilcell.plant.record import rows_digest
from hilcell.plant.tables import ARCHIVE, PARTS, POINT, RUN, Row, Utc
from hilcell.sanitize import clean

CHANGED = "the plant's database was changed or damaged; restore a backup, then ship again"
COLUMNS = [each for each in POINT.c if each.name != "digest"]


@dataclass
class Moved:
    """Runs, points and bytes moved to files; ``refused``: reasons of one line, by run."""

    runs: int = 0
    points: int = 0
    size_bytes: int = 0
    refused: dict[str, str] = field(default_factory=dict)


def archive(database: Database, before: datetime, folder: Path) -> Moved:
    """Move the points of all runs that ended before a time to files of a folder.

    Raises `PlantUnavailable`, `PlantError`, `RightMissing`, and `NotWritten` where the folder
    cannot be written.
    """
    if not before <= (now := datetime.now(UTC)):
        raise PlantError(
            f"plant archive: expected a day before {now:%Y-%m-%d}, got {before:%Y-%m-%d}: points "
            "of runs to come would be moved as well"
        )
    database.check_right(  # also where nothing is to be moved
        func.has_table_privilege(POINT.name, "DELETE"),
        "this login may not archive; only the database's owner may",
    )
    with as_not_written(folder):
        folder.mkdir(parents=True, exist_ok=True)
    points = select(POINT.c.seq).where(POINT.c.digest == RUN.c.digest).exists()
    query = select(RUN.c.digest).where(RUN.c.ended < before, points).order_by(RUN.c.ended)
    with database.transaction() as connection:
        digests = connection.execute(query).scalars().all()
    moved = Moved()
    for digest in digests:
        with database.transaction() as connection:
            (run,) = read_rows(connection, select(RUN).where(RUN.c.digest == digest), "a run")
            try:
                size_bytes, points_count = _move(connection, run, folder)
            except Changed as error:
                moved.refused[run["name"]] = str(error)
                continue
        moved.runs += 1
        moved.points += points_count
        moved.size_bytes += size_bytes
    return moved


class Changed(PlantError):
    """The rows of a run, or the file of its points, are not those that were shipped."""


def _move(connection: Connection, run: Row, folder: Path) -> tuple[int, int]:
    """Move the points of a run; return the size of the file, and how many they are."""
    rows = run_rows(connection, run, None)
    content = _encoded(rows[POINT])
    if rows_digest({**rows, POINT: _decoded(run, content)}) != run["digest"]:
        raise Changed(f"run {clean(run['name'])} is not as shipped: {CHANGED}")
    path = folder / f"{run['digest'].hex}.parquet"
    beside = folder / f".{secrets.token_hex(8)}.part"
    try:
        with as_not_written(path):
            with beside.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
            _keep_names(folder)
    finally:
        beside.unlink(missing_ok=True)
    sha256 = hashlib.sha256(content).hexdigest()
    row = {"digest": run["digest"], "file": path.name, "sha256": sha256}
    connection.execute(ARCHIVE.insert(), row)
    connection.execute(POINT.delete().where(POINT.c.digest == run["digest"]))
    return len(content), len(rows[POINT])


def _keep_names(folder: Path) -> None:
    """Wait until the names of a folder's files are on the disk, where the system can."""
    if os.name == "posix":
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def run_rows(connection: Connection, run: Row, folder: Path | None) -> dict[Table, list[Row]]:
    """Return all rows of a revision of a run; archived points are read from ``folder``.

    Raises `PlantError`, and `Changed` for a file that is missing or differs.
    """
    tables = {RUN: [run]}
    for table in PARTS:
        query = select(table).where(table.c.digest == run["digest"])
        named = f"run {clean(run['name'])}"
        tables[table] = read_rows(connection, query.order_by(*table.primary_key), named)
    kept = connection.execute(select(ARCHIVE).where(ARCHIVE.c.digest == run["digest"])).first()
    if kept is not None and not tables[POINT]:
        tables[POINT] = _decoded(run, _content(run, kept, folder))
    return tables


def read_rows(connection: Connection, query: Select[Any], what: str) -> list[Row]:
    """Return rows; raises `Changed` for values that do not fit their column."""
    try:
        return list(connection.execute(query).mappings())
    except (ValueError, TypeError, AttributeError, RecursionError, struct.error):
        raise Changed(f"{what}: the database has values that cannot be read: {CHANGED}") from None


def _content(run: Row, kept: Row, folder: Path | None) -> bytes:
    name = f"run {clean(run['name'])}"
    when = f"{kept.at:%Y-%m-%d}"
    if folder is None:
        raise Changed(
            f"{name}: its points were moved to the file {clean(kept.file)} on {when}; name the "
            "folder with --archive"
        )
    path = folder / f"{run['digest'].hex}.parquet"  # not a path that the database names
    restore = "restore it from a backup of the archive"
    try:
        if path.exists() and not path.is_file():
            raise OSError(errno.EINVAL, "it is not a regular file")
        content = path.read_bytes()
    except OSError as error:
        raise Changed(
            f"{name}: its points, moved on {when}: {clean(str(path))} cannot be read: "
            f"{error.strerror}; {restore}, or name its folder with --archive"
        ) from None
    if hashlib.sha256(content).hexdigest() != kept.sha256:
        raise Changed(
            f"{name}: its points, moved on {when}: {clean(str(path))} differs from the file that "
            f"was written: another SHA-256; {restore}"
        )
    return content


def _encoded(rows: list[Row]) -> bytes:
    """Return rows of `point` as a Parquet file; JSON is kept as text."""
    import pyarrow as pa
    from pyarrow import parquet

    schema = pa.schema([(each.name, _kind(each)) for each in COLUMNS])
    values = [[_as_text(each, row[each.name]) for row in rows] for each in COLUMNS]
    table = pa.table(
        [pa.array(column, kind) for column, kind in zip(values, schema.types, strict=True)],
        schema=schema,
    )
    file = io.BytesIO()
    parquet.write_table(table, file, compression="zstd")
    return file.getvalue()


def _decoded(run: Row, content: bytes) -> list[Mapping[str, object]]:
    from pyarrow import parquet

    texts = {each.name for each in COLUMNS if isinstance(each.type, sa.JSON)}
    return [
        {"digest": run["digest"]}
        | {
            name: json.loads(value) if name in texts and value is not None else value
            for name, value in row.items()
        }
        for row in parquet.read_table(io.BytesIO(content)).to_pylist()
    ]


def _as_text(column: sa.Column[Any], value: object) -> object:
    return json.dumps(value) if isinstance(column.type, sa.JSON) and value is not None else value


def _kind(column: sa.Column[Any]) -> Any:
    import pyarrow as pa

    match column.type:
        case Utc():
            return pa.timestamp("us", tz="UTC")
        case sa.Double():
            return pa.float64()
        case sa.Integer():
            return pa.int64()
        case sa.Boolean():
            return pa.bool_()
        case _:
            return pa.string()
