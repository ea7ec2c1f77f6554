"""A laser tracker behind SpatialAnalyzer, by its bridge T2SA over TCP: API's trackers, and others.

The bridge measures named points of SpatialAnalyzer's job, a grid (`t2sa_points`): a place is
measured through the one nearest in direction. Requests are ``!COMMAND:values`` or
``?QUESTION:values``, with semicolons. Every request has one reply, ``ACK-300 text`` or ``ERR-305
text``; older versions write ``ERR-305: text``. A position is ``result x,y,z`` or ``result:
X:x;Y:y;Z:z``, after the point's name and before a date in the PC's own format.

The traps: a result of a simulated instrument, an old one and one in inches look like a good one;
each is recognised by its values. Replies have no number, so a late one looks like the next one's:
after a measurement without a reply the bridge must confirm a halt, and then answer a request of
another kind; after any other silence, and after a stop, the connection is not used any more.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from drivers.device_errors import TRACKER, ProtocolError
from drivers.spatialanalyzer.t2sa_points import SEARCH_MM, NamedPoints, read_points
from drivers.supervision import Deadline, on_failure
from drivers.tracker_readings import (
    Positive,
    TrackerAbilities,
    check_reflector,
    checked_request,
    checked_search,
    matching_form,
    off_target,
    repeats_std,
    retry_while_busy,
)
from drivers.wires import TcpLink, TextLines
from hilcell.cell.settings import SettingsError
from hilcell.clock import WallClock
from hilcell.decoding import typed
from hilcell.ports import (
    Ability,
    Array,
    Candidate,
    Clock,
    DeviceError,
    DeviceRefused,
    Identity,
    NoReading,
    TrackerReading,
    is_simulated_name,
)
from hilcell.sanitize import clean
from hilcell.wire.channel import Host, Port

# Deadlines on the wire, in real time.
REPLY_S = 5.0
MEASURE_S = 30.0
BUSY_PAUSE_S = 0.2
READY = ("Instrument is connected", "READY")
BUSY = 201
MAX_TEXT = 120
# Codes of the vendor's list that a measurement, or a question of one, may bring.
CODES = {
    200: ("HC-T23", "command rejected"),
    BUSY: ("HC-T21", "busy"),
    301: ("HC-T70", "laser not switched"),
    305: ("HC-T11", "measurement of the point failed"),
    306: ("HC-T72", "no such group or point"),
    323: ("HC-T70", "instrument interface not started"),
    330: ("HC-T13", "halted"),
    338: ("HC-T70", "instrument not ready"),
    340: ("HC-T11", "measurement of the group failed"),
    341: ("HC-T70", "not connected to SpatialAnalyzer"),
    346: ("HC-T72", "no such object in the job"),
    347: ("HC-T70", "no such instrument in the job"),
}
UNKNOWN = ("HC-T24", "not known")
ACT = "check SpatialAnalyzer and the tracker, then resume"

Word = Annotated[str, Meta(max_length=60, pattern=r"^[^;:\x00-\x1f\x7f]*$")]


class Reply(NamedTuple):
    """One reply; ``code`` is that of the line, ``text`` is cleaned."""

    accepted: bool
    code: int
    text: str

    @property
    def is_result(self) -> bool:
        return self.accepted and re.search(r"\bresult\b", self.text) is not None

    @property
    def is_ready(self) -> bool:
        """Whether it states that no command is in progress."""
        return self.accepted and self.text.startswith(READY)

    @property
    def is_laser(self) -> bool:
        return self.accepted and re.search(r"\b(?:LON|LOFF|LNC|WARM)\b", self.text) is not None

    @property
    def found(self) -> str:
        """The code with its meaning and the bridge's own text."""
        _, meaning = CODES.get(self.code, UNKNOWN)
        return f"ERR-{self.code} ({meaning}): {self.text[:MAX_TEXT]}"


