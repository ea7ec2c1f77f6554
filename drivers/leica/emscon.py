"""Leica emScon TPI, the binary interface of Leica's laser trackers: packets and settings.

Little-endian, packed to 4 bytes; every packet starts with its size and its type. A result is no
reply: the reply to "start measurement" comes at once, the result later as a packet of its own, with
status changes between them, two packets in one segment or one over two.

Settings belong to the tracker, not to the connection: they are written, read back, and read again
after a change by another client, of which the tracker notifies without the value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, IntEnum
from struct import Struct
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from drivers.device_errors import TRACKER, ProtocolError
from drivers.tracker_readings import changed, readback_error
from hilcell.ports import DeviceError

SMALLEST, LARGEST = 12, 65536  # bytes of a packet
FARTHEST = 1e9  # in every unit beyond the reach of any tracker; figures above are no positions


class Layout:
    """Numbers in the bodies of commands and replies that are no settings."""

    ENVIRONMENT = Struct("<3d")
    DIRECTION = Struct("<2d")  # horizontal angle from x to y, zenith angle
    DISTANCE = Struct("<d")
    POSITION = Struct("<3di")


class Value:
    """Values of settings, as they are written and read."""

    MILLIMETRES = (1, 0, 0, 0, 0)  # mm, rad, Celsius, mbar, % relative humidity
    RIGHT_HANDED = 0
    STATIONARY, CONTINUOUS_TIME = 0, 1
    UNTIL_STOPPED = 0
    FIRST_FACE, SECOND_FACE = 1, 2  # ES_TrackerFace


class Type(IntEnum):
    """Kinds of packets (ES_DataType)."""

    COMMAND = 0
    ERROR = 1
    SINGLE_RESULT = 2
    MULTI_RESULT = 3
    STATUS_CHANGE = 8


class Command(IntEnum):
    """Commands used here (ES_Command), besides those that read and write a `Setting`."""

    GET_SYSTEM_STATUS = 1
    INITIALIZE = 7
    GET_ENVIRONMENT = 21
    GET_REFLECTORS = 42
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    GO_POSITION = 55
    FIND_REFLECTOR = 63
    GET_DIRECTION = 66
    GET_TRACKER_INFO = 132


class Change(IntEnum):
    """Status changes that matter here (ES_SystemStatusChange), besides those of a `Setting`."""

    COMPENSATION = 11
    NOT_READY = 25
    PROCESSOR_CLOSING = 997
    SERVER_CLOSING = 998
    SERVER_STARTED = 999


class Setting(Enum):
    """A setting: its label, the commands that read and write it, its status changes, its layout.

    The face and what makes the frame are not written here.
    """

    UNITS = "units", 6, 5, {6}, "<5I"
    COORDINATE_SYSTEM = "coordinate system", 27, 26, {12}, "<i"
    MEASUREMENT_MODE = "measurement mode", 25, 24, {17}, "<i"
    STATIONARY = "stationary parameters", 29, 28, {18}, "<ii"
    # Separation in ms, number of points, use of a region, its type.
    CONTINUOUS_TIME = "continuous time parameters", 31, 30, {19}, "<4i"
    SEARCH = "search", 44, 43, {4}, "<di"
    REFLECTOR = "reflector", 41, 40, {7}, "<i"
    FACE = "face", 98, 0, {30, 31}, "<i"
    # Followed by other settings of the system.
    SYSTEM_SETTINGS = "weather monitor, transformation and orientation in use", 48, 0, {8}, "<3i"
    ORIENTATION = "station orientation", 13, 0, {15}, "<6d"  # three lengths, three angles
    TRANSFORMATION = "transformation", 15, 0, {16}, "<7d"  # three lengths, three angles, scale

    def __init__(self, label: str, read: int, write: int, changes: set[int], layout: str) -> None:
        self.label, self.read, self.write = label, read, write
        self.changes, self.layout = changes, Struct(layout)


COMMAND_NAMES = {
    **{int(each): each.name for each in Command},
    **{each.write: f"set {each.name}" for each in Setting if each.write},
    **{each.read: f"get {each.name}" for each in Setting},
}


def command_name(command: int) -> str:
    return COMMAND_NAMES[command].lower().replace("_", " ")


def failed(command: int, status: int) -> DeviceError:
    known = STATUS.get(status, UNKNOWN)
    error = TRACKER.no_reading if known.recoverable else TRACKER.failed
    return error(known.alarm, command_name(command), status_text(status), status=status)


class Status(NamedTuple):
    """Text and alarm of a status, and whether only one measurement failed."""

    text: str
    alarm: str
    recoverable: bool = False


BUSY, NOT_IMPLEMENTED, NOT_READY = 1, 2, 10004
STATUS = {
    BUSY: Status("server busy", "HC-T21", recoverable=True),
    NOT_IMPLEMENTED: Status("command not implemented", "HC-T23"),
    **{n: Status(f"wrong parameter {n - 3 or ''}".rstrip(), "HC-T23") for n in range(3, 11)},
    **{n: Status(f"parameter {(n - 9) // 2} out of range", "HC-T23") for n in range(11, 23)},
    23: Status("wrong reflector", "HC-T12", recoverable=True),
    26: Status("no tracker processor found", "HC-T22"),
    28: Status("no last measured point", "HC-T11", recoverable=True),
    37: Status("no distance set", "HC-T11", recoverable=True),
    38: Status("no tracker connected", "HC-T22"),
    39: Status("tracker not initialised", "HC-T04"),
    57: Status("weather data out of range", "HC-T05", recoverable=True),
    94: Status("no temperature from the weather station", "HC-T05", recoverable=True),
    95: Status("no pressure from the weather station", "HC-T05", recoverable=True),
    96: Status("no humidity from the weather station", "HC-T05", recoverable=True),
    98: Status("invalid input data", "HC-T23", recoverable=True),
    NOT_READY: Status("not ready: no reflector is locked", "HC-T11", recoverable=True),
    10005: Status("distance meter still starting", "HC-T19", recoverable=True),
    10009: Status("no stationary result", "HC-T15", recoverable=True),
    10010: Status("sensor not levelled", "HC-T20"),
    10012: Status("not warmed up", "HC-T19"),
    10013: Status("sensor not stable", "HC-T15", recoverable=True),
    10014: Status("system not ready for a measurement", "HC-T13", recoverable=True),
    10015: Status("the sensor does not answer", "HC-T22"),
}
UNKNOWN = Status("unknown", "HC-T24")


class Reply(NamedTuple):
    """The reply to a command."""

    command: int
    status: int
    body: bytes


class Failure(NamedTuple):
    """An error packet: the answer to a refused command, or unasked for when the beam breaks."""

    command: int
    status: int


class StatusChange(NamedTuple):
    """Something changed in the tracker."""

    change: int


class Single(NamedTuple):
    """A single measurement in the units and the coordinate system that are set."""

    status: int
    xyz: tuple[float, float, float]
    std: tuple[float, float, float]
    std_total: float
    air: tuple[float, float, float]  # temperature, pressure, humidity

    @classmethod
    def decode(cls, body: bytes) -> Self:
        """Return the result in a packet's body; raises `struct.error`."""
        # Passed over: the modes, and the covariances behind the deviations.
        values = struct.unpack_from("<I 8x 7d 56x 3d", body)
        return cls(values[0], values[1:4], values[4:7], values[7], values[8:])


