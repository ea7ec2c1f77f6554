"""A strip's sensor at the far end of a line, for tests: SIKO's service commands over TCP."""

from __future__ import annotations

import socket
from collections.abc import Callable

from tests.drivers.peers import Server


class StripPeer:
    """Answers ``A0``, ``A1``, ``A2``, ``Z`` and ``X``; ``spoil`` may change an answer."""

    def __init__(self) -> None:
        self.counts: Callable[[], int] = lambda: 110_042
        self.register = 0
        self.silent = False
        self.connections = 0
        self.spoil: Callable[[bytes, bytes], bytes] = lambda _command, answer: answer
        self.server = Server(self._serve)
        self.channel = f"socket://127.0.0.1:{self.server.port}"

    def __enter__(self) -> StripPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()

    def _serve(self, connection: socket.socket) -> None:
        self.connections += 1
        while command := connection.recv(1):
            if command == b"A":
                command += connection.recv(1)
            if not self.silent:
                connection.sendall(self.spoil(command, self._answer(command)))

    def _answer(self, command: bytes) -> bytes:
        texts = {b"A0": "MSAC501SN3-08Bit", b"A1": "V1.00-Nov 03 2015", b"A2": "001234567"}
        texts |= {b"Z": f"{self.counts():+08d}", b"X": f"0x{self.register:02x}"}
        return f"{texts[command]}>\r".encode("ascii")
