from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from drivers import slide, supervision
from drivers.canopen import can_link, drive, nodes, sdo, slcan_bus
from drivers.canopen import rail as canopen_rail
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.canopen.rail_bed import BedRail, RailBed, RailTime


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
def bed(peer: CanPeer, time: RailTime) -> Iterator[RailBed]:
    with closing(RailBed(peer, time, BedRail)) as bed:
        yield bed


@pytest.fixture
def rail(bed: RailBed) -> BedRail:
    return bed.connect()
