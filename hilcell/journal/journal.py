"""The journal: one SQLite file a run, append-only, hash-chained, one commit a record.

A record that `Journal.append` has returned is durable: it survives kill -9 and power loss (WAL with
synchronous=FULL). Nothing may be shown, counted or acted upon before that return. Other processes
can still damage the files: they are checked before each record, and records are read back every
`READ_BACK` records and before the end.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
import sqlite3
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

import msgspec

from hilcell.decoding import Json, typed
from hilcell.errors import EXIT_REFUSED, EXIT_STORAGE, HilcellError
from hilcell.journal.runs_folder import command_on
from hilcell.model.records import Fact, Kind, fact_of

# SQLite reports no error while it writes into a deleted, replaced or truncated file.


class OpenFile:
    """A file that only grows while it is open."""

    def __init__(self, path: Path) -> None:
        """The file may not exist yet."""
        self.path = path
        self._name = os.fspath(path)
        self._found = self._look()

    def note(self) -> None:
        """Note the file's size, unless it was damaged."""
        if not self.lost():
            self._found = self._look()

    @property
    def size(self) -> int:
        """Return the last noted size in bytes; 0 without a file."""
        return 0 if self._found is None else self._found[2]

    def lost(self) -> str:
        """Return the damage to the file since it was last noted; "" for none."""
        if self._found is None:
            return ""
        now = self._look()
        if now is None or now[:2] != self._found[:2]:
            return "taken away or replaced"
        return "cut short" if now[2] < self._found[2] else ""

    def _look(self) -> tuple[int, int, int] | None:
        """Return device, inode and size in bytes of the file at the path, or None."""
        try:
            found = os.stat(self._name)  # noqa: PTH116 - twice a record: a Path's takes longer
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_size


Body: TypeAlias = Json | msgspec.Struct  # of a record to be written

FORM = 2
READ_BACK = 500  # records between two checks of the written file
SYNCHRONOUS = "FULL"  # an append returns once its record is on the disk
# Other errors hide a file.
NOT_FOUND_ERRNOS = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)
MAX_JOURNAL_BYTES = 2**28  # bytes of a journal; one of a thousand points has some 2**23
MAX_RECORD_BYTES = 2**25  # bytes
MAX_STEPS = 2 * 10**8  # of SQLite's virtual machine, some 15 a record: bounds a hostile file
RESTORE_ADVICE = "fetch the run's folder from the backup, or start a new run with `hilcell run`"
# Raised while reading a file that is no journal.
CONTENT_ERRORS = (ValueError, TypeError, msgspec.MsgspecError, RecursionError, MemoryError)

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

_SCHEMA = "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL"
ACCESS_ERRORS = (  # errors that are not of the file's content
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_NOMEM, sqlite3.SQLITE_PERM, sqlite3.SQLITE_READONLY,
)  # fmt: skip


class StorageError(HilcellError):
    """The journal cannot be written or read; ``record`` is the number of the first bad record."""

    code = "HC-J04"
    exit_code = EXIT_STORAGE

    def __init__(self, text: str = "", *, code: str = "", record: int | None = None) -> None:
        super().__init__(text, code=code)
        self.record = record

    def facts(self) -> Json:
        """Return the error as JSON."""
        fields = {} if self.record is None else {"fields": {"record": self.record}}
        return super().facts() | fields


class Damaged(StorageError):
    """Records that differ from those written; ``damage`` states where and how."""

    code = "HC-J02"

    def __init__(self, path: Path, damage: str, record: int) -> None:
        super().__init__(
            f"journal {path}: {damage}; the file was changed or damaged, and its results cannot be "
            f"trusted; {RESTORE_ADVICE}",
            record=record,
        )
        self.damage = damage


class NeverBegan(StorageError):
    """The journal has no record: the run died before its first; nothing is lost."""

    code = "HC-J06"
    exit_code = EXIT_REFUSED


class NotFinite(HilcellError):
    """A record has a NaN or an infinity, which JSON cannot represent; nothing was written."""

    code = "HC-J12"


