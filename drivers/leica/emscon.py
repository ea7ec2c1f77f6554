"""Leica emScon TPI, the binary interface of Leica's laser trackers: codec and framing.

Little-endian, packed to 4 bytes; every packet starts with its size and its type. A result is no
reply: the reply to "start measurement" comes at once, the result later as a packet of its own, with
status changes between them, two packets in one segment or one over two.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMALLEST, LARGEST = 12, 65536
_HEADER = struct.Struct("<II")
_COMMAND = struct.Struct("<III")
_RESULT = struct.Struct("<Iii17d")
_SYSTEM_STATUS = struct.Struct("<IIII iii Iii")
_TRACKER_INFO = struct.Struct("<I64s")
_REFLECTOR = struct.Struct("<iiId64s")
UNITS = struct.Struct("<5I")
ENVIRONMENT = struct.Struct("<3d")
NUMBER = struct.Struct("<i")
STATIONARY = struct.Struct("<ii")
SEARCH = struct.Struct("<di")
DISTANCE = struct.Struct("<d")
POSITION = struct.Struct("<3di")
CONTINUOUS = struct.Struct("<4i")  # separation ms, number of points, use region, region type
SYSTEM_SETTINGS = struct.Struct("<3i")  # weather monitor, transformation, orientation in use, ...
ORIENTATION = struct.Struct("<6d")  # of the station: three lengths, three angles
TRANSFORMATION = struct.Struct("<7d")  # three lengths, three angles, scale
_MULTI = struct.Struct("<IiII3d")
_SAMPLE = np.dtype([("status", "<i4"), ("s", "<i4"), ("us", "<i4"), ("xyz", "<f8", (3,))])

MILLIMETRE_UNITS = (1, 0, 0, 0, 0)  # mm, rad, Celsius, mbar, % relative humidity
OTHER_UNITS_MM = {
    "metres": 1000.0, "micrometres": 0.001, "feet": 304.8, "yards": 914.4, "inches": 25.4,
}  # fmt: skip
FARTHEST = 1e9  # in every unit beyond the reach of any tracker; figures above are no positions
RIGHT_HANDED = 0
STATIONARY_MODE, CONTINUOUS_TIME_MODE = 0, 1
UNTIL_STOPPED = 0
INITIALIZED = 5
AIR_MEASURED = 2  # the weather monitor reads, and corrects the distances by it
FIRST_FACE, SECOND_FACE = 1, 2  # ES_TrackerFace
TEMPERATURE_C = (-20.0, 60.0)
PRESSURE_MBAR = (500.0, 1200.0)
HUMIDITY_PERCENT = (0.0, 100.0)


class EmsconError(ValueError):
    """Bytes that are no packet of the interface."""


class Type(IntEnum):
    """Kinds of packets (ES_DataType)."""

    COMMAND = 0
    ERROR = 1
    SINGLE_RESULT = 2
    MULTI_RESULT = 3
    REFLECTOR_POSITION = 7
    STATUS_CHANGE = 8


class Command(IntEnum):
    """Commands used here (ES_Command)."""

    GET_SYSTEM_STATUS = 1
    SET_UNITS = 5
    GET_UNITS = 6
    INITIALIZE = 7
    GET_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    GET_ENVIRONMENT = 21
    SET_MEASUREMENT_MODE = 24
    GET_MEASUREMENT_MODE = 25
    SET_COORDINATE_SYSTEM = 26
    GET_COORDINATE_SYSTEM = 27
    SET_STATIONARY = 28
    GET_STATIONARY = 29
    SET_CONTINUOUS_TIME = 30
    GET_CONTINUOUS_TIME = 31
    SET_REFLECTOR = 40
    GET_REFLECTOR = 41
    GET_REFLECTORS = 42
    SET_SEARCH = 43
    GET_SEARCH = 44
    GET_SYSTEM_SETTINGS = 48
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_POSITION = 55
    FIND_REFLECTOR = 63
    GET_FACE = 98
    GET_TRACKER_INFO = 132


class Change(IntEnum):
    """Status changes that matter here (ES_SystemStatusChange)."""

    SEARCH = 4
    UNITS = 6
    REFLECTOR = 7
    SYSTEM_SETTINGS = 8
    COMPENSATION = 11
    COORDINATE_SYSTEM = 12
    ORIENTATION = 15
    TRANSFORMATION = 16
    MEASUREMENT_MODE = 17
    STATIONARY = 18
    CONTINUOUS_TIME = 19
    NOT_READY = 25
    READY = 27
    FIRST_FACE = 30
    SECOND_FACE = 31
    PROCESSOR_CLOSING = 997
    SERVER_CLOSING = 998
    SERVER_STARTED = 999


NOT_IMPLEMENTED = 2
STATUS = {
    1: "server busy",
    NOT_IMPLEMENTED: "command not implemented",
    **{code: f"wrong parameter {code - 3 or ''}".rstrip() for code in range(3, 11)},
    **{code: f"parameter {(code - 9) // 2} out of range" for code in range(11, 23)},
    23: "wrong reflector",
    26: "no tracker processor found",
    28: "no last measured point",
    37: "no distance set",
    38: "no tracker connected",
    39: "tracker not initialised",
    57: "weather data out of range",
    94: "no temperature from the weather station",
    95: "no pressure from the weather station",
    96: "no humidity from the weather station",
    98: "invalid input data",
    10004: "not ready: no reflector is locked",
    10005: "distance meter still starting",
    10009: "no stationary result",
    10010: "sensor not levelled",
    10012: "not warmed up",
    10013: "sensor not stable",
    10014: "system not ready for a measurement",
    10015: "the sensor does not answer",
}
BUSY, NOT_READY = 1, 10004
# Which alarm a status raises; all others are not known to the interface.
ALARMS = {
    BUSY: "HC-T21",
    **dict.fromkeys((*range(2, 23), 98), "HC-T23"),
    23: "HC-T12",
    **dict.fromkeys((26, 38, 10015), "HC-T22"),
    **dict.fromkeys((28, 37, NOT_READY), "HC-T11"),
    39: "HC-T04",
    **dict.fromkeys((57, 94, 95, 96), "HC-T05"),
    **dict.fromkeys((10005, 10012), "HC-T19"),
    **dict.fromkeys((10009, 10013), "HC-T15"),
    10010: "HC-T20",
    10014: "HC-T13",
}
UNKNOWN = "HC-T24"
# With these one measurement failed and the device is well; all others are the device's failure.
RECOVERABLE = frozenset(
    {BUSY, 23, 28, 37, 57, 94, 95, 96, 98, NOT_READY, 10005, 10009, 10013, 10014}
)


@dataclass(frozen=True, slots=True)
class Reply:
    """The reply to a command."""

    command: int
    status: int
    body: bytes


@dataclass(frozen=True, slots=True)
class Failure:
    """An error packet: the answer to a refused command, or unasked for when the beam breaks."""

    command: int
    status: int


@dataclass(frozen=True, slots=True)
class StatusChange:
    """Something changed in the tracker."""

    change: int


@dataclass(frozen=True, slots=True)
class Single:
    """A single measurement in the units and the coordinate system that are set."""

    status: int
    mode: int
    xyz: tuple[float, float, float]
    std: tuple[float, float, float]
    std_total: float
    temperature: float
    pressure: float
    humidity: float


@dataclass(frozen=True, slots=True, eq=False)
class Multi:
    """Samples of a continuous measurement: the worst status of all, device times (N,), (N, 3)."""

    status: int
    device_s: NDArray[np.float64]
    xyz: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Other:
    """A packet of a kind that is not used here."""

    kind: int


Packet = Reply | Failure | StatusChange | Single | Multi | Other


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """Processor state, version, weather monitor and serial number, as the tracker reports them."""

    processor: int
    version: str
    weather_monitor: int
    serial: int


@dataclass(frozen=True, slots=True)
class Reflector:
    """One of the tracker's reflectors; the server sends one such reply for each of ``total``."""

    total: int
    number: int
    offset_mm: float
    name: str


