"""The wall clock of a real cell, whose every wait ends within 20 ms of a stop."""

from __future__ import annotations

import time
from threading import Event

from hilcell.ports import Stopped


class WallClock:
    """Cell time is real time."""

    def __init__(self, stop: Event) -> None:
        self._stop = stop

    def now_s(self) -> float:
        """Return monotonic seconds."""
        return time.monotonic()

    def pc_s(self) -> float:
        """Return monotonic seconds."""
        return time.monotonic()

    def wait(self, duration_s: float) -> None:
        """Wait; raise `Stopped` at once when a stop is asked for."""
        self._stop.wait(duration_s)
        self.check()

    def check(self) -> None:
        """Raise `Stopped` if a stop was asked for."""
        if self._stop.is_set():
            raise Stopped("a stop was asked for")
