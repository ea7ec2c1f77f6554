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
from functools import cached_property

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

Numbers = tuple[int | float, ...]


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


@dataclass(frozen=True)
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

    def decode(self, payload: bytes) -> dict[str, Numbers]:
        """Return the numbers of a data package by field; raises `RtdeError`, also for NaN."""
        layout, places = self._layout
        if len(payload) != layout.size or payload[0] != self.number:
            raise RtdeError(
                f"a data package of {len(payload)} bytes by recipe {payload[:1].hex() or 'none'} "
                f"came, wanted {layout.size} bytes by recipe {self.number:02x}"
            )
        flat = layout.unpack(payload)
        found = {name: flat[place] for name, place in places.items()}
        if not math.isfinite(sum(flat)):
            for name, numbers in found.items():
                if not all(map(math.isfinite, numbers)):
                    raise RtdeError(f"{name} is {', '.join(map(str, numbers))}")
        return found

    def encode(self, values: Mapping[str, Numbers]) -> bytes:
        """Return a data package."""
        flat = [number for name in self.names for number in values[name]]
        return encode(Kind.DATA, self._layout[0].pack(self.number, *flat))

    @cached_property
    def _layout(self) -> tuple[struct.Struct, dict[str, slice]]:
        """Return the layout of a data package, and the place of each field among its values."""
        unknown = [each for each in self.types if each not in FORMATS]
        if unknown:
            raise RtdeError(f"fields of type {', '.join(unknown)}")
        places, place = dict[str, slice](), 1
        for name, each in zip(self.names, self.types, strict=True):
            count = int(FORMATS[each][:-1] or 1)
            places[name] = slice(place, place + count)
            place += count
        return struct.Struct(">B" + "".join(FORMATS[each] for each in self.types)), places


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