class Record(msgspec.Struct, frozen=True, dict=True):
    """One acknowledged record. ``key`` names its subject; a later one of the key supersedes."""

    seq: int
    t: str
    kind: Kind
    key: str
    body: Json

    @cached_property
    def fact(self) -> Fact:
        """Return the body as its type; raises `msgspec.ValidationError`."""
        return fact_of(self.kind, self.key, self.body)

    def event(self, run: str) -> Json:
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

    def __init__(self, path: Path, run: str, *, create: bool, again: str = "") -> None:
        """``again`` is the command to repeat once a failed disk is repaired."""
        self.path, self.run = path, run
        self._again = again or command_on(path.parent, "resume")
        self._lock = threading.Lock()
        self._listeners: list[Callable[[Record], None]] = []
        if not create:
            if not path.is_file():
                raise StorageError(f"journal {path}: no such file; `hilcell runs` lists the runs")
            _check_kinds(path)
        try:
            self._base = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
            self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
            self._base.execute("PRAGMA journal_mode=WAL")
            self._base.execute(f"PRAGMA synchronous={SYNCHRONOUS}")
            self._base.execute("PRAGMA cache_size=-256")  # KiB: the last pages are enough
            if create:
                self._base.executescript(f"BEGIN;{_TABLES}")  # atomic
                meta = (("form", str(FORM)), ("run", run))
                self._base.executemany("INSERT INTO meta VALUES (?, ?)", meta)
                self._base.execute("COMMIT")
        except sqlite3.Error as error:
            why = _refusal(path, os.R_OK | os.W_OK) or str(error)
            raise StorageError(f"journal {path}: cannot be opened: {why}") from error
        self._files = OpenFile(path), OpenFile(_wal(path))
        self._unsound: StorageError | None = None
        self._seq, self._hash = 0, b""
        try:
            for record, stored in _stored(self._base, path):
                self._seq, self._hash = record.seq, stored
                self._take(record)
        except BaseException as error:  # nothing leaves the file open
            self._base.close()
            if isinstance(error, sqlite3.Error):
                raise StorageError(f"journal {path}: cannot be read: {error}") from error
            raise
        self._read_back_to = self._seq

    def listen(self, listener: Callable[[Record], None]) -> None:
        """Call ``listener`` with every appended record once it is durable."""
        self._listeners.append(listener)

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        """Write one record and return it when it is durable.

        Raises `StorageError`, and `NotFinite` before anything is written.
        """
        with self._lock:
            moment = datetime.now(UTC).isoformat(timespec="milliseconds")
            what = f"journal {self.path}: record {self._seq + 1} ({kind} {key or '-'})"
            plain, text = plain_body(body, what, f", then `{self._again}`")
            record = Record(self._seq + 1, moment, kind, key, plain)
            digest = chain(self._hash, record)
            row = (record.seq, record.t, kind, key, text.decode(), digest)
            self._check_files()
            self._check_size()
            try:
                self._base.execute("INSERT INTO record VALUES (?, ?, ?, ?, ?, ?)", row)
            except sqlite3.Error as error:
                raise self._no_room(f"record {record.seq} could not be stored", error) from error
            for file in self._files:
                file.note()
            self._seq, self._hash = record.seq, digest
            if self._seq >= self._read_back_to + READ_BACK:
                self._read_back(self._read_back_to)
            self._take(record)
        return record

    def read_back(self) -> None:
        """Read the whole file as another process would; raises `StorageError` for missing records,
        also at all later appends.
        """
        with self._lock:
            self._check_files()
            self._read_back(0)

    def _read_back(self, after: int) -> None:
        """Read the records after one, once they are in the main file."""
        seq, last = after, b""
        try:
            self._base.execute("PRAGMA wal_checkpoint(PASSIVE)")
            with closing(_reader(self.path)) as base:  # a new connection has no cache
                for record, stored in _stored(base, self.path, after):
                    seq, last = record.seq, stored
        except sqlite3.Error as error:
            if getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL:
                raise self._no_room("it could not be read back", error) from error
            self._refuse(f"it cannot be read back: {error}", seq + 1)
        except Damaged as error:
            self._refuse(error.damage, seq + 1)
        except StorageError as error:
            self._refuse(str(error).removeprefix(f"journal {self.path}: "), seq + 1)
        if (seq, last) != (self._seq, self._hash) and self._seq > after:
            self._refuse(f"it ends with record {seq}", seq + 1)
        self._read_back_to = self._seq

    def _no_room(self, found: str, error: sqlite3.Error) -> StorageError:
        from hilcell.journal.disk_space import shortage  # a list of runs does without

        return StorageError(
            f"journal {self.path}: {found}: {error}{shortage(self.path.parent)}; "
            f"make room or repair the disk, then `{self._again}`",
            code="HC-J01",
        )

    def _refuse(self, found: str, record: int) -> None:
        self._unsound = StorageError(
            f"journal {self.path}: it lacks some of the {self._seq} records that were written: "
            f"{found}; the file was damaged while run {self.run} wrote it; "
            "check the disk, then fetch the run's folder from the backup or start a new run",
            code="HC-J13",
            record=record,
        )
        raise self._unsound

    def _take(self, record: Record) -> None:
        """Pass a durable record on, read or just appended."""
        for listener in self._listeners:
            listener(record)

    def _check_files(self) -> None:
        if self._unsound is not None:
            raise self._unsound
        for file in self._files:
            if lost := file.lost():
                raise StorageError(
                    f"journal {self.path}: {file.path.name} was {lost} while run {self.run} wrote "
                    f"it; put it back, then `{self._again}` measures what is missing",
                    code="HC-J10",
                    record=self._seq + 1,
                )

    def _check_size(self) -> None:
        if (size := sum(file.size for file in self._files)) > MAX_JOURNAL_BYTES:
            raise StorageError(
                f"journal {self.path}: it has {size} bytes, expected at most {MAX_JOURNAL_BYTES}; "
                "start a new run",
                code="HC-J01",
            )

    def close(self) -> None:
        with self._lock:
            self._base.close()


