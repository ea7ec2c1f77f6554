"""A laser tracker over TCP, by Leica's emScon TPI (Programmer's Manual, binary interface).

Positions on the wire have the configured units and axes, internally mm, right-handed. As in the
original, lengths are metres until SetUnits, and a measurement is acknowledged at once while its
result is a later packet.

During an operation StopMeasurement is obeyed, and other commands are answered with "busy". In
stepped time results follow at once. Samples of a stream are sent when due: in stepped time by the
thread that advances time.
"""

from __future__ import annotations

import math
import operator
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from itertools import takewhile

import numpy as np

from fakes.faults import Faults, Vanished
from fakes.site import Site
from fakes.time import CellTime
from fakes.truth.tracker_truth import Followed, Measurement, StreamTruth
from fakes.truth.transforms import Array
from fakes.wires import HOST, Connection, Listener, Segments, Server

# -- packets: little-endian, pack 4 (names after the header of the TPI) ----------------

# Every packet begins ``size i32 | type u32``; commands and replies continue with ``command u32``,
# replies with ``status u32``, then the command's fields.

HEAD = struct.Struct("<iI")
COMMAND = struct.Struct("<iII")


class Type(IntEnum):
    """Type of a packet."""

    COMMAND = 0
    ERROR = 1
    SINGLE_RESULT = 2
    MULTI_RESULT = 3
    STATUS_CHANGE = 8


class Command(IntEnum):
    """Commands of an emScon tracker, besides its settings."""

    GET_SYSTEM_STATUS = 1
    GET_TRACKER_STATUS = 2
    INITIALIZE = 7
    GET_ORIENTATION = 13
    GET_TRANSFORMATION = 15
    GET_REFLECTORS = 42
    START_MEASUREMENT = 49
    STOP_MEASUREMENT = 52
    CHANGE_FACE = 53
    GO_BIRD_BATH = 54
    GO_POSITION = 55
    POINT_LASER = 58
    FIND_REFLECTOR = 63
    GET_DIRECTION = 66
    GET_FACE = 98
    GET_MEASUREMENT_STATUS = 122
    GET_TRACKER_INFO = 132
    GO_AND_MEASURE = 135
    GET_SOFTWARE_VERSION = 142


class Status(IntEnum):
    """Result status of a reply."""

    OK = 0
    BUSY = 1
    NOT_IMPLEMENTED = 2
    WRONG_PARAMETER = 3
    WRONG_PARAMETER_1 = 4
    OUT_OF_RANGE_1 = 12
    WRONG_REFLECTOR = 23
    NO_DISTANCE = 37
    NOT_INITIALIZED = 39
    WEATHER_OUT_OF_RANGE = 57
    NO_TEMPERATURE = 94
    NOT_READY = 10004
    NO_STATIONARY_RESULT = 10009
    NOT_WARMED_UP = 10012


class Change(IntEnum):
    """Unsolicited system status changes, besides those of settings."""

    ENVIRONMENT = 2
    REFRACTION = 3
    NOT_READY = 25
    MEASURING = 26
    READY = 27
    INITIALIZATION = 151


def reply(command: int, status: int = Status.OK, body: bytes = b"") -> bytes:
    """Return a reply; errors are packets of a type of their own, without body."""
    layout = struct.Struct("<iIII")
    if status != Status.OK:
        return layout.pack(layout.size, Type.ERROR, command, status)
    return layout.pack(layout.size + len(body), Type.COMMAND, command, status) + body


def status_change(change: int) -> bytes:
    return COMMAND.pack(COMMAND.size, Type.STATUS_CHANGE, change)


def single_result(values: tuple[float, ...], status: int = Status.OK) -> bytes:
    """Return SingleMeasResult: ReturnDataT's status, mode 0, no try mode, 17 doubles."""
    layout = struct.Struct("<iIIIi17d")
    return layout.pack(layout.size, Type.SINGLE_RESULT, status, 0, 0, *values)


