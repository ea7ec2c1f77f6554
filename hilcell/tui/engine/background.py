"""Keeps the screen's thread free: slow work runs in threads, full garbage collections wait.

asyncio joins its own threads when a program ends, so an engine that works for an hour, or one that
does not answer, would keep a closed screen's process alive. A collection over all that a screen
holds takes a tenth of a second in which no thread runs, and a stop may not wait for that: young
objects are collected as always, all objects only while nothing moves.
"""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


async def run_in_thread(work: Callable[P, T], *args: P.args, **facts: P.kwargs) -> T:
    """Return what a function returns, or raise what it raises.

    The work is done also where it was given up before its thread ran: it may be a stop.
    """
    future: Future[T] = Future()

    def run() -> None:
        awaited = future.set_running_or_notify_cancel()
        try:
            result = work(*args, **facts)
        except Exception as error:  # noqa: BLE001 - raised where it is awaited
            if awaited:
                future.set_exception(error)
        else:
            if awaited:
                future.set_result(result)

    threading.Thread(target=run, name="run_in_thread", daemon=True).start()
    return await asyncio.wrap_future(future)


class GarbageCollector:
    """Takes whole collections over from the interpreter until `end`."""

    PERIOD_S = 30.0
    NEVER = 1_000_000_000

    def __init__(self, now_s: float) -> None:
        self._whole_s = now_s
        self._rested = False  # at the tick before
        self._before = gc.get_threshold()
        gc.set_threshold(self._before[0], self._before[1], self.NEVER)
        gc.freeze()  # what was loaded stays

    def tick(self, *, at_rest: bool, now_s: float) -> None:
        """Collect everything, where that may be done now and was not done lately.

        Not at the first tick of a rest: why nothing moves, such as a run's end, is painted first.
        """
        if at_rest and self._rested and now_s - self._whole_s >= self.PERIOD_S:
            self._whole_s = now_s
            gc.collect()
        self._rested = at_rest

    def end(self) -> None:
        """Give the collection back."""
        gc.unfreeze()
        gc.set_threshold(*self._before)
