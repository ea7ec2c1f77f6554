"""An index over all runs, derived from their journals, and the order in which they ran.

It is one file in the folder of runs that may be deleted at any time. The journal takes precedence:
a row counts only while the journal is the same file; a run without an end, or with a live engine,
is read each time. Rows are sealed, since they decide which calibration is current: an index with a
row that does not match its seal is rebuilt.
"""

from __future__ import annotations

import hashlib
import heapq
import os
import secrets
import sqlite3
import stat
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import TypeVar

import msgspec

from hilcell.decoding import decoded, typed
from hilcell.errors import HilcellError, one_line
from hilcell.journal.calibration_facts import CalibrationFacts, facts_of, outcome
from hilcell.journal.journal import (
    ACCESS_ERRORS,
    NOT_FOUND_ERRNOS,
    RESTORE_ADVICE,
    NeverBegan,
    Record,
    StorageError,
)
from hilcell.journal.runs import JOURNAL, is_run, live_engine, read_records, run_folders, unusable
from hilcell.model.events import (
    ArmCarried,
    CalibrationRevoked,
    CalibrationUsed,
    Connected,
    SessionOrdered,
)
from hilcell.model.plan import FolderOrder, PlanRecord
from hilcell.model.records import OVER, Ended, RunState, StateChanged
from hilcell.model.results import Place
from hilcell.model.verdicts import Verdict

NAME = "index.sqlite"
SCHEMA = 13  # increase it whenever `RunRow` or the meaning of its fields changes
BUSY_S = 2.0  # wait for another writer; then the journals are read instead
SETTLED_S = 3.0  # file times have a resolution of up to 2 s
UNREADABLE, NEVER_BEGAN = "unreadable", "never began"  # states that no journal holds
T = TypeVar("T")


class RunRow(msgspec.Struct, frozen=True, kw_only=True):
    """One run, from its journal.

    Times are UTC, ISO 8601 to the second; ``session`` (ms) is when it was last begun or resumed,
    ``ended`` and ``exit`` are of the last end, which a resumed run loses again. A journal that is
    unreadable, or of a run that never began, has only name, state, reason, and as ``begun`` when
    its file was last written. Figures (mm) are 3D errors of the validation at the grid's station,
    or of a fit's nominal and chosen model; None where the procedure has none. ``origin`` is the
    digest of the journal's first record, which only a copy of a run's folder has as well.
    """

    name: str
    begun: str
    state: str
    session: str = ""
    ended: str = ""
    reason: str = ""
    procedure: str = ""
    cell: str = ""
    serial: str = ""
    operator: str = ""
    job: str = ""
    seed: int | None = None
    simulated: bool = False
    points: int = 0
    exit: int | None = None
    live: bool = False
    before_mean_mm: float | None = None
    chosen_mean_mm: float | None = None
    chosen_max_mm: float | None = None
    machine_seed: int | None = None
    moved: bool = False
    replayed: bool = False
    facts: CalibrationFacts = CalibrationFacts()
    order: FolderOrder = FolderOrder()
    origin: str = ""

    @property
    def calibrates(self) -> bool:
        """Whether the run ended with a calibration; a replay only repeats that of another run."""
        return self.finished and self.facts.kind != "" and not self.replayed

    @property
    def finished(self) -> bool:
        return self.state == "finished" and self.exit is not None

    @property
    def verdict(self) -> str:
        """Return the run's outcome as text; "" where it has not ended."""
        code = None if self.live or self.gone else self.exit
        return outcome(self.facts, self.state, code, self.points)

    @property
    def readable(self) -> bool:
        return self.state not in (UNREADABLE, NEVER_BEGAN)

    @property
    def gone(self) -> bool:
        """Whether the engine was lost: the journal has no end."""
        # A refused resume writes an end but keeps the state of the crash.
        ended = self.exit is not None and self.state in ("idle", *OVER)
        return self.readable and not (self.live or ended or self.unbegun)

    @property
    def unbegun(self) -> bool:
        """Whether there is only a plan: the engine is starting, or died while starting."""
        return self.state == "idle" and not self.live and self.exit is None

    @property
    def condition(self) -> str:
        if self.unbegun:
            return "not begun"
        return f"{self.state}, engine gone" if self.gone else self.state

    @property
    def by_clock(self) -> tuple[str, str]:
        """Return what orders runs of different folders: the clock, then the names."""
        return self.session or self.begun, self.name

    @property
    def last_began(self) -> datetime:
        """Return when the last session began."""
        return datetime.fromisoformat(self.by_clock[0]).astimezone(UTC)


