"""RTDE, the real-time data exchange of Universal Robots: packages and recipes, without a wire.

Big-endian. Package ``size u16 of the whole, type u8, payload``. A recipe names the fields of data
packages once; from then on they carry its number and the values in its order. The controller
answers a field that it lacks with NOT_FOUND, an input that another client holds with IN_USE.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

VERSION = 2  # of the protocol
LONGEST = 4096
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"
FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "INT32": "i",
    "UINT32": "I",
    "UINT64": "Q",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}
_HEAD = struct.Struct(">HB")

Value = int | float | tuple[int | float, ...]


class Kind(IntEnum):
    """Types of packages."""

    VERSION = 86
    CONTROLLER_VERSION = 118
    TEXT = 77
    DATA = 85
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80


class RtdeError(ValueError):
    """Bytes that are no package of the protocol, or not the expected one."""


def encode(kind: Kind, payload: bytes = b"") -> bytes:
    """Return a package."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


def request_version() -> bytes:
    """Return the request to speak version 2 of the protocol."""
    return encode(Kind.VERSION, struct.pack(">H", VERSION))


def request_outputs(names: Sequence[str], rate_hz: float) -> bytes:
    """Return the request for data packages of these fields."""
    return encode(Kind.OUTPUTS, struct.pack(">d", rate_hz) + ",".join(names).encode("ascii"))


def request_inputs(names: Sequence[str]) -> bytes:
    """Return the request to write these fields."""
    return encode(Kind.INPUTS, ",".join(names).encode("ascii"))


def accepted(payload: bytes) -> bool:
    """Return whether the controller accepts, from the answer's one byte."""
    if len(payload) != 1:
        raise RtdeError(f"an answer of {len(payload)} bytes, wanted 1")
    return payload[0] == 1


def controller_version(payload: bytes) -> str:
    """Return the controller's version, from four numbers."""
    if len(payload) != 16:
        raise RtdeError(f"a controller version of {len(payload)} bytes, wanted 16")
    return ".".join(map(str, struct.unpack(">4I", payload)))


def text_of(payload: bytes) -> str:
    """Return the message of a text package."""
    if not payload or len(payload) < 1 + payload[0]:
        raise RtdeError("a text package without its text")
    return payload[1 : 1 + payload[0]].decode("utf-8", "replace")


@dataclass(frozen=True, slots=True)
class Recipe:
    """Fields of data packages in their order, with their types, under the controller's number."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def from_answer(cls, names: Sequence[str], payload: bytes) -> Recipe:
        """Return the recipe that an answer sets up; types may be `NOT_FOUND` or `IN_USE`."""
        types = tuple(payload[1:].decode("ascii", "replace").split(","))
        if not payload or len(types) != len(names):
            raise RtdeError(f"{len(types)} types for {len(names)} fields")
        return cls(payload[0], tuple(names), types)

    def lacking(self, why: str) -> list[str]:
        """Return the fields with this type: `NOT_FOUND` or `IN_USE`."""
        return [name for name, each in zip(self.names, self.types, strict=True) if each == why]

    def decode(self, payload: bytes) -> dict[str, Value]:
        """Return the values of a data package by field; raises `RtdeError`, also for NaN."""
        layout = self._layout()
        if len(payload) != layout.size or payload[0] != self.number:
            raise RtdeError(
                f"data of {len(payload)} bytes of recipe {payload[:1].hex()}, "
                f"wanted {layout.size} of {self.number:02x}"
            )
        values = iter(layout.unpack(payload)[1:])
        found: dict[str, Value] = {}
        for name, each in zip(self.names, self.types, strict=True):
            count = int(FORMATS[each][:-1] or 1)
            taken = tuple(next(values) for _ in range(count))
            if not all(math.isfinite(value) for value in taken):
                raise RtdeError(f"{name} is {', '.join(map(str, taken))}")
            found[name] = taken if count > 1 else taken[0]
        return found

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return a data package."""
        flat = [part for name in self.names for part in _parts(values[name])]
        return encode(Kind.DATA, self._layout().pack(self.number, *flat))

    def _layout(self) -> struct.Struct:
        unknown = [each for each in self.types if each not in FORMATS]
        if unknown:
            raise RtdeError(f"fields of type {', '.join(unknown)}")
        return struct.Struct(">B" + "".join(FORMATS[each] for each in self.types))


def _parts(value: Value) -> tuple[int | float, ...]:
    return value if isinstance(value, tuple) else (value,)


class Packages:
    """Puts the packages of a stream of bytes together, however they were split or glued."""

    def __init__(self) -> None:
        self._bytes = b""

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and payload of each package that ``data`` completes; raises `RtdeError`."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if not _HEAD.size <= size <= LONGEST:
                raise RtdeError(
                    f"a package of {size} bytes, {_HEAD.size} to {LONGEST} are possible"
                )
            if len(self._bytes) < size:
                return
            payload, self._bytes = self._bytes[_HEAD.size : size], self._bytes[size:]
            yield kind, payload
