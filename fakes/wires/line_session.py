"""The lines of one client: whole lines in, whole lines out, on a socket or a serial line."""

from __future__ import annotations

import re
import socket
from typing import Protocol

from fakes.wires.segments import Client, Segments

RECEIVE = 4096


class Wire(Client, Protocol):
    """Both ways of one connection."""

    def receive(self, timeout_s: float | None) -> bytes:
        """Return bytes, none after the timeout; raises `OSError` at the end."""


class LineSession:
    """Whole lines in, whole lines out; ``late`` are kept until the next answer."""

    def __init__(self, wire: Wire) -> None:
        self._wire, self._segments = wire, Segments(wire)
        self._pending = b""
        self.lines: list[bytes] = []
        self.late: list[bytes] = []

    def say(self, line: bytes) -> None:
        """Send a line."""
        self._segments.send(line + b"\r\n")

    def raw(self, data: bytes) -> None:
        """Send bytes."""
        self._segments.send(data)

    def line(self, timeout_s: float | None) -> bytes | None:
        """Return the next line that is not empty, None after the timeout."""
        if not self.lines:
            self.receive(timeout_s)
        return self.lines.pop(0) if self.lines else None

    def receive(self, timeout_s: float | None) -> None:
        """Take in bytes."""
        *lines, self._pending = re.split(rb"[\r\n]", self._pending + self._wire.receive(timeout_s))
        self.lines += [line for line in lines if line]


class Connection:
    """A client's TCP connection."""

    def __init__(self, client: socket.socket) -> None:
        self._client, self.sendall = client, client.sendall

    def receive(self, timeout_s: float | None) -> bytes:
        """Return bytes, none after the timeout; raises `OSError` at the end."""
        self._client.settimeout(timeout_s)
        try:
            data = self._client.recv(RECEIVE)
        except TimeoutError:
            return b""
        finally:
            self._client.settimeout(None)
        if not data:
            raise ConnectionAbortedError
        return data
