"""Ships the runs of a folder to the plant's database: at least once, kept there once, in order.

The journals are the outbox: a run is waiting until the database has its newest revision, and the
database alone says which those are. So nothing is lost by a kill of either side, by a server that
was away, or by one that was set back to a backup. Beside the journals, which are only read, lies a
file that spares reading those again that are shipped; it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import sqlite3
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from uuid import UUID

import msgspec
from sqlalchemy import Connection, func, select
from sqlalchemy.dialects import postgresql, sqlite

from hilcell.calibration.file import seal_problems
from hilcell.errors import HilcellError
from hilcell.journal.index import NEVER_BEGAN, RunRow, in_order, own_file, read_index
from hilcell.journal.journal import StorageError
from hilcell.journal.runs import CALIBRATION, JOURNAL, is_run, read_records
from hilcell.journal.states import OVER
from hilcell.plant.database import POSTGRESQL, SEEN, Database, PlantAway, PlantError, RightMissing
from hilcell.plant.record import Document, NotOver, RunRecord, heads, key_of, record_of
from hilcell.plant.tables import POINT, RUN
from hilcell.sanitize import clean

BATCH = 500  # keys of one question

Key = tuple[UUID, int]  # of a run and its revision


class Forked(PlantError):
    """The database has other records of this run: its journal was changed, or resumed twice."""

    code = "HC-J22"


def there(connection: Connection, keys: Iterable[Key]) -> set[Key]:
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
    _refuse_forked(connection, record, heads, ended)
    on_postgresql = connection.dialect.name == POSTGRESQL
    (run,) = record.rows[RUN]
    if on_postgresql:
        connection.execute(select(func.plant_month(run["month"])))
    insert = postgresql.insert if on_postgresql else sqlite.insert
    added = insert(RUN).on_conflict_do_nothing().execution_options(preserve_rowcount=True)
    done = connection.execute(added, run)
    if not done.rowcount:
        return False
    for table, every in record.rows.items():
        if every and table is not RUN:
            connection.execute(table.insert(), every)
    return True


def _refuse_forked(
    connection: Connection, record: RunRecord, heads: Sequence[str], ended: int
) -> None:
    """Refuse a journal that does not go on from, or lead to, what was shipped of the run.

    Also one shipped under another name: its measurements would count twice.
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
    if found:
        return
    for start in range(ended, len(heads), BATCH):
        same = RUN.c.head.in_(heads[start : start + BATCH])
        asked_name = select(RUN.c.revision).where(same, RUN.c.run_key != record.run_key).limit(1)
        if connection.execute(asked_name).first() is not None:
            raise Forked(
                f"run {record.row.name}: the plant has its journal under another name: its folder "
                "was renamed, or is a copy or a link; keep one, under the name that was shipped"
            )


# The folder is another PC's, so nothing in it is trusted: a link is not followed, and a file
# whose seal does not hold is refused rather than shipped.

MOST_BYTES = 64 * 2**20


class BadDocument(PlantError):
    """A document of a run's folder is not what the run wrote."""

    def __init__(self, path: Path, why: str) -> None:
        act = "put the run's own file back, or move this one elsewhere, then ship again"
        super().__init__(f"run {path.parent.name}: its {path.name} {why}; {act}")


def documents_of(folder: Path, row: RunRow) -> list[Document]:
    """Return the calibration file of a run that ended with one; raises `BadDocument`.

    A run whose file is not there has none: its journal still holds all that it was computed from.
    """
    path = folder / CALIBRATION
    if not row.calibrates or not (path.is_symlink() or path.exists()):
        return []
    content = _content(path)
    try:
        problems = seal_problems(msgspec.json.decode(content))
        text = content.decode()
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, LookupError, TypeError):
        problems = ["is no calibration file"]
    if problems:
        raise BadDocument(path, problems[0])
    return [Document(path.name, hashlib.sha256(content).hexdigest(), text)]


def _content(path: Path) -> bytes:
    try:
        found = path.lstat()
        if not stat.S_ISREG(found.st_mode):
            raise BadDocument(path, "is a link or no file")
        if found.st_size > MOST_BYTES:
            raise BadDocument(path, f"has {found.st_size} bytes, expected at most {MOST_BYTES}")
        return path.read_bytes()
    except OSError as error:
        raise BadDocument(path, f"cannot be read: {error.strerror}") from error


MEND = "take its folder from a backup, or out of the runs folder"
_BROKEN = (  # what a journal that is none of a run may raise
    msgspec.ValidationError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError
)  # fmt: skip


class Behind(NamedTuple):
    """The last record of a run's journal here, and that of the newest one that the plant has."""

    here: int
    plant: int


@dataclass
class Shipped:
    """The outcome for the runs of a folder. ``refused`` are reasons, one line each, by the run.

    ``behind`` are runs of which the plant has later records, as of a folder that a backup restored.
    """

    runs: int = 0
    points: int = 0
    before: int = 0  # were there already
    waiting: list[str] = field(default_factory=list)  # live, or without an end of their own
    refused: dict[str, str] = field(default_factory=dict)
    behind: dict[str, Behind] = field(default_factory=dict)