def read_index(runs: Path) -> list[RunRow]:
    """Return all runs of a folder, newest first; raises `StorageError`."""
    stamps = _stamps(runs)
    index = _IndexFile(runs)
    rows = index.rows(stamps) if stamps else {}
    missing = (name for name in stamps if name not in rows)
    # In batches: an interrupted first build is not lost.
    while batch := {name: row_of(runs / name) for name in islice(missing, 200)}:
        index.store(batch, stamps)
        rows |= batch
    return in_order(rows.values())[::-1]


def find_run(runs: Path, name: str) -> Path:
    """Return the folder of a run by its name, a unique prefix, or ``last``.

    Raises `HilcellError` where no run or several runs match.
    """
    if name and is_run(Path(name)):
        return Path(name)
    names = [folder.name for folder in run_folders(runs)]
    if name == "last" and names:
        return runs / read_index(runs)[0].name
    meant = [name] if name in names else [each for each in names if name and each.startswith(name)]
    if len(meant) == 1:
        return runs / meant[0]
    if meant:
        raise HilcellError(f"run {name!r} is ambiguous: {', '.join(meant)}", code="HC-J09")
    if Path(name).parts:  # neither "" nor "."
        _check_journal(runs / name)
    if not _is_folder(runs):
        raise HilcellError(
            f"run {name[:80]!r} not found: no folder of runs {runs}; name another folder with "
            "--runs, or start the first run with `hilcell run`",
            code="HC-J09",
        )
    newest = ", ".join(row.name for row in read_index(runs)[2::-1]) or "none"
    raise HilcellError(
        f"run {name[:80]!r} not found in {runs}; newest there: {newest}", code="HC-J09"
    )


def _check_journal(folder: Path) -> None:
    """Raise `StorageError` where a run's folder has lost its journal."""
    journal = folder / JOURNAL
    if _is_folder(journal):
        raise StorageError(f"journal {journal}: it is a folder, expected a file; {RESTORE_ADVICE}")
    if folder.name and _is_folder(folder):
        raise StorageError(
            f"journal {journal}: no such file in the folder of the run; {RESTORE_ADVICE}"
        )


def _is_folder(path: Path) -> bool:
    with suppress(OSError):  # not a valid file name
        return path.is_dir()
    return False


def row_of(folder: Path) -> RunRow:
    try:
        row = row_of_records(folder.name, read_records(folder))
    except Exception as error:  # noqa: BLE001 - whatever a run's folder holds, it stops no other run
        state = NEVER_BEGAN if isinstance(error, NeverBegan) else UNREADABLE
        reason = str(error) if isinstance(error, StorageError) else one_line(error)
        return RunRow(name=folder.name, begun=_written(folder), state=state, reason=reason)
    return msgspec.structs.replace(row, live=live_engine(folder) is not None)


def matches(row: RunRow, words: str) -> bool:
    """Whether a row matches all ``words`` of a search, in any order and case.

    ``field:word`` searches one field, ``-word`` excludes. An incomplete word (``-``, ``state:``)
    excludes nothing.
    """
    whole = "\n".join([text_of(row) for text_of in _FIELDS.values()]).casefold()

    def holds(word: str) -> bool:
        text, where = word.removeprefix("-"), whole
        field, colon, value = text.partition(":")
        if colon and field in _FIELDS:
            text, where = value, _FIELDS[field](row).casefold()
        found = text == where if where.isdecimal() else text in where
        return not text or found != word.startswith("-")

    return all(map(holds, words.casefold().split()))


_FIELDS: dict[str, Callable[[RunRow], str]] = {
    "run": attrgetter("name"),
    "begun": attrgetter("begun"),
    "ended": attrgetter("ended"),
    "procedure": attrgetter("procedure"),
    "cell": attrgetter("cell"),
    "serial": attrgetter("serial"),
    "operator": attrgetter("operator"),
    "job": attrgetter("job"),
    "seed": lambda row: "" if row.seed is None else str(row.seed),
    "kind": lambda row: ("simulated" if row.simulated else "real") if row.readable else "",
    "state": lambda row: f"{row.condition}, live" if row.live else row.condition,
    "exit": lambda row: "" if row.exit is None else str(row.exit),
    "points": lambda row: str(row.points),
    "reason": attrgetter("reason"),
    "verdict": attrgetter("verdict"),
}


