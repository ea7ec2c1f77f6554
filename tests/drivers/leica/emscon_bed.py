"""The driver of an emScon tracker at its peer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.ports import DeviceError
from tests.drivers.leica.emscon_peer import EmsconPeer
from tests.drivers.peers import Bed, WireTime, refusal

POINT = np.array([4321.5, -250.25, 300.0])
SMR = "SMR 1.5in"


class Quick(LeicaEmsconTracker):
    """A tracker at its peer, with short deadlines."""

    REPLY_S = 0.3
    MOVE_S = 0.3
    RESULT_S = 0.2
    INITIALIZE_S = 0.5

    def __init__(self, peer: EmsconPeer, time: WireTime, **options: Any) -> None:
        values: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": peer.server.port,
            "reflector": SMR,
            "max_std_mm": 0.05,
            "find_radius_mm": 5.0,
            "reading_s": 0.1,
        }
        super().__init__(self.Options(**(values | options)), time)
        self.peer, self.time = peer, time


EmsconBed = Bed[EmsconPeer, Quick]


def measuring(tracker: Quick, samples: int = 1) -> DeviceError:
    """Return the error of a measurement."""
    return refusal(lambda: tracker.measure(POINT, SMR, samples))


def punctual(monkeypatch: pytest.MonkeyPatch, tracker: Quick) -> None:
    """Let no look take time while the peer has not answered yet, on however slow a PC."""
    link, peer, asked = tracker._wire(), tracker.peer, list[str]()
    send, before = link.send, peer.answered

    def counted(data: bytes, operation: str) -> None:
        asked.append(operation)
        send(data, operation)

    monkeypatch.setattr(link, "send", counted)
    tracker.time.busy = lambda: peer.answered < before + len(asked)