@dataclass(frozen=True, slots=True, eq=False)
class Multi:
    """Samples of a continuous measurement: the worst status of all, device times (N,), (N, 3)."""

    status: int
    device_s: NDArray[np.float64]
    xyz: NDArray[np.float64]

    @classmethod
    def decode(cls, body: bytes) -> Self:
        """Return the samples in a packet's body; raises `ProtocolError` or `struct.error`."""
        header = Struct("<IiII3d")
        status, count, _mode, _try_mode, *_air = header.unpack_from(body)
        layout = np.dtype([("status", "<i4"), ("s", "<i4"), ("us", "<i4"), ("xyz", "<f8", (3,))])
        if count != (len(body) - header.size) / layout.itemsize:
            raise ProtocolError(f"{count} samples are announced in {len(body)} bytes")
        samples = np.frombuffer(body, layout, offset=header.size)
        bad = samples["status"][samples["status"] != 0]
        device_s = samples["s"] + samples["us"] * 1e-6
        return cls(status or int(bad[0] if len(bad) else 0), device_s, samples["xyz"].copy())


Packet = Reply | Failure | StatusChange | Single | Multi


def check_measured(packet: Packet, kind: type[Single | Multi], operation: str) -> None:
    """Raise the error of a failed measurement, or of a bad result."""
    if isinstance(packet, Failure) or (isinstance(packet, kind) and packet.status != 0):
        raise failed(Command.START_MEASUREMENT, packet.status)
    if packet == StatusChange(Change.NOT_READY):
        raise TRACKER.no_reading("HC-T10", operation, "the beam broke")


