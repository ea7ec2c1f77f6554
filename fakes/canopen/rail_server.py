"""The rail of the simulated cell on its bus: gateway, drive and strip sensor, in one thread.

Drive and sensor stay as they are when a client leaves; only the gateway's channel is new for the
next one, and heartbeats that a fault has silenced are heard again. Heartbeats and wire deadlines
run in real time, the slide in plant time: a SYNC or an SDO read looks at the slide once, before the
nodes answer it. In stepped time nobody looks at a slide whose master has died, so a drive that
brakes by itself is looked at until it stands.
"""

from __future__ import annotations

import math
from functools import partial

from fakes.canopen.rail_drive import NODE, RailDrive
from fakes.canopen.slave import HEADER, SYNC_COB_ID, Abort, abort_reply
from fakes.canopen.slcan_gateway import BusServer
from fakes.faults import Faults
from fakes.site import Site
from fakes.strips.wire import STRIP_NODE, RailStrip, StripBus, StripLine, strip_wire
from fakes.time import PlantTime
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import Cell


class RailServer(BusServer):
    """Serves the rail as slcan over TCP on a port, 0 for one that the system chooses."""

    def __init__(
        self,
        rail: RailTruth,
        faults: Faults,
        cell: Cell,
        time: PlantTime,
        *,
        port: int = 0,
        line: StripLine | StripBus | None = None,
    ) -> None:
        """``line`` is the strip's where that is not on the bus."""
        super().__init__("rail server", faults, cell.rail.options, port)
        if line is not None:
            self._listeners, self.address = (line,), self.address | line.address
        self._rail, self._faults, self._time = rail, faults, time
        self._drive = RailDrive(rail, faults, cell.rail, self._transmit)
        self._strip = None if line else RailStrip(rail.poll(), faults, self._transmit)
        self._nodes[NODE] = self._drive
        if self._strip is not None:
            self._nodes[STRIP_NODE] = self._strip
        self._slide_moves = False
        self._silent: set[int] = set()
        self._delay_s = 0.0
        self._late: list[tuple[float, int, bytes]] = []

    def _wait_s(self) -> float:
        look_period_s = 0.01
        longest_s = look_period_s if self._watches() else self.IDLE_S
        late_s = min((late[0] for late in self._late), default=math.inf)
        return min(super()._wait_s(), max(0.0, late_s - self.now_s()), longest_s)

    def _watches(self) -> bool:
        """Whether the slide must be looked at although no client asks."""
        if self._drive.stopping or (self._slide_moves and not self._drive.moving):
            return True
        cyclic = any(node.cyclic() for node in self._nodes.values())
        return self._drive.moving and (cyclic or not self._time.stepped)

    def _tick(self, now_s: float) -> None:
        if self._watches():
            self._look(now_s)
        super()._tick(now_s)
        for late in [late for late in self._late if late[0] <= now_s]:
            self._late.remove(late)
            self._gateway.send(late[1], late[2])

    def _look(self, now_s: float) -> None:
        slide = self._rail.poll()
        self._slide_moves = slide.moving
        self._strike(now_s, slide.moving)
        self._drive.observe(slide)
        if self._strip is not None:
            self._strip.observe(slide)

    def _open(self) -> None:
        self._silent.clear()
        super()._open()

    def _receive(self, cob_id: int, data: bytes) -> None:
        self._delay_s = 0.0
        sdo_requests = (0x600 + NODE, 0x600 + STRIP_NODE)
        sdo_read = b"\x40"
        if cob_id == SYNC_COB_ID:
            self._delay_s = self._faults.number("rail.late_tpdo") or 0.0
            if self._strip is not None:
                self._strip.strike()
            self._drive.dither()
            self._look(self.now_s())
        elif cob_id in sdo_requests:
            if data[:1] == sdo_read:
                self._look(self.now_s())
            if self._spoilt(cob_id, data):
                return
        super()._receive(cob_id, data)
        self._delay_s = 0.0

    def _transmit(self, cob_id: int, data: bytes) -> None:
        heartbeats = range(0x700, 0x780)
        if cob_id in heartbeats and not self._beats(cob_id & 0x7F, boot_up=data == b"\0"):
            return
        twin = self._faults.number("rail.second_node")
        if twin is not None and cob_id in (0x580 + twin, 0x700 + twin):
            self._gateway.send(cob_id, data)
        if self._delay_s:
            self._late.append((self.now_s() + self._delay_s, cob_id, data))
        else:
            self._gateway.send(cob_id, data)

    def _number(self, fault: str, usual: int, *, moving: bool = True) -> int | None:
        """Return the value of a fault that strikes; ``usual`` where its own says no more."""
        value = self._faults.take(fault, moving=moving)
        return None if value is None else usual if value is True else int(value)

    def _spoilt(self, cob_id: int, data: bytes) -> bool:
        """Whether an SDO request is answered otherwise than by its node."""
        if self._faults.take("rail.sdo_timeout") is not None:
            return True
        code = self._number("rail.sdo_abort", Abort.DEVICE_STATE)
        if code is not None and len(data) == 8:
            _, index, sub = HEADER.unpack_from(data)
            self._transmit(cob_id - 0x80, abort_reply(index, sub, code))
            return True
        self._delay_s = self._faults.number("rail.late_reply") or 0.0
        return False

    def _strike(self, now_s: float, moving: bool) -> None:
        """Let the faults of a moving slide happen, or those that are set to strike at rest."""
        take = partial(self._number, moving=moving)
        if (code := take("rail.emcy", 0x7305)) is not None:
            self._drive.emergency(code, 0)
        if (code := take("rail.fault", 0x8611)) is not None:
            self._drive.fail(code)
        if (switch := take("rail.limit_switch", 1)) is not None:
            self._drive.trip_limit(switch)
        if (number := take("rail.node_reset", NODE)) is not None:
            self._silent.discard(number)
            if (node := self._nodes.get(number)) is not None:  # which this bus has
                node.reset(now_s)
        if take("rail.vanish", 1) is not None:
            self._gateway.close()

    def _beats(self, node: int, *, boot_up: bool) -> bool:
        if boot_up:
            return True
        if (lost := self._number("rail.heartbeat_loss", NODE)) is not None:
            self._silent.add(lost)
        return node not in self._silent


def serve(site: Site, port: int) -> RailServer:
    """Return the rail of a simulated cell on its bus; raises `SettingsError` without a slide."""
    rail, stated = site.slide(), site.cell.rail.options.get("strip")
    line = strip_wire(rail, site.faults, dict(stated)) if stated else None
    return RailServer(rail, site.faults, site.cell, site.time, port=port, line=line)
