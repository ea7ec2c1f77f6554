"""One CAN bus in a thread: its gateway is served, its nodes do what is due."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from fakes.canopen.slcan_gateway import SlcanGateway
from fakes.time import PAUSE_S, OwnTime


class BusThread:
    """Runs from `start` to `close`; ``wait_s`` says how long nothing is due, ``tick`` does it."""

    def __init__(
        self,
        name: str,
        gateway: SlcanGateway,
        wait_s: Callable[[], float],
        tick: Callable[[float], None],
    ) -> None:
        self._gateway, self._wait_s, self._tick = gateway, wait_s, tick
        self.now_s = OwnTime().now_s
        self._closing = threading.Event()
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=name)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """Switch the bus off and return when the thread has ended."""
        self._closing.set()
        with suppress(OSError):
            self._waker.send(b"\0")
        if self._thread.is_alive():
            self._thread.join()
        self._gateway.close()
        self._wake.close()
        self._waker.close()

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._gateway.serve(min(self._wait_s(), PAUSE_S), self._wake)
                self._tick(self.now_s())
                self._gateway.flush()
        finally:
            # Should a fault's value make no sense here, clients see the end, not silence.
            self._gateway.close()