@dataclass(frozen=True, slots=True)
class SystemStatus:
    """States of processor, laser, distance meter and weather monitor; version, serial number."""

    INITIALIZED: ClassVar[int] = 5  # of the processor
    LASER_READY: ClassVar[int] = 3
    ADM_READY: ClassVar[int] = 2
    NO_SENSOR: ClassVar[int] = 99  # type of the tracker
    AIR_MEASURED: ClassVar[int] = 2  # the weather monitor reads, and corrects the distances by it

    processor: int
    laser: int
    adm: int
    version: str
    weather_monitor: int
    serial: int

    @classmethod
    def decode(cls, body: bytes) -> Self:
        """Return the body of the reply to GetSystemStatus; raises `struct.error`."""
        values = struct.unpack_from("<IIII iii Iii", body)
        major, minor, build, weather, _flags, serial = values[4:]
        _last, processor, laser, adm = values[:4]
        return cls(processor, laser, adm, f"{major}.{minor}.{build}", weather, serial)


class Reflector(NamedTuple):
    """One of the tracker's reflectors; the server sends one such reply for each of ``total``."""

    total: int
    number: int
    offset_mm: float
    name: str

    @classmethod
    def decode(cls, body: bytes) -> Self:
        """Return the body of one reply to GetReflectors; raises `struct.error`."""
        total, number, _kind, offset_mm, name = struct.unpack_from("<iiId64s", body)
        return cls(total, number, offset_mm, utf_16_text(name))


def encode(command: int, body: bytes = b"") -> bytes:
    return struct.pack("<III", SMALLEST + len(body), Type.COMMAND, command) + body


def status_text(status: int) -> str:
    return f"status {status} ({STATUS.get(status, UNKNOWN).text})"


def air_problem(temperature_c: float, pressure_mbar: float, humidity_percent: float) -> str:
    if temperature_c == humidity_percent == 0.0:
        return "temperature 0 C and humidity 0 %: the probe does not measure"
    limits = (
        ("temperature", temperature_c, "C", (-20.0, 60.0)),
        ("pressure", pressure_mbar, "mbar", (500.0, 1200.0)),
        ("humidity", humidity_percent, "%", (0.0, 100.0)),
    )
    for name, value, unit, (low, high) in limits:
        if not low <= value <= high:
            return f"{name} {value} {unit} is not between {low:g} and {high:g}"
    return ""


def direction(horizontal_rad: float, zenith_rad: float) -> list[float]:
    """Return the unit vector (3,) of a beam at two angles, in the tracker's frame."""
    across = math.sin(zenith_rad)
    return [
        across * math.cos(horizontal_rad),
        across * math.sin(horizontal_rad),
        math.cos(zenith_rad),
    ]


def possible(*values: float) -> bool:
    """Whether these are finite lengths within any tracker's reach, in whichever unit."""
    return all(abs(value) < FARTHEST for value in values)


class PacketReader:
    """Cuts a stream of bytes into packets."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Return the packets that are complete now; after a `ProtocolError` the stream is lost."""
        self._buffer += data
        packets = list[Packet]()
        header = Struct("<II")
        while len(self._buffer) >= header.size:
            size, kind = header.unpack_from(self._buffer)
            if not SMALLEST <= size <= LARGEST:
                raise ProtocolError(f"a packet of {size} bytes is announced")
            if len(self._buffer) < size:
                break
            packet = decode(kind, bytes(self._buffer[header.size : size]))
            packets += [] if packet is None else [packet]
            del self._buffer[:size]
        return packets


