"""Commands as an emScon tracker performs them: settings, pointing, finding, measuring.

Positions on the wire have the units and axes that were set; inside all is mm, right-handed. As with
the original, lengths are metres until SetUnits says otherwise, and a measurement is acknowledged at
once while its result comes later as a packet of its own.
"""

from __future__ import annotations

import math
import operator
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from fakes.faults import Faults, Vanished
from fakes.leica.emscon_packets import (
    COMMAND,
    Change,
    Command,
    Status,
    multi_result,
    reply,
    single_result,
    status_change,
    wide,
)
from fakes.time import PlantTime
from fakes.truth.tracker_truth import Followed, Instrument, Measurement, StreamTruth
from fakes.truth.transforms import Array
from hilcell.cell.file import Cell


class SampleStream:
    """A continuous measurement: samples by the tracker's clock, in packets, late and cut.

    The samples that are due follow from plant time alone, never from when somebody asks. As with
    the original a packet holds several samples and comes late; it may come in two pieces, or
    together with the next; only the times inside it say when a sample was taken. The methods must
    not be called by two threads at once.
    """

    def __init__(
        self,
        truth: StreamTruth,
        time: PlantTime,
        faults: Faults,
        followed: Followed,
        pack: Callable[[Array, Array], bytes],
        *,
        separation_s: float,
        points: int,
        lost: Callable[[], None],
    ) -> None:
        """``pack``: device times (N,), positions (N, 3) mm -> packet. ``points`` 0 is until it is
        stopped; ``lost`` is called when the beam breaks.
        """
        self._truth, self._time, self._faults = truth, time, faults
        self._followed, self._pack, self._lost = followed, pack, lost
        self._separation_s, self._points = separation_s, points
        self._start_s = truth.device_s(time.now_s())
        self._taken = self._packets = 0
        self._times_s, self._xyz_mm = np.zeros(0), np.zeros((0, 3))
        self._kept = b""
        self.ended = False

    def due(self) -> bytes:
        """Return the packets that are due by now."""
        if self.ended:
            return b""
        broken = self._take()
        sent = b""
        packet_samples = (8, 3, 12, 5, 9)  # in turn
        while len(self._times_s) >= (size := packet_samples[self._packets % len(packet_samples)]):
            sent += self._packet(size)
        if broken or self._taken == self._points != 0:
            sent += self._end()
            if broken:
                self._lost()
                sent += status_change(Change.NOT_READY)
            else:
                sent += status_change(Change.READY)
        return sent

    def stop(self) -> bytes:
        """End at the client's wish; return all that was still under way."""
        return self.due() + (b"" if self.ended else self._end())

    def close(self) -> None:
        """End; may be called again."""
        if not self.ended:
            self._end()

    def _take(self) -> bool:
        """Take the samples that are due; return whether the beam broke."""
        now_s = self._truth.device_s(self._time.now_s())
        due = int((now_s - self._start_s) / self._separation_s)
        wanted = min(due, self._points) if self._points else due
        if wanted == self._taken:
            return False
        numbers = np.arange(self._taken + 1, wanted + 1)
        struck = next(
            (
                n
                for n in range(len(numbers))
                if self._faults.take("tracker.stream_break") is not None
            ),
            None,
        )
        times_s = np.asarray(self._start_s + self._separation_s * numbers[:struck], dtype=float)
        xyz_mm = self._followed.read(times_s) if len(times_s) else np.zeros((0, 3))
        self._taken += len(xyz_mm)
        self._times_s = np.append(self._times_s, times_s[: len(xyz_mm)])
        self._xyz_mm = np.vstack([self._xyz_mm, xyz_mm])
        return struck is not None or len(xyz_mm) < len(times_s)

    def _packet(self, size: int) -> bytes:
        """Return the bytes that go out with the next packet; the rest of it waits."""
        self._packets += 1
        data = self._kept + self._pack(self._times_s[:size], self._xyz_mm[:size])
        self._times_s, self._xyz_mm = self._times_s[size:], self._xyz_mm[size:]
        cut = len(data)
        late_every, cut_every = 5, 3  # packets that wait for the next, and whose second half does
        if self._packets % late_every == 0:
            cut = 0
        elif self._packets % cut_every == 0:
            cut //= 2
        self._kept = data[cut:]
        return data[:cut]

    def _end(self) -> bytes:
        self.ended = True
        self._followed.end()
        rest = self._pack(self._times_s, self._xyz_mm) if len(self._times_s) else b""
        return self._kept + rest


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


