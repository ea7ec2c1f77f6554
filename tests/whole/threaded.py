"""A run in a thread of the test, which stands still at events until the test lets it go on.

Its control socket answers meanwhile, so that screens and orders come exactly when they are to.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from subprocess import CompletedProcess
from types import TracebackType
from typing import Any, Self

from hilcell.run.control import stop_engine
from tests.whole.bench import broken, performed

Event = dict[str, Any]
Stands = Callable[[Event], bool]


class ThreadedRun:
    """`hilcell run` or `resume`; one that outlives its block is stopped.

    It stands still at each event, or at those of ``stands``.
    """

    def __init__(self, runs: Path, *words: str | Path, stands: Stands = lambda _: True) -> None:
        self.runs, self._stands = runs, stands
        self.events: list[Event] = []
        self.done: CompletedProcess[str] | None = None
        self._came: SimpleQueue[Event | None] = SimpleQueue()
        self._ended = False  # all events were taken, which is later than ``done``
        self._may_go_on = threading.Semaphore(0)
        self._words = (*words, "--json", "--runs", runs)
        self._thread = threading.Thread(target=self._run, name="threaded run")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None
    ) -> None:
        if self.done is None and self.events:
            stop_engine(self.folder)
        self.rest()

    @property
    def folder(self) -> Path:
        return self.runs / str(self.events[0]["run"])

    def until(self, wanted: Callable[[Event], object]) -> Event:
        """Let the run go on to an event that matches; return it."""
        while (event := self._next()) is not None:
            if wanted(event):
                return event
        raise AssertionError(f"the run ended first: {self.done}")

    def rest(self) -> Event:
        """Let the run go on to its end; return its last event.

        One that breaks an invariant fails the test.
        """
        while self._next() is not None:
            continue
        self._thread.join()
        assert self.done is not None
        assert broken(self.done.stdout) == []
        return self.events[-1]

    def _next(self) -> Event | None:
        if self._ended:
            return None
        if not self.events or self._stands(self.events[-1]):
            self._may_go_on.release()
        event = self._came.get()
        if event is None:
            self._ended = True
        else:
            self.events.append(event)
        return event

    def _run(self) -> None:
        self._may_go_on.acquire()
        self.done = performed(*self._words, hear=self._hear)
        self._came.put(None)

    def _hear(self, event: Event) -> None:
        self._came.put(event)
        if self._stands(event):
            self._may_go_on.acquire()


def never(_: Event) -> bool:
    """Let a run stand still at no event."""
    return False


def is_state(event: Event, name: str) -> bool:
    return bool(event["kind"] == "state" and event["machine"] == "run" and event["to"] == name)