def parse(line: str) -> Reply:
    """Return a reply; raises `ProtocolError`."""
    found = re.fullmatch(r"(ACK|ERR)-(\d{3}):?(?:\s+(.*))?", line.strip())
    if found is None:
        raise ProtocolError(f"no reply of T2SA: {clean(line[:MAX_TEXT])!r}")
    return Reply(found[1] == "ACK", int(found[2]), clean(found[3] or ""))


def position_of(reply: Reply, point: str) -> Array:
    """Return the position (3,) in a reply; values that are no numbers or out of reach are NaN.

    Raises `ProtocolError` where it has none, or is of another point.
    """
    axes = r"\bresult:?\s+X:([^;]*);\s*Y:([^;]*);\s*Z:([^;]*)(?:;|$)"
    commas = r"\bresult:?\s+([^,;\s]+),([^,;\s]+),([^,;\s]+)(?:\s|$)"
    found = re.search(axes, reply.text) or re.search(commas, reply.text)
    if found is None:
        raise ProtocolError(f"no position x,y,z with decimal points: {reply.text[:MAX_TEXT]!r}")
    if point not in re.split(r"[\s;]+", reply.text[: found.start()]):
        raise ProtocolError(f"the answer is not of point {point}: {reply.text[:MAX_TEXT]!r}")
    form = r"\s*[-+]?\d{1,9}(?:\.\d{0,30})?(?:[eE][-+]?\d{1,3})?\s*"
    values = [float(each) if re.fullmatch(form, each) else math.nan for each in found.groups()]
    # Beyond 1e9 it is beyond the reach of any tracker, in whichever unit.
    return np.array([value if abs(value) < 1e9 else math.nan for value in values])


def other_forms(xyz_mm: Array, named_mm: Array) -> dict[str, Array]:
    """Return places (3,) that a result may mean; it was measured through the point ``named_mm``."""
    return {
        "in inches": 25.4 * xyz_mm,
        "in metres": 1000.0 * xyz_mm,
        "as a deviation from the named point": named_mm + xyz_mm,
    }


