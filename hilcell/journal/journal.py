"""The journal: one SQLite file a run, append-only, hash-chained, one commit a record.

A record that `Journal.append` has returned is durable: it survives kill -9 and power loss (WAL with
synchronous=FULL). Nothing may be shown, counted or acted upon before that return.
"""

from __future__ import annotations

import errno
import hashlib
import math
import sqlite3
import stat
import threading
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from hilcell.errors import HilcellError

SCHEMA = 1
ABSENT = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)  # other errors hide a file
NULL = b"null"  # JSON of None, and of every number that is not finite
Kind = Literal["plan", "state", "intent", "point", "frame", "verdict", "event", "end"]

_TABLES = """
CREATE TABLE meta (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE record (
    seq  INTEGER PRIMARY KEY,
    t    TEXT NOT NULL,
    kind TEXT NOT NULL,
    key  TEXT NOT NULL,
    body TEXT NOT NULL,
    hash BLOB NOT NULL
) STRICT;
CREATE TRIGGER record_is_never_changed BEFORE UPDATE ON record
BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
CREATE TRIGGER record_is_never_deleted BEFORE DELETE ON record
BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
"""


class StorageError(HilcellError):
    """The journal cannot be written or read."""

    code = "HC-J04"


class NotFinite(HilcellError):
    """A record holds a NaN or an infinity, which JSON cannot state; nothing was written."""

    code = "HC-J12"


class Record(msgspec.Struct, frozen=True):
    """One acknowledged record. ``key`` names its subject; a later one of the key supersedes."""

    seq: int
    t: str
    kind: Kind
    key: str
    body: dict[str, Any]

    def event(self, run: str) -> dict[str, Any]:
        """Return the record as the event that commands print."""
        head = {"run": run, "seq": self.seq, "t": self.t, "kind": self.kind}
        return head | ({"key": self.key} if self.key else {}) | self.body


def chain(before: bytes, record: Record) -> bytes:
    """Return the hash that ties ``record`` to the hash of the record before it."""
    canonical = msgspec.json.encode(
        [record.seq, record.t, record.kind, record.key, record.body], order="sorted"
    )
    return hashlib.sha256(before + canonical).digest()


class Journal:
    """A run's journal, open for writing. Safe to use from several threads."""

    def __init__(self, path: Path, run: str, *, create: bool) -> None:
        self.path, self.run = path, run
        self._lock = threading.Lock()
        self._listeners: list[Callable[[Record], None]] = []
        if not create and not path.is_file():
            raise StorageError(f"journal {path}: no such file; `hilcell runs` lists the runs")
        try:
            self._base = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute("PRAGMA synchronous=FULL")
            if create:
                self._base.executescript(f"BEGIN;{_TABLES}")  # all of it, or a file without tables
                meta = (("schema", str(SCHEMA)), ("run", run))
                self._base.executemany("INSERT INTO meta VALUES (?, ?)", meta)
                self._base.execute("COMMIT")
        except sqlite3.Error as error:
            raise StorageError(f"journal {path}: cannot be opened: {error}") from error
        self._place = _place(path)
        self._seq, self._hash = 0, b""
        for record, stored in _stored(self._base, path):
            self._seq, self._hash = record.seq, stored
            self._take(record)

    def listen(self, listener: Callable[[Record], None]) -> None:
        """Call ``listener`` with every record appended from now on, once it is durable."""
        self._listeners.append(listener)

    def append(self, kind: Kind, key: str, body: dict[str, Any]) -> Record:
        """Write one record and return it when it is durable.

        Raises `StorageError`, and `NotFinite` before anything is written.
        """
        plain = msgspec.to_builtins(body, enc_hook=_plain)
        with self._lock:
            moment = datetime.now(UTC).isoformat(timespec="milliseconds")
            text = msgspec.json.encode(plain)
            if NULL in text and (bad := _not_finite(plain)):
                raise NotFinite(
                    f"journal {self.path}: record {self._seq + 1} ({kind} {key or '-'}): {bad}, "
                    f"wanted a finite number; nothing was written; check the device that it came "
                    f"from, then `hilcell resume {self.run}`"
                )
            record = Record(self._seq + 1, moment, kind, key, plain)
            digest = chain(self._hash, record)
            row = (record.seq, record.t, kind, key, text.decode(), digest)
            self._check_place()
            try:
                self._base.execute("INSERT INTO record VALUES (?, ?, ?, ?, ?, ?)", row)
            except sqlite3.Error as error:
                raise StorageError(
                    f"journal {self.path}: record {record.seq} could not be stored: {error}; "
                    f"make room or mend the disk, then `hilcell resume {self.run}`",
                    code="HC-J01",
                ) from error
            self._seq, self._hash = record.seq, digest
            self._take(record)
        return record

    def _take(self, record: Record) -> None:
        """Hand a durable record on: one that the file held before, or one just appended."""
        for listener in self._listeners:
            listener(record)

    def _check_place(self) -> None:
        """Refuse to write into a file that nobody will find again."""
        if _place(self.path) != self._place:
            raise StorageError(
                f"journal {self.path}: the file was taken away or replaced while run {self.run} "
                f"wrote it; put it back, then `hilcell resume {self.run}`",
                code="HC-J10",
            )

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._base.close()


