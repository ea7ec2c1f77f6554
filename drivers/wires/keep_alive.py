"""A thread that asks something harmless of idle connections, so that the server keeps them.

The trap: KUKAVARPROXY drops a client after 30 s without a request, and a stop sent over a dropped
connection is lost. The thread keeps a failure that it finds; the device's next use raises it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

from hilcell.ports import HilcellError, Stopped

IDLE_S = 8.0
LOOK_S = 1.0
JOIN_S = 3.0


class Connection(Protocol):
    """One that knows when it was used last, by ``time.monotonic()``."""

    used_s: float


Kept = TypeVar("Kept", bound=Connection)


class KeepAlive(Generic[Kept]):
    """Calls ``ask`` with every connection that has been idle for `IDLE_S`."""

    def __init__(self, connections: Sequence[Kept], ask: Callable[[Kept], object]) -> None:
        self._connections, self._ask = connections, ask
        self._failure: HilcellError | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keep-alive", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Raise the error that broke a connection since the last look."""
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        """End the thread."""
        self._end.set()
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        try:
            while not self._end.wait(LOOK_S):
                self._ask_idle()
        except Stopped:
            return  # the run ends; nothing needs these connections any longer
        except HilcellError as error:
            self._failure = error

    def _ask_idle(self) -> None:
        for connection in self._connections:
            if time.monotonic() - connection.used_s > IDLE_S:
                self._ask(connection)