# -- the order of runs ----------------------------------------------------------------------------

# It does not depend on a clock. A run that begins or continues journals the run before it and takes
# the next number of the folder. Runs of one cell exclude one another, so their numbers order their
# ends, even with a wrong PC clock. Runs of other folders are merged by the clock.


def in_order(rows: Iterable[RunRow]) -> list[RunRow]:
    """Return runs in the order in which their last sessions began."""
    folders: defaultdict[str, list[RunRow]] = defaultdict(list)
    for row in rows:
        folders[row.order.folder].append(row)
    for of_folder in folders.values():
        of_folder.sort(key=lambda row: (row.order.number, row.by_clock))
    return list(heapq.merge(*folders.values(), key=attrgetter("by_clock")))


def next_order(rows: Iterable[RunRow]) -> FolderOrder:
    """Return the order of a session that begins now; an unreadable run may have a number."""
    rows = list(rows)
    numbered = [row for row in in_order(rows) if row.order.folder]
    if not numbered:
        return FolderOrder(secrets.token_hex(8), 1)
    last = numbered[-1]
    highest = max(row.order.number for row in numbered if row.order.folder == last.order.folder)
    unread = sum(not row.readable for row in rows)
    return FolderOrder(last.order.folder, highest + unread + 1, last.name)


def clock_notes(rows: Iterable[RunRow], now: datetime | None = None) -> Iterator[str]:
    """Yield where the PC's clock ran back between two runs of a folder, and before ``now``."""
    step = timedelta(minutes=1)  # adjustments by network time
    latest: dict[str, RunRow] = {}
    for row in in_order(row for row in rows if row.order.folder):
        before = latest.setdefault(row.order.folder, row)
        began, earlier = row.last_began, before.last_began
        if earlier - began > step:
            yield _ran_back(before, earlier, f"run {row.name} began after it, at", began)
        elif began > earlier:
            latest[row.order.folder] = row
    for row in latest.values():
        if now is not None and row.last_began - now > step:
            yield _ran_back(row, row.last_began, "now it is", now)


def _ran_back(before: RunRow, earlier: datetime, then: str, later: datetime) -> str:
    hours = (earlier - later) / timedelta(hours=1)
    return (
        f"the clock ran back by {hours:.2f} h: run {before.name} began {_utc(earlier)}, {then} "
        f"{_utc(later)}; the order of the runs is right, their times are not: check the PC's clock"
    )


def _utc(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%SZ}"


# -- a row from a journal --------------------------------------------------------------------------


class _Method(msgspec.Struct):
    mean_mm: float
    max_mm: float


class _Fit(msgspec.Struct):
    methods: dict[str, _Method] = {}
    chosen: str = ""


class _Result(msgspec.Struct):
    validation: dict[str, Place] = {}
    campaign: _Fit = msgspec.field(default_factory=_Fit)


def _facts(records: Iterable[Record], kind: type[T]) -> list[tuple[Record, T]]:
    """Return the records of a type; raises `msgspec.ValidationError`."""
    return [(record, record.fact) for record in records if isinstance(record.fact, kind)]


