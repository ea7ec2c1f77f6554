"""A simulated CANopen node: dictionary, SDO, PDO, NMT, SYNC, heartbeat both ways, EMCY (CiA 301).

A device is a subclass of `CanopenSlave` that fills the object dictionary and overrides the hooks
`written`, `switched_off` and `connection_lost`. One thread calls everything. Heartbeats and event
timers run in real time, and no heartbeat is punctual. A lost heartbeat takes the node out of
OPERATIONAL (1029:01 = 0) and is latched: a new master must start it again, and a START before its
first new heartbeat has no lasting effect.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class Abort(IntEnum):
    """SDO abort codes, CiA 301 table 22."""

    TOGGLE_NOT_ALTERNATED = 0x05030000
    UNKNOWN_COMMAND = 0x05040001
    READ_ONLY = 0x06010002
    NO_SUCH_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_TOO_LONG = 0x06040042
    WRONG_LENGTH = 0x06070010
    VALUE_RANGE = 0x06090030
    DEVICE_STATE = 0x08000022


class SdoAbortError(Exception):
    """The node refuses an access with a code of CiA 301 table 22."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code


@dataclass(slots=True)
class Entry:
    """One sub-index. ``kind`` is a `struct` letter (b B h H i I) or ``s`` for a visible string.

    ``read`` replaces the stored value; ``write`` is asked before a value is stored and may raise
    `SdoAbortError`; ``allowed`` are the only values that may be written.
    """

    kind: str
    value: int | str = 0
    access: str = "rw"
    mappable: bool = False
    allowed: range | tuple[int, ...] | None = None
    read: Callable[[], int | str] | None = None
    write: Callable[[int], None] | None = None

    @property
    def size(self) -> int:
        return struct.calcsize("<" + self.kind)

    @property
    def number(self) -> int:
        if not isinstance(self.value, int):
            raise TypeError(f"expected an object that holds a number, got {self.value!r}")
        return self.value

    def encode(self) -> bytes:
        value = self.value if self.read is None else self.read()
        if isinstance(value, str):
            return value.encode("ascii")
        return struct.pack("<" + self.kind, value)

    def upload(self) -> bytes:
        """Read over the wire; raises `SdoAbortError`."""
        write_only = 0x06010001
        if self.access == "wo":
            raise SdoAbortError(write_only)
        return self.encode()

    def check_writable(self) -> None:
        """Raise `SdoAbortError` if it is read-only over the wire."""
        if self.access == "ro":
            raise SdoAbortError(Abort.READ_ONLY)

    def download(self, data: bytes) -> None:
        """Write over the wire; raises `SdoAbortError`."""
        self.check_writable()
        if self.kind == "s":
            self.value = data.decode("ascii", errors="replace")
            return
        if len(data) != self.size:
            raise SdoAbortError(Abort.WRONG_LENGTH)
        value: int = struct.unpack("<" + self.kind, data)[0]
        if self.allowed is not None and value not in self.allowed:
            raise SdoAbortError(Abort.VALUE_RANGE)
        if self.write is not None:
            self.write(value)
        self.value = value


class ObjectDictionary:
    """All objects of a node, by index and sub-index (clause 7.4).

    Values are stored in the object's units, little-endian on the wire. Access to an existing object
    may be refused; each refusal carries the abort code of a real node.
    """

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._defaults: dict[tuple[int, int], int | str] = {}

    def add(self, index: int, sub: int, entry: Entry) -> None:
        """Add an object; a reset restores its present value."""
        self._entries[index, sub] = entry
        self._defaults[index, sub] = entry.value

    def add_array(self, index: int, *entries: Entry) -> None:
        """Add a record or array: sub-index 0 holds the highest sub-index."""
        self.add(index, 0, Entry("B", len(entries), "ro"))
        for sub, entry in enumerate(entries, start=1):
            self.add(index, sub, entry)

    def entry(self, index: int, sub: int) -> Entry:
        no_such_subindex = 0x06090011
        if (index, sub) not in self._entries:
            known = (index, 0) in self._entries
            raise SdoAbortError(no_such_subindex if known else Abort.NO_SUCH_OBJECT)
        return self._entries[index, sub]

    def number(self, index: int, sub: int = 0) -> int:
        return self._entries[index, sub].number

    def set(self, index: int, sub: int, value: int | str) -> None:
        self._entries[index, sub].value = value

    def restore(self, indices: range) -> None:
        for key, value in self._defaults.items():
            if key[0] in indices:
                self._entries[key].value = value