def multi_result(times_s: Array, xyz: Array, air: tuple[float, float, float]) -> bytes:
    """Return MultiMeasResult in mode 1: samples with the tracker's time in s and us."""
    layout = struct.Struct("<iIIiII3d")
    sample = np.dtype([("status", "<i4"), ("s", "<i4"), ("us", "<i4"), ("xyz", "<f8", (3,))])
    samples = np.zeros(len(times_s), sample)
    samples["s"], samples["us"] = np.divmod(np.rint(times_s * 1e6), 1_000_000)
    samples["xyz"] = xyz
    size = layout.size + samples.nbytes
    head = layout.pack(size, Type.MULTI_RESULT, Status.OK, len(samples), 1, 0, *air)
    return head + samples.tobytes()


def wide(text: str) -> bytes:
    """Return a name as 32 UTF-16 units."""
    return text[:31].encode("utf-16-le").ljust(64, b"\0")


# -- samples --------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class SampleStream:
    """A continuous measurement: samples by the tracker's clock, in late and divided packets.

    Due samples depend on cell time alone, not on polls. As in the original a packet has several
    samples and is late; it may come in two pieces, or together with the next; only its timestamps
    tell when a sample was taken. Not thread-safe.
    """

    truth: StreamTruth
    time: CellTime
    faults: Faults
    followed: Followed
    pack: Callable[[Array, Array], bytes]  # device times (N,), positions (N, 3) mm -> packet
    separation_s: float
    points: int  # 0: until stopped
    lost: Callable[[], None]  # called when the beam breaks

    def __post_init__(self) -> None:
        self._start_s = self.truth.device_s(self.time.now_s())
        self._sampled = self._packets = 0
        self._times_s, self._xyz_mm = np.zeros(0), np.zeros((0, 3))
        self._delayed = b""
        self.ended = False

    def due(self) -> bytes:
        """Return the packets that are due by now."""
        if self.ended:
            return b""
        broken = self._sample()
        sent = b""
        packet_samples = (8, 3, 12, 5, 9)  # in sequence
        while len(self._times_s) >= (size := packet_samples[self._packets % len(packet_samples)]):
            sent += self._packet(size)
        if broken or self._sampled == self.points != 0:
            sent += self.end() + status_change(Change.NOT_READY if broken else Change.READY)
        if broken:
            self.lost()
        return sent

    def end(self) -> bytes:
        """Return all remaining bytes; a second call does nothing."""
        if self.ended:
            return b""
        self.ended = True
        self.followed.end()
        rest = self.pack(self._times_s, self._xyz_mm) if len(self._times_s) else b""
        return self._delayed + rest

    def _sample(self) -> bool:
        """Take the due samples; return whether the beam broke."""
        now_s = self.truth.device_s(self.time.now_s())
        due = int((now_s - self._start_s) / self.separation_s)
        wanted = min(due, self.points) if self.points else due
        if wanted == self._sampled:
            return False
        numbers = np.arange(self._sampled + 1, wanted + 1)
        beam = takewhile(lambda _: not self.faults.strikes("tracker.stream_break"), numbers)
        seen = sum(1 for _ in beam)
        times_s = np.asarray(self._start_s + self.separation_s * numbers[:seen], dtype=float)
        xyz_mm = self.followed.read(times_s) if len(times_s) else np.zeros((0, 3))
        self._sampled += len(xyz_mm)
        self._times_s = np.append(self._times_s, times_s[: len(xyz_mm)])
        self._xyz_mm = np.vstack([self._xyz_mm, xyz_mm])
        return len(xyz_mm) < len(numbers)

    def _packet(self, size: int) -> bytes:
        """Return the bytes to send now; the rest waits for the next packet."""
        self._packets += 1
        data = self._delayed + self.pack(self._times_s[:size], self._xyz_mm[:size])
        self._times_s, self._xyz_mm = self._times_s[size:], self._xyz_mm[size:]
        cut = len(data)
        late_every, cut_every = 5, 3  # packets that are delayed, completely or their second half
        if self._packets % late_every == 0:
            cut = 0
        elif self._packets % cut_every == 0:
            cut //= 2
        self._delayed = data[cut:]
        return data[:cut]


