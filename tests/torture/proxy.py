"""A TCP proxy before a device: the network between engine and device, failing on demand."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from contextlib import suppress

PIECE = 65536
FLOOD = b"t" * 4096  # a line that never ends, a length that no packet has
RESET = struct.pack("ii", 1, 0)  # SO_LINGER: close by RST
GLUE_S = 0.004  # replies that come within this time leave as one


class Proxy:
    """Listens on a port of its own and hands bytes on; ``mode`` says how.

    ``pass``, ``blackhole`` (all is swallowed, nothing closed), ``flood``, ``slices`` (1 byte each),
    ``glue``, ``slow`` (each piece of an answer ``delay_s`` late).
    """

    def __init__(self, port: int) -> None:
        self._behind = port
        self.mode, self.delay_s = "pass", 0.0
        self._ended = False
        self._lock = threading.Lock()
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listening.getsockname()[1]
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def reset(self) -> None:
        """Break every connection by RST."""
        with self._lock:
            pairs, self._pairs = self._pairs, []
        for near, far in pairs:
            with suppress(OSError):
                near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            for each in (near, far):
                each.close()

    def close(self) -> None:
        """End."""
        self._ended = True
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.reset()
        for thread in self._threads:
            thread.join()

    def _accept(self) -> None:
        while not self._ended:
            try:
                near, _ = self._listening.accept()
                far = socket.create_connection(("127.0.0.1", self._behind))
            except OSError:
                return
            for each in (near, far):
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._pairs.append((near, far))
            thread = threading.Thread(target=self._pump, args=(near, far), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _pump(self, near: socket.socket, far: socket.socket) -> None:
        with suppress(OSError, ValueError), near, far:
            while not self._ended:
                ready, _, _ = select.select([near, far], [], [], 0.05)
                if self.mode == "flood":
                    near.sendall(FLOOD)
                for source in ready:
                    if self.mode == "glue" and source is far:
                        time.sleep(GLUE_S)
                    data = source.recv(PIECE)
                    if not data:
                        return
                    if self.mode not in ("blackhole", "flood"):
                        self._hand_on(data, near if source is far else far, answer=source is far)

    def _hand_on(self, data: bytes, to: socket.socket, *, answer: bool) -> None:
        if answer and self.mode == "slow":
            time.sleep(self.delay_s)
        if self.mode != "slices":
            to.sendall(data)
            return
        for byte in data:
            to.sendall(bytes((byte,)))
