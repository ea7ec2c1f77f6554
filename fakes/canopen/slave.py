"""A simulated CANopen node: NMT, SYNC, heartbeat both ways, EMCY, SDO and PDO (CiA 301).

A device is a subclass that fills the object dictionary and overrides the four hooks `written`,
`switched_off`, `connection_lost` and `restarted`. One thread calls everything. Heartbeats and event
timers run in real time, independent of the plant's clock, and no heartbeat is punctual. A lost
heartbeat takes the node out of OPERATIONAL by itself (1029:01 = 0) and is latched: a new master
must start it again, and a START before its first new heartbeat does not hold.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fakes.canopen.dictionary import Entry, ObjectDictionary
from fakes.canopen.pdo import ReceivePdo, TransmitPdo
from fakes.canopen.sdo import SdoServer

NMT_COB_ID, SYNC_COB_ID = 0x000, 0x080


class ErrorKind(IntEnum):
    """Bits of the error register, 1001h."""

    GENERIC = 0x01
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20


Send = Callable[[int, bytes], None]


class Nmt(IntEnum):
    """The states of a node as its heartbeat carries them."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


@dataclass(frozen=True, slots=True)
class NodeIdentity:
    """Contents of 1000h, 1008h and 1018h."""

    device_type: int
    name: str
    vendor: int
    product: int
    revision: int
    serial: int


