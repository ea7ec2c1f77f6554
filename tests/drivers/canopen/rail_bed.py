"""The rail's driver on a simulated bus of its own, in time that passes by its waits."""

from __future__ import annotations

import contextlib
import select
from collections.abc import Iterator
from typing import Any

import pytest

from drivers import standstill, supervision
from drivers.canopen import can_link, drive, nodes, sdo, slcan_bus
from drivers.canopen import rail as canopen_rail
from drivers.canopen.rail import CanopenRail
from hilcell.ports import Clock, DeviceError
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.peers import A_LOOK_S, WireTime

BEAT, START = (0x77F, b"\x05"), (0x000, b"\x01")


class RailTime(WireTime):
    """The time of a CAN link, too, on which a look is one that finds nothing."""

    def __init__(self, peer: CanPeer) -> None:
        super().__init__()
        self._peer = peer

    def now_s(self) -> float:
        """Return the cell's time: a slide takes its own, however seldom it is looked at."""
        return super().now_s() + self._peer.axis.passed_s

    def silence(self, a_look_s: float = A_LOOK_S) -> None:
        super().silence(a_look_s)
        can_link.PAUSE_S = a_look_s

    def select(
        self, read: list[int], write: list[int], failed: list[int], limit_s: float
    ) -> tuple[list[int], list[int], list[int]]:
        """Look at a bus: it is silent when its nodes have dealt with all that they were sent."""
        if not any(found := select.select(read, write, failed, limit_s)) and limit_s:
            self._peer.settle()
            found = select.select(read, write, failed, 0.0)
        return found


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch, peer: CanPeer) -> RailTime:
    time = RailTime(peer)
    for module, name, value in (
        (drive.Drive, "STALL_S", 0.3),
        (standstill.Standing, "SETTLE_S", 0.3),
        (nodes, "FIND_S", 0.5),
        (nodes, "OPERATIONAL_S", 0.5),
        (nodes, "START_PERIOD_S", 0.1),
        (canopen_rail.Release, "RELEASE_S", 0.5),
        (sdo, "REPLY_S", 0.1),
        (sdo.SdoChannel, "LATE_S", 0.15),
        (can_link, "PAUSE_S", 0.0),
        (supervision, "time", time),
        (canopen_rail, "time", time),
        (slcan_bus, "select", time),
    ):
        monkeypatch.setattr(module, name, value)
    return time


def rail_for(peer: CanPeer, clock: Clock, **options: Any) -> CanopenRail:
    values: dict[str, Any] = {
        "channel": peer.channel,
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
        "standstill_dwell_s": 0.05,
    }
    return CanopenRail(CanopenRail.Options(**(values | options)), clock)


@contextlib.contextmanager
def connected(peer: CanPeer, time: RailTime, **options: Any) -> Iterator[CanopenRail]:
    """Yield a connected rail; some tests have killed its link, or silenced its nodes."""
    rail = rail_for(peer, time, **options)
    rail.connect()
    try:
        yield rail
    finally:
        time.silence()
        with contextlib.suppress(DeviceError):
            rail.close()


def holding(peer: CanPeer, time: RailTime, **options: Any) -> CanopenRail:
    """Return a rail that holds the slide with its power on."""
    rail = rail_for(peer, time, **options)
    rail.connect()
    rail.move_to(600.0)
    return rail


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        yield peer


@pytest.fixture
def rail(peer: CanPeer, time: RailTime) -> Iterator[CanopenRail]:
    with connected(peer, time) as rail:
        yield rail
