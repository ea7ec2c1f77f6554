"""The rail of the simulated cell on its bus: gateway, drive and strip sensor, in one thread.

Drive and sensor stay as they are when a client leaves; only the gateway's channel is new for the
next one, and heartbeats that a fault has silenced are heard again. Heartbeats and wire deadlines
run in real time, the slide in plant time: a SYNC or an SDO read looks at the slide once, before the
nodes answer it. In stepped time nobody looks at a slide whose master has died, so a drive that
brakes by itself is looked at until it stands.
"""

from __future__ import annotations

from functools import partial

from fakes.canopen.rail_drive import NODE, RailDrive
from fakes.canopen.slave import HEADER, SYNC_COB_ID, CanopenSlave, abort_reply
from fakes.canopen.slcan_gateway import BusThread, SlcanGateway, is_serial
from fakes.faults import Faults, Value
from fakes.site import Site
from fakes.strips.wire import STRIP_NODE, RailStrip, StripBus, StripLine, strip_wire
from fakes.time import PlantTime
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import Cell

HEARTBEATS = range(0x700, 0x780)
# Values of the faults whose own value only says that they strike.
DEFAULT_FAULT, DEFAULT_EMERGENCY, DEFAULT_ABORT = 0x8611, 0x7305, 0x08000022


class RailServer:
    """Serves the rail as slcan over TCP on a port, 0 for one that the system chooses."""

    def __init__(
        self,
        rail: RailTruth,
        faults: Faults,
        cell: Cell,
        time: PlantTime,
        *,
        port: int = 0,
        serial: bool = False,
        line: StripLine | StripBus | None = None,
    ) -> None:
        """``serial``: the gateway's wire. ``line`` is the strip's where that is not on the bus."""
        self._rail, self._faults, self._time = rail, faults, time
        self._gateway = SlcanGateway(faults, self._open, self._receive, port=port, serial=serial)
        self._drive = RailDrive(rail, faults, cell.rail, self._transmit)
        self._line, self._stated = line, cell.rail.options
        self._strip = None if line else RailStrip(rail.poll(), faults, self._transmit)
        self._nodes: dict[int, CanopenSlave] = {self._drive.node: self._drive}
        if self._strip is not None:
            self._nodes[self._strip.node] = self._strip
        self._slide_moves = False
        self._booted = False
        self._silent: set[int] = set()
        self._delay_s = 0.0
        self._late: list[tuple[float, int, bytes]] = []
        self._bus = BusThread("rail server", self._gateway, self._wait_s, self._tick)

    @property
    def address(self) -> dict[str, object]:
        """Return the channel, as an option of the driver."""
        of_strip = {} if self._line is None else self._line.address
        return self._gateway.address(self._stated) | of_strip

    def restore(self) -> None:
        """Leave the bus as it is: the driver resets a drive's fault."""

    @property
    def port(self) -> int:
        """Return the TCP port on 127.0.0.1."""
        return self._gateway.port

    def start(self) -> None:
        """Begin to serve."""
        self._bus.start()
        if self._line is not None:
            self._line.start()

    def close(self) -> None:
        """Switch the bus off and return when the thread has ended."""
        if self._line is not None:
            self._line.close()
        self._bus.close()

    # -- time ---------------------------------------------------------------------------------

    def _wait_s(self) -> float:
        due_s = min(node.next_s() for node in self._nodes.values())
        due_s = min([due_s, *(late[0] for late in self._late)])
        look_period_s = 0.01
        idle_s = 0.5
        longest_s = look_period_s if self._watches() else idle_s
        return min(max(0.0, due_s - self._bus.now_s()), longest_s)

    def _watches(self) -> bool:
        """Whether the slide must be looked at although no client asks."""
        if self._drive.stopping or (self._slide_moves and not self._drive.moving):
            return True
        cyclic = any(node.cyclic() for node in self._nodes.values())
        return self._drive.moving and (cyclic or not self._time.stepped)

    def _tick(self, now_s: float) -> None:
        if self._watches():
            self._look(now_s)
        for node in self._nodes.values():
            node.tick(now_s)
        due = [late for late in self._late if late[0] <= now_s]
        for late in due:
            self._late.remove(late)
            self._gateway.send(late[1], late[2])

    def _look(self, now_s: float) -> None:
        slide = self._rail.poll()
        self._slide_moves = slide.moving
        self._strike(now_s, slide.moving)
        self._drive.observe(slide)
        if self._strip is not None:
            self._strip.observe(slide)

    # -- frames -------------------------------------------------------------------------------

    def _open(self) -> None:
        self._silent.clear()
        if not self._booted:
            self._booted = True
            for node in self._nodes.values():
                node.boot(self._bus.now_s())

    def _receive(self, cob_id: int, data: bytes) -> None:
        now_s = self._bus.now_s()
        self._delay_s = 0.0
        sdo_requests = (0x600 + NODE, 0x600 + STRIP_NODE)
        sdo_read = b"\x40"
        if cob_id == SYNC_COB_ID:
            self._delay_s = self._faults.number("rail.late_tpdo") or 0.0
            if self._strip is not None:
                self._strip.strike()
            self._drive.dither()
            self._look(now_s)
        elif cob_id in sdo_requests:
            if data[:1] == sdo_read:
                self._look(now_s)
            if self._spoilt(cob_id, data):
                return
        for node in self._nodes.values():
            node.receive(cob_id, data, now_s)
        self._delay_s = 0.0

    def _transmit(self, cob_id: int, data: bytes) -> None:
        if cob_id in HEARTBEATS and not self._beats(cob_id & 0x7F, boot_up=data == b"\0"):
            return
        twin = self._faults.number("rail.second_node")
        if twin is not None and cob_id in (0x580 + twin, 0x700 + twin):
            self._gateway.send(cob_id, data)
        if self._delay_s:
            self._late.append((self._bus.now_s() + self._delay_s, cob_id, data))
        else:
            self._gateway.send(cob_id, data)

    # -- faults -------------------------------------------------------------------------------

    def _spoilt(self, cob_id: int, data: bytes) -> bool:
        """Whether an SDO request is answered otherwise than by its node."""
        if self._faults.take("rail.sdo_timeout") is not None:
            return True
        code = self._faults.take("rail.sdo_abort")
        if code is not None and len(data) == 8:
            _, index, sub = HEADER.unpack_from(data)
            reply = abort_reply(index, sub, _number(code, DEFAULT_ABORT))
            self._transmit(cob_id - 0x80, reply)
            return True
        self._delay_s = self._faults.number("rail.late_reply") or 0.0
        return False

    def _strike(self, now_s: float, moving: bool) -> None:
        """Let the faults of a moving slide happen, or those that are set to strike at rest."""
        take = partial(self._faults.take, moving=moving)
        code = take("rail.emcy")
        if code is not None:
            self._drive.emergency(_number(code, DEFAULT_EMERGENCY), 0)
        code = take("rail.fault")
        if code is not None:
            self._drive.fail(_number(code, DEFAULT_FAULT))
        switch = take("rail.limit_switch")
        if switch is not None:
            self._drive.trip_limit(int(switch))
        node = take("rail.node_reset")
        if node is not None:
            self._reset(_number(node, NODE), now_s)
        if take("rail.vanish") is not None:
            self._gateway.close()

    def _reset(self, number: int, now_s: float) -> None:
        """Reboot a node, where this bus has it."""
        self._silent.discard(number)
        if (node := self._nodes.get(number)) is not None:
            node.reset(now_s)

    def _beats(self, node: int, *, boot_up: bool) -> bool:
        if boot_up:
            return True
        lost = self._faults.take("rail.heartbeat_loss")
        if lost is not None:
            self._silent.add(_number(lost, NODE))
        return node not in self._silent


def _number(value: Value, default: int) -> int:
    return default if value is True else int(value)


def serve(site: Site, port: int) -> RailServer:
    """Return the rail of a simulated cell on its bus; raises `SettingsError` without a slide."""
    rail = site.slide()
    options = site.cell.rail.options
    stated, serial = options.get("strip"), is_serial(options.get("channel")) and not port
    line = strip_wire(rail, site.faults, dict(stated)) if stated else None
    return RailServer(rail, site.faults, site.cell, site.time, port=port, serial=serial, line=line)
