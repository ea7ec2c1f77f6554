from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from drivers import supervision
from tests.drivers.leica.emscon_bed import SMR, Make, Quick
from tests.drivers.leica.emscon_peer import EmsconPeer
from tests.drivers.peers import WireTime, closed_behind, wire_time


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


@pytest.fixture
def make(peer: EmsconPeer, time: WireTime) -> Iterator[Make]:
    """Make trackers, not yet connected, which are closed behind the test."""

    def build(**options: Any) -> Quick:
        values: dict[str, Any] = {
            "host": "127.0.0.1",
            "port": peer.server.port,
            "reflector": SMR,
            "max_std_mm": 0.05,
            "find_radius_mm": 5.0,
            "reading_s": 0.1,
        }
        return Quick(Quick.Options(**(values | options)), time)

    yield from closed_behind(build)


@pytest.fixture
def tracker(make: Make) -> Quick:
    tracker = make()
    tracker.connect()
    return tracker
