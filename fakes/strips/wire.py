"""The wire of a strip that is not on its drive's: a serial line, or a CAN bus of its own."""

from __future__ import annotations

from fakes.canopen.rail_strip import NODE, RailStrip
from fakes.canopen.slave import SYNC_COB_ID
from fakes.canopen.slcan_gateway import BusThread, SlcanGateway, is_serial
from fakes.faults import Faults
from fakes.site import Site
from fakes.strips.line import StripLine
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.settings import SettingsError

# Faults of a gateway are those of the drive's bus; here the sensor's strike, and its silence.


class StripBus:
    """Serves one strip behind a gateway: on TCP, or on the serial line that its channel names."""

    def __init__(
        self, rail: RailTruth, faults: Faults, options: dict[str, object], *, port: int = 0
    ) -> None:
        self._rail, self._faults, self._options = rail, faults, options
        serial = is_serial(options.get("channel")) and not port
        self._gateway = SlcanGateway(Faults(), self._boot, self._hear, port=port, serial=serial)
        self._strip = RailStrip(rail.poll(), faults, self._gateway.send)
        self._booted = False
        self._bus = BusThread("strip bus", self._gateway, self._wait_s, self._strip.tick)

    @property
    def address(self) -> dict[str, object]:
        """Return the channel, as options of the driver."""
        return {"strip": self._options | self._gateway.address(self._options)}

    def start(self) -> None:
        """Begin to serve."""
        self._bus.start()

    def restore(self) -> None:
        """Leave the sensor as it is: it has nothing to put right."""

    def close(self) -> None:
        """Stop serving."""
        self._bus.close()

    def _wait_s(self) -> float:
        idle_s = 0.5
        return min(max(0.0, self._strip.next_s() - self._bus.now_s()), idle_s)

    def _boot(self) -> None:
        if not self._booted:
            self._booted = True
            self._strip.boot(self._bus.now_s())

    def _hear(self, cob_id: int, data: bytes) -> None:
        of_node = (SYNC_COB_ID, 0x600 + NODE)
        if cob_id in of_node and self._faults.take("rail.strip_silent") is not None:
            return
        if cob_id == SYNC_COB_ID:
            self._strip.strike()
            self._strip.observe(self._rail.poll())
        self._strip.receive(cob_id, data, self._bus.now_s())


def strip_wire(
    rail: RailTruth, faults: Faults, stated: dict[str, object], *, port: int = 0
) -> StripLine | StripBus:
    """Return what serves the strip whose options a cell file states."""
    if stated.get("driver") == "canopen":
        return StripBus(rail, faults, stated, port=port)
    return StripLine(rail, faults, stated, port=port)


def serve(site: Site, port: int) -> StripLine | StripBus:
    """Return the strip of a cell whose slide is the robot's axis; raises `SettingsError`."""
    rail = site.plant.rail
    if not isinstance(rail, RailTruth):
        raise SettingsError("rail", ["this cell has no slide to simulate"])
    return strip_wire(rail, site.faults, dict(site.cell.rail.options.get("strip", {})), port=port)
