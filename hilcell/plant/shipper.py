"""Ships the runs of a folder to the plant's database, in order; each is stored there once.

The journals are the outbox: a run waits until the database has its newest revision, and the
database alone knows its revisions. So nothing is lost if either side is killed, or if a server was
unavailable or restored from a backup. A cache beside the journals avoids reading shipped ones
again; it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import sqlite3
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote
from typing import NamedTuple
from uuid import UUID

import msgspec
from sqlalchemy import JSON, Connection, Table, cast, column, func, literal, or_, select, tuple_
from sqlalchemy.dialects import postgresql, sqlite

from hilcell.calibration.file import seal_problems
from hilcell.errors import HilcellError
from hilcell.journal.index import NEVER_BEGAN, RunRow, in_order, own_file, read_index
from hilcell.journal.journal import Record, StorageError
from hilcell.journal.runs import CALIBRATION, JOURNAL, is_run, read_records
from hilcell.model.records import OVER
from hilcell.plant.database import (
    POSTGRESQL,
    SHIPPED,
    Database,
    Locked,
    PlantError,
    PlantUnavailable,
    RightMissing,
)
from hilcell.plant.record import (
    Document,
    RunNotFinished,
    RunRecord,
    Values,
    cell_key_of,
    heads,
    run_key_of,
    run_record,
)
from hilcell.plant.rights import CELL
from hilcell.plant.tables import BATCH, CLAIM, LOGIN, POINT, RUN, Row
from hilcell.sanitize import clean

Key = tuple[UUID, UUID, int]  # of the cell, of the run, and its revision


class Forked(PlantError):
    """The database has another history of this run: its journal was changed, or resumed twice."""

    code = "HC-J22"


class AnothersCell(PlantError):
    """The cell of a run belongs to another login."""


def shipped_revisions(connection: Connection, keys: Iterable[Key]) -> set[Key]:
    columns = (RUN.c.cell_key, RUN.c.run_key, RUN.c.revision)
    runs = sorted({(cell, run) for cell, run, _ in keys})
    found: set[Key] = set()
    for start in range(0, len(runs), BATCH):
        query = tuple_(*columns[:2]).in_(runs[start : start + BATCH])
        found |= {tuple(row) for row in connection.execute(select(*columns).where(query))}
    return found


def write(connection: Connection, record: RunRecord, heads: Sequence[str], ended: int = 0) -> bool:
    """Write a run in the transaction of ``connection``; return whether it is new.

    ``heads`` are the hashes of its journal after each record, ``ended`` is the index of its first
    end: no earlier revision was ever shipped. Raises `Forked` and `AnothersCell`.
    """
    run: Row = record.rows[RUN][0]
    _claim(connection, run)
    _refuse_forked(connection, record, heads, ended)
    insert = (postgresql if connection.dialect.name == POSTGRESQL else sqlite).insert
    added = insert(RUN).on_conflict_do_nothing().execution_options(preserve_rowcount=True)
    done = connection.execute(added, run)
    if not done.rowcount:
        key = (run["cell_key"], record.run_key, record.revision)
        if key not in shipped_revisions(connection, [key]):
            raise Forked(
                f"run {record.row.name}: another run in the database has its digest; the "
                "database's owner searches it by `digest` in the table `run`"
            )
        return False
    for table, every in record.rows.items():
        if every and table is not RUN:
            _insert(connection, table, every)
    return True


def _insert(connection: Connection, table: Table, rows: Sequence[Values]) -> None:
    """Insert rows; on PostgreSQL points, of which there are many, by one order and as JSON, which
    has all their digits; a journal has finite numbers alone.
    """
    if table is not POINT or connection.dialect.name != POSTGRESQL:
        connection.execute(table.insert(), rows)
        return
    sent = cast(literal(msgspec.json.encode(rows).decode()), JSON)
    columns = [column(each.name, each.type) for each in table.c]
    received = func.json_to_recordset(sent).table_valued(*columns).render_derived(with_types=True)
    connection.execute(table.insert().from_select(list(table.c), select(received)))


def _claim(connection: Connection, run: Row) -> None:
    """Claim the cell of a run, if nobody has, for a login that is held to its cells."""
    if connection.dialect.name != POSTGRESQL:
        return
    cell, serial = run["cell"], run["serial"]
    free = select(func.row_security_active(RUN.name)).scalar_subquery().is_(False)
    own = select(CLAIM.c.cell).where(CLAIM.c.cell == cell, CLAIM.c.serial == serial)
    known = select(or_(free, own.exists()))
    if connection.execute(known).scalar_one():
        return
    first = postgresql.insert(CLAIM).values(cell=cell, serial=serial).on_conflict_do_nothing()
    connection.execute(first)
    if not connection.execute(known).scalar_one():
        login = connection.execute(select(LOGIN)).scalar_one()
        owner = f"hilcell plant assign {quote(cell)} --serial {quote(serial)} --login {login}"
        raise AnothersCell(
            f"run {run['name']}: cell {clean(cell)}, serial number {clean(serial) or 'none'}, "
            f"belongs to another login than {login}: give this cell its own name and serial number "
            f"in its cell file, or let the database's owner run `{owner}`"
        )


def _refuse_forked(
    connection: Connection, record: RunRecord, heads: Sequence[str], ended: int
) -> None:
    """Refuse a journal that differs from the shipped revisions, or was shipped under another name:
    its measurements would count twice.
    """
    (run,) = record.rows[RUN]
    own_cell = RUN.c.cell_key == run["cell_key"]  # a journal names its cell: no other has its heads
    query = select(RUN.c.revision, RUN.c.head).where(own_cell, RUN.c.run_key == record.run_key)
    found = connection.execute(query).all()
    for revision, head in found:
        if revision <= len(heads) and heads[revision - 1] != head:
            raise Forked(
                f"run {record.row.name}: record {revision} in the database differs: the journal "
                "was changed, or its folder was copied and resumed twice; ship the right one"
            )
    if found:
        return
    for start in range(ended, len(heads), BATCH):
        same = RUN.c.head.in_(heads[start : start + BATCH])
        same_journal = select(RUN.c.revision).where(own_cell, same, RUN.c.run_key != record.run_key)
        if connection.execute(same_journal.limit(1)).first() is not None:
            raise Forked(
                f"run {record.row.name}: its journal was shipped under another name: the folder "
                "was renamed, or is a copy or a link; keep one, under the shipped name"
            )


# The folder may be another PC's, so nothing in it is trusted: links are not followed, and a file
# with an invalid seal is refused.

MOST_BYTES = 64 * 2**20


class BadAttachment(PlantError):
    """An attachment is not the file that the run wrote."""

    def __init__(self, path: Path, why: str) -> None:
        act = "restore the run's file, or move this one elsewhere, then ship again"
        super().__init__(f"run {path.parent.name}: its {path.name} {why}; {act}")


def attachments(folder: Path, row: RunRow) -> list[Document]:
    """Return the calibration file of a run, if it exists; raises `BadAttachment`."""
    path = folder / CALIBRATION
    if not row.calibrates or not (path.is_symlink() or path.exists()):
        return []
    content = _content(path)
    try:
        problems = seal_problems(msgspec.json.decode(content))
        text = content.decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, LookupError, TypeError):
        problems = ["is not a calibration file"]
    if problems:
        raise BadAttachment(path, problems[0])
    return [Document(path.name, hashlib.sha256(content).hexdigest(), text)]


def _content(path: Path) -> bytes:
    try:
        status = path.lstat()
        if not stat.S_ISREG(status.st_mode):
            raise BadAttachment(path, "is not a regular file")
        if status.st_size > MOST_BYTES:
            raise BadAttachment(path, f"has {status.st_size} bytes, expected at most {MOST_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise BadAttachment(path, f"cannot be read: {error.strerror}") from error


RESTORE = "restore its folder from a backup, or move it out of the folder of runs"
_BROKEN = (  # errors of a journal that is not one of a run
    msgspec.ValidationError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError
)  # fmt: skip


class Behind(NamedTuple):
    """The last record of a run's journal here, and in the database."""

    here: int
    plant: int