MM_PER_UNIT = {0: 1000.0, 1: 1.0}  # m, mm
RAD_PER_UNIT = {0: 1.0, 1: math.pi / 180, 2: math.pi / 200}
AXES = {0: (1, 1, 1), 1: (-1, 1, 1), 2: (1, -1, 1), 3: (1, 1, -1)}  # RHR, LHRX, LHRY, LHRZ
STATIONARY, CONTINUOUS_TIME = 0, 1  # modes of measurement
OFFSETS_MM = {"SMR 1.5in": 19.05, "SMR 0.875in": 11.1125, "SMR 0.5in": 6.35}

Arguments = tuple[float, ...]
# Settings: the commands that write and read them, their status change, their fields, and the values
# at the beginning.
SETTINGS: dict[str, tuple[int, int, int, str, Arguments]] = {
    "units": (5, 6, 6, "<5I", (0, 0, 0, 0, 0)),
    "environment": (20, 21, Change.ENVIRONMENT, "<3d", (20.0, 1013.3, 60.0)),
    "refraction": (22, 23, Change.REFRACTION, "<2d", (1.000275, 1.000279)),
    "measurement mode": (24, 25, 17, "<I", (STATIONARY,)),
    "axes": (26, 27, 12, "<I", (0,)),
    "stationary": (28, 29, 18, "<2i", (1000, 1)),
    "continuous": (30, 31, 19, "<4i", (500, 0, 0, 0)),  # separation ms, points, region
    "reflector": (40, 41, 7, "<i", (1,)),
    "search": (43, 44, 4, "<di", (12.0, 30_000)),  # mm, ms
    "system": (47, 48, 8, "<I8i", (2, 0, 0, 0, 1, 0, 0, 0, 0)),
    "statistic mode": (80, 81, 24, "<2I", (0, 0)),
}


class Result(bytes):
    """The packets that end a measurement; faults of a wire may damage them."""


# A step of a command: seconds of cell time to let pass, packets to send together, or packets with
# the stream of samples that follows them.
Steps = Iterator[float | bytes | tuple[bytes, SampleStream]]


