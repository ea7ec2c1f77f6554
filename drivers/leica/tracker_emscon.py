"""A Leica laser tracker over emScon TPI (TCP 700).

The trap: results carry no number, so a late one could pass for the next point. Pending results are
dropped before each start, a failed measurement is stopped and the stop awaited, two results to one
start are no reading, and a result far from the expected place is refused.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from threading import Event
from typing import Annotated, NamedTuple, Self, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from drivers.device_errors import TRACKER, ProtocolError
from drivers.leica import emscon
from drivers.leica.emscon import (
    Change,
    Command,
    EmsconSettings,
    Failure,
    Layout,
    Multi,
    Packet,
    Reflector,
    Reply,
    Setting,
    Single,
    StatusChange,
    SystemStatus,
    Value,
)
from drivers.leica.emscon_abilities import Reported, TrackerInfo, abilities
from drivers.supervision import Deadline, on_failure
from drivers.tracker_readings import (
    Positive,
    check_reflector,
    check_samples,
    check_serial,
    checked_request,
    checked_search,
    leica_identity,
    matching_form,
    off_target,
    repeats_std,
    retry_while_busy,
    scatter_error,
)
from drivers.wires import TcpLink
from hilcell.clock import WallClock
from hilcell.decoding import typed
from hilcell.ports import (
    Ability,
    Air,
    Array,
    Candidate,
    Clock,
    DeviceError,
    HilcellError,
    Identity,
    NoReading,
    Stopped,
    StreamBlock,
    TrackerReading,
)
from hilcell.sanitize import clean
from hilcell.wire.channel import Host, Port

T = TypeVar("T")


class Place(NamedTuple):
    """Where a reflector (3,) is expected, tracker's frame, and how far from there it may be."""

    near_mm: Array
    radius_mm: float

    def check(self, result: Single) -> None:
        """Raise `NoReading` for a result elsewhere, `DeviceError` for one in other units."""
        off_mm = float(np.linalg.norm(np.array(result.xyz) - self.near_mm))
        if off_mm <= self.radius_mm:
            return
        units_mm = {
            "metres": 1000.0, "micrometres": 0.001, "feet": 304.8, "yards": 914.4,
            "inches": 25.4,
        }  # fmt: skip
        forms = {unit: unit_mm * np.array(result.xyz) for unit, unit_mm in units_mm.items()}
        if not (unit := matching_form(self.near_mm, self.radius_mm, forms)):
            raise off_target(off_mm, self.radius_mm)
        found, xyz = f"the result {result.xyz} is in {unit}", result.xyz
        raise TRACKER.failed("HC-T18", "measure", found, expected="mm", xyz=xyz, unit=unit)


