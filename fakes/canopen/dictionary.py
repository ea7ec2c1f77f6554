"""The object dictionary of a simulated CANopen node (CiA 301, clause 7.4).

Values are held in the units of the object, little-endian on the wire. An object may exist and still
be refused; every refusal carries the abort code that a real node would send.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

Value = int | str

# SDO abort codes, CiA 301 table 22.


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
    value: Value = 0
    access: str = "rw"
    mappable: bool = False
    allowed: range | tuple[int, ...] | None = None
    read: Callable[[], Value] | None = None
    write: Callable[[int], None] | None = None

    @property
    def size(self) -> int:
        """Return the length in bytes of a number."""
        return struct.calcsize("<" + self.kind)

    def encode(self) -> bytes:
        """Return the present value as it goes over the wire."""
        value = self.value if self.read is None else self.read()
        if isinstance(value, str):
            return value.encode("ascii")
        return struct.pack("<" + self.kind, value)

    def decode(self, data: bytes) -> Value:
        """Return the value of ``data``; raises `SdoAbortError` on a wrong length."""
        if self.kind == "s":
            return data.decode("ascii", errors="replace")
        if len(data) != self.size:
            raise SdoAbortError(Abort.WRONG_LENGTH)
        value: int = struct.unpack("<" + self.kind, data)[0]
        return value


class ObjectDictionary:
    """All objects of a node, by index and sub-index."""

    def __init__(self) -> None:
        self._entries: dict[tuple[int, int], Entry] = {}
        self._indices: set[int] = set()
        self._defaults: dict[tuple[int, int], Value] = {}

    def add(self, index: int, sub: int, entry: Entry) -> Entry:
        """Add an object; its present value is the one that a reset restores."""
        self._entries[index, sub] = entry
        self._indices.add(index)
        self._defaults[index, sub] = entry.value
        return entry

    def add_array(self, index: int, *entries: Entry) -> None:
        """Add a record or array: sub-index 0 holds the highest sub-index."""
        self.add(index, 0, Entry("B", len(entries), "ro"))
        for sub, entry in enumerate(entries, start=1):
            self.add(index, sub, entry)

    def entry(self, index: int, sub: int) -> Entry:
        """Return an object; raises `SdoAbortError`."""
        if index not in self._indices:
            raise SdoAbortError(Abort.NO_SUCH_OBJECT)
        no_such_subindex = 0x06090011
        if (index, sub) not in self._entries:
            raise SdoAbortError(no_such_subindex)
        return self._entries[index, sub]

    def number(self, index: int, sub: int = 0) -> int:
        """Return the stored number of an object."""
        value = self._entries[index, sub].value
        if not isinstance(value, int):
            raise TypeError(f"object {index:04X}:{sub:02X} holds {value!r}, not a number")
        return value

    def set(self, index: int, sub: int, value: Value) -> None:
        """Change a value from inside the device, with any access."""
        self._entries[index, sub].value = value

    def upload(self, index: int, sub: int) -> bytes:
        """Read an object over the wire; raises `SdoAbortError`."""
        entry = self.entry(index, sub)
        write_only = 0x06010001
        if entry.access == "wo":
            raise SdoAbortError(write_only)
        return entry.encode()

    def check_writable(self, index: int, sub: int) -> Entry:
        """Return an object that may be written over the wire; raises `SdoAbortError`."""
        entry = self.entry(index, sub)
        if entry.access == "ro":
            raise SdoAbortError(Abort.READ_ONLY)
        return entry

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Write an object over the wire; raises `SdoAbortError`."""
        entry = self.check_writable(index, sub)
        value = entry.decode(data)
        if isinstance(value, int):
            if entry.allowed is not None and value not in entry.allowed:
                raise SdoAbortError(Abort.VALUE_RANGE)
            if entry.write is not None:
                entry.write(value)
        entry.value = value

    def restore(self, indices: range) -> None:
        """Put the values of ``indices`` back to those at power-on."""
        for key, value in self._defaults.items():
            if key[0] in indices:
                self._entries[key].value = value