@dataclass
class Shipped:
    """The outcome for the runs of a folder. ``refused``: reasons of one line, by run.

    ``behind``: runs with later records in the database, as in a folder restored from a backup.
    """

    runs: int = 0
    points: int = 0
    before: int = 0  # shipped before
    waiting: list[str] = field(default_factory=list)  # live, or without an end
    refused: dict[str, str] = field(default_factory=dict)
    behind: dict[str, Behind] = field(default_factory=dict)


def ship(
    runs: Path, database: Database, on_shipped: Callable[[str], None] = lambda _: None
) -> Shipped:
    """Ship all ended runs of a folder, in their order; ``on_shipped`` is called with each name.

    A refused run does not stop the others; a cell that another transaction holds stops no other
    cell. Raises `PlantUnavailable`, `PlantError`, `RightMissing`, and `StorageError` for a folder
    that cannot be read.
    """
    if not runs.exists():  # a timer with a mistyped folder must not succeed
        raise PlantError(f"folder of runs {clean(str(runs))} does not exist")
    if (runs / JOURNAL).is_file():
        raise PlantError(f"expected a folder of runs, got that of one run: {clean(str(runs))}")
    database.check()
    database.check_right(  # also where nothing is to be shipped
        func.has_any_column_privilege(RUN.name, "INSERT"),
        f"this login may not ship; the database's owner admits it: GRANT {CELL} TO NAME",
    )
    done = Shipped()
    cache = _ShippedCache(runs)
    rows = in_order(read_index(runs))
    here = cache.known(rows)
    blocked: dict[UUID, str] = {}  # cells, by the first run that waited for a lock
    for row in _missing(rows, database, here, done):
        cell = cell_key_of(row)
        if cell in blocked:  # each would wait as long
            done.refused[row.name] = f"run {row.name}: not tried, as its cell: {blocked[cell]}"
            continue
        try:
            record, of_records, ended = _read(runs, row, here)
            with database.transaction() as connection:
                new = write(connection, record, of_records, ended)
        except RunNotFinished:
            done.waiting.append(row.name)
            continue
        except HilcellError as error:
            if isinstance(error, Locked):
                blocked[cell] = f"run {row.name} waited for a lock"
            elif isinstance(error, (PlantUnavailable, RightMissing)):  # of every run
                raise
            done.refused[row.name] = _one_line(row.name, str(error))
            continue
        cache.add(row, here[row.name])
        done.before += not new
        done.runs += new
        done.points += len(record.rows[POINT]) if new else 0
        if new:
            on_shipped(row.name)
    done.refused |= _without_journal(runs)
    here |= _waiting(runs, [row for row in rows if row.name in done.waiting and not row.live])
    done.behind = _newer_in_database(database, here)
    return done


