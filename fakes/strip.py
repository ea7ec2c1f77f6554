"""The magnetic strip's sensor, behind each wire that it may have.

On a CAN bus it is a CiA 406 absolute linear encoder, 100 counts/mm: `RailStrip`. On a serial line,
or TCP on a stated port, it speaks SIKO's service commands: ``A0``, ``A1``, ``A2``, ``Z`` or ``X``,
without an end of line; an answer ends with ``>`` and CR, and sometimes comes in two pieces.
Anything else is answered with ``?`` and CR.

Absolute, so it needs no homing. Its reading flickers by a count to either side. Without its magnet
a sensor repeats the last position; only its alarm shows it (bit 0 of 6503h and an EMCY, or of
``X``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import ClassVar

from fakes.canopen.rail_device import RailDevice
from fakes.canopen.slave import (
    SYNC_COB_ID,
    CanopenSlave,
    Entry,
    ErrorKind,
    NodeIdentity,
    TransmitPdo,
)
from fakes.canopen.slcan_gateway import BusServer
from fakes.faults import Faults
from fakes.site import Site
from fakes.truth.noise import Dither
from fakes.truth.rail_truth import RailState
from fakes.wires import Connection, Listener, Segments, SerialLine, Server, Wire


class StripSensor:
    """The head of one strip; call ``apply_faults`` before each reading."""

    def __init__(self, slide: RailState, faults: Faults, device: RailDevice) -> None:
        self._faults, self._device = faults, device
        self.position = self._counts(slide.strip_mm)
        self.velocity_mm_s = 0.0
        self.missing = False  # the magnet
        self._frozen = False
        self._jump_mm = 0.0
        self._dither = Dither(1, scope=6)
        self._jitter = 0

    def observe(self, slide: RailState) -> None:
        self.velocity_mm_s = slide.velocity_mm_s
        if not self._frozen and not self.missing:
            at_mm = slide.strip_mm + self._jump_mm
            self.position = self._counts(at_mm) + self._jitter

    def _counts(self, strip_mm: float) -> int:
        return round((strip_mm + self._device.strip_zero_mm) * self._device.strip_counts_per_mm)

    def apply_faults(self) -> None:
        self._jump_mm += self._faults.amount("rail.strip_jump")
        self._frozen = self._faults.strikes("rail.strip_frozen")
        jitter = int(self._faults.amount("rail.strip_jitter"))
        self._dither.step()
        # The fault alternates: any two readings show both sides.
        alternate = -jitter if self._jitter > 0 else jitter
        self._jitter = alternate if jitter else self._dither.counts
        self.missing = self._faults.strikes("rail.missing_magnet")


class StripLine(Server):
    """Serves one strip on a line of its own, or on a TCP ``port``."""

    ANSWERS: ClassVar = {
        b"A0": "MSAC501 simulated>",
        b"A1": "V1.00-simulated>",
        b"A2": "002014003>",
    }

    def __init__(self, site: Site, options: dict[str, object], port: int = 0) -> None:
        self._rail, self._faults = site.slide(), site.faults
        self._lock = threading.Lock()
        self._sensor = StripSensor(self._rail.poll(), site.faults, site.rail_device)
        line = (
            Listener("strip", lambda client: self._serve(Connection(client)), port=port)
            if port
            else SerialLine("strip line", self._serve)
        )
        stated = options | {"driver": "serial", "channel": line.channel}
        super().__init__({"strip": stated}, line)

    def answers(self, pending: bytes) -> tuple[list[bytes], bytes]:
        """Return the answers to commands, and the bytes of one that is not whole."""
        found: list[bytes] = []
        while pending:
            size = 2 if pending[:1] in b"Aa" else 1
            if len(pending) < size:
                break
            command, pending = pending[:size].upper(), pending[size:]
            with self._lock:
                answer = self._answer(command)
            if not self._faults.strikes("rail.strip_silent"):
                found.append(answer.encode("ascii") + b"\r")
        return found, pending

    def _answer(self, command: bytes) -> str:
        if command == b"Z":
            self._sensor.apply_faults()
            self._sensor.observe(self._rail.poll())
            return f"{self._sensor.position:+08d}>"
        if command == b"X":
            return f"0x{self._sensor.missing:02x}>"
        return self.ANSWERS.get(command, "?")

    def _serve(self, wire: Wire) -> None:
        segments, pending = Segments(wire.sendall), b""
        while True:
            answers, pending = self.answers(pending + wire.receive(None))
            for answer in answers:
                segments.send(answer)


IDENTITY = NodeIdentity(0x00080196, "hilcell strip sensor (simulated)", 0x484, 0x406, 1, 2014002)


class RailStrip(CanopenSlave):
    """A node that says where the strip sees the slide."""

    SPEED_STEP = 10  # 6005:02, in 0.01 mm/s
    POSITION_ERROR = 1 << 0

    def __init__(
        self,
        slide: RailState,
        faults: Faults,
        send: Callable[[int, bytes], None],
        device: RailDevice,
    ) -> None:
        super().__init__(device.strip_node, IDENTITY, send)
        self._sensor = StripSensor(slide, faults, device)
        self._alarms = 0
        self._add_objects(round(1e6 / abs(device.strip_counts_per_mm)))

    def observe(self, slide: RailState) -> None:
        self._sensor.observe(slide)

    def apply_faults(self) -> None:
        self._sensor.apply_faults()
        before, self._alarms = self._alarms, self.POSITION_ERROR * self._sensor.missing
        encoder_fault = 0x7305
        if self._alarms != before:
            self.emergency(encoder_fault * self._sensor.missing, ErrorKind.DEVICE_PROFILE)

    def _add_objects(self, step_nm: int) -> None:
        """``step_nm``: 6005:01 and 6501, in 0.001 um."""
        add, record = self.dictionary.add, self.dictionary.add_array
        add(0x6000, 0, Entry("H", 0, allowed=(0,)))
        add(0x6004, 0, Entry("i", 0, "ro", mappable=True, read=lambda: self._sensor.position))
        record(0x6005, Entry("I", step_nm, "ro"), Entry("I", self.SPEED_STEP, "ro"))
        record(0x6030, Entry("h", 0, "ro", mappable=True, read=self._speed))
        # 6200h is the profile's name for the event timer of the first TPDO.
        add(0x6200, 0, Entry("H", 0, write=partial(self.dictionary.set, 0x1800, 5)))
        add(0x6500, 0, Entry("H", 0, "ro", mappable=True))
        short = "H" if step_nm < 1 << 16 else "I"
        add(0x6501, 0, Entry(short, step_nm, "ro"))  # shorter than the profile's U32, as sold
        add(0x6503, 0, Entry("H", 0, "ro", mappable=True, read=lambda: self._alarms))
        add(0x6504, 0, Entry("H", self.POSITION_ERROR, "ro"))
        add(0x6505, 0, Entry("H", 0, "ro", mappable=True))
        add(0x6506, 0, Entry("H", 0, "ro"))
        add(0x650B, 0, Entry("I", IDENTITY.serial, "ro"))
        # The profile's defaults: 6004 by the cyclic timer, and on SYNC (off).
        self.transmit_pdos += [
            TransmitPdo(self.dictionary, self.node, number, (0x6004,), transmission)
            for number, transmission in enumerate((255, 1))
        ]

    def _speed(self) -> int:
        speed, limit = round(self._sensor.velocity_mm_s * 100.0 / self.SPEED_STEP), 1 << 15
        return min(max(speed, -limit), limit - 1)


class StripBus(BusServer):
    """Serves one strip behind a gateway of its own.

    Faults of a gateway are those of the drive's bus; here the sensor's strike, and its silence.
    """

    def __init__(self, site: Site, options: dict[str, object], port: int = 0) -> None:
        super().__init__("strip bus", Faults(), options, port)
        self.address = {"strip": options | self.address}
        self._rail, self._faults = site.slide(), site.faults
        device = site.rail_device
        self._strip = RailStrip(self._rail.poll(), site.faults, self._gateway.send, device)
        self._nodes[device.strip_node] = self._strip

    def _receive(self, cob_id: int, data: bytes) -> None:
        of_node = (SYNC_COB_ID, 0x600 + self._strip.node)
        if cob_id in of_node and self._faults.strikes("rail.strip_silent"):
            return
        if cob_id == SYNC_COB_ID:
            self._strip.apply_faults()
            self._strip.observe(self._rail.poll())
        super()._receive(cob_id, data)


def serve(site: Site, port: int = 0) -> StripLine | StripBus:
    """Return the strip of a cell on a wire of its own; raises `SettingsError` without a slide."""
    stated = dict(site.cell.rail.options.get("strip", {}))
    server = StripBus if stated.get("driver") == "canopen" else StripLine
    return server(site, stated, port)
