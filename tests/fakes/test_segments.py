from __future__ import annotations

from types import SimpleNamespace

import pytest

from fakes import wires
from fakes.wires import Segments


class Wire:
    """Keeps what each segment carries."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []

    def sendall(self, data: bytes) -> None:
        self.pieces.append(data)


def sent(count: int, size: int = 20) -> list[bytes]:
    wire = Wire()
    segments_of = Segments(wire.sendall)
    for number in range(count):
        segments_of.send(bytes([number]) * size)
    return wire.pieces


@pytest.fixture(autouse=True)
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(wires, "time", SimpleNamespace(sleep=found.append))
    return found


def test_nothing_is_lost_and_every_seventh_packet_is_split() -> None:
    pieces = sent(70)
    assert b"".join(pieces) == b"".join(bytes([number]) * 20 for number in range(70))
    assert len(pieces) == 70 + 70 // Segments.SPLIT_EVERY
    assert sent(70) == pieces
    assert len({len(piece) for piece in pieces}) > 5  # cut at many places


def test_the_delay_is_far_below_a_millisecond_on_average(pauses: list[float]) -> None:
    sent(2 * Segments.LATE_EVERY)
    assert pauses.count(Segments.LATE_S) == 2
    assert sum(pauses) / (2 * Segments.LATE_EVERY) < 1e-4