def _place(path: Path) -> tuple[int, int] | None:
    """Return which file is at a path, or None where none is."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _plain(value: Any) -> Any:
    """Turn numpy arrays and scalars into plain numbers."""
    return value.tolist()


def _not_finite(value: Any, name: str = "") -> str:
    """Return the first number below ``value`` that is not finite, by its place; "" for none."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"{name} is {value}"
    parts: Iterable[tuple[str, Any]] = ()
    if isinstance(value, dict):
        parts = ((f"{name}.{key}" if name else str(key), part) for key, part in value.items())
    elif isinstance(value, list | tuple):
        parts = ((f"{name}[{number}]", part) for number, part in enumerate(value))
    return next((bad for where, part in parts if (bad := _not_finite(part, where))), "")


def is_there(path: Path) -> bool:
    """Whether a file is at a path; raises `OSError` where that cannot be found out."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        if error.errno in ABSENT:
            return False
        raise


def read_journal(path: Path, after: int = 0) -> list[Record]:
    """Return the records after ``after``; raises `StorageError` where the file is not sound.

    Reading from the first record on verifies the hash chain.
    """
    try:
        if not is_there(path):
            raise StorageError(f"journal {path}: no such file; `hilcell runs` lists the runs")
        base = _reader(path)
        try:
            return [record for record, _ in _stored(base, path, after)]
        finally:
            base.close()
    except sqlite3.Error as error:
        raise StorageError(f"journal {path}: cannot be read: {error}") from error
    except OSError as error:
        raise StorageError(f"journal {path}: cannot be read: {error.strerror}") from error


def _reader(path: Path) -> sqlite3.Connection:
    """Open a journal to read it, also one whose folder may not be written."""
    where = f"{path.resolve().as_uri()}?mode=ro"
    base = sqlite3.connect(where, uri=True, isolation_level=None)
    try:
        base.execute("PRAGMA schema_version")
    except sqlite3.DatabaseError as error:
        rest = path.with_name(f"{path.name}-wal")  # records that are not in the file yet
        unwritable = error.sqlite_errorcode & 0xFF in (
            sqlite3.SQLITE_READONLY,
            sqlite3.SQLITE_CANTOPEN,
        )
        if unwritable and not (rest.exists() and rest.stat().st_size):
            base.close()
            return sqlite3.connect(f"{where}&immutable=1", uri=True, isolation_level=None)
    return base


def _stored(base: sqlite3.Connection, path: Path, after: int = 0) -> Iterator[tuple[Record, bytes]]:
    """Yield records with their hashes, verified against the chain from ``after`` on."""
    try:
        if not base.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return  # killed while it was made: nothing was recorded
        found = dict(base.execute("SELECT name, value FROM meta")).get("schema")
        if found != str(SCHEMA):
            raise StorageError(
                f"journal {path}: schema {found!r}, this hilcell reads {SCHEMA}; "
                "open it with the version that wrote it",
                code="HC-J03",
            )
        first = base.execute("SELECT hash FROM record WHERE seq = ?", (after,)).fetchone()
        before = first[0] if first else b""
        rows = base.execute("SELECT * FROM record WHERE seq > ? ORDER BY seq", (after,))
        for wanted, (seq, t, kind, key, body, stored) in enumerate(rows, start=after + 1):
            record = Record(seq, t, kind, key, msgspec.json.decode(body))
            before = chain(before, record)
            if seq != wanted or before != stored:
                raise StorageError(
                    f"journal {path}: record {seq} is not the one that was written; "
                    "the file was changed or damaged, and its results cannot be trusted",
                    code="HC-J02",
                )
            yield record, stored
    except (sqlite3.DatabaseError, msgspec.DecodeError) as error:
        raise StorageError(
            f"journal {path}: damaged or not a journal: {error}",
            code="HC-J02",
        ) from error
