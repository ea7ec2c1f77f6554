from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from drivers import slide, supervision
from drivers.canopen import can_link, drive, nodes, sdo, slcan_bus
from drivers.canopen import rail as canopen_rail
from drivers.canopen.rail import CanopenRail
from hilcell.ports import DeviceError
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.canopen.rail_bed import Connect, RailTime, rail_for


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        yield peer


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch, peer: CanPeer) -> RailTime:
    time = RailTime(peer)
    for module, name, value in (
        (drive.Drive, "STALL_S", 0.3),
        (slide.SlideMonitor, "SETTLE_S", 0.3),
        (nodes, "FIND_S", 0.5),
        (nodes, "OPERATIONAL_S", 0.5),
        (nodes, "START_PERIOD_S", 0.1),
        (canopen_rail.Release, "RELEASE_S", 0.5),
        (sdo, "REPLY_S", 0.1),
        (sdo.SdoChannel, "LATE_S", 0.15),
        (can_link.LinkTime, "PAUSE_S", 0.0),
        (supervision, "time", time),
        (canopen_rail, "time", time),
        (slcan_bus, "select", time),
    ):
        monkeypatch.setattr(module, name, value)
    return time


@pytest.fixture
def connect(peer: CanPeer, time: RailTime) -> Iterator[Connect]:
    """Connect rails; behind the test they are closed, as far as their links still work."""
    rails: list[CanopenRail] = []

    def connected(**options: Any) -> CanopenRail:
        rails.append(rail_for(peer, time, **options))
        rails[-1].connect()
        return rails[-1]

    yield connected
    time.silence()
    for rail in rails:
        with suppress(DeviceError):
            rail.close()


@pytest.fixture
def rail(connect: Connect) -> CanopenRail:
    return connect()