def _read(runs: Path, row: RunRow, here: dict[str, Key]) -> tuple[RunRecord, list[str], int]:
    """Return a run's record, the hashes of its journal, and the index of its first end."""
    try:
        records = read_records(runs / row.name)
        here[row.name] = _key(row, records)
        record = run_record(row.name, records, attachments(runs / row.name, row))
        ended = next((n for n, each in enumerate(records) if each.kind == "end"), 0)
        return record, heads(records), ended
    except StorageError as error:
        raise PlantError(f"{error}; {RESTORE}") from error
    except _BROKEN as error:
        raise PlantError(f"its journal is not one of a run: {error}; {RESTORE}") from error


def _without_journal(runs: Path) -> dict[str, str]:
    """Return the refusals of folders with a calibration but without a journal."""
    folders = sorted(path.parent for path in runs.glob(f"*/{CALIBRATION}"))
    wrong = f"it has {CALIBRATION} but no {JOURNAL}; {RESTORE}"
    return {each.name: f"run {each.name}: {wrong}" for each in folders if not is_run(each)}


def _waiting(runs: Path, rows: Sequence[RunRow]) -> dict[str, Key]:
    """Return the present keys of runs that have not ended."""
    keys: dict[str, Key] = {}
    for row in rows:
        with suppress(HilcellError, *_BROKEN):
            keys[row.name] = _key(row, read_records(runs / row.name))
    return keys


