"""How a robot's server sends an answer: as its faults want it, else as `segments` says."""

from __future__ import annotations

import socket
import threading

from fakes.faults import Faults
from fakes.wires.segments import Segments

RECEIVE = 4096


class Answers:
    """The sending side of one server's connections."""

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
