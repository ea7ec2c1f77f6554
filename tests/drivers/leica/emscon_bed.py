"""The driver of an emScon tracker at its peer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.leica.tracker_emscon import LeicaEmsconTracker
from hilcell.ports import DeviceError
from tests.drivers.leica.emscon_peer import EmsconPeer
from tests.drivers.peers import WireTime, refusal

POINT = np.array([4321.5, -250.25, 300.0])
SMR = "SMR 1.5in"


class Quick(LeicaEmsconTracker):
    REPLY_S = 0.3
    MOVE_S = 0.3
    RESULT_S = 0.2
    INITIALIZE_S = 0.5


Make = Callable[..., Quick]


def measuring(tracker: Quick, samples: int = 1) -> DeviceError:
    """Return the error of a measurement."""
    return refusal(lambda: tracker.measure(POINT, SMR, samples))


def punctual(
    monkeypatch: pytest.MonkeyPatch, tracker: Quick, peer: EmsconPeer, time: WireTime
) -> None:
    """Let no look take time while the peer has not answered yet, on however slow a PC."""
    link, before, asked = tracker._wire(), peer.answered, list[str]()
    send = link.send

    def counted(data: bytes, operation: str) -> None:
        asked.append(operation)
        send(data, operation)

    monkeypatch.setattr(link, "send", counted)
    time.busy = lambda: peer.answered < before + len(asked)