def decode(kind: int, body: bytes) -> Packet | None:
    """Return a packet by its type and the bytes after its header; None of a type not used here."""
    try:
        if kind == Type.COMMAND:
            command, status = struct.unpack_from("<II", body)
            return Reply(command, status, body[8:])
        if kind == Type.ERROR:
            return Failure(*struct.unpack_from("<II", body))
        if kind == Type.STATUS_CHANGE:
            return StatusChange(*struct.unpack_from("<I", body))
        if kind == Type.SINGLE_RESULT:
            return Single.decode(body)
        if kind == Type.MULTI_RESULT:
            return Multi.decode(body)
    except struct.error as error:
        raise ProtocolError(f"a packet of type {kind} with only {len(body)} bytes") from error
    return None


def decode_tracker_name(body: bytes) -> str:
    """Return the name in the body of the reply to GetTrackerInfo; raises `struct.error`."""
    _kind, name = struct.unpack_from("<I64s", body)
    return utf_16_text(name)


def utf_16_text(field: bytes) -> str:
    return field.decode("utf-16-le", errors="replace").partition("\0")[0]


class EmsconSettings:
    """The values that the tracker is set to, and the changes by other clients."""

    def __init__(
        self,
        ask: Callable[[int, bytes], bytes],
        numbers_of: Callable[[int, Struct], tuple[float, ...]],
    ) -> None:
        self._ask, self._numbers_of = ask, numbers_of
        self._recorded: dict[Setting, tuple[float, ...]] = {}
        self._changes: set[int] = set()

    def write(self, setting: Setting, *values: float) -> None:
        """Write a setting and believe it only when it reads back."""
        self._ask(setting.write, setting.layout.pack(*values))
        self.expect(setting, *values)

    def expect(self, setting: Setting, *values: float) -> None:
        """Refuse a setting that does not read as these values, and store them. Lengths are
        converted from and to the tracker's own unit, so their last digits may differ.
        """
        found = self._numbers_of(setting.read, setting.layout)
        self._changes.difference_update(setting.changes)  # our own; the reading is newer
        if not self._same(found, values):
            raise readback_error(setting.label, found, values)
        self._recorded[setting] = values

    def record(self, setting: Setting) -> tuple[float, ...]:
        """Return a setting that is left unchanged, and must stay so."""
        self._recorded[setting] = found = self._numbers_of(setting.read, setting.layout)
        return found

    def recorded(self, setting: Setting) -> tuple[float, ...]:
        """Return the value of a setting that was written or recorded."""
        return self._recorded[setting]

    def record_frame(self) -> None:
        """Record the frame in which the tracker measures; refuse one with a scale.

        A controller without system settings is older, and has none of these.
        """
        try:
            if not self._ask(Setting.SYSTEM_SETTINGS.read, b""):
                return
        except DeviceError as refusal:
            if refusal.fields.get("status") != NOT_IMPLEMENTED:
                raise
            return
        _weather, transforms, _orients = self.record(Setting.SYSTEM_SETTINGS)
        self.record(Setting.ORIENTATION)
        scale = self.record(Setting.TRANSFORMATION)[-1]
        if transforms and not abs(scale - 1.0) <= 1e-9:
            raise TRACKER.refused(
                "HC-T06",
                "connect",
                f"a transformation of scale {scale:.9g} is in use",
                expected="1",
                act="switch it off or set its scale to 1 in the tracker's software, then resume",
                setting=Setting.TRANSFORMATION.label,
                scale=scale,
            )

    def note_change(self, change: int) -> None:
        """Note a change; nothing is asked yet."""
        self._changes.add(change)

    def verify(self) -> None:
        """Read each changed setting again; raises `DeviceError` where its value differs."""
        if Change.COMPENSATION in self._changes:
            raise changed("compensation", "it was changed", "the one of before")
        all_of_them = Change.SERVER_STARTED in self._changes
        for setting in self._recorded:
            if all_of_them or not self._changes.isdisjoint(setting.changes):
                self.verify_setting(setting)
        self._changes.clear()

    def verify_setting(self, setting: Setting) -> None:
        """Raise `DeviceError` where a setting is no longer the recorded one."""
        found, recorded = self._numbers_of(setting.read, setting.layout), self._recorded[setting]
        if not self._same(found, recorded):
            raise changed(setting.label, f"now reads {found}", f"{recorded}")

    @staticmethod
    def _same(found: tuple[float, ...], expected: tuple[float, ...]) -> bool:
        return bool(np.allclose(found, expected, rtol=1e-6, atol=1e-6))