class EmsconDevice:
    """One tracker; ``handle`` may come from several threads."""

    SERIAL = 402871
    FIRST, SECOND = 1, 2  # faces
    BALL = 1  # target type: corner cube
    VERSION = (3, 8, 0)
    INITIALISE_S, POINT_S, FACE_S = 30.0, 0.6, 4.0
    LOOK_S = 1.0  # for a reflector in a beam that was let go

    def __init__(self, site: Site) -> None:
        self._lock = threading.RLock()
        self._truth, self._loose = site.truth, False  # loose: a person may have the beam
        self._instrument, self._faults, self._time = site.truth.tracker, site.faults, site.time
        self._streams = site.truth.streams
        mounted = site.cell.tracker.reflector
        names = [*(name for name in OFFSETS_MM if name != mounted), mounted]
        self._reflectors, self._mounted = dict(enumerate(names, 1)), len(names)
        self._settings = {name: values for name, (*_, values) in SETTINGS.items()}
        self._initialised = False
        self._pointing_mm = np.array([1000.0, 0.0, 0.0])
        self._target: str | None = None
        self._face = self.FIRST
        self._late: list[bytes] = []
        queries: dict[int, Callable[[], bytes]] = {
            Command.GET_ORIENTATION: lambda: struct.pack("<6d", *[0.0] * 6),
            Command.GET_TRANSFORMATION: lambda: struct.pack("<7d", *[0.0] * 6, 1.0),
            Command.GET_SYSTEM_STATUS: self._system_status,
            Command.GET_TRACKER_STATUS: lambda: struct.pack("<I", 2 if self._initialised else 0),
            Command.GET_MEASUREMENT_STATUS: self._measurement_status,
            Command.GET_DIRECTION: self._direction,
            Command.GET_FACE: lambda: struct.pack("<I", self._face),
            Command.GET_TRACKER_INFO: self._tracker_info,
            Command.GET_SOFTWARE_VERSION: lambda: (
                ".".join(map(str, self.VERSION)).encode().ljust(64, b"\0")
            ),
        }
        work: dict[int, tuple[str, Callable[..., Steps]]] = {
            Command.GET_REFLECTORS: ("<", self._list_reflectors),
            Command.INITIALIZE: ("<", self._initialise),
            Command.GO_POSITION: ("<3di", self._go_position),
            Command.POINT_LASER: ("<3d", self._point),
            Command.FIND_REFLECTOR: ("<d", self._find_reflector),
            Command.START_MEASUREMENT: ("<", self._start_measurement),
            Command.GO_AND_MEASURE: ("<3d", self._go_and_measure),
            Command.STOP_MEASUREMENT: ("<", lambda command: iter([reply(command)])),
            Command.CHANGE_FACE: ("<", self._change_face),
            Command.GO_BIRD_BATH: ("<", self._go_bird_bath),
        }
        # The format of the fields behind a command, and what it does.
        self._handlers = work | {
            command: ("<", partial(self._query, query)) for command, query in queries.items()
        }
        for name, (write, read, _, form, _) in SETTINGS.items():
            self._handlers[write] = (form, partial(self._set, name))
            self._handlers[read] = ("<", partial(self._query, partial(self._setting, name)))

    def handle(self, packet: bytes) -> Steps:
        """Yield the steps of one complete packet from the client."""
        _, _, command = COMMAND.unpack_from(packet)
        if command not in self._handlers:
            yield reply(command, Status.NOT_IMPLEMENTED)
            return
        form, handler = self._handlers[command]
        try:
            arguments = struct.unpack(form, packet[COMMAND.size :])
        except struct.error:
            yield reply(command, Status.WRONG_PARAMETER)
            return
        steps = handler(command, *arguments)
        while True:
            with self._lock:
                step = next(steps, None)
            if step is None:
                return
            yield step

    # -- settings and queries -------------------------------------------------------------------

    def _set(self, name: str, command: int, *values: float) -> Steps:
        status = self._setting_status(name, values)
        if status != Status.OK:
            yield reply(command, status)
            return
        if name == "search":
            values = (values[0] * self._mm_per_unit(), values[1])
        self._settings[name] = values
        yield reply(command) + status_change(SETTINGS[name][2])

    def _setting_status(self, name: str, values: Arguments) -> Status:
        first, streams = values[0], self._streams is not None
        known_units = (MM_PER_UNIT, RAD_PER_UNIT, {0}, {0, 1}, {0})  # C; mbar or hPa; relative
        refusals: dict[str, tuple[Status, Callable[[], bool]]] = {
            "units": (
                Status.WRONG_PARAMETER_1,
                lambda: all(map(operator.contains, known_units, values)),
            ),
            "axes": (Status.WRONG_PARAMETER_1, lambda: first in AXES),
            "reflector": (Status.WRONG_PARAMETER_1, lambda: first in self._reflectors),
            "measurement mode": (
                Status.NOT_IMPLEMENTED,
                lambda: first == STATIONARY or (first == CONTINUOUS_TIME and streams),
            ),
            "stationary": (Status.OUT_OF_RANGE_1, lambda: 100 <= first <= 100_000),
            "continuous": (Status.OUT_OF_RANGE_1, lambda: 1 <= first <= 100_000),
            "search": (Status.OUT_OF_RANGE_1, lambda: first > 0),
            "environment": (
                Status.WEATHER_OUT_OF_RANGE,
                lambda: -20 <= first <= 60 and 500 <= values[1] <= 1200 and 0 <= values[2] <= 100,
            ),
        }
        status, allowed = refusals.get(name, (Status.OK, lambda: True))
        return Status.OK if allowed() else status

    def _query(self, query: Callable[[], bytes], command: int) -> Steps:
        yield reply(command, Status.OK, query())

    def _setting(self, name: str) -> bytes:
        values = self._settings[name]
        if name == "search":
            values = (values[0] / self._mm_per_unit(), values[1])
        if name == "environment":
            values = self._weather()
        return struct.pack(SETTINGS[name][3], *values)

    def _list_reflectors(self, command: int) -> Steps:
        packets = b""
        for number, name in self._reflectors.items():
            offset = OFFSETS_MM.get(name, 0.0) / self._mm_per_unit()
            head = struct.pack("<iiId", len(self._reflectors), number, self.BALL, offset)
            packets += reply(command, Status.OK, head + wide(name))
        yield packets

    def _system_status(self) -> bytes:
        other = self._faults.strikes("tracker.wrong_identity")
        processor, laser, distance_meter = (5 if self._initialised else 4), 3, 2
        head = struct.pack("<4I", Status.OK, processor, laser, distance_meter)
        return head + struct.pack("<3iI2i", *self.VERSION, 2, 0, self.SERIAL + other)

    def _measurement_status(self) -> bytes:
        self._catch()
        found, compensated, distance, distance_compensated = 1, 2, 4, 8
        bits = found | compensated | distance | distance_compensated
        bits |= 4096 * (self._face == self.FIRST)
        bits |= 2048 * (self._target is not None)
        bits |= 65536 * self._initialised
        return struct.pack("<Ii", Status.OK, bits)

    def _direction(self) -> bytes:
        self._catch()
        x, y, z = self._pointing_mm
        per_unit = RAD_PER_UNIT[int(self._settings["units"][1])]
        angles = math.atan2(y, x) / per_unit, math.atan2(math.hypot(x, y), z) / per_unit
        return struct.pack("<2d", *angles)

    def _tracker_info(self) -> bytes:
        sensor_at401 = 70
        head = struct.pack("<I", sensor_at401) + wide("AT401 (simulated)")
        has_distance, has_camera, has_level = 1, 1, 1
        flags = struct.pack("<5i", self.SERIAL, 1, has_distance, has_camera, has_level)
        limits = struct.pack("<3d2i2d", 0.0, 160.0, 0.5, 1000, 2, 2 * math.pi, math.pi)
        return head + flags + limits + struct.pack("<I2i", 1, *self.VERSION[:2])

    def _weather(self) -> tuple[float, float, float]:
        air = self._instrument.air()
        return air.temperature_c, air.pressure_mbar, air.humidity_percent

    # -- work -----------------------------------------------------------------------------------

    def _initialise(self, command: int) -> Steps:
        self._keep_beam()
        yield self.INITIALISE_S
        self._initialised, self._target, self._face = True, None, self.FIRST
        yield reply(command) + status_change(Change.INITIALIZATION)

    def _go_bird_bath(self, command: int) -> Steps:
        self._target = None
        yield self.FACE_S
        self._loose = True
        self._truth.release_beam()
        yield reply(command)

    def meet_run(self) -> None:
        """Let the person in the hall begin again: a run has come."""
        self._truth.begin_round()

    def _keep_beam(self) -> None:
        """Move the head by its motors: nobody has the beam any more."""
        self._loose = False
        self._truth.keep_beam()

    def _catch(self) -> None:
        """Lock on the reflector on which a person has put the beam meanwhile."""
        nest = self._truth.aimed_at() if self._loose else None
        at_mm = None if nest is None else self._instrument.reflector(nest)
        if at_mm is not None:
            self._loose, self._target, self._pointing_mm = False, nest, at_mm

    def _change_face(self, command: int) -> Steps:
        if not self._initialised:
            yield reply(command, Status.NOT_INITIALIZED)
            return
        yield self.FACE_S
        self._face = self.SECOND if self._face == self.FIRST else self.FIRST
        seen = Change.READY if self._lock_on() else Change.NOT_READY
        yield reply(command) + status_change(seen)

    def _point(self, command: int, *xyz: float) -> Steps:
        self._keep_beam()
        self._pointing_mm, self._target = self._from_wire_mm(xyz), None
        yield self.POINT_S
        yield reply(command)

    def _go_position(self, command: int, x: float, y: float, z: float, _coordinates: int) -> Steps:
        self._pointing_mm = self._from_wire_mm((x, y, z))
        yield from self._search(command)

    def _find_reflector(self, command: int, distance: float) -> Steps:
        distance_mm = distance * self._mm_per_unit()
        if not distance_mm > 0:
            yield reply(command, Status.OUT_OF_RANGE_1)
            return
        direction = self._pointing_mm / np.linalg.norm(self._pointing_mm)
        self._pointing_mm = distance_mm * direction
        yield from self._search(command)

    def _search(self, command: int) -> Steps:
        if not self._initialised:
            yield reply(command, Status.NOT_INITIALIZED)
            return
        self._keep_beam()
        yield self.POINT_S
        if self._lock_on():
            yield reply(command) + status_change(Change.READY)
        else:
            yield status_change(Change.NOT_READY) + reply(command, Status.NO_DISTANCE)

    def _lock_on(self) -> bool:
        self._target = self._instrument.find(self._pointing_mm, self._settings["search"][0])
        if self._faults.strikes("tracker.no_reflector"):
            self._target = None
        return self._target is not None

    def _go_and_measure(self, command: int, *xyz: float) -> Steps:
        self._keep_beam()
        self._pointing_mm = self._from_wire_mm(xyz)
        yield self.POINT_S
        self._lock_on()
        yield from self._start_measurement(command)

    def _start_measurement(self, command: int) -> Steps:
        if self._faults.strikes("tracker.vanish"):
            raise Vanished
        refused = self._refusal()
        if refused != Status.OK:
            yield reply(command, refused)
            return
        if self._loose:
            yield self.LOOK_S
            self._catch()
        broken = self._faults.strikes("tracker.beam_break_before")
        target = self._target
        began_mm = None if target is None else self._instrument.reflector(target)
        if broken or target is None or began_mm is None:  # or carried away
            yield self._broken(command)
            return
        begun = reply(command) + status_change(Change.MEASURING)
        if self._streams is not None and self._settings["measurement mode"][0] == CONTINUOUS_TIME:
            yield begun, self._stream_of(target, self._streams)
            return
        yield begun
        yield self._settings["stationary"][0] / 1000.0
        yield Result(self._result(command, target, began_mm))

    def _stream_of(self, target: str, truth: StreamTruth) -> SampleStream:
        separation_ms, points, *_region = self._settings["continuous"]
        return SampleStream(
            truth=truth,
            time=self._time,
            faults=self._faults,
            followed=truth.follow(target),
            pack=lambda times_s, xyz_mm: multi_result(
                times_s, self._to_wire(xyz_mm), self._weather()
            ),
            separation_s=separation_ms / 1000.0,
            points=int(points),
            lost=partial(setattr, self, "_target", None),
        )

    def _refusal(self) -> Status:
        strikes = self._faults.strikes
        if strikes("tracker.init_lost"):
            self._initialised = False
        if not self._initialised:
            return Status.NOT_INITIALIZED
        for fault, status in (
            ("tracker.busy", Status.BUSY),
            ("tracker.wrong_reflector", Status.WRONG_REFLECTOR),
            ("tracker.not_warmed_up", Status.NOT_WARMED_UP),
            ("tracker.no_distance", Status.NO_DISTANCE),
        ):
            if strikes(fault):
                return status
        return Status.OK

    def _result(self, command: int, target: str, began_mm: Array) -> bytes:
        strikes, ready = self._faults.strikes, status_change(Change.READY)
        ended_mm = self._instrument.reflector(target)
        if strikes("tracker.beam_break_after") or ended_mm is None:
            return self._broken(command)
        still_mm = 0.02  # a target that moves further gives no stationary result
        measured = None
        if np.linalg.norm(ended_mm - began_mm) <= still_mm:
            measured = self._instrument.measure(target, back=self._face == self.SECOND)
        if measured is None:
            return reply(command, Status.NO_STATIONARY_RESULT) + ready
        packets, self._late = [*self._late, self._encode(measured)], []
        if strikes("tracker.late_result"):
            packets, self._late = packets[:-1], packets[-1:]
        if strikes("tracker.no_result"):
            packets = []
        storm = int(self._faults.amount("tracker.status_storm"))
        return status_change(Change.REFRACTION) * storm + b"".join(packets) + ready

    def _broken(self, command: int) -> bytes:
        self._target = None
        return status_change(Change.NOT_READY) + reply(command, Status.NOT_READY)

    def _encode(self, measured: Measurement) -> bytes:
        in_metres = self._faults.strikes("tracker.metres")
        per_unit = 1000.0 if in_metres else self._mm_per_unit()
        signs = self._signs()
        if self._faults.strikes("tracker.left_handed"):
            signs[1] = -signs[1]
        xyz_mm = measured.xyz_mm
        along = xyz_mm / np.linalg.norm(xyz_mm)
        xyz = signs * (xyz_mm + self._offset_error_mm() * along) / per_unit
        bad = self._faults.take("tracker.bad_number")
        if bad is not None:
            xyz[0] = float(bad)
        std = measured.std_mm / per_unit
        total = float(np.linalg.norm(std))
        weather, status = self._weather(), Status.OK
        if self._faults.strikes("tracker.no_weather"):
            weather, status = (0.0, 0.0, 0.0), Status.NO_TEMPERATURE
        values = (*xyz, *std, total, 0.0, 0.0, 0.0, *std, total, *weather)
        return single_result(values, status)

    def _to_wire(self, xyz_mm: Array) -> Array:
        """Return positions (N, 3) in the configured units and axes."""
        along = xyz_mm / np.linalg.norm(xyz_mm, axis=1, keepdims=True)
        found: Array = self._signs() * (xyz_mm + self._offset_error_mm() * along)
        return found / self._mm_per_unit()

    def _offset_error_mm(self) -> float:
        mounted, chosen = (
            OFFSETS_MM.get(self._reflectors[number], 0.0)
            for number in (self._mounted, int(self._settings["reflector"][0]))
        )
        return mounted - chosen

    def _signs(self) -> Array:
        return np.array(AXES[int(self._settings["axes"][0])], dtype=float)

    def _mm_per_unit(self) -> float:
        return MM_PER_UNIT[int(self._settings["units"][0])]

    def _from_wire_mm(self, values: Arguments) -> Array:
        inside: Array = self._signs() * np.array(values) * self._mm_per_unit()
        return inside