HEADER = struct.Struct("<BHB")
ABORT = 0x80
TOGGLE = 0x10


@dataclass(slots=True)
class _Transfer:
    specifier: int  # of the client's segments
    index: int
    sub: int
    data: bytes
    announced: int | None = None
    toggle: int = 0

    def check_toggle(self, command: int) -> None:
        if command & TOGGLE != self.toggle:
            raise SdoAbortError(Abort.TOGGLE_NOT_ALTERNATED)
        self.toggle ^= TOGGLE


def abort_reply(index: int, sub: int, code: int) -> bytes:
    """Return the 8 bytes that refuse an access."""
    return HEADER.pack(ABORT, index, sub) + struct.pack("<I", code)


class SdoServer:
    """Answers the requests of one SDO channel (clause 7.2.4): expedited and segmented.

    One transfer at a time; a new initiate request drops the current one. Only the toggle bit tells
    a repeated segment from the next one.
    """

    UPLOAD, DOWNLOAD = SEGMENTS = 3, 0  # specifiers of a client's segments

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        self._transfer = None

    def answer(self, request: bytes) -> bytes | None:
        """Return the reply to ``request``; an abort of the client gets none."""
        if len(request) != 8:
            return None
        command, index, sub = HEADER.unpack_from(request)
        if command == ABORT:
            self.reset()
            return None
        specifier, transfer = command >> 5, self._transfer
        if specifier in self.SEGMENTS and transfer is not None:
            index, sub = transfer.index, transfer.sub
        try:
            if specifier == 2:
                return self._initiate_upload(index, sub)
            if specifier == 1:
                return self._initiate_download(command, index, sub, request)
            if transfer is None or transfer.specifier != specifier:
                raise SdoAbortError(Abort.UNKNOWN_COMMAND)
            transfer.check_toggle(command)
            if specifier == self.UPLOAD:
                return self._upload_segment(transfer, command)
            return self._download_segment(transfer, command, request)
        except SdoAbortError as refusal:
            self.reset()
            return abort_reply(index, sub, refusal.code)

    def _initiate_upload(self, index: int, sub: int) -> bytes:
        self.reset()
        data = self._dictionary.entry(index, sub).upload()
        if 1 <= len(data) <= 4:
            command = 0x43 | (4 - len(data)) << 2
            return HEADER.pack(command, index, sub) + data.ljust(4, b"\0")
        self._transfer = _Transfer(self.UPLOAD, index, sub, data)
        return HEADER.pack(0x41, index, sub) + struct.pack("<I", len(data))

    def _upload_segment(self, transfer: _Transfer, command: int) -> bytes:
        segment, transfer.data = transfer.data[:7], transfer.data[7:]
        reply = (command & TOGGLE) | (7 - len(segment)) << 1 | (0 if transfer.data else 1)
        if not transfer.data:
            self.reset()
        return bytes([reply]) + segment.ljust(7, b"\0")

    def _initiate_download(self, command: int, index: int, sub: int, request: bytes) -> bytes:
        self.reset()
        entry = self._dictionary.entry(index, sub)
        expedited, sized = bool(command & 2), bool(command & 1)
        if expedited:
            own = 4 if entry.kind == "s" else entry.size
            length = 4 - (command >> 2 & 3) if sized else own
            entry.download(request[4 : 4 + length])
        else:
            entry.check_writable()
            announced = struct.unpack_from("<I", request, 4)[0] if sized else None
            self._transfer = _Transfer(self.DOWNLOAD, index, sub, b"", announced)
        return HEADER.pack(0x60, index, sub) + bytes(4)

    def _download_segment(self, transfer: _Transfer, command: int, request: bytes) -> bytes:
        transfer.data += request[1 : 8 - (command >> 1 & 7)]
        longest = 4096
        if len(transfer.data) > longest:
            raise SdoAbortError(Abort.WRONG_LENGTH)
        if command & 1:
            if transfer.announced not in {None, len(transfer.data)}:
                raise SdoAbortError(Abort.WRONG_LENGTH)
            self._dictionary.entry(transfer.index, transfer.sub).download(transfer.data)
            self.reset()
        return bytes([0x20 | command & TOGGLE]) + bytes(7)


