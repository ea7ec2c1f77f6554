"""A session follows one run: its feed reads from a thread of its own, its view holds the result.

Reading may block, so the feed never runs in the thread that takes keys. Each poll is handed over as
one `RunUpdate`; only the session keeps state.
"""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Unpack

import msgspec

from hilcell.alarms import Latch, alarms_of
from hilcell.alarms.alarm import CONTINUE_KEY, acknowledged_in
from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, StorageError, is_regular_file, read_journal
from hilcell.journal.runs import CALIBRATION, JOURNAL
from hilcell.model.events import AlarmsAcknowledged
from hilcell.run.control import (
    MEASURED_S,
    Command,
    EngineClient,
    EngineLost,
    EngineSilent,
    Status,
    Subject,
    stop_engine,
)
from hilcell.run.forecast import Forecast
from hilcell.tui.run_view import EngineState, RunView

if TYPE_CHECKING:
    from hilcell.journal.journal import Record


@dataclass(frozen=True, slots=True)
class RunUpdate:
    """The result of one poll, or of several that are not shown yet."""

    records: list[Record] = field(default_factory=list)
    engine: EngineState = EngineState.NONE
    status: Status | None = None
    trouble: str = ""
    calibrated: bool = True  # whether a calibration has its file; checked after the engine's end
    answered: datetime | None = None  # when the status came; None: just now

    def followed_by(self, later: RunUpdate) -> RunUpdate:
        """Return both as one: the records of both, everything else as it is now."""
        newest = self if later.status is None else later
        return replace(
            later,
            records=[*self.records, *later.records],
            status=newest.status,
            answered=newest.answered,
        )


