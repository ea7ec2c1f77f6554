"""Follows one run from a thread of its own: reads new records and asks the engine for its status.

Reading may block, so it never runs in the thread that takes keys. Each look is handed over as one
`RunUpdate`; only the session keeps state.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, StorageError, is_there, read_journal
from hilcell.journal.runs import CALIBRATION, JOURNAL
from hilcell.run.control import EngineClient, EngineLost, EngineSilent, Status
from hilcell.tui.engine.run_view import EngineState

QUIET_S = 0.5  # where no engine is at work, little happens
REOPEN_S = 10.0  # a line that was silent for so long is opened again


@dataclass(frozen=True, slots=True)
class RunUpdate:
    """The result of one look, or of several that nobody has seen yet."""

    records: list[Record] = field(default_factory=list)
    engine: EngineState = EngineState.NONE
    status: Status | None = None
    trouble: str = ""
    calibrated: bool = True  # whether a calibration has its file; looked at after the engine's end
    answered: datetime | None = None  # when the status came; None: just now

    def followed_by(self, later: RunUpdate) -> RunUpdate:
        """Return both as one: the records of both, everything else as it is now."""
        heard = self if later.status is None else later
        return replace(
            later,
            records=[*self.records, *later.records],
            status=heard.status,
            answered=heard.answered,
        )


class Inbox:
    """Holds what waits to be shown as one update, however many looks it came with.

    A screen that is slower than its feed falls behind by one update, and never by more.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waits: RunUpdate | None = None

    def put(self, update: RunUpdate) -> bool:
        """Add an update, from any thread; return whether none waited before."""
        with self._lock:
            before = self._waits
            self._waits = update if before is None else before.followed_by(update)
        return before is None

    def take(self) -> RunUpdate | None:
        """Return all that waits, and hold nothing."""
        with self._lock:
            update, self._waits = self._waits, None
        return update


class Feed:
    """Looks at a run every ``period_s`` and hands over what is new."""

    def __init__(
        self, folder: Path, deliver: Callable[[RunUpdate], object], period_s: float
    ) -> None:
        self.folder = folder
        self.client: EngineClient | None = None
        self._deliver, self._period_s = deliver, period_s
        self._seen = 0
        self._answered_s = 0.0
        self._leave = False
        self._ended = threading.Event()
        self._soon = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="feed", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def look_now(self) -> None:
        """Look at once: a command was sent."""
        self._soon.set()

    def close(self, *, leave: bool) -> None:
        """Stop looking. ``leave``: report to the engine that this screen leaves on purpose."""
        self._leave = leave
        self._ended.set()
        self._soon.set()
        self._disconnect()

    def _disconnect(self) -> None:
        client, self.client = self.client, None
        if client is not None:
            if self._leave:
                client.leave()
            client.close()

    def _follow(self) -> None:
        while not self._ended.is_set():
            began_s = time.monotonic()
            update = self._look()
            if not self._ended.is_set():
                self._deliver(update)
                quiet = update.engine is EngineState.NONE
                period_s = max(self._period_s, QUIET_S) if quiet else self._period_s
                self._soon.wait(max(period_s - (time.monotonic() - began_s), 0.02))
                self._soon.clear()
        self._disconnect()  # a line that was being opened when the end came

    def _look(self) -> RunUpdate:
        engine, status = self._ask_status()
        answered = None if status is None else utc_now()
        try:
            records = read_journal(self.folder / JOURNAL, after=self._seen)
        except StorageError as error:
            waits = engine is not EngineState.NONE or self._lacks(JOURNAL)
            trouble = "" if waits and not self._seen else str(error)
            return RunUpdate([], engine, status, trouble, answered=answered)
        self._seen += len(records)
        calibrated = engine is not EngineState.NONE or not self._lacks(CALIBRATION)
        return RunUpdate(records, engine, status, calibrated=calibrated, answered=answered)

    def _lacks(self, name: str) -> bool:
        """Whether a file is missing, as far as that is known."""
        try:
            return not is_there(self.folder / name)
        except OSError:
            return False

    def _ask_status(self) -> tuple[EngineState, Status | None]:
        """Ask the engine how it is; after an answer that cannot be read the lamps grow stale."""
        try:
            client = self._connected()
            if client is None:
                return EngineState.NONE, None
            status = client.ask("status")
        except EngineSilent:
            if time.monotonic() - self._answered_s > REOPEN_S:
                self._disconnect()
            return EngineState.SILENT, None
        except EngineLost:
            self.client = None
            return EngineState.NONE, None
        except HilcellError:
            return EngineState.ANSWERING, None
        self._answered_s = time.monotonic()
        return EngineState.ANSWERING, status

    def _connected(self) -> EngineClient | None:
        if self.client is None:
            self.client = EngineClient.of_run(self.folder)
            self._answered_s = time.monotonic()
            if self.client is not None:
                self.client.ask("attend")
        return self.client


def utc_now() -> datetime:
    """Return the time of day, by which journals are dated."""
    return datetime.now(UTC)
