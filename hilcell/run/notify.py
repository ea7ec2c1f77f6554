"""Notifications: a command of the cell file runs at events of a run, with the event as JSON.

The run never waits for the command: a thread of its own reads the records that the journal has
stored, finds the events and runs the command for one after the other. The end of the process waits
for it at most `CLOSING_S`. A command that is missing, fails or hangs is journalled and changes
nothing else. No shell is started; the command's output is discarded.
"""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, TypeAlias

import msgspec

from hilcell.alarms.alarm import Alarm, alarms_of
from hilcell.cell.file import NotifyEvent, NotifyTable
from hilcell.decoding import Json
from hilcell.errors import HilcellError
from hilcell.journal.journal import Record, read_journal
from hilcell.journal.log import Log, RunJournal
from hilcell.journal.runs import JOURNAL
from hilcell.model.events import NotificationFailed
from hilcell.model.records import WAITING, StateChanged
from hilcell.run.last_word import last_word
from hilcell.sanitize import encodable, harmless

LIMIT_S = 30.0  # of one command, while the run goes on
REST_S = 2.0  # after the run's end: for all that still waits
END_S = 5.0  # of the command for the end itself
CLOSING_S = REST_S + END_S + 1.0
LONGEST = 500  # characters of one text
LOOK_S = 0.1  # between two looks at a command

_Told: TypeAlias = tuple[NotifyEvent, Json]


class Notifier:
    """Runs the command of ``table`` at the events of one session: ``with Notifier(..):``.

    ``say`` takes a failure that the journal cannot store.
    """

    def __init__(
        self, table: NotifyTable, journal: RunJournal, folder: Path, say: Callable[[str], object]
    ) -> None:
        self._table, self._journal, self._folder, self._say = table, journal, folder, say
        self._log = Log()  # of its own: the journal's changes while this thread reads
        self._known: set[tuple[str, int, str]] = set()  # alarms of earlier sessions, and sent ones
        self._queue: queue.SimpleQueue[Record | _Told | None] = queue.SimpleQueue()
        self._first = 0  # the last record before this session
        self._over_s: float | None = None  # when the session has ended, s of the monotonic clock
        self._thread = threading.Thread(target=self._work, name="notify", daemon=True)

    def __enter__(self) -> Self:
        newest = self._journal.log.newest
        self._first = 0 if newest is None else newest.seq
        self._journal.listen(self._queue.put)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait for the last command, at most `CLOSING_S`."""
        self._over_s = time.monotonic()
        self._queue.put(None)
        self._thread.join(CLOSING_S)

    def ended(self, code: int, fault: Exception | None) -> None:
        """Notify of the end, once results and calibration are written."""
        log = self._journal.log  # no other thread writes it any more
        journalled = log.end is not None and log.end.exit == code
        word = last_word(log, self._folder, None if journalled else fault)
        outcome = log.outcome_text if journalled else ""
        facts = {"exit": code, "outcome": outcome, "text": word.text, "next": list(word.next)}
        self._queue.put(("end", facts))

    # -- the thread -------------------------------------------------------------------------------

    def _work(self) -> None:
        readable = self._read_earlier()
        while (item := self._queue.get()) is not None:
            if isinstance(item, tuple):
                self._tell(*item)
            elif readable:
                self._log.take(item)
                for event, facts in self._events(item):
                    self._tell(event, facts)

    def _read_earlier(self) -> bool:
        """Read the records before this session; return whether the journal can be read."""
        try:
            for record in read_journal(self._folder / JOURNAL):
                if record.seq <= self._first:
                    self._log.take(record)
        except HilcellError as error:
            self._say(f"warning: no notifications before the end: {error}")
            return False
        earlier = alarms_of(self._log, self._journal.run, live=False)
        self._known.update(alarm.mark for alarm in earlier)
        return True

    def _events(self, record: Record) -> Iterator[_Told]:
        if record.kind not in ("state", "event", "verdict"):
            return
        for alarm in alarms_of(self._log, self._journal.run, live=True):
            if alarm.mark not in self._known:
                self._known.add(alarm.mark)
                if alarm.severity != "notice":
                    yield "alarm", _alarm_facts(alarm)
        match record.fact:
            case StateChanged(machine="run", to=to) as change if to in WAITING:
                prompt = change.prompt or {}
                if prompt and not prompt.get("by_itself"):
                    text = f"{prompt['title']}: {prompt['text']}"
                    yield "prompt", {"text": text, "title": prompt["title"]}
                else:
                    yield "suspension", {"text": f"{to}: {change.reason}", "reason": change.reason}

    def _tell(self, event: NotifyEvent, facts: Json) -> None:
        """Run the command for one event, if the cell file has chosen it."""
        if event not in self._table.events:
            return
        inputs = self._journal.log.inputs
        body = {
            "event": event,
            "run": self._journal.run,
            "folder": str(self._folder.resolve()),
            "cell": self._journal.log.cell.name,
            "procedure": inputs.procedure,
            "simulated": inputs.simulated,
            "operator": inputs.operator,
            "job": inputs.job,
            "state": self._journal.log.state,
        }
        failed = self._run(event, msgspec.json.encode(cleaned(body | facts)))
        if failed:
            try:
                self._journal.append("event", "", NotificationFailed(event=event, reason=failed))
            except HilcellError as error:
                self._say(f"warning: notification of {event}: {failed}; {error}")

    def _until_s(self, event: NotifyEvent, began_s: float) -> float:
        """Return when the command must have ended, s of the monotonic clock."""
        if event == "end":
            return began_s + END_S
        over_s = self._over_s
        return began_s + LIMIT_S if over_s is None else min(began_s + LIMIT_S, over_s + REST_S)

    def _run(self, event: NotifyEvent, text: bytes) -> str:
        """Run the command; return why it failed, "" where it did not."""
        began_s = time.monotonic()
        if began_s >= self._until_s(event, began_s):
            return "not sent: the run had ended, and earlier commands took too long"
        try:
            process = subprocess.Popen(  # noqa: S603 - of the cell file, which is trusted
                self._table.words,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # a ctrl-C of the run is not the command's
            )
        except OSError as error:
            return f"{self._table.words[0]}: cannot be started: {error.strerror}"
        with process:
            assert process.stdin is not None  # noqa: S101 - a pipe, which holds all of the text
            with suppress(BrokenPipeError), process.stdin as pipe:
                pipe.write(text)
            while True:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(LOOK_S)
                    break
                if time.monotonic() >= self._until_s(event, began_s):
                    os.killpg(process.pid, signal.SIGKILL)  # it exists, as long as none waits
                    took_s = time.monotonic() - began_s
                    return f"{self._table.words[0]}: killed after {took_s:.0f} s: it hangs"
        code = process.returncode
        died = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"{self._table.words[0]}: {died}" if code else ""


def _alarm_facts(alarm: Alarm) -> Json:
    text = f"{alarm.code} {alarm.title}: {': '.join(filter(None, (alarm.where, alarm.found)))}"
    names = ("code", "severity", "title", "where", "found", "do")
    return {"text": text} | {name: getattr(alarm, name) for name in names}


def cleaned(value: object) -> object:
    """Return a value in JSON types whose texts are one clean line each: devices wrote some.

    They are short, so that a pipe holds the whole event and writing it never waits.
    """
    match value:
        case str():
            return harmless(encodable(" ".join(value.split())))[:LONGEST]
        case Mapping():
            return {name: cleaned(each) for name, each in value.items()}
        case Sequence():
            return [cleaned(each) for each in value]
        case _:
            return value