class LeicaEmsconTracker:
    """Satisfies `hilcell.ports.Tracker`, and its `Streams`, `TwoFaces`, `Aims`, `Inspects` and
    `Discovers`.
    """

    AIR = "values that air can have"
    # How long the tracker may search; less than MOVE_S.
    SEARCH_MS = 10_000
    WIDE_SEARCH_MS = 25_000

    # Deadlines on the wire, in real time.
    REPLY_S = 5.0
    INITIALIZE_S = 90.0
    MOVE_S = 30.0
    RESULT_S = 5.0  # on top of the time that the measurement takes

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Where the tracker is, and how it measures."""

        host: Host
        reflector: str
        max_std_mm: Positive
        find_radius_mm: Positive
        port: Port = 700
        serial: str = ""
        reading_s: Annotated[float, Meta(ge=0.1, le=100)] = 0.5

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._link: TcpLink | None = None
        self._reader = emscon.PacketReader()
        self._packets: deque[Packet] = deque()
        self.settings = EmsconSettings(self._ask, self._numbers_of)
        self._numbers: dict[str, int] = {}
        self._reflector = ""
        self._arrived_s = 0.0  # of the newest bytes
        self._taken_s = 0.0  # of those of the newest result
        self._followed = False  # the beam is on the reflector that was measured last
        self._air_measured = False
        self._results = 0  # since the start was acknowledged

    # -- the port -----------------------------------------------------------------------------

    def connect(self) -> list[Identity]:
        self._open()
        with on_failure(self.close):
            identity = self._identity(self._initialised())
            self._set_up()
            self._numbers = {clean(each.name): each.number for each in self._reflectors()}
            self._choose(self._options.reflector)
            self._first_face()
        return [identity]

    def inspect(self) -> list[Ability]:
        continuous = Setting.CONTINUOUS_TIME
        self._open()
        with closing(self):
            info = self._request(Command.GET_TRACKER_INFO)
            direction = self._answer_of(Command.GET_DIRECTION, Layout.DIRECTION)
            face = self._face()
            reported = Reported(
                status=self._system_status(),
                info=self._decoded(TrackerInfo.decode, info.body) if info.body else None,
                reflectors=self._reflectors(),
                air=self._air(),
                face=face,
                tells_direction=direction is not None,
                streams=self._answer_of(continuous.read, continuous.layout) is not None,
            )
        return abilities(reported, self._options.reflector, self._options.serial)

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the tracker at the host that a person gave, if it answers as emScon."""
        if not known.get("host"):
            return []
        given = {name: known[name] for name in ("host", "port") if name in known}
        anything = {"reflector": "", "max_std_mm": 1.0, "find_radius_mm": 1.0}
        try:
            tracker = cls(typed(given | anything, cls.Options), WallClock(Event()))
            tracker._open()
            with closing(tracker):
                identity = tracker._identity(tracker._system_status())
                reflectors = [clean(each.name) for each in tracker._reflectors()]
        except (DeviceError, msgspec.ValidationError):
            return []
        options = tracker._options
        place: dict[str, object] = {"host": options.host, "port": options.port}
        title = f"{identity.text}, at {identity.address}"
        return [Candidate(title, place | {"serial": identity.serial}, [identity], reflectors)]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        near_mm = checked_request(near_mm, samples)
        self.point_at(near_mm, reflector)
        return self._reading(Place(near_mm, self._options.find_radius_mm), reflector, samples)

    def release_beam(self) -> None:
        """Send the beam home, from where a person carries the reflector or the beam elsewhere."""
        self._drop_pending()
        self._followed = False
        self._ask(Command.GO_BIRD_BATH, limit_s=self.MOVE_S)

    def measure_aimed(self, reflector: str, samples: int) -> TrackerReading:
        check_samples(samples)
        self._drop_pending()
        self._choose(reflector)
        return self._reading(None, reflector, samples)

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        near_mm = checked_search(near_mm, samples, radius_mm)
        options, place = self._options, Place(near_mm, radius_mm)
        self._drop_pending()
        self.settings.write(Setting.SEARCH, radius_mm, self.WIDE_SEARCH_MS)
        try:
            self.point_at(near_mm, reflector)
            reading = self._reading(place, reflector, samples)
        except NoReading:
            self.settings.write(Setting.SEARCH, options.find_radius_mm, self.SEARCH_MS)
            raise
        self.settings.write(Setting.SEARCH, options.find_radius_mm, self.SEARCH_MS)
        return reading

    def measure_back(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        near_mm = checked_request(near_mm, samples)
        self.point_at(near_mm, reflector)
        self._turn_to(Value.SECOND_FACE)
        place = Place(near_mm, self._options.find_radius_mm)
        try:
            reading = self._reading(place, reflector, samples)
        except NoReading:
            self._turn_to(Value.FIRST_FACE)
            raise
        self._turn_to(Value.FIRST_FACE)
        return reading

    def stream(self, near_mm: Array, reflector: str, rate_hz: float) -> EmsconStream:
        radius_mm = self._options.find_radius_mm
        return EmsconStream(self, self._clock, near_mm, reflector, rate_hz, radius_mm)

    def stop(self) -> None:
        if (link := self._link) is not None:  # another thread may be closing
            link.send(emscon.encode(Command.STOP_MEASUREMENT), "stop")

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
        self._link = None

    # -- also for a stream --------------------------------------------------------------------

    def point_at(self, near_mm: Array, reflector: str) -> None:
        """Choose a reflector and catch it near (3,) mm; drop pending results first.

        A beam that has followed it there stays.
        """
        self._drop_pending()
        followed = self._followed and reflector == self._reflector
        self._choose(reflector)
        if not (followed and self._looks_at(near_mm)):
            self._aim(near_mm)

    def leave_stream(self) -> None:
        """Stop and put the mode back, without waiting for answers; then connect again."""
        self.stop()
        mode = Setting.MEASUREMENT_MODE
        body = mode.layout.pack(Value.STATIONARY)
        self._wire().send(emscon.encode(mode.write, body), "stop")

    # -- connecting ---------------------------------------------------------------------------

    def _open(self) -> None:
        self.close()
        options = self._options
        self._link = TcpLink(TRACKER, options.host, options.port, self._clock.check)
        self._reader, self._packets, self._reflector = emscon.PacketReader(), deque(), ""
        self._followed = False

    def _initialised(self) -> SystemStatus:
        """Initialise a tracker that is not; refuse another one before its head turns."""
        status = self._system_status()
        check_serial(str(status.serial), self._options.serial)
        if status.processor != SystemStatus.INITIALIZED:
            self._ask(Command.INITIALIZE, limit_s=self.INITIALIZE_S)
            status = self._system_status()
        if status.processor != SystemStatus.INITIALIZED:
            found = f"processor status {status.processor}"
            expected = f"{SystemStatus.INITIALIZED} (initialised)"
            raise TRACKER.refused(
                "HC-T04", "initialise", found, expected=expected, processor=status.processor
            )
        return status

    def _identity(self, status: SystemStatus) -> Identity:
        self._air_measured = status.weather_monitor == SystemStatus.AIR_MEASURED
        address = f"{self._options.host}:{self._options.port}"
        answer = self._request(Command.GET_TRACKER_INFO).body  # nothing by older controllers
        name = clean(self._decoded(emscon.decode_tracker_name, answer)) if answer else ""
        firmware = f"emScon {status.version}"
        return leica_identity(name, f", {firmware}", str(status.serial), address, firmware)

    def _system_status(self) -> SystemStatus:
        body = self._ask(Command.GET_SYSTEM_STATUS)
        return self._decoded(SystemStatus.decode, body)

    def _set_up(self) -> None:
        options = self._options
        # A new start: news of before, of our own initialisation also, is of no settings of ours.
        settings = self.settings = EmsconSettings(self._ask, self._numbers_of)
        settings.write(Setting.UNITS, *Value.MILLIMETRES)
        settings.write(Setting.COORDINATE_SYSTEM, Value.RIGHT_HANDED)
        if settings.record(Setting.MEASUREMENT_MODE) != (Value.STATIONARY,):
            self._request(Command.STOP_MEASUREMENT)  # a stream that was left behind
        settings.write(Setting.MEASUREMENT_MODE, Value.STATIONARY)
        settings.write(Setting.STATIONARY, round(1000 * options.reading_s), 1)
        settings.write(Setting.SEARCH, options.find_radius_mm, self.SEARCH_MS)
        settings.record_frame()
        if problem := emscon.air_problem(*self._air()):
            raise TRACKER.refused("HC-T05", "connect", problem, expected=self.AIR)

    def _air(self) -> tuple[float, float, float]:
        celsius, mbar, percent = self._numbers_of(Command.GET_ENVIRONMENT, Layout.ENVIRONMENT)
        return celsius, mbar, percent

    def _turn_to(self, face: int) -> None:
        """Turn over, and believe it only when the face reads back."""
        self._followed = False
        self._ask(Command.CHANGE_FACE, limit_s=self.MOVE_S)
        self.settings.expect(Setting.FACE, face)

    def _face(self) -> int | None:
        """Return the face, which older controllers do not report: None there."""
        answer = self._answer_of(Setting.FACE.read, Setting.FACE.layout)
        return None if answer is None else int(answer[0])

    def _first_face(self) -> None:
        """Turn back a tracker that an earlier engine left in its second face."""
        face = self._face()
        if face == Value.SECOND_FACE:
            self._turn_to(Value.FIRST_FACE)
        elif face == Value.FIRST_FACE:
            self.settings.record(Setting.FACE)

    def _reflectors(self) -> list[Reflector]:
        """Return the tracker's reflectors. One reply comes for each of them."""
        first = self._decoded(Reflector.decode, self._ask(Command.GET_REFLECTORS))
        found = [first]
        deadline = Deadline(self.REPLY_S)
        for _ in range(first.total - 1):
            body = self._status(Command.GET_REFLECTORS, deadline).body
            found.append(self._decoded(Reflector.decode, body))
        return found

    def _choose(self, reflector: str) -> None:
        if reflector == self._reflector:
            return
        known = ", ".join(map(repr, self._numbers))
        check_reflector(reflector, list(self._numbers), f"the tracker knows {known}")
        self.settings.write(Setting.REFLECTOR, self._numbers[reflector])
        self._reflector = reflector

    # -- measuring ----------------------------------------------------------------------------

    def _looks_at(self, near_mm: Array) -> bool:
        """Whether the beam passes (3,) mm as near as a search would reach, where it is known."""
        angles = self._answer_of(Command.GET_DIRECTION, Layout.DIRECTION)
        if angles is None:
            return False
        beam = np.array(emscon.direction(*angles))
        along_mm = float(near_mm @ beam)
        off_mm = float(np.linalg.norm(near_mm - along_mm * beam))
        return along_mm > 0.0 and off_mm <= self._options.find_radius_mm

    def _aim(self, near_mm: Array) -> None:
        """Point the beam at ``near_mm``; search around where nothing is caught there."""
        body = Layout.POSITION.pack(*near_mm, 1)
        try:
            self._ask(Command.GO_POSITION, body, limit_s=self.MOVE_S)
        except NoReading as first:
            try:
                self._find(near_mm)
            except NoReading as second:
                second.found += f", after go position: {first.found}"
                second.fields.update(self._searched())
                raise

    def _searched(self) -> dict[str, object]:
        """Return how far a search went, and where the beam looks where the controller tells."""
        radius_mm, _limit_ms = self.settings.recorded(Setting.SEARCH)
        angles = self._answer_of(Command.GET_DIRECTION, Layout.DIRECTION)
        beam = {} if angles is None else {"beam": emscon.direction(*angles)}
        return {"searched_mm": radius_mm, **beam}

    def _find(self, near_mm: Array) -> None:
        body = Layout.DISTANCE.pack(float(np.linalg.norm(near_mm)))
        self._ask(Command.FIND_REFLECTOR, body, limit_s=self.MOVE_S)

    def _single(self, place: Place | None) -> Single:
        try:
            self.start(None if place is None else place.near_mm)
            result = self._await_result()
            self._check_single()
        except NoReading as error:
            # Only an answered stop guarantees that no result of this try is still to come.
            status = self._request(Command.STOP_MEASUREMENT).status
            if status != 0:
                found = f"{error.found}, and it was not stopped: {emscon.status_text(status)}"
                fields = {"status": status, **error.fields}
                raise NoReading(
                    "HC-T25", TRACKER.name, error.operation, found, act=error.act, fields=fields
                ) from error
            raise
        self._check(result, place)
        return result

    def start(self, near_mm: Array | None) -> None:
        """Start to measure; search once more near (3,) where the beam has lost its reflector.

        None: measure where the beam is, or not at all.
        """
        self.settings.verify()
        reply = self._request(Command.START_MEASUREMENT)
        if near_mm is not None and reply.status == emscon.NOT_READY:
            self._find(near_mm)
            reply = self._request(Command.START_MEASUREMENT)
        if reply.status != 0:
            raise emscon.failed(Command.START_MEASUREMENT, reply.status)
        self._results = 0

    def _check_single(self) -> None:
        """Refuse a result that was not the only one, or whose settings were changed meanwhile.

        A measurement still in progress makes the tracker busy, so its result comes before the
        reply.
        """
        self.settings.verify_setting(Setting.REFLECTOR)
        self.settings.verify()
        if self._results != 1:
            found, came = f"{self._results} results came to one start", self._results
            raise TRACKER.no_reading("HC-T31", "measure", found, expected="1", results=came)

    def _await_result(self) -> Single:
        limit_s = self._options.reading_s + self.RESULT_S
        deadline = Deadline(limit_s)
        while (packet := self.next_packet(deadline)) is not None:
            emscon.check_measured(packet, Single, "measure")
            if isinstance(packet, Single):
                self._taken_s = self._arrived_s
                return packet
        found = f"acknowledged, but no result came within {limit_s:.1f} s"
        raise TRACKER.no_reading("HC-T13", "measure", found, waited_s=limit_s)

    def _check(self, result: Single, place: Place | None) -> None:
        if not emscon.possible(*result.xyz, *result.std, result.std_total):
            found = f"the result {result.xyz}, standard deviation {result.std_total:g}"
            raise TRACKER.no_reading(
                "HC-T14", "measure", found, expected="a position in mm", xyz=result.xyz
            )
        if place is not None:
            place.check(result)
        if not 0.0 <= result.std_total <= self._options.max_std_mm:
            found = f"standard deviation {result.std_total:.4f} mm"
            raise scatter_error(found, self._options.max_std_mm, std_mm=result.std_total)
        if problem := emscon.air_problem(*result.air):
            raise TRACKER.no_reading("HC-T05", "measure", problem, expected=self.AIR)

    def _reading(self, place: Place | None, reflector: str, samples: int) -> TrackerReading:
        self._followed = False  # where this fails, the next one points at the place again
        results = [self._single(place) for _ in range(samples)]
        self._followed = True
        points_mm = np.array([result.xyz for result in results])
        std_mm = np.array(results[0].std)
        if samples > 1:
            std_mm = repeats_std(points_mm, self._options.max_std_mm)
        air = Air(*results[-1].air) if self._air_measured else None
        mean_mm = points_mm.mean(axis=0)
        return TrackerReading(mean_mm, std_mm, samples, reflector, air, self._taken_s)

    # -- packets ------------------------------------------------------------------------------

    def _drop_pending(self) -> None:
        while self.next_packet(Deadline(0.0)) is not None:
            pass

    def _ask(self, command: int, body: bytes = b"", limit_s: float = 0.0) -> bytes:
        """Send a command and return its reply's body; raises the error of a refusal."""
        reply = self._request(command, body, limit_s)
        if reply.status != 0:
            raise emscon.failed(command, reply.status)
        return reply.body

    def _request(self, command: int, body: bytes = b"", limit_s: float = 0.0) -> Reply:
        limit_s = limit_s or self.REPLY_S

        def ask() -> Reply:
            self._wire().send(emscon.encode(command, body), emscon.command_name(command))
            return self._status(command, Deadline(limit_s))

        return retry_while_busy(
            ask, lambda reply: reply.status == emscon.BUSY, limit_s, self._clock
        )

    def _status(self, command: int, deadline: Deadline) -> Reply:
        """Return the reply to ``command``, refused or not; older results are dropped."""
        while (packet := self.next_packet(deadline)) is not None:
            if isinstance(packet, Reply | Failure) and packet.command == command:
                return Reply(command, packet.status, getattr(packet, "body", b""))
            if isinstance(packet, Reply) and packet.command != Command.STOP_MEASUREMENT:
                found = f"a reply to command {packet.command} came"
                raise self._lost(found, emscon.command_name(command))
        raise self._lost("no answer in time", emscon.command_name(command))

    def _numbers_of(self, command: int, layout: struct.Struct) -> tuple[float, ...]:
        return self._decoded(layout.unpack_from, self._ask(command))

    def _answer_of(self, command: int, layout: struct.Struct) -> tuple[float, ...] | None:
        """Return numbers that an older controller does not know: None there."""
        reply = self._request(command)
        if reply.status or not reply.body:
            return None
        return self._decoded(layout.unpack_from, reply.body)

    def _decoded(self, decode: Callable[[bytes], T], body: bytes) -> T:
        try:
            return decode(body)
        except struct.error as error:
            raise self._lost(f"a reply of {len(body)} bytes: {error}", "decode") from error

    def next_packet(self, deadline: Deadline) -> Packet | None:
        """Return the next packet, or nothing when ``deadline`` is over."""
        while not self._packets:
            data = self._wire().receive(emscon.LARGEST, deadline)
            if not data:
                return None
            self._arrived_s = self._clock.pc_s()
            try:
                self._packets.extend(self._reader.feed(data))
            except ProtocolError as error:
                raise self._lost(str(error), "receive") from error
        packet = self._packets.popleft()
        if packet in (StatusChange(Change.SERVER_CLOSING), StatusChange(Change.PROCESSOR_CLOSING)):
            raise self._lost("the tracker's server is closing", "receive")
        if isinstance(packet, StatusChange):
            self.settings.note_change(packet.change)
        self._results += isinstance(packet, Single)
        return packet

    def _lost(self, found: str, operation: str) -> DeviceError:
        """Return the error after which the stream cannot be trusted; the wire is closed."""
        error = self._wire().broken(operation, found)
        self.close()
        return error

    def _wire(self) -> TcpLink:
        return TRACKER.connected(self._link)


class EmsconStream:
    """Satisfies `hilcell.ports.Stream`: continuous time mode, samples by the tracker's own clock.

    Packets come late, cut and together, so only the time inside a sample counts. The mode belongs
    to the tracker, not to the connection: every exit restores stationary mode, and after a kill the
    next connect.
    """

    SLOWEST_HZ, FASTEST_HZ = 0.1, 1000.0
    SILENT_S = 3.0  # wire deadline: from one packet to the next, on top of a packet's own time
    END_S = 5.0  # wire deadline: from the stop to its reply
    SEPARATION_SHARE = 0.5  # by which the samples' times may miss the separation that was set
    ENOUGH = 3  # steps that show the unit of time; fewer may be a gap

    def __init__(
        self,
        tracker: LeicaEmsconTracker,
        clock: Clock,
        near_mm: Array,
        reflector: str,
        rate_hz: float,
        find_radius_mm: float,
    ) -> None:
        near_mm = checked_request(near_mm, operation="stream")
        if not self.SLOWEST_HZ <= rate_hz <= self.FASTEST_HZ:
            found, expected = f"{rate_hz} samples/s", f"{self.SLOWEST_HZ} to {self.FASTEST_HZ:g}"
            raise TRACKER.failed("HC-T35", "stream", found, expected=expected, rate_hz=rate_hz)
        self._separation_ms = round(1000.0 / rate_hz)
        self.rate_hz = 1000.0 / self._separation_ms
        self._tracker, self._clock = tracker, clock
        self._near_mm, self._reflector, self._radius_mm = near_mm, reflector, find_radius_mm
        self._silent_s = self.SILENT_S + self._separation_ms / 1000.0
        self._silence = Deadline(self._silent_s)
        self._emptied_s = 0.0
        self._last_s: float | None = None
        self._running = False

    def __enter__(self) -> Self:
        self._tracker.point_at(self._near_mm, self._reflector)
        settings = self._tracker.settings
        try:
            settings.write(Setting.MEASUREMENT_MODE, Value.CONTINUOUS_TIME)
            parameters = (self._separation_ms, Value.UNTIL_STOPPED, 0, 0)
            settings.write(Setting.CONTINUOUS_TIME, *parameters)
        except BaseException as error:  # also a stop: no stream's mode is left behind
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """End the stream: the tracker measures at rest again.

        A stop is not waited for, and the next connect reads the mode back.
        """
        try:
            if isinstance(error, Stopped):
                self._tracker.leave_stream()
                return
            if self._running:
                self._stop()
            self._tracker.settings.write(Setting.MEASUREMENT_MODE, Value.STATIONARY)
        except HilcellError as failure:  # a stop, too, would hide the error
            if error is None:
                raise
            error.add_note(f"the stream was not ended: {failure}; the next connect ends it")

    def kickoff(self) -> None:
        self._emptied_s = self._clock.now_s()
        self._tracker.start(self._near_mm)
        self._running = True
        self._silence = Deadline(self._silent_s)

    def collect(self) -> list[StreamBlock]:
        looked_s = self._clock.now_s()
        over = self._silence.expired()
        samples = self._samples(iter(lambda: self._tracker.next_packet(Deadline(0.0)), None))
        if samples:
            self._silence = Deadline(self._silent_s)
        elif over:
            raise self._empty(f"no samples for {self._silent_s:.1f} s")
        return self._blocks(samples, looked_s)

    def complete(self) -> list[StreamBlock]:
        """End the stream and return the rest of it; raises `NoReading` where nothing ever came."""
        looked_s = self._clock.now_s()
        samples = self._samples(self._stop())
        self._tracker.settings.verify()  # those that were changed while it measured
        if self._last_s is None:
            raise self._empty("no sample came")
        return self._blocks(samples, looked_s)

    @staticmethod
    def _empty(found: str) -> NoReading:
        return TRACKER.no_reading("HC-T40", "stream", found)

    def _stop(self) -> list[Packet]:
        """Stop measuring; return the blocks that came before the tracker's answer."""
        packets: list[Packet] = []
        self._tracker.stop()
        deadline = Deadline(self.END_S)
        while (packet := self._tracker.next_packet(deadline)) is not None:
            if isinstance(packet, Reply | Failure) and packet.command == Command.STOP_MEASUREMENT:
                self._running = False
                if packet.status != 0:
                    raise emscon.failed(Command.STOP_MEASUREMENT, packet.status)
                return packets
            packets.append(packet)
        raise TRACKER.failed(
            "HC-T42", "stream", f"not stopped within {self.END_S:.0f} s", waited_s=self.END_S
        )

    def _samples(self, packets: Iterable[Packet]) -> list[Multi]:
        """Return the packets of samples; raises the error in one of them."""
        samples = list[Multi]()
        for packet in packets:
            if isinstance(packet, Multi) and not len(packet.device_s):
                continue
            emscon.check_measured(packet, Multi, "stream")
            if isinstance(packet, Multi):
                self._check(packet)
                samples.append(packet)
        return samples

    def _check(self, packet: Multi) -> None:
        if not emscon.possible(*packet.xyz.flat):
            raise TRACKER.no_reading(
                "HC-T14", "stream", f"a sample at {packet.xyz} mm", expected="a position in mm"
            )
        if self._last_s is None:
            off_mm = float(np.linalg.norm(packet.xyz[0] - self._near_mm))
            if not off_mm <= self._radius_mm:
                raise off_target(off_mm, self._radius_mm, "stream")
        before_s = [] if self._last_s is None else [self._last_s]
        steps_ms = 1000.0 * np.diff([*before_s, *packet.device_s])
        self._last_s = float(packet.device_s[-1])
        if not bool(np.all(steps_ms > 0)):
            found = f"the samples' times run back by {-float(steps_ms.min()):.3f} ms"
            expected = "later than the sample before"
            raise TRACKER.no_reading("HC-T41", "stream", found, expected=expected)
        typical_ms = (
            float(np.median(steps_ms)) if len(steps_ms) >= self.ENOUGH else self._separation_ms
        )
        if not abs(typical_ms / self._separation_ms - 1.0) <= self.SEPARATION_SHARE:
            raise TRACKER.failed(
                "HC-T41",
                "stream",
                f"samples {typical_ms:.3f} ms apart",
                expected=f"{self._separation_ms} ms",
                act="the tracker counts its time in other units, or lost samples; report it",
                separation_ms=typical_ms,
                wanted_ms=self._separation_ms,
            )

    def _blocks(self, samples: list[Multi], looked_s: float) -> list[StreamBlock]:
        """Return the packets since the poll before ``looked_s`` that emptied the buffer."""
        after_s, by_s, self._emptied_s = self._emptied_s, self._clock.now_s(), looked_s
        return [StreamBlock(each.device_s, each.xyz, after_s, by_s) for each in samples]
