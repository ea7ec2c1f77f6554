"""The simulated magnetic-strip sensor: CiA 406, absolute linear encoder, 100 counts/mm.

Absolute, so it needs no homing. Its reading flickers by a count to either side. A sensor without
its magnet goes on answering with the last position; only alarm bit 0 (6503h) and an EMCY show it.
"""

from __future__ import annotations

from collections.abc import Callable

from fakes.canopen.dictionary import Entry
from fakes.canopen.pdo import INVALID, Mapping, TransmitPdo
from fakes.canopen.slave import CanopenSlave, ErrorKind, NodeIdentity
from fakes.faults import Faults
from fakes.strips.line import StripSensor
from fakes.truth.rail_truth import RailState

NODE = 6
IDENTITY = NodeIdentity(0x00080196, "hilcell strip sensor (simulated)", 0x484, 0x406, 1, 2014002)


class RailStrip(CanopenSlave):
    """Node 6: says where the strip sees the slide."""

    SPEED_STEP = 10  # 6005:02, in 0.01 mm/s
    INT16 = range(-(1 << 15), 1 << 15)
    POSITION_ERROR = 1 << 0

    def __init__(
        self, slide: RailState, faults: Faults, send: Callable[[int, bytes], None]
    ) -> None:
        super().__init__(NODE, IDENTITY, send)
        self._sensor = StripSensor(slide, faults)
        self._alarms = 0
        self._add_objects()
        self._add_pdos()

    def observe(self, slide: RailState) -> None:
        """Take the slide's state of now."""
        self._sensor.observe(slide)

    def strike(self) -> None:
        """Let the faults of a SYNC come and go."""
        self._sensor.strike()
        alarms = self.POSITION_ERROR if self._sensor.missing else 0
        encoder_fault = 0x7305
        if alarms != self._alarms:
            self.emergency(encoder_fault if alarms else 0, ErrorKind.DEVICE_PROFILE)
        self._alarms = alarms

    def _add_objects(self) -> None:
        add, record = self.dictionary.add, self.dictionary.add_array
        add(0x6000, 0, Entry("H", 0, allowed=(0,)))
        add(0x6004, 0, Entry("i", 0, "ro", mappable=True, read=lambda: self._sensor.position))
        step_nm = 10_000  # 6005:01 and 6501, in 0.001 um
        record(0x6005, Entry("I", step_nm, "ro"), Entry("I", self.SPEED_STEP, "ro"))
        record(0x6030, Entry("h", 0, "ro", mappable=True, read=self._speed))
        add(0x6200, 0, Entry("H", 0, write=self._change_cycle))
        add(0x6500, 0, Entry("H", 0, "ro", mappable=True))
        add(0x6501, 0, Entry("H", step_nm, "ro"))  # shorter than the profile's U32, as sold
        add(0x6503, 0, Entry("H", 0, "ro", mappable=True, read=lambda: self._alarms))
        add(0x6504, 0, Entry("H", self.POSITION_ERROR, "ro"))
        add(0x6505, 0, Entry("H", 0, "ro", mappable=True))
        add(0x6506, 0, Entry("H", 0, "ro"))
        add(0x650B, 0, Entry("I", IDENTITY.serial, "ro"))

    def _speed(self) -> int:
        speed = round(self._sensor.velocity_mm_s * 100.0 / self.SPEED_STEP)
        return min(max(speed, self.INT16[0]), self.INT16[-1])

    def _change_cycle(self, period_ms: int) -> None:
        # 6200h is the profile's name for the event timer of the first TPDO.
        self.dictionary.set(0x1800, 5, period_ms)

    def _add_pdos(self) -> None:
        """Lay out the profile's defaults: 6004 by the cyclic timer, and on SYNC (off)."""
        position: Mapping = ((0x6004, 0),)
        self.transmit_pdos += [
            TransmitPdo(self.dictionary, 0, 0x180 + NODE, position),
            TransmitPdo(self.dictionary, 1, 0x280 + NODE | INVALID, position, transmission=1),
        ]