INVALID = 1 << 31


class Pdo:
    """Communication and mapping parameters of one PDO, and the mapped data.

    A mapping may be changed only while the PDO is switched off (bit 31 of its COB-ID) and its count
    is 0; the count is written last, where the node judges the whole mapping. Remote frames are not
    answered, so bit 30 of a COB-ID must stay set (clauses 7.2.2 and 7.5.2.35-38).
    """

    NO_RTR = 1 << 30
    SYNC_TYPES, EVENT_TYPES = range(241), range(254, 256)
    COMMUNICATION, MAPPING, COB_ID = 0, 0, 0  # of the first, in a kind of PDO

    def __init__(
        self,
        dictionary: ObjectDictionary,
        node: int,
        number: int,
        mapped: Sequence[int],
        transmission: int = 255,
    ) -> None:
        """``mapped`` are objects without sub-indices. All but the first PDO are switched off."""
        self._dictionary = dictionary
        cob_id = self.COB_ID + 0x100 * number + node | self.NO_RTR | (INVALID if number else 0)
        types = (*self.SYNC_TYPES, *self.EVENT_TYPES)
        self._cob_id = Entry("I", cob_id, write=self._change_cob_id)
        self._type = Entry("B", transmission, allowed=types)
        inhibit, self._timer_ms = Entry("H", 0, write=self._while_invalid), Entry("H", 0)
        timers = (inhibit, Entry("B", 0), self._timer_ms)
        dictionary.add_array(self.COMMUNICATION + number, self._cob_id, self._type, *timers)
        coded = [index << 16 | 8 * dictionary.entry(index, 0).size for index in mapped]
        coded += [0] * (8 - len(coded))
        self._places_cache = [Entry("I", value, write=self._change_mapping) for value in coded]
        self._count = Entry("B", len(mapped), write=self._change_count)
        for sub, entry in enumerate((self._count, *self._places_cache)):
            dictionary.add(self.MAPPING + number, sub, entry)

    @property
    def valid(self) -> bool:
        return not self._cob_id.number & INVALID

    @property
    def cob_id(self) -> int:
        return self._cob_id.number & 0x7FF

    def mapped(self) -> list[Entry]:
        return [self._mapped(place) for place in self._places_cache[: self._count.number]]

    def assemble(self) -> bytes:
        return b"".join(entry.encode() for entry in self.mapped())

    def distribute(self, data: bytes) -> bool:
        """Write received data to the mapped objects; a frame that is too short changes nothing."""
        entries = self.mapped()
        if len(data) < sum(entry.size for entry in entries):
            return False
        for entry in entries:
            # A PDO has no answer: where a value is refused, the node keeps the old one.
            with suppress(SdoAbortError):
                entry.download(data[: entry.size])
            data = data[entry.size :]
        return True

    def _mapped(self, place: Entry) -> Entry:
        return self._dictionary.entry(place.number >> 16, place.number >> 8 & 0xFF)

    def _change_cob_id(self, value: int) -> None:
        if self.valid and (value ^ self._cob_id.number) & 0x3FFFFFFF:
            raise SdoAbortError(Abort.DEVICE_STATE)
        if not value & self.NO_RTR or not 0x180 < value & 0x3FFFFFFF < 0x580:
            raise SdoAbortError(Abort.VALUE_RANGE)

    def _while_invalid(self, _value: int) -> None:
        if self.valid:
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _change_mapping(self, _value: int) -> None:
        if self.valid or self._count.number:
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _change_count(self, count: int) -> None:
        self._while_invalid(count)
        if count > len(self._places_cache):
            raise SdoAbortError(Abort.VALUE_RANGE)
        bits = 0
        for place in self._places_cache[:count]:
            try:
                entry = self._mapped(place)
            except SdoAbortError:
                raise SdoAbortError(Abort.NO_SUCH_OBJECT) from None
            if not entry.mappable or place.number & 0xFF != 8 * entry.size:
                raise SdoAbortError(Abort.NOT_MAPPABLE)
            bits += 8 * entry.size
        if bits > 64:
            raise SdoAbortError(Abort.PDO_TOO_LONG)