def encode(command: Command, body: bytes = b"") -> bytes:
    """Return a command packet."""
    return _COMMAND.pack(_COMMAND.size + len(body), Type.COMMAND, command) + body


def alarm(status: int) -> str:
    """Return the code of the alarm that a status raises."""
    return ALARMS.get(status, UNKNOWN)


def status_text(status: int) -> str:
    """Return a status code with its meaning."""
    return f"status {status} ({STATUS.get(status, 'unknown')})"


def air_problem(temperature_c: float, pressure_mbar: float, humidity_percent: float) -> str:
    """Return why the air's values are impossible, or nothing."""
    if temperature_c == humidity_percent == 0.0:
        return "temperature 0 C and humidity 0 %: the probe does not measure"
    limits = (
        ("temperature", temperature_c, "C", TEMPERATURE_C),
        ("pressure", pressure_mbar, "mbar", PRESSURE_MBAR),
        ("humidity", humidity_percent, "%", HUMIDITY_PERCENT),
    )
    for name, value, unit, (low, high) in limits:
        if not low <= value <= high:
            return f"{name} {value} {unit} is not between {low:g} and {high:g}"
    return ""


def possible(*values: float) -> bool:
    """Whether these are finite lengths within any tracker's reach, in whichever unit."""
    return all(abs(value) < FARTHEST for value in values)