@dataclass(frozen=True, slots=True)
class Later:
    """Something that ends after plant time has passed."""

    duration_s: float
    finish: Callable[[], Answer]
    measures: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """Packets to send now, and those that come later."""

    packets: list[bytes] = field(default_factory=list)
    later: Later | None = None
    stream: SampleStream | None = None


class EmsconDevice:
    """One tracker; ``handle`` may come from several threads."""

    SERIAL = 402871
    FIRST, SECOND = 1, 2  # faces
    BALL = 1  # target type: corner cube
    VERSION = (3, 8, 0)
    INITIALISE_S, POINT_S, FACE_S = 30.0, 0.6, 4.0

    def __init__(
        self,
        cell: Cell,
        instrument: Instrument,
        faults: Faults,
        streams: tuple[StreamTruth, PlantTime] | None = None,
    ) -> None:
        """Without ``streams`` the tracker measures at rest only."""
        self._lock = threading.RLock()
        self._instrument, self._faults, self._streams = instrument, faults, streams
        mounted = cell.tracker.reflector
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
        work: dict[int, tuple[str, Callable[[int, Arguments], Answer]]] = {
            Command.GET_REFLECTORS: ("<", self._list_reflectors),
            Command.INITIALIZE: ("<", self._initialise),
            Command.GO_POSITION: ("<3di", self._go_position),
            Command.POINT_LASER: ("<3d", self._point),
            Command.FIND_REFLECTOR: ("<d", self._find_reflector),
            Command.START_MEASUREMENT: ("<", self._start_measurement),
            Command.GO_AND_MEASURE: ("<3d", self._go_and_measure),
            Command.STOP_MEASUREMENT: ("<", lambda command, _: Answer([reply(command)])),
            Command.CHANGE_FACE: ("<", self._change_face),
            Command.GO_BIRD_BATH: ("<", self._turn),
        }
        # The format of the fields behind a command, and what it does.
        self._handlers = work | {
            command: ("<", partial(self._ask, query)) for command, query in queries.items()
        }
        for name, (write, read, _, form, _) in SETTINGS.items():
            self._handlers[write] = (form, partial(self._set, name))
            self._handlers[read] = ("<", partial(self._ask, partial(self._setting, name)))

    def handle(self, packet: bytes) -> Answer:
        """Return the answer to one whole packet from the client."""
        _, _, command = COMMAND.unpack_from(packet)
        if command not in self._handlers:
            return Answer([reply(command, Status.NOT_IMPLEMENTED)])
        form, handler = self._handlers[command]
        try:
            arguments = struct.unpack(form, packet[COMMAND.size :])
        except struct.error:
            return Answer([reply(command, Status.WRONG_PARAMETER)])
        with self._lock:
            return handler(command, arguments)

    # -- settings and queries -------------------------------------------------------------------

    def _set(self, name: str, command: int, values: Arguments) -> Answer:
        status = self._refused_setting(name, values)
        if status != Status.OK:
            return Answer([reply(command, status)])
        if name == "search":
            values = (values[0] * self._mm_per_unit(), values[1])
        self._settings[name] = values
        return Answer([reply(command), status_change(SETTINGS[name][2])])

    def _refused_setting(self, name: str, values: Arguments) -> Status:
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

    def _ask(self, query: Callable[[], bytes], command: int, _: Arguments) -> Answer:
        return Answer([reply(command, Status.OK, query())])

    def _setting(self, name: str) -> bytes:
        values = self._settings[name]
        if name == "search":
            values = (values[0] / self._mm_per_unit(), values[1])
        if name == "environment":
            values = self._weather()
        return struct.pack(SETTINGS[name][3], *values)

    def _list_reflectors(self, command: int, _: Arguments) -> Answer:
        packets = []
        for number, name in self._reflectors.items():
            offset = OFFSETS_MM.get(name, 0.0) / self._mm_per_unit()
            head = struct.pack("<iiId", len(self._reflectors), number, self.BALL, offset)
            packets.append(reply(command, Status.OK, head + wide(name)))
        return Answer(packets)

    def _system_status(self) -> bytes:
        other = self._faults.take("tracker.wrong_identity") is not None
        processor, laser, distance_meter = (5 if self._initialised else 4), 3, 2
        head = struct.pack("<4I", Status.OK, processor, laser, distance_meter)
        return head + struct.pack("<3iI2i", *self.VERSION, 2, 0, self.SERIAL + other)

    def _measurement_status(self) -> bytes:
        found, compensated, distance, distance_compensated = 1, 2, 4, 8
        bits = found | compensated | distance | distance_compensated
        bits |= 4096 * (self._face == self.FIRST)
        bits |= 2048 * (self._target is not None)
        bits |= 65536 * self._initialised
        return struct.pack("<Ii", Status.OK, bits)

    def _direction(self) -> bytes:
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

    def _initialise(self, command: int, arguments: Arguments) -> Answer:
        def finish() -> Answer:
            self._initialised, self._target, self._face = True, None, self.FIRST
            return Answer([reply(command), status_change(Change.INITIALIZATION)])

        return Answer(later=Later(self.INITIALISE_S, finish))

    def _turn(self, command: int, arguments: Arguments) -> Answer:
        self._target = None
        return Answer(later=Later(self.FACE_S, lambda: Answer([reply(command)])))

    def _change_face(self, command: int, arguments: Arguments) -> Answer:
        """Turn over and look where it looked before."""
        if not self._initialised:
            return Answer([reply(command, Status.NOT_INITIALIZED)])

        def finish() -> Answer:
            self._face = self.SECOND if self._face == self.FIRST else self.FIRST
            seen = Change.READY if self._lock_on() else Change.NOT_READY
            return Answer([reply(command), status_change(seen)])

        return Answer(later=Later(self.FACE_S, finish))

    def _point(self, command: int, arguments: Arguments) -> Answer:
        self._pointing_mm, self._target = self._inside_mm(arguments[:3]), None
        return Answer(later=Later(self.POINT_S, lambda: Answer([reply(command)])))

    def _go_position(self, command: int, arguments: Arguments) -> Answer:
        self._pointing_mm = self._inside_mm(arguments[:3])
        return self._search(command)

    def _find_reflector(self, command: int, arguments: Arguments) -> Answer:
        distance_mm = arguments[0] * self._mm_per_unit()
        if not distance_mm > 0:
            return Answer([reply(command, Status.OUT_OF_RANGE_1)])
        direction = self._pointing_mm / np.linalg.norm(self._pointing_mm)
        self._pointing_mm = distance_mm * direction
        return self._search(command)

    def _search(self, command: int) -> Answer:
        if not self._initialised:
            return Answer([reply(command, Status.NOT_INITIALIZED)])

        def finish() -> Answer:
            if self._lock_on():
                return Answer([reply(command), status_change(Change.READY)])
            return Answer([status_change(Change.NOT_READY), reply(command, Status.NO_DISTANCE)])

        return Answer(later=Later(self.POINT_S, finish))

    def _lock_on(self) -> bool:
        with self._lock:
            self._target = self._instrument.find(self._pointing_mm, self._settings["search"][0])
            if self._faults.take("tracker.no_reflector") is not None:
                self._target = None
            return self._target is not None

    def _go_and_measure(self, command: int, arguments: Arguments) -> Answer:
        self._pointing_mm = self._inside_mm(arguments)

        def finish() -> Answer:
            self._lock_on()
            return self._start_measurement(command, ())

        return Answer(later=Later(self.POINT_S, finish))

    def _start_measurement(self, command: int, arguments: Arguments) -> Answer:
        if self._faults.take("tracker.vanish") is not None:
            raise Vanished
        refused = self._refusal()
        if refused != Status.OK:
            return Answer([reply(command, refused)])
        target = self._target
        if self._faults.take("tracker.beam_break_before") is not None or target is None:
            return self._broken(command)
        began_mm = self._instrument.reflector(target)
        if began_mm is None:  # carried away
            return self._broken(command)
        if self._settings["measurement mode"][0] == CONTINUOUS_TIME:
            measuring = status_change(Change.MEASURING)
            return Answer([reply(command), measuring], stream=self._stream_of(target))
        later = Later(
            self._settings["stationary"][0] / 1000.0,
            lambda: self._result(command, target, began_mm),
            True,
        )
        return Answer([reply(command), status_change(Change.MEASURING)], later)

    def _stream_of(self, target: str) -> SampleStream | None:
        if self._streams is None:
            return None
        truth, time = self._streams
        separation_ms, points, *_region = self._settings["continuous"]
        return SampleStream(
            truth,
            time,
            self._faults,
            truth.follow(target),
            lambda times_s, xyz_mm: multi_result(times_s, self._outside(xyz_mm), self._weather()),
            separation_s=separation_ms / 1000.0,
            points=int(points),
            lost=partial(setattr, self, "_target", None),
        )

    def _refusal(self) -> Status:
        take = self._faults.take
        if take("tracker.init_lost") is not None:
            self._initialised = False
        if not self._initialised:
            return Status.NOT_INITIALIZED
        for fault, status in (
            ("tracker.busy", Status.BUSY),
            ("tracker.wrong_reflector", Status.WRONG_REFLECTOR),
            ("tracker.not_warmed_up", Status.NOT_WARMED_UP),
            ("tracker.no_distance", Status.NO_DISTANCE),
        ):
            if take(fault) is not None:
                return status
        return Status.OK

    def _result(self, command: int, target: str, began_mm: Array) -> Answer:
        ready = status_change(Change.READY)
        still_mm = 0.02  # a target that moves farther meanwhile gives no stationary result
        with self._lock:
            take = self._faults.take
            ended_mm = self._instrument.reflector(target)
            if take("tracker.beam_break_after") is not None or ended_mm is None:
                return self._broken(command)
            moved_mm = np.linalg.norm(ended_mm - began_mm)
            back = self._face == self.SECOND
            seen = moved_mm <= still_mm
            measured = self._instrument.measure(target, back=back) if seen else None
            if measured is None:
                return Answer([reply(command, Status.NO_STATIONARY_RESULT), ready])
            packets, self._late = [*self._late, self._packed(measured)], []
            if take("tracker.late_result") is not None:
                packets, self._late = packets[:-1], packets[-1:]
            if take("tracker.no_result") is not None:
                packets = []
            storm = int(self._faults.number("tracker.status_storm") or 0)
            return Answer([*[status_change(Change.REFRACTION)] * storm, *packets, ready])

    def _broken(self, command: int) -> Answer:
        self._target = None
        return Answer([status_change(Change.NOT_READY), reply(command, Status.NOT_READY)])

    def _packed(self, measured: Measurement) -> bytes:
        in_metres = self._faults.take("tracker.metres") is not None
        per_unit = 1000.0 if in_metres else self._mm_per_unit()
        signs = self._signs()
        if self._faults.take("tracker.left_handed") is not None:
            signs[1] = -signs[1]
        xyz_mm = measured.xyz_mm
        along = xyz_mm / np.linalg.norm(xyz_mm)
        xyz = signs * (xyz_mm + self._wrong_reflector_mm() * along) / per_unit
        bad = self._faults.take("tracker.bad_number")
        if bad is not None:
            xyz[0] = float(bad)
        std = measured.std_mm / per_unit
        total = float(np.linalg.norm(std))
        weather, status = self._weather(), Status.OK
        if self._faults.take("tracker.no_weather") is not None:
            weather, status = (0.0, 0.0, 0.0), Status.NO_TEMPERATURE
        values = (*xyz, *std, total, 0.0, 0.0, 0.0, *std, total, *weather)
        return single_result(values, status)

    def _outside(self, xyz_mm: Array) -> Array:
        """Return positions (N, 3) in the units and axes that are set."""
        along = xyz_mm / np.linalg.norm(xyz_mm, axis=1, keepdims=True)
        found: Array = self._signs() * (xyz_mm + self._wrong_reflector_mm() * along)
        return found / self._mm_per_unit()

    def _wrong_reflector_mm(self) -> float:
        """Return how much the range is off with another reflector than the one mounted."""
        mounted, chosen = (
            OFFSETS_MM.get(self._reflectors[number], 0.0)
            for number in (self._mounted, int(self._settings["reflector"][0]))
        )
        return mounted - chosen

    def _signs(self) -> Array:
        return np.array(AXES[int(self._settings["axes"][0])], dtype=float)

    def _mm_per_unit(self) -> float:
        return MM_PER_UNIT[int(self._settings["units"][0])]

    def _inside_mm(self, values: Arguments) -> Array:
        inside: Array = self._signs() * np.array(values) * self._mm_per_unit()
        return inside