class TransmitPdo(Pdo):
    """A PDO that the node sends: on SYNC, on a change, or by its event timer."""

    COMMUNICATION, MAPPING, COB_ID = 0x1800, 0x1A00, 0x180
    _syncs, _sent_s = 0, 0.0
    _sent: bytes | None = None

    def rewind(self) -> None:
        """Start again, as on entering OPERATIONAL."""
        self._syncs, self._sent, self._sent_s = 0, None, 0.0

    def at_sync(self) -> bytes | None:
        kind = self._type.number
        if kind not in self.SYNC_TYPES or not self.valid:
            return None
        self._syncs += 1
        data = self.assemble()
        due = data != self._sent if kind == 0 else self._syncs % kind == 0
        self._sent = data if due else self._sent
        return data if due else None

    def at_event(self, now_s: float) -> bytes | None:
        """Return the data due now, by the event timer or because it changed."""
        if self._type.number not in self.EVENT_TYPES or not self.valid:
            return None
        data = self.assemble()
        if data == self._sent and now_s < self.next_s():
            return None
        self._sent, self._sent_s = data, now_s
        return data

    def next_s(self) -> float:
        if self._type.number in self.EVENT_TYPES and self.valid and self._timer_ms.number:
            return self._sent_s + self._timer_ms.number / 1000.0
        return math.inf


class ReceivePdo(Pdo):
    """A PDO that the node takes: at once, or held back until the next SYNC."""

    COMMUNICATION, MAPPING, COB_ID = 0x1400, 0x1600, 0x200
    _held: bytes | None = None

    def take(self, data: bytes) -> bool:
        """Take a frame; False when it is shorter than the mapping."""
        if self._type.number in self.SYNC_TYPES:
            self._held = data
            return True
        return self.distribute(data)

    def at_sync(self) -> bool:
        """Write the frame that was held back; False when it is shorter than the mapping."""
        data, self._held = self._held, None
        return data is None or self.distribute(data)


SYNC_COB_ID = 0x080


