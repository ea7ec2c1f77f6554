"""A laser tracker for tests: answers each command from a table, and lies on demand."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Sequence

import numpy as np

from tests.drivers.peers import Server
from tests.fakes.wires import exactly

NOT_READY, READY, CLOSING = (struct.pack("<III", 12, 8, change) for change in (25, 27, 998))
Answer = Callable[[bytes], Sequence[bytes]]


def reply(command: int, body: bytes = b"", status: int = 0) -> bytes:
    return struct.pack("<IIII", 16 + len(body), 0, command, status) + body


def failure(command: int, status: int) -> bytes:
    return struct.pack("<IIII", 16, 1, command, status)


def result(
    xyz: Sequence[float] | np.ndarray,
    *,
    std: float = 0.005,
    status: int = 0,
    air: Sequence[float] = (22.5, 1013.25, 45.0),
) -> bytes:
    values = (*xyz, std / 2, std / 2, std / 2, std, *[0.0] * 7, *air)
    return struct.pack("<IIIii17d", 156, 2, status, 0, 0, *values)


def reflector(total: int, number: int, name: str) -> bytes:
    field = name.encode("utf-16-le").ljust(64, b"\0")
    return reply(42, struct.pack("<iiId64s", total, number, 1, 19.05, field))


class EmsconPeer:
    """Measures the point to which it was sent; ``answers[command]`` overrides a reply."""

    def __init__(self) -> None:
        self.xyz: tuple[float, ...] = (0.0, 0.0, 0.0)
        self.settings: dict[int, bytes] = {
            13: struct.pack("<6d", *[0.0] * 6),
            15: struct.pack("<7d", *[0.0] * 6, 1.0),
            25: struct.pack("<i", 0),
            48: struct.pack("<9i", 2, 0, 0, 0, 1, 0, 0, 0, 0),
        }
        self.initialized = 5
        self.weather_monitor = 2
        self.commands: list[int] = []
        self.stopped = threading.Event()
        self.slice = 0
        self.answered = 0
        self.answers: dict[int, Answer] = {
            1: self._status,
            7: self._initialize,
            21: lambda _: [reply(21, struct.pack("<3d", 21.0, 1010.0, 40.0))],
            42: lambda _: [reflector(2, 4, "SMR 0.5in"), READY, reflector(2, 9, "SMR 1.5in")],
            49: lambda _: [reply(49), READY, result(self.xyz)],
            52: self._stop,
            55: self._go,
            63: lambda _: [reply(63), READY],
        }
        self.server = Server(self._serve)

    def __enter__(self) -> EmsconPeer:
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()

    def _serve(self, connection: socket.socket) -> None:
        while True:
            size, _kind, command = struct.unpack("<III", exactly(connection, 12))
            body = exactly(connection, size - 12)
            self.commands.append(command)
            data = b"".join(self.answers.get(command, self._set(command))(body))
            step = self.slice or max(1, len(data))
            for at in range(0, len(data), step):
                connection.sendall(data[at : at + step])
            self.answered += 1

    def _set(self, command: int) -> Answer:
        """Keep a setting under the number of its reading command."""
        pairs = {5: 6, 24: 25, 26: 27, 28: 29, 30: 31, 40: 41, 43: 44}

        def keep(body: bytes) -> list[bytes]:
            self.settings[pairs[command]] = body
            return [reply(command)]

        if command in pairs:
            return keep
        return lambda _: [reply(command, self.settings.get(command, b""))]

    def _status(self, _body: bytes) -> list[bytes]:
        values = (0, self.initialized, 3, 2, 3, 8, 900, self.weather_monitor, 0, 390793)
        return [reply(1, struct.pack("<IIIIiiiIii", *values))]

    def _initialize(self, _body: bytes) -> list[bytes]:
        self.initialized = 5
        return [NOT_READY, reply(7), READY]

    def _stop(self, _body: bytes) -> list[bytes]:
        self.stopped.set()
        return [reply(52)]

    def _go(self, body: bytes) -> list[bytes]:
        self.xyz = struct.unpack_from("<3d", body)
        return [NOT_READY, reply(55), READY]