class T2saTracker:
    """Satisfies `hilcell.ports.Tracker`, and its `Searches`, `Inspects` and `Discovers`.

    A person cannot aim it: the bridge measures named points only.
    """

    HALT, STATUS, LASER = "!HALT", "?STAT", "?LSTA"
    MEASURE, POSITION = "!MEAS_SINGLE_POINT:", "?POINT_POS:"
    WARM_POLL_S, WARM_S = 1.0, 300.0  # of the cell's time
    COMPARED = 5  # points of the list, from the first to the last
    SAME_MM = 0.01  # of a point in the list and in the job: both are rounded
    NOMINAL_MM = 1.0  # a reflector is as near to a point of the grid once in a million
    TRIES = 3  # named points, where one leads to another reflector

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Where the bridge is, its list of points, and how it is set.

        ``points`` is the CSV that SpatialAnalyzer has imported as ``collection`` and ``group``. The
        wire states no instrument: ``instrument`` and ``plate`` are those of its name plate.
        """

        host: Host
        port: Port = 50_000
        reflector: str
        max_std_mm: Positive
        find_radius_mm: Positive
        points: str = ""
        collection: Annotated[Word, Meta(min_length=1)] = "A"
        group: Annotated[Word, Meta(min_length=1)] = "HILCELL"
        search_mm: Annotated[float, Meta(ge=1, le=1000)] = SEARCH_MM
        repeats: Annotated[int, Meta(ge=2, le=100)] = 2
        power_lock: bool = True
        profile: Word = ""
        working_frame: Word = ""
        instrument: str = "API laser tracker"
        plate: str = "not stated"

    def __init__(self, options: Options, clock: Clock) -> None:
        self._options, self._clock = options, clock
        self._lines: TextLines | None = None
        self._stopped = False
        self._points: NamedPoints | None = None
        self._last_mm: Array | None = None
        self._arrived_s = 0.0

    # -- the port -----------------------------------------------------------------------------

    def inspect(self) -> list[Ability]:
        found = TrackerAbilities()
        try:
            points = _read(self._options.points)
        except DeviceRefused as refusal:
            points = None
            found.need("list of points", False, refusal.found)
        link = self._open()
        with closing(self):
            state = self._exchange(self.STATUS)
            found.need("bridge ready", state.is_ready, state.text or f"code {state.code}")
            laser = self._exchange(self.LASER).text
            note = laser if "LON" in laser else f"{laser}; connecting switches it on"
            found.may("laser on and warm", "LON" in laser, note)
            if points is not None:
                found.need("list of points", True, f"{len(points.names)} points")
                self._compare_listed(points, found)
        found.may("serial number", False, f"not stated by the bridge at {link.address}; plate")
        found.may("weather station", False, "SpatialAnalyzer corrects distances by its own air")
        found.may("second face", False, "errors of its axes are not seen")
        found.may("stream", False, "no axis sweeps: gear ripple remains")
        found.may("aim by a person", False, "it measures named points only")
        return found.listed

    def _compare_listed(self, points: NamedPoints, found: TrackerAbilities) -> None:
        """Add whether the job has the listed points."""
        try:
            self._compare(points)
        except DeviceError as error:
            if self._lines is None:
                raise
            found.need("points in the job", False, error.found)
        else:
            group = f"{self._options.collection};{self._options.group}"
            found.need("points in the job", True, clean(group))

    @classmethod
    def discover(cls, known: Mapping[str, object]) -> list[Candidate]:
        """Return the bridge at the host that a person gave, if it answers as T2SA."""
        if not known.get("host"):
            return []
        given = {name: known[name] for name in ("host", "port") if name in known}
        anything = {"reflector": "", "max_std_mm": 1.0, "find_radius_mm": 1.0}
        try:
            tracker = cls(typed(given | anything, cls.Options), WallClock(Event()))
            link = tracker._open()
            with closing(tracker):
                state = tracker._exchange(cls.STATUS).text
        except (DeviceError, msgspec.ValidationError):
            return []
        options = tracker._options
        place: dict[str, object] = {"host": options.host, "port": options.port}
        simulated = is_simulated_name(state)
        identity = Identity(
            TRACKER.name, "tracker, by SpatialAnalyzer", "", link.address, simulated, "tracker"
        )
        return [Candidate(f"T2SA at {link.address}: {state}", place, [identity])]

    def connect(self) -> list[Identity]:
        self.close()
        options = self._options
        if self._points is None or Path(options.points).exists():
            self._points = _read(options.points)
        points = self._points  # whichever it is, the job is compared with it
        link = self._open()
        with on_failure(self.close):
            state = self._ready()
            self._set_up()
            self._compare(points)
        model = f"{clean(options.instrument)}, by SpatialAnalyzer"
        serial, simulated = clean(options.plate), is_simulated_name(state)
        return [Identity(TRACKER.name, model, serial, link.address, simulated, "tracker")]

    def measure(self, near_mm: Array, reflector: str, samples: int) -> TrackerReading:
        """Measure the reflector expected at ``near_mm`` (3,), tracker frame, ``samples`` times.

        It is measured `repeats` times at least: the wire states no deviation of one measurement.
        """
        near_mm = checked_request(near_mm, samples)
        options = self._options
        self._check_target(reflector)
        points = TRACKER.connected(self._points)
        name, _, beside_mm = points.aim(near_mm, options.search_mm)
        if not beside_mm <= options.search_mm:
            raise TRACKER.failed(
                "HC-T74",
                "measure",
                f"the aim at named point {name} is {beside_mm:.1f} mm beside {_shown(near_mm)}",
                expected=f"<= {options.search_mm:.1f} mm (tracker.options.search_mm)",
                point=name,
                beside_mm=beside_mm,
                limit_mm=options.search_mm,
            )
        count, others_mm = max(samples, options.repeats), dict[str, Array]()
        points_mm = np.array([self._single(near_mm, others_mm) for _ in range(count)])
        std_mm = repeats_std(points_mm, options.max_std_mm)
        mean_mm = points_mm.mean(axis=0)
        return TrackerReading(mean_mm, std_mm, count, reflector, None, self._arrived_s)

    def search(
        self, near_mm: Array, reflector: str, samples: int, radius_mm: float
    ) -> TrackerReading:
        """Measure the reflector within ``radius_mm`` of ``near_mm`` (3,), tracker frame.

        The bridge searches around each named point there, the nearest first.
        """
        near_mm = checked_search(near_mm, samples, radius_mm)
        self._check_target(reflector)
        points, searched = TRACKER.connected(self._points), self._options.search_mm
        found = f"none of the named points is within {radius_mm:.1f} mm beside {_shown(near_mm)}"
        failure = TRACKER.no_reading("HC-T11", "search", found)
        for name, named_mm in points.around(near_mm, radius_mm, searched):
            try:
                xyz_mm = self._measured(name, named_mm)
            except NoReading as error:
                failure = error
                continue
            off_mm = float(np.linalg.norm(xyz_mm - near_mm))
            if off_mm <= radius_mm:
                return self.measure(xyz_mm, reflector, samples)
            failure = off_target(off_mm, radius_mm, "search")
        failure.fields["searched_mm"] = radius_mm
        raise failure

    def stop(self) -> None:
        """Halt the measurement in progress, without waiting for an answer."""
        lines, self._stopped = self._lines, True  # another thread may be closing
        if lines is not None:
            lines.send(self.HALT, "stop")

    def close(self) -> None:
        if self._lines is not None:
            self._lines.link.close()
        self._lines = None

    # -- connecting ---------------------------------------------------------------------------

    def _open(self) -> TcpLink:
        self.close()
        link = TcpLink(TRACKER, self._options.host, self._options.port, self._clock.check)
        # A date in the PC's own format may hold letters of any alphabet.
        self._lines, self._stopped = TextLines(link, letters=True), False
        return link

    def _ready(self) -> str:
        """Return the bridge's state as soon as it is ready; raises where it stays busy."""
        ask, limit_s = partial(self._exchange, self.STATUS), MEASURE_S
        reply = retry_while_busy(
            ask, lambda each: not each.is_ready, limit_s, self._clock, BUSY_PAUSE_S
        )
        if not reply.is_ready:
            alarm = "HC-T21" if reply.accepted else CODES.get(reply.code, UNKNOWN)[0]
            found = f"state {reply.text!r} for {limit_s:.1f} s"
            raise TRACKER.failed(
                alarm, "connect", found, expected=repr(READY[0]), act=ACT, status=reply.code
            )
        return reply.text

    def _set_up(self) -> None:
        options = self._options
        reply = self._exchange("!SET_SIM:0")
        if not reply.accepted:
            found, operation = reply.found, "switch simulation off"
            raise TRACKER.refused("HC-T71", operation, found, status=reply.code)
        self._warm()
        settings = {
            "station lock": "!SET_STATION_LOCK:1",
            "power lock": f"SET_POWER_LOCK:{int(options.power_lock)}",
        }
        if options.profile:
            settings["measurement profile"] = f"!SINGLE_POINT_MEAS_PROFILE:{options.profile}"
        if options.working_frame:
            settings["working frame"] = f"!SET_WORKING_FRAME:{options.working_frame}"
        for what, command in settings.items():
            reply = self._exchange(command)
            if not reply.accepted:
                raise TRACKER.refused(
                    "HC-T06",
                    f"set {what}",
                    reply.found,
                    expected=command,
                    act="set it in SpatialAnalyzer, or correct tracker.options; then resume",
                    setting=what,
                    status=reply.code,
                )

    def _warm(self) -> None:
        """Switch the laser on where it is off, and wait until it has warmed up."""
        state = self._ask(self.LASER).text
        if "LOFF" in state:
            self._ask("!LST:1")
            state = self._ask(self.LASER).text
        ends_s = self._clock.now_s() + self.WARM_S
        while "WARM" in state and self._clock.now_s() < ends_s:
            self._clock.wait(self.WARM_POLL_S)
            state = self._ask(self.LASER).text
        if "LON" not in state:
            code = "HC-T19" if "WARM" in state else "HC-T70"
            found, operation = f"state {state!r}", "switch the laser on"
            raise TRACKER.failed(code, operation, found, expected="LON", act=ACT, state=state)

    def _compare(self, points: NamedPoints) -> None:
        """Refuse a job whose points are not those of the list, by some of them."""
        for name, listed_mm in points.spread(self.COMPARED):
            found_mm = self._position(self.POSITION, name)
            if not float(np.linalg.norm(found_mm - listed_mm)) <= self.SAME_MM:
                forms = other_forms(found_mm, np.full(3, np.nan))
                form = matching_form(listed_mm, self.SAME_MM, forms)
                form = form and f" {form}"
                raise TRACKER.refused(
                    "HC-T73",
                    "compare points",
                    f"point {name} is at {_shown(found_mm)} in SpatialAnalyzer{form}",
                    expected=f"{_shown(listed_mm)} mm as in {clean(self._options.points)}",
                    point=name,
                    found_mm=found_mm.tolist(),
                    listed_mm=listed_mm.tolist(),
                )

    # -- measuring ----------------------------------------------------------------------------

    def _check_target(self, reflector: str) -> None:
        """Refuse a reflector that is not SpatialAnalyzer's, and a connection that is gone."""
        target = f"the target in SpatialAnalyzer is {self._options.reflector!r}"
        check_reflector(reflector, [self._options.reflector], target)
        self._wire()

    def _single(self, near_mm: Array, others_mm: dict[str, Array]) -> Array:
        """Return one position (3,); where another reflector is caught, aim on its far side.

        ``others_mm`` are those that were caught in its place, by their named points.
        """
        limit_mm, search_mm = self._options.find_radius_mm, self._options.search_mm
        points, off_mm = TRACKER.connected(self._points), np.inf
        for _ in range(self.TRIES):
            name, named_mm, _ = points.aim(near_mm, search_mm, list(others_mm.values()))
            if name in others_mm:
                break
            try:
                xyz_mm = self._measured(name, named_mm)
            except NoReading as error:
                if error.code == "HC-T11":
                    error.fields["searched_mm"] = search_mm
                raise
            off_mm = float(np.linalg.norm(xyz_mm - near_mm))
            if off_mm <= limit_mm:
                return xyz_mm
            if form := matching_form(near_mm, limit_mm, other_forms(xyz_mm, named_mm)):
                found, expected = f"the result {_shown(xyz_mm)} is {form}", "a position in mm"
                raise TRACKER.failed(
                    "HC-T77", "measure", found, expected=expected, xyz=xyz_mm.tolist(), form=form
                )
            others_mm[name] = xyz_mm
        raise off_target(off_mm, limit_mm)

    def _measured(self, name: str, named_mm: Array) -> Array:
        """Return the position (3,) of the reflector that is caught from a named point."""
        xyz_mm = self._position(self.MEASURE, name)
        if not bool(np.all(np.isfinite(xyz_mm))):
            raise TRACKER.no_reading(
                "HC-T14", "measure", f"the result {xyz_mm} is no position", xyz_mm=str(xyz_mm)
            )
        if self._last_mm is not None and bool(np.all(xyz_mm == self._last_mm)):
            found = f"the result {_shown(xyz_mm)} is the former one to its last digit"
            raise TRACKER.no_reading("HC-T76", "measure", found, xyz_mm=xyz_mm.tolist())
        self._last_mm = xyz_mm
        if not float(np.linalg.norm(xyz_mm - named_mm)) > self.NOMINAL_MM:
            found = f"the result {_shown(xyz_mm)} is the named point {name} itself"
            raise TRACKER.refused("HC-T71", "measure", found, xyz_mm=xyz_mm.tolist(), point=name)
        return xyz_mm

    # -- the bridge ---------------------------------------------------------------------------

    def _ask(self, command: str) -> Reply:
        """Request, again while the bridge is busy; raises the error of a refusal."""
        ask, limit_s = partial(self._exchange, command), self._limit_s(command)
        reply = retry_while_busy(
            ask, lambda each: each.code == BUSY, limit_s, self._clock, BUSY_PAUSE_S
        )
        if not reply.accepted:
            alarm, _ = CODES.get(reply.code, UNKNOWN)
            again = alarm in ("HC-T11", "HC-T13", "HC-T21") and command.startswith(self.MEASURE)
            error = TRACKER.no_reading if again else TRACKER.failed
            raise error(alarm, self._label(command), reply.found, status=reply.code)
        return reply

    def _position(self, command: str, name: str) -> Array:
        """Return a named point's position (3,) by a command; values that are no numbers are NaN."""
        reply = self._ask(f"{command}{self._options.collection};{self._options.group};{name}")
        try:
            return position_of(reply, name)
        except ProtocolError as error:
            raise self._lost(str(error), "decode") from error

    def _exchange(self, command: str) -> Reply:
        """Request once and return the reply; results that were not asked for are dropped."""
        measures = command.startswith(self.MEASURE)
        asks_result = measures or command.startswith(self.POSITION)
        reply = self._answer(command, lambda reply: asks_result or not reply.is_result)
        if reply is not None:
            return reply
        if not measures:
            raise self._lost("no answer in time", self._label(command))
        # It is halted, and no reply to it may be still to come.
        self._confirm(self.HALT, lambda reply: reply.accepted and not reply.is_result)
        self._confirm(self.LASER, lambda reply: reply.is_laser)
        found = f"no answer to {self._label(command)} in {MEASURE_S:.1f} s"
        raise TRACKER.no_reading("HC-T13", "measure", found, waited_s=MEASURE_S)

    def _lost(self, found: str, operation: str) -> DeviceError:
        """Return the error after which the replies cannot be trusted; the connection is closed."""
        error = TRACKER.connected(self._lines).link.broken(operation, found)
        self.close()
        return error

    def _confirm(self, command: str, answers: Callable[[Reply], bool]) -> None:
        if self._answer(command, answers) is None:
            raise self._lost("no answer in time", self._label(command))

    def _answer(self, command: str, answers: Callable[[Reply], bool]) -> Reply | None:
        """Request, and drop all replies up to the one that answers; None where none comes."""
        self._wire().send(command, self._label(command))
        deadline = Deadline(self._limit_s(command))
        while (reply := self._reply(deadline)) is not None and not answers(reply):
            pass
        return reply

    def _reply(self, deadline: Deadline) -> Reply | None:
        """Return the next reply, None when ``deadline`` is over; a line that failed is closed."""
        try:
            line = self._wire().receive(deadline)
        except DeviceError:
            self.close()
            raise
        self._clock.check()  # the answer to a stop is none to a request
        if line is None:
            return None
        self._arrived_s = self._clock.pc_s()
        try:
            return parse(line)
        except ProtocolError as error:
            raise self._lost(str(error), "receive") from error

    def _wire(self) -> TextLines:
        if self._lines is None or self._stopped:
            self._clock.check()
        lines = TRACKER.connected(self._lines)
        if self._stopped:
            raise TRACKER.failed("HC-T34", "use", "stopped")
        return lines

    def _limit_s(self, command: str) -> float:
        return MEASURE_S if command.startswith(self.MEASURE) else REPLY_S

    @staticmethod
    def _label(command: str) -> str:
        return command.partition(":")[0].strip("!?").lower().replace("_", " ")


def _read(points: str) -> NamedPoints:
    """Return the list that the cell file names; raises `DeviceRefused`."""
    problem = "tracker.options.points is empty"
    if points:
        try:
            return read_points(Path(points))
        except SettingsError as error:
            problem = clean(str(error))
    raise TRACKER.refused("HC-T75", "read the list of points", problem, expected="a list")


def _shown(xyz_mm: Array) -> str:
    return "(" + ", ".join(f"{each:.3f}" for each in xyz_mm) + ")"