class ErrorKind(IntEnum):
    """Bits of the error register, 1001h."""

    GENERIC = 0x01
    COMMUNICATION = 0x10
    DEVICE_PROFILE = 0x20


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

    NMT_COB_ID = 0x000
    PDO_TOO_SHORT = 0x8210
    COMMUNICATION_AREA, WHOLE_DICTIONARY = range(0x1000, 0x2000), range(0x10000)
    KEPT_ERRORS = 4
    HEARTBEAT_LOST = 0x8130

    def __init__(
        self, node: int, identity: NodeIdentity, send: Callable[[int, bytes], None]
    ) -> None:
        self.node = node
        self.nmt = Nmt.BOOT_UP
        self.dictionary = ObjectDictionary()
        self.transmit_pdos: list[TransmitPdo] = []
        self.receive_pdos: list[ReceivePdo] = []
        self._send = send
        self._sdo = SdoServer(self.dictionary)
        self._next_heartbeat_s = math.inf
        self._jitter_rng = np.random.default_rng(node)
        self._heard_by_s = math.inf
        self._heartbeat_lost = False
        self._add_communication_objects(identity)

    # -- added by a device --------------------------------------------------------------------

    def written(self) -> None:
        """React to objects that the master has written: all of one frame are in place."""

    def switched_off(self) -> None:
        """React to the loss of power or to a reset of the whole node, with which all is lost."""

    def connection_lost(self) -> None:
        """React to a lost heartbeat, to NMT stop and to a reset of the communication."""

    # -- called by the bus --------------------------------------------------------------------

    def boot(self, now_s: float) -> None:
        self.nmt = Nmt.PRE_OPERATIONAL
        self._send(0x700 + self.node, bytes([Nmt.BOOT_UP]))
        self._schedule_heartbeat(now_s)

    def receive(self, cob_id: int, data: bytes, now_s: float) -> None:
        if self.nmt is Nmt.BOOT_UP:
            return
        if cob_id == self.NMT_COB_ID:
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
        return min(self._next_heartbeat_s, self._heard_by_s, self._event_s())

    def cyclic(self) -> bool:
        return self._event_s() < math.inf

    def _event_s(self) -> float:
        operational = self.nmt is Nmt.OPERATIONAL
        timers = (pdo.next_s() for pdo in self.transmit_pdos if operational)
        return min(timers, default=math.inf)

    def reset(self, now_s: float) -> None:
        """Reset the whole node, as NMT command 129 or a short loss of power does."""
        self.switched_off()
        self._restart(self.WHOLE_DICTIONARY, now_s)

    # -- emergencies --------------------------------------------------------------------------

    def emergency(self, code: int, register: int) -> None:
        """Send EMCY ``code`` and keep it in 1001h and 1003h; code 0 clears ``register``."""
        dictionary = self.dictionary
        old = dictionary.number(0x1001)
        if code:
            left = old | register | ErrorKind.GENERIC
            kept = [dictionary.number(0x1003, sub) for sub in range(1, self.KEPT_ERRORS + 1)]
            for sub, value in enumerate([code, *kept[:-1]], start=1):
                dictionary.set(0x1003, sub, value)
            dictionary.set(0x1003, 0, min(self.KEPT_ERRORS, dictionary.number(0x1003) + 1))
        else:
            left = old & ~(register | ErrorKind.GENERIC)
        dictionary.set(0x1001, 0, left | ErrorKind.GENERIC if left else 0)
        if self.nmt is not Nmt.STOPPED:
            frame = struct.pack("<HB5x", code, dictionary.number(0x1001))
            self._send(dictionary.number(0x1014) & 0x7FF, frame)

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
        self.boot(now_s)

    def _synchronise(self) -> None:
        if self.nmt is not Nmt.OPERATIONAL:
            return
        for receive in self.receive_pdos:
            if receive.valid and not receive.at_sync():
                self.emergency(self.PDO_TOO_SHORT, ErrorKind.COMMUNICATION)
        self.written()
        self._send_due(TransmitPdo.at_sync)

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
        if self.nmt is Nmt.OPERATIONAL:
            self._send_due(lambda pdo: pdo.at_event(now_s))

    def _send_due(self, due: Callable[[TransmitPdo], bytes | None]) -> None:
        for pdo in self.transmit_pdos:
            if (data := due(pdo)) is not None:
                self._send(pdo.cob_id, data)

    # -- heartbeats ---------------------------------------------------------------------------

    def _schedule_heartbeat(self, now_s: float) -> None:
        period_s = self.dictionary.number(0x1017) / 1000.0
        latest_heartbeat = 0.3  # of its period
        period_s *= 1.0 + self._jitter_rng.uniform(0.0, latest_heartbeat)
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
