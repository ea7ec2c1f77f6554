"""How bytes leave a device's server: now and then late, and now and then in two segments.

Real devices do both, and TCP promises neither promptness nor whole packets. The turns depend on
how often was sent over the connection, so they are the same in each run.
"""

from __future__ import annotations

import socket
import threading
import time
from typing import Protocol

from fakes.faults import Faults

RECEIVE = 4096
LATE_EVERY, LATE_S = 47, 0.001
SPLIT_EVERY = 7


class Client(Protocol):
    """A socket, or what sends like one."""

    def sendall(self, data: bytes, /) -> None:
        """Send all of ``data``."""


class Segments:
    """The sending side of one connection."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.sent = 0

    def send(self, data: bytes) -> None:
        """Send ``data``; raises `OSError`."""
        self.sent += 1
        if self.sent % LATE_EVERY == 0:
            time.sleep(LATE_S)
        apart_every, apart_s = 3 * SPLIT_EVERY, 0.0005  # so that each half is read by itself
        if self.sent % SPLIT_EVERY == 0 and len(data) > 1:
            cut = 1 + self.sent % (len(data) - 1)
            self._client.sendall(data[:cut])
            data = data[cut:]
            if self.sent % apart_every == 0:
                time.sleep(apart_s)
        self._client.sendall(data)


class Answers:
    """The sending side of a robot's server: an answer as its faults want it, else by `Segments`."""

    def __init__(self, faults: Faults, closing: threading.Event) -> None:
        """``closing`` ends a wait for a late answer."""
        self._faults, self._closing = faults, closing

    def send(self, client: socket.socket, segments: Segments, answer: bytes) -> bool:
        """Send an answer; return whether the client stays connected."""
        take = self._faults.take
        if take("robot.idle_close") is not None:
            return False
        if take("robot.half_open") is not None:
            client.settimeout(None)
            while client.recv(RECEIVE):  # nothing comes of it until the client has gone
                pass
            return False
        if take("robot.no_reply") is not None:
            return True
        late_s = self._faults.number("robot.late_reply")
        if late_s is not None:
            self._closing.wait(late_s)
        if take("robot.split_reply") is not None:
            client.sendall(answer[: len(answer) // 2])
            self._closing.wait(0.02)  # so that both halves are segments of their own
            answer = answer[len(answer) // 2 :]
        segments.send(answer)
        return True