def _key(row: RunRow, records: Sequence[Record]) -> Key:
    return cell_key_of(row), *run_key_of(row.name, records)


def _newer_in_database(database: Database, here: dict[str, Key]) -> dict[str, Behind]:
    with database.transaction() as connection:
        shipped = sorted(shipped_revisions(connection, here.values()))
    newest = {tuple(run): revision for *run, revision in shipped}  # the last revision stays
    return {
        name: Behind(revision, newest[tuple(run)])
        for name, (*run, revision) in here.items()
        if newest.get(tuple(run), 0) > revision
    }


def _one_line(run: str, reason: str) -> str:
    """Return a reason as one line that names the run."""
    line = "; ".join(each.strip() for each in reason.splitlines())
    return line if line.startswith(f"run {run}") else f"run {run}: {line}"


def _missing(
    rows: Sequence[RunRow], database: Database, known: dict[str, Key], done: Shipped
) -> Iterator[RunRow]:
    """Yield the ended runs that the database may lack."""
    with database.transaction() as connection:
        shipped = shipped_revisions(connection, known.values())
    for row in rows:
        if row.state == NEVER_BEGAN:
            continue  # nothing was recorded
        if not row.readable:
            done.refused[row.name] = _one_line(row.name, f"{row.reason}; {RESTORE}")
        elif row.live or row.gone or row.state not in OVER:
            done.waiting.append(row.name)
        elif row.name in known and known[row.name] in shipped:
            done.before += 1
        else:
            yield row


class _ShippedCache:
    """The shipped revisions of journals that are unchanged since; empty if it cannot be used."""

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def known(self, rows: Sequence[RunRow]) -> dict[str, Key]:
        by_name = {row.name: row for row in rows}
        known: dict[str, Key] = {}
        with suppress(sqlite3.Error), closing(self._open()) as base:
            for name, fingerprint, run_key, revision in base.execute("SELECT * FROM seen"):
                with suppress(OSError):
                    row = by_name.get(name)
                    if row is not None and fingerprint == self._fingerprint(row):
                        known[name] = cell_key_of(row), UUID(run_key), revision
        return known

    def add(self, row: RunRow, key: Key) -> None:
        with suppress(sqlite3.Error, OSError), closing(self._open()) as base:
            _, run_key, revision = key
            values = (row.name, self._fingerprint(row), str(run_key), revision)
            base.execute("INSERT OR REPLACE INTO seen VALUES (?, ?, ?, ?)", values)

    def _fingerprint(self, row: RunRow) -> str:
        file = (self._runs / row.name / JOURNAL).stat()
        content = f"{file.st_mtime_ns} {file.st_size} ".encode() + msgspec.json.encode(row)
        return hashlib.sha256(content).hexdigest()

    def _open(self) -> sqlite3.Connection:
        with ExitStack() as undo:
            base = sqlite3.connect(own_file(self._runs / SHIPPED), isolation_level=None)
            undo.callback(base.close)
            base.execute(
                "CREATE TABLE IF NOT EXISTS seen "
                "(run TEXT PRIMARY KEY, row TEXT, run_key TEXT, revision INTEGER) STRICT"
            )
            base.execute("PRAGMA synchronous=OFF")  # it is rebuilt from the journals
            undo.pop_all()
        return base
