"""Where the worker waits while a run is paused: between two points, with nothing under way."""

from __future__ import annotations

import threading
from collections.abc import Callable

REST_S = 0.02


class PauseGate:
    """Open at first. ``reached`` is called when the worker stands before the closed gate.

    A gate that opens and closes again at once must find the worker either resting or gone, never
    in between, and an open gate is never reported as reached; so a thread that changes or reports
    either holds the lock. ``reached`` must not wait.
    """

    def __init__(self, reached: Callable[[], None]) -> None:
        self._reached = reached
        self._lock = threading.Lock()
        self._open = threading.Event()
        self._open.set()
        self._resting = False

    @property
    def closed(self) -> bool:
        """Whether the worker may not pass."""
        return not self._open.is_set()

    @property
    def resting(self) -> bool:
        """Whether the worker waits here."""
        return self._resting

    def close(self) -> None:
        """Let the worker wait when it comes here next."""
        with self._lock:
            self._open.clear()
            if self._resting:
                self._reached()

    def open(self) -> None:
        """Let the worker pass."""
        with self._lock:
            self._open.set()

    def passage(self, at_rest: Callable[[], None]) -> None:
        """Wait while the gate is closed, calling ``at_rest`` all the while; it may raise."""
        while not self._passed():
            at_rest()
            self._open.wait(REST_S)

    def _passed(self) -> bool:
        with self._lock:
            if self._open.is_set():
                self._resting = False
            elif not self._resting:
                self._resting = True
                self._reached()
            return not self._resting