class Inbox:
    """Merges what waits to be shown into one update, however many polls it came with.

    A screen that is slower than its feed falls behind by one update, and never by more.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pending: RunUpdate | None = None

    def put(self, update: RunUpdate) -> bool:
        """Add an update, from any thread; return whether none waited before."""
        with self._lock:
            before = self._pending
            self._pending = update if before is None else before.followed_by(update)
        return before is None

    def take(self) -> RunUpdate | None:
        with self._lock:
            update, self._pending = self._pending, None
        return update


class Feed:
    """Polls a run every ``period_s`` and hands over what is new."""

    QUIET_S = 0.5  # where no engine is at work, little happens
    REOPEN_S = 10.0  # a line that was silent for so long is opened again

    def __init__(
        self, folder: Path, deliver: Callable[[RunUpdate], object], period_s: float
    ) -> None:
        self.folder = folder
        self.client: EngineClient | None = None
        self._deliver, self._period_s = deliver, period_s
        self._records_read = 0
        self._answered_s = 0.0
        self._leave = False
        self._ended = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="feed", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def poll_now(self) -> None:
        self._wake.set()

    def close(self, *, leave: bool) -> None:
        """Stop polling. ``leave``: report to the engine that this screen leaves on purpose."""
        self._leave = leave
        self._ended.set()
        self._wake.set()
        self._disconnect()

    def _disconnect(self) -> None:
        client, self.client = self.client, None
        if client is not None:
            if self._leave:
                client.leave()
            client.close()

    def _follow(self) -> None:
        while not self._ended.is_set():
            start_s = time.monotonic()
            update = self._poll()
            if not self._ended.is_set():
                self._deliver(update)
                quiet = update.engine is EngineState.NONE
                period_s = max(self._period_s, self.QUIET_S) if quiet else self._period_s
                self._wake.wait(max(period_s - (time.monotonic() - start_s), 0.02))
                self._wake.clear()
        self._disconnect()  # a line that was being opened when the end came

    def _poll(self) -> RunUpdate:
        engine, status = self._ask_status()
        answered = None if status is None else utc_now()
        try:
            records = read_journal(self.folder / JOURNAL, after=self._records_read)
        except StorageError as error:
            starting = engine is not EngineState.NONE or self._is_missing(JOURNAL)
            trouble = "" if starting and not self._records_read else str(error)
            return RunUpdate([], engine, status, trouble, answered=answered)
        self._records_read += len(records)
        calibrated = engine is not EngineState.NONE or not self._is_missing(CALIBRATION)
        return RunUpdate(records, engine, status, calibrated=calibrated, answered=answered)

    def _is_missing(self, name: str) -> bool:
        try:
            return not is_regular_file(self.folder / name)
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
            if time.monotonic() - self._answered_s > self.REOPEN_S:
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
    return datetime.now(UTC)


class Session:
    """Follows one run and sends commands to its engine."""

    TIMEOUT_S: ClassVar[dict[Command, float]] = {"answer": MEASURED_S}

    def __init__(
        self,
        folder: Path,
        deliver: Callable[[RunUpdate], object],
        period_s: float,
        process: subprocess.Popen[bytes] | None = None,
        go_on: str = CONTINUE_KEY,
    ) -> None:
        self.folder = folder
        self.view = RunView(
            folder.name, engine=EngineState.STARTING if process else EngineState.UNKNOWN
        )
        self.latch = Latch()
        self.stop_received = False  # whether an engine of the run that is live now received a stop
        self.process = process  # the engine, where this screen has started it
        self._go_on = go_on
        self._unreadable = ""  # why the journal's records cannot be applied
        self._forecast = Forecast()
        self._status_at: datetime | None = None
        self.inbox = Inbox()
        self.feed = Feed(folder, deliver, period_s)

    def take(self, update: RunUpdate, now: datetime) -> None:
        if not self._unreadable:
            self._take_records(update.records)
        view = self.view
        view.trouble = self._unreadable or update.trouble
        if update.status is not None:
            view.status, self._status_at = update.status, update.answered or now
        before = view.engine, view.calibrated
        view.engine, view.calibrated = self._engine(update.engine), update.calibrated
        changed = (view.engine, view.calibrated) != before
        news = changed or (update.records and not self._unreadable)
        if news and view.log.plan is not None:
            present = view.engine is not EngineState.NONE
            lost = not view.calibrated
            view.alarms = alarms_of(view.log, view.run, live=present, go_on=self._go_on, lost=lost)
            self.latch.take(view.alarms, self._continued_at, acknowledged_in(view.log))
        self.tick(now)

    def _engine(self, reported: EngineState) -> EngineState:
        if reported is not EngineState.NONE:
            return reported
        begins = self.view.engine is EngineState.STARTING
        running = self.process is not None and self.process.poll() is None
        return EngineState.STARTING if begins and running else EngineState.NONE

    def _take_records(self, records: Sequence[Record]) -> None:
        view = self.view
        try:
            for record in records:
                view.take(record)
                self._forecast.take(record)
            if view.records:
                _ = view.log.cell  # checked here, so that every line may use it
        except (HilcellError, msgspec.ValidationError) as error:
            self._unreadable = f"{view.run}: written by another version of hilcell: {error}"
            self.view = RunView(view.run)

    @property
    def _continued_at(self) -> str:
        """Return the time of the newest record, where the run went on, so that causes are gone.

        Where it was opened again, aborted or lost its engine, causes are not known to be gone.
        """
        log = self.view.log
        went_on = ("running", "pausing", "paused", "suspended", "finished")
        went_well = log.state in went_on and (self.view.live or log.over)
        return log.newest.t if went_well and log.newest is not None else ""

    def tick(self, now: datetime) -> None:
        view = self.view
        view.now = now
        view.status_age_s = (
            (now - self._status_at).total_seconds() if self._status_at is not None else 0.0
        )
        last = datetime.fromisoformat(view.records[-1].t) if view.records else now
        at = now if view.live else last
        view.elapsed_s = self._forecast.elapsed_s(at)
        view.remaining_s = self._forecast.remaining_s(at)
        view.ahead = self._forecast.ahead(at) if view.live else []
        self.stop_received = self.stop_received and view.live
        view.span = self._forecast.span

    def stop(self) -> bool:
        """Send a stop at once, from any thread; return whether an engine received it.

        Where the connection is lost, a new one is opened. An engine that is being started takes
        no commands yet: its process gets SIGTERM, which ends it before anything moves. Later that
        would be wrong: an engine that has finished still writes its results.
        """
        client = self.feed.client
        if not ((client is not None and client.stop()) or stop_engine(self.folder)):
            if self.process is None or self.view.engine is not EngineState.STARTING:
                return False
            self.process.terminate()  # does nothing where it has ended
        self.stop_received = True
        return True

    def ask(self, command: Command, **subject: Unpack[Subject]) -> None:
        """Send a command; raises `HilcellError` where it is refused or no engine lives."""
        timeout_s = self.TIMEOUT_S.get(command)
        apart = timeout_s is not None  # so that the lamps do not wait for it
        client = EngineClient.of_run(self.folder, timeout_s) if apart else self.feed.client
        if client is None:
            raise HilcellError(
                f"{command}: no engine is running for {self.folder.name}", code="HC-J08"
            )
        try:
            client.ask(command, **subject)
        finally:
            if apart:
                client.close()
        self.feed.poll_now()

    def acknowledge(self) -> AlarmsAcknowledged:
        """Acknowledge every alarm on this screen; return that, to be sent to the engine."""
        codes = (each.alarm.code for each in self.latch.standing() if not each.acknowledged)
        newest = self.view.log.newest
        made = AlarmsAcknowledged(codes=list(codes), until=0 if newest is None else newest.seq)
        self.latch.acknowledge()
        return made

    def send(self, made: AlarmsAcknowledged) -> None:
        """Have the engine journal it; where none does, only this screen knows."""
        with suppress(HilcellError):
            self.ask("acknowledge", codes=tuple(made.codes), until=made.until)

    def close(self, *, leave: bool) -> None:
        self.feed.close(leave=leave)
        if self.process is not None:
            self.process.poll()
