"""$TIMER[10] of a controller: it counts milliseconds, and reaches zero or is set back.

Its time is real, whatever the simulated cell's pace: a PC that lives speaks in real time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from fakes.time import PAUSE_S, OwnTime


class LifeTimer:
    """Calls ``act``, in a thread that lives while the timer runs, when it has reached zero."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act
        self._changed = threading.Condition()
        self._time = OwnTime()
        self._zero_s = 0.0
        self._running = self._watched = False

    def start(self, value_ms: int) -> None:
        """Run from a value, which is below zero."""
        with self._changed:
            self._zero_s, self._running = self._time.now_s() - value_ms / 1000.0, True
            if not self._watched:
                self._watched = True
                threading.Thread(target=self._watch, name="timer 10", daemon=True).start()
            self._changed.notify()

    def set_ms(self, value_ms: int) -> None:
        """Set the value; whether the timer runs does not change."""
        with self._changed:
            self._zero_s = self._time.now_s() - value_ms / 1000.0

    def stop(self) -> None:
        """Run no longer."""
        with self._changed:
            self._running = False
            self._changed.notify()

    @property
    def ran_out(self) -> bool:
        """Whether it runs and has reached zero."""
        with self._changed:
            return self._running and self._time.now_s() >= self._zero_s

    def _watch(self) -> None:
        while self._await_zero():
            self._act()
            with self._changed:
                self._running &= self._time.now_s() < self._zero_s  # it acts once

    def _await_zero(self) -> bool:
        """Wait until the timer has reached zero, or runs no longer; return whether it runs."""
        with self._changed:
            while self._running and (left_s := self._zero_s - self._time.now_s()) > 0:
                self._changed.wait(min(left_s, PAUSE_S))
            self._watched = self._running
            return self._running