def row_of_records(name: str, records: Iterable[Record]) -> RunRow:
    """Return the row of a run without an engine.

    Raises `StorageError` and `msgspec.ValidationError`. Unlike `Log` it loads no arrays.
    """
    records = list(records)
    facts = [each for each in records if each.kind not in ("intent", "frame", "point")]
    plans = _facts(facts, PlanRecord)
    if not plans:
        raise NeverBegan("the journal holds no plan: the run died before its first record")
    plan, inputs = plans[-1]
    life = [each for each in _facts(facts, StateChanged) if each[1].machine == "run"]
    states: list[RunState] = ["idle", *(typed(change.to, RunState) for _, change in life)]
    began = next((record for record, change in reversed(life) if change.to == "checking"), plan)
    ends = [each for each in _facts(facts, Ended) if each[0].seq > began.seq]
    end, last = ends[-1] if ends else (None, None)
    # A refused session has no number.
    ordered = [each for record, each in _facts(facts, SessionOrdered) if record.seq < began.seq]
    orders = [inputs.order]
    orders += [FolderOrder(each.folder, each.number, each.after) for each in ordered]
    verdicts = {record.key: each for record, each in _facts(facts, Verdict)}
    used = ["", *(each.run for _, each in _facts(facts, CalibrationUsed))]
    carried = ["", *(each.run for _, each in _facts(facts, ArmCarried))]
    revoked = ["", *(each.reason for _, each in _facts(facts, CalibrationRevoked))]
    devices = [device for _, each in _facts(facts, Connected) for device in each.devices]
    before_mean_mm, chosen_mean_mm, chosen_max_mm = _figures(
        {} if last is None else last.result, str(inputs.cell["grid"]["station"])
    )
    return RunRow(
        name=name,
        begun=f"{plan.t[:19]}Z",  # a journal's times are UTC, ISO 8601 to the millisecond
        session="" if began is plan else f"{began.t[:23]}Z",
        origin=hashlib.sha256(msgspec.json.encode(plan)).hexdigest(),
        state=states[-1],
        ended="" if end is None else f"{end.t[:19]}Z",
        reason=(life[-1][1].reason if life else "") or ("" if last is None else last.reason),
        procedure=inputs.procedure,
        cell=str(inputs.cell["name"]),
        serial=inputs.serial,
        operator=inputs.operator,
        job=inputs.job,
        seed=inputs.seed,
        simulated=inputs.simulated or any(each.simulated for each in devices),
        machine_seed=inputs.machine_seed,
        moved=any(each.kind == "intent" for each in records),
        replayed=inputs.replayed,
        points=len({each.key for each in records if each.kind == "point"}),
        exit=None if last is None else last.exit,
        before_mean_mm=before_mean_mm,
        chosen_mean_mm=chosen_mean_mm,
        chosen_max_mm=chosen_max_mm,
        facts=facts_of(verdicts, used[-1], revoked[-1], carried[-1]),
        order=orders[-1],
    )


def _figures(result: dict[str, object], station: str) -> tuple[float | None, ...]:
    """Return mean before, mean and maximum after (mm), or None."""
    with suppress(msgspec.ValidationError):  # a plug-in's procedure may have other figures
        main = typed(result, _Result)
        if place := main.validation.get(station):
            return place.before.mean, place.chosen.mean, place.chosen.max
        methods = main.campaign.methods
        before, chosen = methods.get("nominal"), methods.get(main.campaign.chosen)
        if before and chosen:
            return before.mean_mm, chosen.mean_mm, chosen.max_mm
    return None, None, None


# -- the files ------------------------------------------------------------------------------------


def _stamps(runs: Path) -> dict[str, str]:
    """Return stamps of the journals by run, which change with the files; "" if unknown."""
    try:
        names = os.listdir(runs)  # noqa: PTH208 - of ten thousand runs a Path each is too slow
    except FileNotFoundError:
        return {}  # no run yet
    except OSError as error:
        raise unusable(runs, error) from error
    now_s = time.time()
    found = ((name, _stamp(f"{runs}/{name}/{JOURNAL}", now_s)) for name in names)
    return {name: stamp for name, stamp in found if stamp is not None}


def _stamp(journal: str, now_s: float) -> str | None:
    try:
        file = os.stat(journal)  # noqa: PTH116 - as above
    except OSError as error:
        return None if error.errno in NOT_FOUND_ERRNOS else ""  # reading it reports the cause
    if not stat.S_ISREG(file.st_mode):
        return None
    # Committed records may not be in the main file yet.
    settled = file.st_mtime < now_s - SETTLED_S and not _size(f"{journal}-wal")
    settled = settled and journal.isprintable()  # names must be UTF-8
    return f"{file.st_mtime_ns} {file.st_size}" if settled else ""


def _size(file: str) -> int:
    try:
        return os.stat(file).st_size  # noqa: PTH116 - as above
    except OSError:
        return 0


def _written(folder: Path) -> str:
    try:
        written_s = (folder / JOURNAL).stat().st_mtime
    except OSError:
        return ""
    return _utc(datetime.fromtimestamp(written_s, UTC))


