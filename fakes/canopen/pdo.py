"""Process data of a simulated CANopen node (CiA 301, clauses 7.2.2 and 7.5.2.35-38).

A mapping may be changed only while the PDO is switched off (bit 31 of its COB-ID) and its count is
0; the count is written last and is where the node judges the whole mapping. Remote frames are not
answered, so bit 30 of a COB-ID must stay set.
"""

from __future__ import annotations

from contextlib import suppress

from fakes.canopen.dictionary import Abort, Entry, ObjectDictionary, SdoAbortError

INVALID, NO_RTR = 1 << 31, 1 << 30
SYNC_TYPES = range(241)
EVENT_TYPES = range(254, 256)
Mapping = tuple[tuple[int, int], ...]


class Pdo:
    """The communication and mapping parameters of one PDO, and the data that they describe."""

    def __init__(
        self,
        dictionary: ObjectDictionary,
        communication: int,
        mapping: int,
        cob_id: int,
        mapped: Mapping,
        transmission: int = 255,
    ) -> None:
        self._dictionary = dictionary
        self._communication, self._mapping = communication, mapping
        types = (*SYNC_TYPES, *EVENT_TYPES)
        dictionary.add_array(
            communication,
            Entry("I", NO_RTR | cob_id, write=self._change_cob_id),
            Entry("B", transmission, allowed=types),
            Entry("H", 0, write=self._while_invalid),
            Entry("B", 0),
            Entry("H", 0),
        )
        dictionary.add(mapping, 0, Entry("B", len(mapped), write=self._change_count))
        for number in range(8):
            value = self._coded(*mapped[number]) if number < len(mapped) else 0
            dictionary.add(mapping, number + 1, Entry("I", value, write=self._change_mapping))

    @property
    def valid(self) -> bool:
        """Whether the PDO is switched on."""
        return not self._dictionary.number(self._communication, 1) & INVALID

    @property
    def cob_id(self) -> int:
        """Return the identifier of its frames."""
        return self._dictionary.number(self._communication, 1) & 0x7FF

    @property
    def transmission(self) -> int:
        """Return the transmission type."""
        return self._dictionary.number(self._communication, 2)

    @property
    def event_timer_s(self) -> float:
        """Return the event timer, 0 for none."""
        return self._dictionary.number(self._communication, 5) / 1000.0

    def mapped(self) -> list[tuple[int, int]]:
        """Return the mapped objects in order."""
        count = self._dictionary.number(self._mapping, 0)
        values = (self._dictionary.number(self._mapping, sub) for sub in range(1, count + 1))
        return [(value >> 16, value >> 8 & 0xFF) for value in values]

    def assemble(self) -> bytes:
        """Return the present data of the mapped objects."""
        return b"".join(self._dictionary.entry(*key).encode() for key in self.mapped())

    def distribute(self, data: bytes) -> bool:
        """Write received data to the mapped objects; a frame that is too short changes nothing."""
        entries = [(key, self._dictionary.entry(*key).size) for key in self.mapped()]
        if len(data) < sum(size for _, size in entries):
            return False
        for (index, sub), size in entries:
            # A PDO has no answer: where a value is refused, the node keeps the old one.
            with suppress(SdoAbortError):
                self._dictionary.download(index, sub, data[:size])
            data = data[size:]
        return True

    def _coded(self, index: int, sub: int) -> int:
        return index << 16 | sub << 8 | 8 * self._dictionary.entry(index, sub).size

    def _change_cob_id(self, value: int) -> None:
        old = self._dictionary.number(self._communication, 1)
        if self.valid and (value ^ old) & 0x3FFFFFFF:
            raise SdoAbortError(Abort.DEVICE_STATE)
        if not value & NO_RTR or not 0x180 < value & 0x3FFFFFFF < 0x580:
            raise SdoAbortError(Abort.VALUE_RANGE)

    def _while_invalid(self, _value: int) -> None:
        if self.valid:
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _change_mapping(self, _value: int) -> None:
        if self.valid or self._dictionary.number(self._mapping, 0):
            raise SdoAbortError(Abort.DEVICE_STATE)

    def _change_count(self, count: int) -> None:
        self._while_invalid(count)
        if count > 8:
            raise SdoAbortError(Abort.VALUE_RANGE)
        bits = 0
        for sub in range(1, count + 1):
            bits += self._checked_bits(self._dictionary.number(self._mapping, sub))
        if bits > 64:
            raise SdoAbortError(Abort.PDO_TOO_LONG)

    def _checked_bits(self, value: int) -> int:
        try:
            entry = self._dictionary.entry(value >> 16, value >> 8 & 0xFF)
        except SdoAbortError:
            raise SdoAbortError(Abort.NO_SUCH_OBJECT) from None
        bits = value & 0xFF
        if not entry.mappable or bits != 8 * entry.size:
            raise SdoAbortError(Abort.NOT_MAPPABLE)
        return bits


class TransmitPdo(Pdo):
    """A PDO that the node sends: on SYNC, on a change, or by its event timer."""

    def __init__(
        self,
        dictionary: ObjectDictionary,
        number: int,
        cob_id: int,
        mapped: Mapping,
        transmission: int = 255,
    ) -> None:
        super().__init__(dictionary, 0x1800 + number, 0x1A00 + number, cob_id, mapped, transmission)
        self._syncs = 0
        self._sent: bytes | None = None
        self._sent_s = 0.0

    def rewind(self) -> None:
        """Start again, as on entering OPERATIONAL."""
        self._syncs, self._sent, self._sent_s = 0, None, 0.0

    def at_sync(self) -> bytes | None:
        """Return the data due at this SYNC."""
        kind = self.transmission
        if kind not in SYNC_TYPES or not self.valid:
            return None
        self._syncs += 1
        data = self.assemble()
        due = data != self._sent if kind == 0 else self._syncs % kind == 0
        self._sent = data if due else self._sent
        return data if due else None

    def at_event(self, now_s: float) -> bytes | None:
        """Return the data due now, by the event timer or because it changed."""
        if self.transmission not in EVENT_TYPES or not self.valid:
            return None
        data, timer_s = self.assemble(), self.event_timer_s
        if data == self._sent and not (timer_s and now_s >= self._sent_s + timer_s):
            return None
        self._sent, self._sent_s = data, now_s
        return data

    def next_s(self) -> float:
        """Return when the event timer runs out."""
        if self.transmission in EVENT_TYPES and self.valid and self.event_timer_s:
            return self._sent_s + self.event_timer_s
        return float("inf")


class ReceivePdo(Pdo):
    """A PDO that the node takes: at once, or held back until the next SYNC."""

    def __init__(
        self, dictionary: ObjectDictionary, number: int, cob_id: int, mapped: Mapping
    ) -> None:
        super().__init__(dictionary, 0x1400 + number, 0x1600 + number, cob_id, mapped)
        self._held: bytes | None = None

    def take(self, data: bytes) -> bool:
        """Take a frame; False when it is shorter than the mapping."""
        if self.transmission in SYNC_TYPES:
            self._held = data
            return True
        return self.distribute(data)

    def at_sync(self) -> bool:
        """Write the frame that was held back; False when it is shorter than the mapping."""
        data, self._held = self._held, None
        return data is None or self.distribute(data)