class PacketReader:
    """Cuts a stream of bytes into packets."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete now; after an `EmsconError` the stream is lost."""
        self._buffer += data
        packets = []
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if not SMALLEST <= size <= LARGEST:
                raise EmsconError(f"a packet of {size} bytes is announced")
            if len(self._buffer) < size:
                break
            packets.append(decode(kind, bytes(self._buffer[_HEADER.size : size])))
            del self._buffer[:size]
        return packets


def decode(kind: int, body: bytes) -> Packet:
    """Return the packet of type ``kind`` whose bytes after the header are ``body``."""
    try:
        if kind == Type.COMMAND:
            command, status = struct.unpack_from("<II", body)
            return Reply(command, status, body[8:])
        if kind == Type.ERROR:
            return Failure(*struct.unpack_from("<II", body))
        if kind == Type.STATUS_CHANGE:
            return StatusChange(*struct.unpack_from("<I", body))
        if kind == Type.SINGLE_RESULT:
            return _single(*_RESULT.unpack_from(body))
        if kind == Type.MULTI_RESULT:
            return _multi(body)
    except struct.error as error:
        raise EmsconError(f"a packet of type {kind} with only {len(body)} bytes") from error
    return Other(kind)


def _single(status: int, mode: int, _try_mode: int, *values: float) -> Single:
    x, y, z, std_1, std_2, std_3, std_total = values[:7]
    return Single(status, mode, (x, y, z), (std_1, std_2, std_3), std_total, *values[14:])


def _multi(body: bytes) -> Multi:
    status, count, _mode, _try_mode, *_air = _MULTI.unpack_from(body)
    if count != (len(body) - _MULTI.size) / _SAMPLE.itemsize:
        raise EmsconError(f"{count} samples are announced in {len(body)} bytes")
    samples = np.frombuffer(body, _SAMPLE, offset=_MULTI.size)
    bad = samples["status"][samples["status"] != 0]
    device_s = samples["s"] + samples["us"] * 1e-6
    return Multi(status or int(bad[0] if len(bad) else 0), device_s, samples["xyz"].copy())


def decode_system_status(body: bytes) -> SystemStatus:
    """Return the body of the reply to GetSystemStatus."""
    values = _unpack(_SYSTEM_STATUS, body)
    major, minor, build, weather, _flags, serial = values[4:]
    return SystemStatus(values[1], f"{major}.{minor}.{build}", weather, serial)


def decode_tracker_name(body: bytes) -> str:
    """Return the name in the body of the reply to GetTrackerInfo."""
    _kind, name = _unpack(_TRACKER_INFO, body)
    return _text(name)


def decode_reflector(body: bytes) -> Reflector:
    """Return the body of one reply to GetReflectors."""
    total, number, _kind, offset_mm, name = _unpack(_REFLECTOR, body)
    return Reflector(total, number, offset_mm, _text(name))


def unpack(layout: struct.Struct, body: bytes) -> tuple[float, ...]:
    """Return the numbers of a reply's body; raises `EmsconError`."""
    return tuple(_unpack(layout, body))


def _unpack(layout: struct.Struct, body: bytes) -> tuple[Any, ...]:
    try:
        return layout.unpack_from(body)
    except struct.error as error:
        raise EmsconError(f"a reply of {len(body)} bytes, {layout.size} expected") from error


def _text(field: bytes) -> str:
    return field.decode("utf-16-le", errors="replace").partition("\0")[0]
