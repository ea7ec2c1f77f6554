"""How bytes leave a device's server: now and then late, and now and then in two segments.

Real devices do both, and TCP promises neither promptness nor whole packets. The turns depend on
how often was sent over the connection, so they are the same in each run.
"""

from __future__ import annotations

import time
from typing import Protocol

LATE_EVERY, LATE_S = 47, 0.001
SPLIT_EVERY = 7
APART_EVERY, APART_S = 3 * SPLIT_EVERY, 0.0005  # so that each half is read by itself


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
        if self.sent % SPLIT_EVERY == 0 and len(data) > 1:
            cut = 1 + self.sent % (len(data) - 1)
            self._client.sendall(data[:cut])
            data = data[cut:]
            if self.sent % APART_EVERY == 0:
                time.sleep(APART_S)
        self._client.sendall(data)
