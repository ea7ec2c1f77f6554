"""The lines of one client: whole lines in, whole lines out, on a socket or a serial line."""

from __future__ import annotations

import re
import socket
import time
from typing import Protocol

from fakes.faults import Faults
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

    def answer(self, line: bytes, faults: Faults) -> None:
        """Send a line behind those kept before; a fault keeps it, too, or has it sent in two."""
        if faults.take("tracker.late_result") is not None:
            self.late.append(line)
            return
        self.say_late()
        if faults.take("tracker.split_packet") is not None:
            self._segments.send(line[:5])
            time.sleep(0.02)  # so that both halves are segments of their own
            line = line[5:]
        self.say(line)

    def say_late(self) -> None:
        """Send the lines that were kept."""
        for late in self.late:
            self.say(late)
        self.late.clear()

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
