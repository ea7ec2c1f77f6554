"""The rail's driver on a simulated bus of its own, in time that passes by its waits."""

from __future__ import annotations

import select
from typing import Any

from drivers.canopen import can_link
from drivers.canopen.rail import CanopenRail
from hilcell.ports import Clock
from tests.drivers.canopen.can_peer import CanPeer
from tests.drivers.peers import A_LOOK_S, Bed, WireTime


class RailTime(WireTime):
    """The time of a CAN link, too, on which only a poll that reads nothing takes time."""

    def __init__(self, peer: CanPeer) -> None:
        super().__init__()
        self._peer = peer

    def now_s(self) -> float:
        """Return the cell's time: a slide takes its own, however seldom it is polled."""
        return super().now_s() + self._peer.axis.passed_s

    def silence(self, a_look_s: float = A_LOOK_S) -> None:
        super().silence(a_look_s)
        can_link.LinkTime.PAUSE_S = a_look_s

    def select(
        self, read: list[int], write: list[int], failed: list[int], limit_s: float
    ) -> tuple[list[int], list[int], list[int]]:
        """Poll a bus: it is silent when its nodes have handled all that they were sent."""
        if not any(ready := select.select(read, write, failed, limit_s)) and limit_s:
            self._peer.settle()
            ready = select.select(read, write, failed, 0.0)
        return ready


class BedRail(CanopenRail):
    """A rail at its peer."""

    def __init__(
        self, peer: CanPeer, time: WireTime, clock: Clock | None = None, **options: Any
    ) -> None:
        values: dict[str, Any] = {
            "channel": peer.channel,
            "travel_min_mm": 0.0,
            "travel_max_mm": 3000.0,
            "speed_mm_s": 250.0,
            "acceleration_mm_s2": 200.0,
            "standstill_dwell_s": 0.05,
        }
        super().__init__(CanopenRail.Options(**(values | options)), clock or time)
        self.peer, self.time = peer, time


class RailBed(Bed[CanPeer, BedRail]):
    def moved(self, **options: Any) -> BedRail:
        """Return a rail that was moved: its drive has power."""
        rail = self.connect(**options)
        rail.move_to(600.0)
        return rail

    def close(self) -> None:
        self.time.silence()
        super().close()