class CanopenSlave:
    """One node on the bus; ``send(cob_id, data)`` puts its frames there."""

    PDO_TOO_SHORT = 0x8210
    COMMUNICATION_AREA, WHOLE_DICTIONARY = range(0x1000, 0x2000), range(0x10000)
    KEPT_ERRORS = 4
    HEARTBEAT_LOST = 0x8130

    def __init__(self, node: int, identity: NodeIdentity, send: Send) -> None:
        self.node = node
        self.nmt = Nmt.BOOT_UP
        self.dictionary = ObjectDictionary()
        self.transmit_pdos: list[TransmitPdo] = []
        self.receive_pdos: list[ReceivePdo] = []
        self._send = send
        self._sdo = SdoServer(self.dictionary)
        self._next_heartbeat_s = math.inf
        self._habits = np.random.default_rng(node)
        self._heard_by_s = math.inf
        self._heartbeat_lost = False
        self._add_communication_objects(identity)

    # -- added by a device --------------------------------------------------------------------

    def written(self) -> None:
        """React to objects that the master has written: all of one frame are in place."""

    def switched_off(self) -> None:
        """React to the loss of power or to a reset of the whole node."""

    def connection_lost(self) -> None:
        """React to a lost heartbeat, to NMT stop and to a reset of the communication."""

    def restarted(self) -> None:
        """React to the end of a reset: the dictionary holds its power-on values."""

    # -- called by the bus --------------------------------------------------------------------

    def boot(self, now_s: float) -> None:
        """Announce the node and wait for the master in PRE-OPERATIONAL."""
        self.nmt = Nmt.PRE_OPERATIONAL
        self._send(0x700 + self.node, bytes([Nmt.BOOT_UP]))
        self._schedule_heartbeat(now_s)

    def receive(self, cob_id: int, data: bytes, now_s: float) -> None:
        """Take one frame from the bus."""
        if self.nmt is Nmt.BOOT_UP:
            return
        if cob_id == NMT_COB_ID:
            self._command(data, now_s)
        elif cob_id == SYNC_COB_ID:
            self._synchronise()
        elif cob_id == 0x600 + self.node:
            self._request(data)
        elif cob_id & ~0x7F == 0x700:
            self._heard(cob_id & 0x7F, now_s)
        elif self.nmt is Nmt.OPERATIONAL:
            self._receive_pdo(cob_id, data)
        self._send_events(now_s)

    def tick(self, now_s: float) -> None:
        """Do the work that is due by time: heartbeats and event timers."""
        if self.nmt is Nmt.BOOT_UP:
            return
        if now_s >= self._next_heartbeat_s:
            self._send(0x700 + self.node, bytes([self.nmt]))
            self._schedule_heartbeat(now_s)
        if now_s > self._heard_by_s:
            self._heard_by_s = math.inf
            self._lose_heartbeat()
        self._send_events(now_s)

    def next_s(self) -> float:
        """Return when `tick` has something to do."""
        timers = (pdo.next_s() for pdo in self.transmit_pdos)
        cyclic_s = min(timers, default=math.inf) if self.nmt is Nmt.OPERATIONAL else math.inf
        return min(self._next_heartbeat_s, self._heard_by_s, cyclic_s)

    def cyclic(self) -> bool:
        """Whether a PDO is sent by its event timer."""
        return self.nmt is Nmt.OPERATIONAL and any(
            pdo.next_s() < math.inf for pdo in self.transmit_pdos
        )

    def reset(self, now_s: float) -> None:
        """Reset the whole node, as NMT command 129 or a short loss of power does."""
        self.switched_off()
        self._restart(self.WHOLE_DICTIONARY, now_s)

    # -- emergencies --------------------------------------------------------------------------

    def emergency(self, code: int, register: int) -> None:
        """Send EMCY ``code`` and keep it in 1001h and 1003h; code 0 clears ``register``."""
        dictionary = self.dictionary
        old = dictionary.number(0x1001)
        dictionary.set(
            0x1001, 0, old | register | ErrorKind.GENERIC if code else self._cleared(register)
        )
        if code:
            self._keep_error(code)
        if self.nmt is not Nmt.STOPPED:
            frame = struct.pack("<HB5x", code, dictionary.number(0x1001))
            self._send(dictionary.number(0x1014) & 0x7FF, frame)

    def _cleared(self, register: int) -> int:
        left = self.dictionary.number(0x1001) & ~(register | ErrorKind.GENERIC)
        return left | ErrorKind.GENERIC if left else 0

    def _keep_error(self, code: int) -> None:
        kept = [self.dictionary.number(0x1003, sub) for sub in range(1, self.KEPT_ERRORS + 1)]
        for sub, value in enumerate([code, *kept[:-1]], start=1):
            self.dictionary.set(0x1003, sub, value)
        self.dictionary.set(0x1003, 0, min(self.KEPT_ERRORS, self.dictionary.number(0x1003) + 1))

    # -- services -----------------------------------------------------------------------------

    def _command(self, data: bytes, now_s: float) -> None:
        if len(data) != 2 or data[1] not in {0, self.node}:
            return
        match data[0]:
            case 1 if self._heartbeat_lost:
                self.nmt = Nmt.PRE_OPERATIONAL
                self.emergency(self.HEARTBEAT_LOST, ErrorKind.COMMUNICATION)
            case 1:
                self.nmt = Nmt.OPERATIONAL
                for pdo in self.transmit_pdos:
                    pdo.rewind()
            case 2:
                self.nmt = Nmt.STOPPED
                self.connection_lost()
            case 128:
                self.nmt = Nmt.PRE_OPERATIONAL
            case 129:
                self.reset(now_s)
            case 130:
                self.connection_lost()
                self._restart(self.COMMUNICATION_AREA, now_s)
            case _:
                pass

    def _restart(self, area: range, now_s: float) -> None:
        self.dictionary.restore(area)
        self._sdo.reset()
        self._heard_by_s, self._heartbeat_lost = math.inf, False
        if area == self.WHOLE_DICTIONARY:
            self.restarted()
        self.boot(now_s)

    def _synchronise(self) -> None:
        if self.nmt is not Nmt.OPERATIONAL:
            return
        for receive in self.receive_pdos:
            if receive.valid and not receive.at_sync():
                self.emergency(self.PDO_TOO_SHORT, ErrorKind.COMMUNICATION)
        self.written()
        for transmit in self.transmit_pdos:
            data = transmit.at_sync()
            if data is not None:
                self._send(transmit.cob_id, data)

    def _request(self, data: bytes) -> None:
        if self.nmt is Nmt.STOPPED:
            return
        reply = self._sdo.answer(data)
        self.written()
        if reply is not None:
            self._send(0x580 + self.node, reply)

    def _receive_pdo(self, cob_id: int, data: bytes) -> None:
        for pdo in self.receive_pdos:
            if pdo.valid and pdo.cob_id == cob_id:
                if not pdo.take(data):
                    self.emergency(self.PDO_TOO_SHORT, ErrorKind.COMMUNICATION)
                self.written()

    def _send_events(self, now_s: float) -> None:
        if self.nmt is not Nmt.OPERATIONAL:
            return
        for pdo in self.transmit_pdos:
            data = pdo.at_event(now_s)
            if data is not None:
                self._send(pdo.cob_id, data)

    # -- heartbeats ---------------------------------------------------------------------------

    def _schedule_heartbeat(self, now_s: float) -> None:
        period_s = self.dictionary.number(0x1017) / 1000.0
        latest_heartbeat = 0.3  # of its period
        period_s *= 1.0 + self._habits.uniform(0.0, latest_heartbeat)
        self._next_heartbeat_s = now_s + period_s if period_s else math.inf

    def _heard(self, node: int, now_s: float) -> None:
        watched = self.dictionary.number(0x1016, 1)
        if not watched & 0xFFFF or watched >> 16 & 0x7F != node:
            return
        self._heard_by_s = now_s + (watched & 0xFFFF) / 1000.0
        if self._heartbeat_lost:
            self._heartbeat_lost = False
            self.emergency(0, ErrorKind.COMMUNICATION)

    def _lose_heartbeat(self) -> None:
        self._heartbeat_lost = True
        self.emergency(self.HEARTBEAT_LOST, ErrorKind.COMMUNICATION)
        self.connection_lost()
        if self.nmt is Nmt.OPERATIONAL and self.dictionary.number(0x1029, 1) == 0:
            self.nmt = Nmt.PRE_OPERATIONAL

    def _change_producer(self, period_ms: int) -> None:
        self._next_heartbeat_s = 0.0 if period_ms else math.inf

    def _change_consumer(self, watched: int) -> None:
        self._heard_by_s = math.inf
        if not watched & 0xFFFF:  # nobody is watched any more; else the next heartbeat clears it
            self._heartbeat_lost = False

    def _clear_errors(self, _count: int) -> None:
        for sub in range(1, self.KEPT_ERRORS + 1):
            self.dictionary.set(0x1003, sub, 0)

    def _add_communication_objects(self, identity: NodeIdentity) -> None:
        add, record = self.dictionary.add, self.dictionary.add_array
        add(0x1000, 0, Entry("I", identity.device_type, "ro"))
        add(0x1001, 0, Entry("B", 0, "ro", mappable=True))
        add(0x1003, 0, Entry("B", 0, allowed=(0,), write=self._clear_errors))
        for sub in range(1, self.KEPT_ERRORS + 1):
            add(0x1003, sub, Entry("I", 0, "ro"))
        add(0x1005, 0, Entry("I", SYNC_COB_ID, "ro"))
        add(0x1008, 0, Entry("s", identity.name, "ro"))
        add(0x1009, 0, Entry("s", "1.0", "ro"))
        add(0x100A, 0, Entry("s", "1.0.0", "ro"))
        add(0x1014, 0, Entry("I", 0x80 + self.node, "ro"))
        record(0x1016, Entry("I", 0, write=self._change_consumer))
        add(0x1017, 0, Entry("H", 0, write=self._change_producer))
        numbers = (identity.vendor, identity.product, identity.revision, identity.serial)
        record(0x1018, *(Entry("I", number, "ro") for number in numbers))
        record(0x1029, Entry("B", 0, allowed=(0, 1)))
        record(0x1200, *(Entry("I", base + self.node, "ro") for base in (0x600, 0x580)))