def ship(runs: Path, database: Database, tell: Callable[[str], None] = lambda _: None) -> Shipped:
    """Ship all runs of a folder that are over, in their order.

    A run that cannot be shipped stops no other. Raises `PlantAway`, `PlantError`,
    `RightMissing`, and `StorageError` for a folder that cannot be read.
    """
    if not runs.exists():  # else a timer with a mistyped folder ships nothing, and says 0
        raise PlantError(f"runs folder {clean(str(runs))} is not there: name the folder of runs")
    if (runs / JOURNAL).is_file():
        raise PlantError(
            f"runs folder {clean(str(runs))} is that of one run: name the folder that it lies in"
        )
    database.check()
    done = Shipped()
    seen = _Seen(runs)
    rows = in_order(read_index(runs))
    here = seen.known(rows)
    for row in _missing(rows, database, here, done):
        try:
            records = read_records(runs / row.name)
            here[row.name] = key_of(row.name, records)
            record = record_of(row.name, records, documents_of(runs / row.name, row))
            ended = next((n for n, each in enumerate(records) if each.kind == "end"), 0)
            with database.transaction() as connection:
                new = write(connection, record, heads(records), ended)
        except NotOver:
            done.waiting.append(row.name)
            continue
        except (PlantAway, RightMissing):  # of every run
            raise
        except HilcellError as error:
            mend = f"; {MEND}" if isinstance(error, StorageError) else ""
            done.refused[row.name] = _of_run(row.name, f"{error}{mend}")
            continue
        except _BROKEN as error:
            wrong = f"its journal is none of a run: {error}; {MEND}"
            done.refused[row.name] = f"run {row.name}: {wrong}"
            continue
        seen.note(row, here[row.name])
        done.before += not new
        done.runs += new
        done.points += len(record.rows[POINT]) if new else 0
        if new:
            tell(row.name)
    done.refused |= _without_journal(runs)
    here |= _waiting(runs, [row for row in rows if row.name in done.waiting and not row.live])
    done.behind = _behind(database, here)
    return done


def _without_journal(runs: Path) -> dict[str, str]:
    """Return the folders that have a run's calibration and no journal, each with what is wrong."""
    folders = sorted(path.parent for path in runs.glob(f"*/{CALIBRATION}"))
    wrong = f"{CALIBRATION} is there, {JOURNAL} is not; {MEND}"
    return {each.name: f"run {each.name}: {wrong}" for each in folders if not is_run(each)}


def _waiting(runs: Path, rows: Sequence[RunRow]) -> dict[str, Key]:
    """Return how far the journals of runs are that are not over."""
    found: dict[str, Key] = {}
    for row in rows:
        with suppress(HilcellError, *_BROKEN):
            found[row.name] = key_of(row.name, read_records(runs / row.name))
    return found


def _behind(database: Database, here: dict[str, Key]) -> dict[str, Behind]:
    """Return the runs of which the plant has later records than this folder."""
    with database.transaction() as connection:
        newest = dict(sorted(there(connection, here.values())))  # the last revision stays
    return {
        name: Behind(revision, newest[run_key])
        for name, (run_key, revision) in here.items()
        if newest.get(run_key, 0) > revision
    }


def _of_run(run: str, reason: str) -> str:
    """Return a reason in one line that names the run, as an error of the database does not."""
    line = "; ".join(each.strip() for each in reason.splitlines())
    return line if run in line else f"run {run}: {line}"


def _missing(
    rows: Sequence[RunRow], database: Database, known: dict[str, Key], done: Shipped
) -> Iterator[RunRow]:
    """Yield the runs that are over and that the database is not known to have."""
    with database.transaction() as connection:
        kept = there(connection, known.values())
    for row in rows:
        if row.state == NEVER_BEGAN:
            continue  # nothing was recorded
        if not row.readable:
            done.refused[row.name] = _of_run(row.name, f"{row.reason}; {MEND}")
        elif row.live or row.gone or row.state not in OVER:
            done.waiting.append(row.name)
        elif row.name in known and known[row.name] in kept:
            done.before += 1
        else:
            yield row


class _Seen:
    """Which revision of a run a journal held when it was shipped, for as long as it is unchanged.

    A file that cannot be used knows none.
    """

    def __init__(self, runs: Path) -> None:
        self._runs = runs

    def known(self, rows: Sequence[RunRow]) -> dict[str, Key]:
        """Return the revisions of those runs that are as they were when they were noted."""
        by_name = {row.name: row for row in rows}
        known: dict[str, Key] = {}
        with suppress(sqlite3.Error), closing(self._open()) as base:
            for name, stamp, run_key, revision in base.execute("SELECT * FROM seen"):
                with suppress(OSError):
                    if name in by_name and stamp == self._stamp(by_name[name]):
                        known[name] = UUID(run_key), revision
        return known

    def note(self, row: RunRow, key: Key) -> None:
        """Note the revision of a run that the database has."""
        with suppress(sqlite3.Error, OSError), closing(self._open()) as base:
            values = (row.name, self._stamp(row), str(key[0]), key[1])
            base.execute("INSERT OR REPLACE INTO seen VALUES (?, ?, ?, ?)", values)

    def _stamp(self, row: RunRow) -> str:
        """Return what changes with a journal: its file, and the row that the index has of it."""
        file = (self._runs / row.name / JOURNAL).stat()
        stamp = f"{file.st_mtime_ns} {file.st_size} ".encode() + msgspec.json.encode(row)
        return hashlib.sha256(stamp).hexdigest()

    def _open(self) -> sqlite3.Connection:
        with ExitStack() as undo:
            base = sqlite3.connect(own_file(self._runs / SEEN), isolation_level=None)
            undo.callback(base.close)
            base.execute(
                "CREATE TABLE IF NOT EXISTS seen "
                "(run TEXT PRIMARY KEY, row TEXT, run_key TEXT, revision INTEGER) STRICT"
            )
            base.execute("PRAGMA synchronous=OFF")  # it is rebuilt from the journals
            undo.pop_all()
        return base