def plain_body(body: Body, what: str, then: str = "") -> tuple[Json, bytes]:
    """Return a record's body in plain types, and its JSON; raises `NotFinite` that names it."""
    plain: Json = msgspec.to_builtins(body, enc_hook=lambda value: value.tolist())
    text = msgspec.json.encode(plain)
    if b"null" in text and (bad := _not_finite(plain)):
        raise NotFinite(
            f"{what}: {bad.removeprefix('.')}, expected a finite number; nothing was written; "
            f"check the device that it came from{then}"
        )
    return plain, text


def _not_finite(value: object) -> str:
    """Return the path of the first number in ``value`` that is not finite; "" for none."""
    if isinstance(value, float):
        return "" if math.isfinite(value) else f" is {value}"
    if isinstance(value, dict):
        parts = ((f".{key}", bad) for key, part in value.items() if (bad := _not_finite(part)))
    elif isinstance(value, (list, tuple)):
        parts = ((f"[{n}]", bad) for n, part in enumerate(value) if (bad := _not_finite(part)))
    else:
        return ""
    return next((where + bad for where, bad in parts), "")


def is_regular_file(path: Path) -> bool:
    """Whether a regular file is at a path; raises `OSError` where that is unknown."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError as error:
        if error.errno in NOT_FOUND_ERRNOS:
            return False
        raise


def _refusal(path: Path, mode: int) -> str:
    """Return the missing permission, which SQLite does not report."""
    if not os.access(path, mode):
        return "no permission to read it" if mode == os.R_OK else "no permission to write it"
    if mode != os.R_OK and not os.access(path.parent, mode):
        return "no permission to write into its folder"
    return ""


def read_journal(path: Path, after: int = 0) -> list[Record]:
    """Return the records after ``after``; raises `StorageError` for a damaged file.

    Reading from the first record verifies the whole hash chain.
    """
    try:
        if not is_regular_file(path):
            raise StorageError(f"journal {path}: no such file; `hilcell runs` lists the runs")
        _check_kinds(path)
        with closing(_reader(path)) as base:
            return [record for record, _ in _stored(base, path, after)]
    except sqlite3.Error as error:
        why = _refusal(path, os.R_OK) or str(error)
        raise StorageError(f"journal {path}: cannot be read: {why}") from error
    except OSError as error:
        raise StorageError(f"journal {path}: cannot be read: {error.strerror}") from error


def _check_kinds(path: Path) -> None:
    """Raise `StorageError` for files that are not regular or too large; `OSError`.

    Opening a pipe may block, and a huge file would exhaust the memory.
    """
    size = 0
    for end in ("", "-wal", "-shm", "-journal"):
        file = path.with_name(f"{path.name}{end}")
        try:
            found = file.stat()
        except OSError as error:
            if error.errno in NOT_FOUND_ERRNOS:
                continue
            raise
        if not stat.S_ISREG(found.st_mode):
            raise StorageError(
                f"journal {path}: {file.name} is no regular file; {RESTORE_ADVICE}", code="HC-J02"
            )
        size += found.st_size
    if size > MAX_JOURNAL_BYTES:
        found_bytes = f"it has {size} bytes, expected at most {MAX_JOURNAL_BYTES}"
        raise StorageError(f"journal {path}: {found_bytes}; {RESTORE_ADVICE}", code="HC-J02")


def _bound(base: sqlite3.Connection) -> None:
    """Limit the size of records and the duration of queries."""
    steps = 10**6  # between two calls of the handler
    left = iter(range(MAX_STEPS // steps))
    base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
    base.set_progress_handler(lambda: next(left, None) is None, steps)


@cache
def _own_schema() -> frozenset[tuple[str, str, str]]:
    with closing(sqlite3.connect(":memory:")) as base:
        base.executescript(_TABLES)
        return frozenset(base.execute(_SCHEMA))


def _check_schema(base: sqlite3.Connection, path: Path) -> bool:
    """Whether the file has the tables of a journal; a new one has none.

    Raises `StorageError` for another form, and `ValueError` for other objects: a view or a computed
    column may be endless.
    """
    found, own = {*base.execute(_SCHEMA)}, _own_schema()
    if any(name == "meta" for _, name, _ in found & own):
        row = base.execute("SELECT value FROM meta WHERE name = 'form'").fetchone()
        form = str(row[0])[:20] if row else "none"
        if form != str(FORM):
            raise StorageError(
                f"journal {path}: form {form}, expected {FORM}; "
                "open it with the version that wrote it",
                code="HC-J03",
            )
    elif found:
        raise ValueError("it has no table of a journal")
    if other := sorted(name for _, name, _ in found - own):
        raise ValueError(f"no part of a journal: {', '.join(other)[:80]!r}")
    return bool(found)


def _wal(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def _reader(path: Path) -> sqlite3.Connection:
    """Open a journal for reading, also in a read-only folder."""
    where = f"{path.resolve().as_uri()}?mode=ro"
    base = sqlite3.connect(where, uri=True, isolation_level=None)
    _bound(base)
    try:
        base.execute("PRAGMA schema_version")
    except sqlite3.DatabaseError as error:
        rest = _wal(path)
        code = error.sqlite_errorcode & 0xFF
        unwritable = code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN)
        if unwritable and not (rest.exists() and rest.stat().st_size):
            base.close()
            base = sqlite3.connect(f"{where}&immutable=1", uri=True, isolation_level=None)
            _bound(base)
    return base


def _stored(base: sqlite3.Connection, path: Path, after: int = 0) -> Iterator[tuple[Record, bytes]]:
    """Yield records with their hashes, verified against the chain from ``after`` on.

    Raises `StorageError`, and `sqlite3.Error` where the file cannot be read.
    """
    expected = after + 1
    try:
        if not _check_schema(base, path):
            _check_pages(base, path)
            return  # killed before the first record
        first = base.execute("SELECT hash FROM record WHERE seq = ?", (after,)).fetchone()
        before = first[0] if first else b""
        # As bytes: decoding detects damaged text.
        texts = ", ".join(f"CAST({each} AS BLOB)" for each in ("t", "kind", "key", "body"))
        rows = f"SELECT seq, {texts}, hash FROM record WHERE seq > ? ORDER BY seq"  # noqa: S608 - ours
        for row in base.execute(rows, (after,)):
            record, stored = _record(row)
            before = chain(before, record)
            if record.seq != expected or before != stored:
                raise ValueError("it differs from the one that was written")
            yield record, stored
            expected += 1
        if not after:
            _check_pages(base, path)  # damaged pages may hide the last records
    except (*CONTENT_ERRORS, sqlite3.Error) as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        if code in ACCESS_ERRORS:
            raise
        other = "not a journal, or " if code == sqlite3.SQLITE_NOTADB else ""
        damage = f"{other}damaged at record {expected}: {_cause(error)}"
        raise Damaged(path, damage, expected) from error


def _cause(error: Exception) -> str:
    if isinstance(error, UnicodeError):
        return "its text is not UTF-8"
    if isinstance(error, sqlite3.Error):
        return "SQLite cannot read its pages"
    return " ".join(str(error).split())


def _record(row: tuple[Any, ...]) -> tuple[Record, bytes]:
    """Return a row's record and hash; raises `ValueError`."""
    seq, t, kind, key, body, stored = row
    texts = {"t": t, "kind": kind, "key": key}
    found = {"seq": seq, "body": msgspec.json.decode(body)}
    found |= {name: bytes.decode(text) for name, text in texts.items()}
    return typed(found, Record), stored


def _check_pages(base: sqlite3.Connection, path: Path) -> None:
    """Raise `ValueError` for damaged pages: they may hide records."""
    (found,) = base.execute("PRAGMA integrity_check(1)").fetchone()
    if found != "ok":
        raise ValueError("the pages of the file are damaged")
    if 0 < path.stat().st_size < 512:  # bytes of the smallest page
        raise ValueError("the file is cut short")  # SQLite treats it as new