class EmsconServer(Server):
    """Serves one tracker on a port, 0 for one that the system chooses."""

    def __init__(self, site: Site, port: int = 0) -> None:
        self._device, self._faults, self._time = EmsconDevice(site), site.faults, site.time
        listener = Listener("emscon", self._serve, port=port)
        self.port = listener.port
        super().__init__({"host": HOST, "port": self.port}, listener)

    def _serve(self, client: socket.socket) -> None:
        session = _Session(client)
        self._device.meet_run()
        while True:
            packet = session.receive(None)
            if packet is not None:
                self._obey(session, packet)

    def _obey(self, session: _Session, packet: bytes) -> None:
        for step in self._device.handle(packet):
            match step:
                case float():
                    if not self._let_pass(session, step):
                        return
                case Result():
                    self._send_damaged(session, step)
                case bytes():
                    session.send(step)
                case head, stream:
                    after = self._stream(session, stream, head)
                    if after is not None:
                        self._obey(session, after)

    def _stream(self, session: _Session, stream: SampleStream, head: bytes) -> bytes | None:
        """Send samples until the client stops it; return a packet received after their end.

        The client advances time as soon as it has a reply: so the stream is followed before the
        first reply, and unfollowed before the reply to the stop.
        """
        lock = threading.Lock()

        def send() -> None:
            with lock:
                try:
                    session.send(stream.due())
                except OSError:
                    stream.end()

        stream_poll_s = 0.05  # cell time between two looks for samples that are due
        poll_s = None if self._time.stepped else stream_poll_s / self._time.speed
        self._time.follow(send)
        try:
            with lock:
                session.send(head)
            while True:
                packet = session.receive(poll_s)
                if packet is None:
                    send()
                    continue
                _, _, command = COMMAND.unpack_from(packet)
                with lock:
                    stopped = command == Command.STOP_MEASUREMENT
                    if not stopped and not stream.ended:
                        session.send(reply(command, Status.BUSY))
                        continue
                    rest = stream.due() + stream.end()
                    self._time.unfollow(send)
                    if not stopped:
                        return packet
                    session.send(rest + reply(command))
                    return None
        finally:
            self._time.unfollow(send)
            with lock:
                stream.end()

    def _let_pass(self, session: _Session, duration_s: float) -> bool:
        """Let cell time pass; return False where the client stopped the command meanwhile."""
        for left_s in self._time.passing(duration_s):
            packet = session.receive(left_s)
            if packet is None:
                continue
            _, _, command = COMMAND.unpack_from(packet)
            if command == Command.STOP_MEASUREMENT:
                session.send(reply(command))
                return False
            session.send(reply(command, Status.BUSY))
        return True

    def _send_damaged(self, session: _Session, data: bytes) -> None:
        strikes = self._faults.strikes
        if strikes("tracker.eof"):
            raise ConnectionAbortedError
        session.results += 1
        late_every, late_s = 5, 0.001  # results that come well after their acknowledgement
        if session.results % late_every == 0:
            self._closing.wait(late_s)
        weather_every = 7  # results with news of the air glued to them
        if session.results % weather_every == 0:
            data = status_change(Change.ENVIRONMENT) + data
        if strikes("tracker.length_zero"):
            data = struct.pack("<iI", 0, 2)
        if strikes("tracker.length_huge"):
            data = struct.pack("<II", 2**31, 2)
        if strikes("tracker.glued_packets"):
            data = status_change(Change.ENVIRONMENT) + data + status_change(Change.ENVIRONMENT)
        if strikes("tracker.split_packet"):
            session.segments.send_in_two(data, 5)
        else:
            session.send(data)


class _Session:
    def __init__(self, client: socket.socket) -> None:
        self._client, self.segments = Connection(client), Segments(client.sendall)
        self._pending = b""
        self.results = 0

    def send(self, data: bytes) -> None:
        if data:  # of a stream nothing may be due
            self.segments.send(data)

    def receive(self, timeout_s: float | None) -> bytes | None:
        """Return the next packet, None after the timeout; raises OSError at the end."""
        while (packet := self._take()) is None:
            if not (data := self._client.receive(timeout_s)):
                return None
            self._pending += data
        return packet

    def _take(self) -> bytes | None:
        if len(self._pending) < HEAD.size:
            return None
        size, _ = HEAD.unpack_from(self._pending)
        longest = 4096
        if not COMMAND.size <= size <= longest:
            raise ConnectionAbortedError
        if len(self._pending) < size:
            return None
        packet, self._pending = self._pending[:size], self._pending[size:]
        return packet


serve = EmsconServer
