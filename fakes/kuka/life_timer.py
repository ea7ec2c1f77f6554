"""$TIMER[10] of a controller: it counts milliseconds of real time, and reaches zero or is set back.

Real time, whatever the simulated cell's pace: a PC that lives speaks in real time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class LifeTimer:
    """Calls ``act``, in a thread of its own, when the running timer has reached zero."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act
        self._changed = threading.Condition()
        self._zero_s = 0.0
        self._running = False
        self._thread: threading.Thread | None = None

    def start(self, value_ms: int) -> None:
        """Run from a value, which is below zero."""
        with self._changed:
            self._zero_s, self._running = time.monotonic() - value_ms / 1000.0, True
            if self._thread is None:
                self._thread = threading.Thread(target=self._watch, name="timer 10", daemon=True)
                self._thread.start()
            self._changed.notify()

    def set_ms(self, value_ms: int) -> None:
        """Set the value; whether the timer runs does not change."""
        with self._changed:
            self._zero_s = time.monotonic() - value_ms / 1000.0

    def stop(self) -> None:
        """Run no longer."""
        with self._changed:
            self._running = False

    @property
    def ran_out(self) -> bool:
        """Whether it runs and has reached zero."""
        with self._changed:
            return self._running and time.monotonic() >= self._zero_s

    def _watch(self) -> None:
        while True:
            with self._changed:
                while not self._running:
                    self._changed.wait()
                self._changed.wait(max(0.0, self._zero_s - time.monotonic()))
            if self.ran_out:
                self._act()
            with self._changed:
                self._running &= time.monotonic() < self._zero_s  # it acts once
