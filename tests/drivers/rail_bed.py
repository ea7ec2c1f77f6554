"""The rail's driver on a simulated bus of its own, with short deadlines."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers import standing
from drivers.canopen import drive, node_watch, pdo, rail_setup, release, sdo
from drivers.canopen.rail import CanopenRail
from hilcell.clock import WallClock
from hilcell.ports import DeviceError
from tests.drivers.can_peer import (
    CanPeer,
)
from tests.drivers.peers import wall_clock


@pytest.fixture(autouse=True)
def short_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in (
        (drive, "STALL_S", 0.3),
        (drive, "POLL_S", 0.002),
        (standing, "POLL_S", 0.002),
        (release, "POLL_S", 0.002),
        (standing, "SETTLE_S", 0.3),
        (rail_setup, "OPERATIONAL_S", 0.5),
        (rail_setup, "START_PERIOD_S", 0.1),
        (release, "RELEASE_S", 0.5),
        (rail_setup, "FIND_S", 0.5),
        (pdo, "REPLY_S", 0.1),
        (node_watch, "HEARTBEAT_AGE_S", 0.6),
        (sdo, "REPLY_S", 0.1),
        (sdo, "LATE_S", 0.15),
    ):
        monkeypatch.setattr(module, name, value)


def rail_for(peer: CanPeer, clock: WallClock | None = None, **options: Any) -> CanopenRail:
    values: dict[str, Any] = {
        "channel": peer.channel,
        "travel_min_mm": 0.0,
        "travel_max_mm": 3000.0,
        "speed_mm_s": 250.0,
        "acceleration_mm_s2": 200.0,
        "standstill_dwell_s": 0.01,
    }
    return CanopenRail(CanopenRail.Options(**(values | options)), clock or wall_clock())


def holding(peer: CanPeer, standstill_dwell_s: float = 0.01) -> CanopenRail:
    """Return a rail that holds the slide with its power on."""
    rail = rail_for(peer, standstill_dwell_s=standstill_dwell_s)
    rail.connect()
    rail.move_to(600.0)
    return rail


BEAT, START = (0x77F, b"\x05"), (0x000, b"\x01")


@pytest.fixture
def peer() -> Iterator[CanPeer]:
    with CanPeer() as peer:
        yield peer


@pytest.fixture
def rail(peer: CanPeer) -> Iterator[CanopenRail]:
    rail = rail_for(peer)
    rail.connect()
    yield rail
    with contextlib.suppress(DeviceError):  # some tests have killed the link
        rail.close()


def soon(holds: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + 5
    while not holds() and time.monotonic() < deadline_s:
        threading.Event().wait(0.01)
    return holds()
