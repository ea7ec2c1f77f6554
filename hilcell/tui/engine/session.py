"""A session: one run as the screen follows it, with its feed, its view and its alarms."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import msgspec

from hilcell.alarms import Latch, alarms_of
from hilcell.alarms.alarm import GO_ON, acknowledged_in
from hilcell.errors import HilcellError
from hilcell.model.events import AlarmsAcknowledged
from hilcell.run.control import Command, EngineClient, Subject, stop_engine
from hilcell.run.forecast import Forecast
from hilcell.tui.engine.feed import Feed, Inbox, RunUpdate
from hilcell.tui.engine.run_view import EngineState, RunView

if TYPE_CHECKING:
    from hilcell.journal.journal import Record


PATIENCE_S: dict[Command, float] = {"answer": 30.0}  # the tracker looks first


class Session:
    """Follows one run and sends commands to its engine."""

    def __init__(
        self,
        folder: Path,
        deliver: Callable[[RunUpdate], object],
        period_s: float,
        process: subprocess.Popen[bytes] | None = None,
        go_on: str = GO_ON,
    ) -> None:
        self.folder = folder
        self.view = RunView(
            folder.name, engine=EngineState.STARTING if process else EngineState.UNKNOWN
        )
        self.latch = Latch()
        self.stop_heard = False  # whether an engine of the run that is live now received a stop
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
            self.latch.take(view.alarms, self._went_on_at, acknowledged_in(view.log))
        self.tick(now)

    def _engine(self, found: EngineState) -> EngineState:
        if found is not EngineState.NONE:
            return found
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
    def _went_on_at(self) -> str:
        """Return the time of the newest record, where the run went on and so has proven something.

        Where it was opened again, aborted or lost its engine, causes are not known to be gone.
        """
        log = self.view.log
        went_on = ("running", "pausing", "paused", "suspended", "finished")
        proven = log.state in went_on and (self.view.live or log.over)
        return log.newest.t if proven and log.newest is not None else ""

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
        self.stop_heard = self.stop_heard and view.live
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
        self.stop_heard = True
        return True

    def ask(self, command: Command, **subject: Unpack[Subject]) -> None:
        """Send a command; raises `HilcellError` where it is refused or no engine lives."""
        patience_s = PATIENCE_S.get(command)
        apart = patience_s is not None  # so that the lamps do not wait for it
        client = EngineClient.of_run(self.folder, patience_s) if apart else self.feed.client
        if client is None:
            raise HilcellError(
                f"{command}: no engine is running for {self.folder.name}",
                code="HC-J08",
            )
        try:
            client.ask(command, **subject)
        finally:
            if apart:
                client.close()
        self.feed.look_now()

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
