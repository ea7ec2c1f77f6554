from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from drivers import supervision
from tests.drivers.leica.emscon_bed import EmsconBed, Quick
from tests.drivers.leica.emscon_peer import EmsconPeer
from tests.drivers.peers import Bed, WireTime, wire_time


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> WireTime:
    return wire_time(monkeypatch, supervision)


@pytest.fixture
def peer() -> Iterator[EmsconPeer]:
    with EmsconPeer() as peer:
        yield peer


@pytest.fixture
def bed(peer: EmsconPeer, time: WireTime) -> Iterator[EmsconBed]:
    with closing(Bed(peer, time, Quick)) as bed:
        yield bed


@pytest.fixture
def tracker(bed: EmsconBed) -> Quick:
    return bed.connect()