def own_file(file: Path) -> Path:
    """Return a file that may be overwritten; raises `sqlite3.DatabaseError` for a link."""
    with suppress(FileNotFoundError):
        found = file.lstat()
        if stat.S_ISLNK(found.st_mode) or (stat.S_ISREG(found.st_mode) and found.st_nlink != 1):
            raise sqlite3.DatabaseError(f"{file} is a link")
    return file


class _IndexFile:
    """The index in the folder of runs; one that cannot be used has no rows and stores none."""

    def __init__(self, runs: Path) -> None:
        self._path = runs / NAME

    def rows(self, stamps: dict[str, str]) -> dict[str, RunRow]:
        """Return the rows whose journals are still the files that they were read from."""
        rows: dict[str, RunRow] = {}
        with self._optional(), closing(self._connect()) as base:
            # As bytes: damage is noticed by the seal.
            parts = ", ".join(f"CAST({each} AS BLOB)" for each in ("name", "stamp", "row", "seal"))
            stored = base.execute(f"SELECT {parts} FROM run").fetchall()  # noqa: S608 - no word is a user's
            if any(seal != self._seal(*sealed) for *sealed, seal in stored):
                raise sqlite3.DatabaseError(f"{self._path}: a row is not the one that was stored")
            texts = [(name.decode(), stamp.decode(), row) for name, stamp, row, _ in stored]
            rows |= {
                name: decoded(row, RunRow)
                for name, stamp, row in texts
                if stamp == stamps.get(name)
            }
            gone = [(name,) for name, _, _ in texts if name not in stamps]
            if gone:
                base.executemany("DELETE FROM run WHERE name = ?", gone)
        return rows

    def store(self, rows: dict[str, RunRow], stamps: dict[str, str]) -> None:
        """Store the rows of ended runs whose files are unchanged."""
        encode = msgspec.json.encode
        lasting = [
            (name, stamps[name], encode(row))
            for name, row in rows.items()
            if stamps[name] and row.exit is not None and not row.live
        ]
        sealed = [
            (*each, self._seal(each[0].encode(), each[1].encode(), each[2])) for each in lasting
        ]
        if sealed:
            with self._optional(), closing(self._connect()) as base:
                base.execute("BEGIN IMMEDIATE")
                base.executemany("INSERT OR REPLACE INTO run VALUES (?, ?, ?, ?)", sealed)
                base.execute("COMMIT")

    @staticmethod
    def _seal(*parts: bytes | None) -> bytes:
        """Return the digest that a row is stored with; a damaged page may hold None."""
        whole = b"\0".join([str(SCHEMA).encode(), *(part or b"" for part in parts)])
        return hashlib.sha256(whole).digest()

    @contextmanager
    def _optional(self) -> Iterator[None]:
        """Ignore an index that is locked or cannot be written; delete a damaged one."""
        try:
            yield
        except (sqlite3.Error, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT)
            if code & 0xFF not in (*ACCESS_ERRORS, sqlite3.SQLITE_FULL):
                for file in (self._path, self._path.with_name(f"{NAME}-journal")):
                    with suppress(OSError):
                        file.unlink()

    def _connect(self) -> sqlite3.Connection:
        table = "CREATE TABLE run (name TEXT PRIMARY KEY, stamp TEXT, row BLOB, seal BLOB) STRICT"
        definition = "SELECT sql FROM sqlite_master WHERE name = 'run'"
        base = sqlite3.connect(own_file(self._path), timeout=BUSY_S, isolation_level=None)
        try:
            base.execute("PRAGMA synchronous=OFF")  # rebuilt after power loss
            base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**20)  # bytes of a row
            if base.execute("PRAGMA user_version").fetchone() != (SCHEMA,):
                base.execute("BEGIN IMMEDIATE")
                base.execute("DROP TABLE IF EXISTS run")
                base.execute(table)
                base.execute(f"PRAGMA user_version={SCHEMA}")
                base.execute("COMMIT")
            elif base.execute(definition).fetchone() != (table,):
                raise sqlite3.DatabaseError(f"{self._path} is no index: a view may have no end")
        except sqlite3.Error:
            base.close()
            raise
        return base
