"""A journal as typed objects: points, frames, states, the frozen plan.

The same class reads a live, a finished and a crashed run; every result is computed from it and can
be computed again.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, MutableMapping, Sequence
from functools import wraps
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, TypeVarTuple

import msgspec
import numpy as np

from hilcell.cell.file import Cell
from hilcell.cell.settings import convert
from hilcell.decoding import Json, learn, typed
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import BeamNoise, beam_noise, reading_variances_mm2
from hilcell.identity import Identity
from hilcell.journal.calibration_facts import CalibrationFacts, facts_of, outcome
from hilcell.journal.journal import Body, Journal, NeverBegan, Record
from hilcell.model import events
from hilcell.model.events import Three
from hilcell.model.frame import Frame
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlanRecord
from hilcell.model.point import CHECKS, CONTROL, Point, PointId
from hilcell.model.records import (
    OVER,
    WAITING,
    CalibrationState,
    Change,
    Ended,
    Intended,
    Kind,
    RunState,
    StateChanged,
)
from hilcell.model.verdicts import Fitted, Verdict
from hilcell.ports import Array

T = TypeVar("T")
E = TypeVar("E", bound=events.Event)
F = TypeVar("F", bound=Frame)
V = TypeVar("V", bound=Verdict)
Args = TypeVarTuple("Args")


# -- the tracker's set-ups -------------------------------------------------------------------------

# A moved tracker has a new set-up with a {W} of its own: ``world``, then ``world.1``, ``world.2``.

VERIFICATION_KINDS = ("world", "control")  # points of these verify the tracker
UNWATCHED_STATES = ("paused", "suspended", "checking")  # a bump may go unnoticed


def world_key(set_up: int) -> str:
    """Return the key of the frame T_W_L of a set-up, counted from 0."""
    return f"world.{set_up}" if set_up else "world"


def carried(xyz_mm: Three, std_mm: Three, T_first: Array, T_own: Array) -> tuple[Three, Three]:
    """Return a reading and its standard deviations as seen from the first set-up.

    ``T_first``, ``T_own`` are T_W_L (4, 4) of the first set-up and of the reading's own.
    """
    T = inverse(T_first) @ T_own
    x, y, z = apply(T, [xyz_mm])[0].tolist()
    u, v, w = np.sqrt(np.square(T[:3, :3]) @ np.square(std_mm)).tolist()
    return (x, y, z), (u, v, w)


class SetUps:
    """The tracker's set-ups and what its last verification covers, from a run's records.

    ``number`` is the present set-up's, ``unverified`` are the keys of points and streams since the
    last verification of the tracker, ``interrupted``: the run has waited since. ``refuted`` are
    the keys of control points that showed a moved tracker.
    """

    def __init__(self) -> None:
        self.number = 0
        self.unverified: dict[str, None] = {}
        self.interrupted = False
        self.refuted: set[str] = set()
        self._control: list[str] = []  # control points of the verification in progress

    @property
    def needs_verification(self) -> bool:
        """Whether points wait for a verification; points of mere checks do not."""
        return any(key.partition("/")[0] not in CHECKS for key in self.unverified)

    def take(self, record: Record) -> list[str]:
        """Apply one record; return the keys that it invalidates."""
        match record.fact:
            case Point(id=PointId(kind=kind), key=key):
                if kind not in VERIFICATION_KINDS:
                    self.unverified[key] = None
                elif kind == "control":
                    self._control.append(key)
            case Frame() if record.key == world_key(self.number):
                self._verified()
            case StateChanged(machine="run", to=to):
                self.interrupted |= to in UNWATCHED_STATES
            case events.StreamRecorded(key=key):
                self.unverified[key] = None
            case events.TrackerMoved(set_up=number, invalid=invalid):
                self.number = number
                self.refuted.update(self._control)
                self._control.clear()
                return invalid
            case events.WorldRemeasured(invalid=invalid):
                return invalid
            case events.TrackerVerified():
                self._verified()
        return []

    def _verified(self) -> None:
        self.unverified.clear()
        self._control.clear()
        self.interrupted = False


# -- the log --------------------------------------------------------------------------------------


class VisitedPoses:
    """Poses that the robot has reached, from a run's records in sequence.

    A motion has ended where a point or another motion follows it in the same session.
    """

    def __init__(self) -> None:
        self._ends = array("d")  # of each seven: the strip's reading, six joints in deg
        self._moving_to: list[float] | None = None

    def take(self, record: Record) -> None:
        match record.fact:
            case StateChanged(to="checking"):
                self._moving_to = None  # its session has ended
            case Intended(action="robot.move", strip_mm=float(strip_mm), joints_deg=joints_deg):
                self._arrived()
                self._moving_to = [strip_mm, *joints_deg]
            case Intended() | Point():
                self._arrived()

    def _arrived(self) -> None:
        if self._moving_to is not None:
            self._ends.extend(self._moving_to)
        self._moving_to = None

    def has(self, strip_mm: float, joints_rad: Array) -> bool:
        """Whether a motion has ended at joints (6,) with the slide at ``strip_mm``."""
        if not self._ends:
            return False
        same_mm, same_deg = 5.0, 1.0  # slide; each axis: corrections are smaller
        off = np.abs(np.reshape(self._ends, (-1, 7)) - [strip_mm, *np.degrees(joints_rad)])
        near = (off[:, 0] <= same_mm) & (off[:, 1:] <= same_deg).all(axis=1)
        return bool(near.any())


class OrderedMotion(NamedTuple):
    """A motion that was ordered, to a point (its key) or a place."""

    seq: int
    key: str
    motion: Intended


class CutOff(msgspec.Struct, frozen=True):
    """A session without an end of its own: its last record, its state and the points by then.

    ``began`` is the number of the record with which it began.
    """

    last: Record
    state: RunState
    points: int
    began: int


class _Row(Point, frozen=True, kw_only=True, array_like=True):
    """A point as the log packs it: without the names of its fields."""


class _Packed(MutableMapping[str, Point]):
    """Points by key, packed: 0.5 kB each instead of 3 kB; each access decodes a new object."""

    def __init__(self) -> None:
        learn(_Row)
        self._encoder, self._decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(_Row)
        self._rows: dict[str, bytes] = {}

    def __getitem__(self, key: str) -> Point:
        return self._decoder.decode(self._rows[key])

    def __setitem__(self, key: str, value: Point) -> None:
        self._rows[key] = self._encoder.encode(typed(value, _Row, from_attributes=True))

    def __delitem__(self, key: str) -> None:
        del self._rows[key]

    def __contains__(self, key: object) -> bool:
        return key in self._rows

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


class Log:
    """The journal so far; ``take`` applies one record. ``packed`` points need little memory."""

    def __init__(self, records: Iterable[Record] = (), *, packed: bool = True) -> None:
        self.plan: PlanRecord | None = None
        self._cell: Cell | None = None
        self.points: MutableMapping[str, Point] = _Packed() if packed else {}
        self.repeated: dict[str, list[Point]] = {}  # earlier measurements of targets, by key
        self._keys: dict[str, dict[str, int]] = {}  # of the points, by kind: numbers of records
        self.changed: dict[str, int] = {}  # by point: the record of its last change
        self.celsius: dict[str, float] = {}  # by point, with a weather station
        self.frames: dict[str, Frame] = {}
        self.verdicts: dict[str, Verdict] = {}
        self.verdict_records: dict[str, Record] = {}
        self.events: list[Record] = []
        self.state: RunState = "idle"
        self.calibration: CalibrationState = "unknown"
        self.life: list[Change] = []  # the run's states
        self.session, self.began = 0, 0  # its number and first record
        self.end: Ended | None = None
        self.fault = ""
        self.moved = False  # in this session
        self.visit = 0  # counts motions of the slide; a touched base belongs to one visit
        self.based_visit = -1  # that of the base frame
        self.visited_poses = VisitedPoses()
        self.set_ups = SetUps()
        self.retakes: dict[str, None] = {}  # keys of points that wait to be re-measured
        self.link: events.LinkCounted | None = None  # of all sessions without a crash
        self.seated = ""  # the place of a reflector that is carried by hand
        self.sights: dict[str, events.ReflectorPlaced] = {}
        self.streams: dict[str, events.StreamRecorded] = {}
        self.curves: dict[int, events.CurveMeasured] = {}  # by axis, 1 to 6
        self.assets: list[Identity] = []  # as last connected
        self.newest: Record | None = None
        self.version = self.measured_version = 0  # newest record; newest point, frame or event
        self._worked: Record | None = None  # the newest except ends, which a refused resume has
        self.order: OrderedMotion | None = None  # the last motion without a known end
        self.cut_off: list[CutOff] = []  # earlier crashed sessions
        self._computed: dict[object, tuple[int, Any]] = {}
        for record in records:
            self.take(record)

    def take(self, record: Record) -> None:
        fact, before = record.fact, self._worked
        self.newest = record
        self.version = record.seq
        unmeasured = record.kind in ("intent", "state", "verdict")
        self.measured_version = self.measured_version if unmeasured else record.seq
        self._worked = before if record.kind == "end" else record
        match fact:
            case PlanRecord():
                self.plan, self._cell = fact, None
            case StateChanged():
                self._take_state(record, fact, before)
            case Point():
                self._take_point(self._carried(fact), record.seq)
                self.order = None
            case Frame():
                self.frames[record.key] = fact
                self.based_visit = self.visit if record.key == "base" else self.based_visit
                self._carry_nests(record.key, record.seq)
            case Verdict():
                self.verdicts[record.key], self.verdict_records[record.key] = fact, record
            case Ended():
                self.end = fact
            case Intended():
                self.moved, self.order = True, OrderedMotion(record.seq, record.key, fact)
                self.visit += fact.action.startswith("rail.")
            case events.Event() | events.OtherEvent():
                self.events.append(record)
                self._take_event(fact)
        self.visited_poses.take(record)
        for key in self.set_ups.take(record):
            self._drop(key)

    def read(self, record: Record) -> Point:
        """Return the point of a record, superseded or not, as seen from the first set-up."""
        assert isinstance(record.fact, Point)  # noqa: S101 - a record of another kind is none
        return self._carried(record.fact)

    def _carried(self, point: Point) -> Point:
        """Return a point as its tracker would have seen it from the first set-up."""
        key = world_key(point.set_up)
        if not point.set_up or key not in self.frames:
            return point
        seen = carried(point.xyz_mm, point.std_mm, self.matrix("world"), self.matrix(key))
        return msgspec.structs.replace(point, xyz_mm=seen[0], std_mm=seen[1])

    def _carry_nests(self, frame: str, seq: int) -> None:
        """Transform the nests of a later set-up's frame."""
        for key, point in self.points.items():
            if point.set_up and frame == world_key(point.set_up):
                self.points[key] = self._carried(point)
                self.changed[key] = seq

    def _drop(self, key: str) -> None:
        """Remove an invalid point; the journal keeps it."""
        self.streams.pop(key, None)
        self.retakes.pop(key, None)
        self.repeated.pop(key, None)
        point = self.points.pop(key, None)
        if point is None:
            return
        del self._keys[point.id.kind][key], self.changed[key]
        self.celsius.pop(key, None)
        if point.id.kind == "touch":
            self.frames.pop(f"touch.{point.station}", None)

    def _take_point(self, point: Point, seq: int) -> None:
        if point.id.kind == "validate" and point.key in self.points:
            self.repeated.setdefault(point.key, []).append(self.points[point.key])
        self._keys.setdefault(point.id.kind, {})[point.key] = seq
        self.changed[point.key] = seq
        if point.temperature_c is None:
            self.celsius.pop(point.key, None)
        else:
            self.celsius[point.key] = point.temperature_c
        self.points[point.key] = point
        self.retakes.pop(point.key, None)

    def _take_event(self, event: events.Event | events.OtherEvent) -> None:
        match event:
            case events.RemeasureRequested():
                self.retakes[event.key] = None
            case events.RemeasureRefused():
                self.retakes.pop(event.key, None)
            case events.StationHeld():
                self.order = None
            case events.LinkCounted():  # each session counts from its connect
                self.link = event if self.link is None else self.link.followed_by(event)
            case events.Connected():
                self.assets = event.devices
                if any(asset.simulated for asset in self.assets):
                    # Independent of the cell file.
                    self.plan = msgspec.structs.replace(self.inputs, simulated=True)
            case events.StreamRecorded():
                self.streams[event.key] = event
            case events.CurveMeasured():
                self.curves[event.axis] = event
            case events.ReflectorPlaced():
                self.seated, self.sights[event.place] = event.place, event

    def _take_state(self, record: Record, change: StateChanged, before: Record | None) -> None:
        if change.machine == "calibration":
            self.calibration = typed(change.to, CalibrationState)
            return
        if change.to == "checking" and self.life and not self.over and before is not None:
            self.cut_off.append(CutOff(before, self.state, len(self.points), self.began))
        self.state = typed(change.to, RunState)
        self.life.append(Change(record.seq, record.t, change))
        if self.state in ("checking", *WAITING):
            self.order = None
        if self.state == "checking":
            self.session, self.began = self.session + 1, record.seq
            self.end, self.fault, self.moved = None, "", False
        if self.state == "faulted" and not self.fault:
            self.fault = change.reason

    def once(self, compute: Callable[[Log, *Args], T], *args: *Args) -> T:
        """Return ``compute(log, *args)``, cached until the next record."""
        return self._cached(self.version, compute, *args)

    def once_measured(self, compute: Callable[[Log, *Args], T], *args: *Args) -> T:
        """Return ``compute(log, *args)``, cached until the next point, frame or event: it must not
        read motions, states or verdicts.
        """
        return self._cached(self.measured_version, compute, *args)

    def _cached(self, version: int, compute: Callable[[Log, *Args], T], *args: *Args) -> T:
        known = self._computed.get((compute, args))
        if known is None or known[0] != version:
            known = self._computed[compute, args] = (version, compute(self, *args))
        value: T = known[1]
        return value

    def verdict(self, kind: type[V], key: str = "") -> V | None:
        """Return the verdict of a type, by the first of its keys or ``key``; None before it."""
        found = self.verdicts.get(key or kind.keys[0])
        return found if isinstance(found, kind) else None

    @property
    def method(self) -> str:
        """The chosen error model, "" before."""
        fitted = self.verdict(Fitted)
        return "" if fitted is None else fitted.method

    def frame(self, kind: type[F], key: str) -> F:
        """Return a frame of a type; raises `KeyError` before it."""
        found = self.frames[key]
        if not isinstance(found, kind):
            raise KeyError(f"{key} is no {kind.__name__}")
        return found

    def happened(self, kind: type[E]) -> list[E]:
        """Return the events of a type in their order."""
        return [record.fact for record in self.events if isinstance(record.fact, kind)]

    @property
    def taken(self) -> dict[str, events.PlaceTaken]:
        """Return the places that an operator has taken, the newest of each nest."""
        return {event.place: event for event in self.happened(events.PlaceTaken)}

    @property
    def states(self) -> dict[str, str]:
        return {"run": self.state, "calibration": self.calibration}

    @property
    def result(self) -> Json:
        """Return the result of the last session; {} before its end."""
        return {} if self.end is None else self.end.result

    @property
    def over(self) -> bool:
        """Whether the last session has ended without a crash."""
        return self.state in OVER

    @property
    def by_factory_links(self) -> bool:
        """Whether the controller uses the maker's measured link lengths of this arm."""
        return bool(self.happened(events.FactoryLinks))

    @property
    def calibrates(self) -> bool:
        """Whether the run wrote a calibration file."""
        return self.state == "finished" and self.facts.kind != ""

    @property
    def facts(self) -> CalibrationFacts:
        return facts_of(self.verdicts)

    @property
    def outcome_text(self) -> str:
        """Return the run's outcome as in the list of runs; "" without an end."""
        code = None if self.end is None else self.end.exit
        return outcome(self.facts, self.state, code, len(self.points))

    @property
    def outcome(self) -> Outcome | None:
        """Return the outcome; None where nothing was judged and no check failed."""
        facts = self.facts
        if self.end is not None and self.end.exit and facts.verdict in ("", Outcome.ACCEPTED.text):
            return Outcome.REJECTED
        return facts.outcome

    @property
    def cell(self) -> Cell:
        if self._cell is None:
            self._cell = convert(self.inputs.cell, Cell, "the journal's cell")
        return self._cell

    @property
    def inputs(self) -> PlanRecord:
        """Return the frozen inputs; raises `NeverBegan`."""
        if self.plan is None:
            raise NeverBegan("the journal holds no plan: the run died before its first record")
        return self.plan

    def find(self, id: PointId) -> Point | None:
        return self.points.get(id.key)

    def point(self, id: PointId) -> Point:
        return self.points[id.key]

    def select(
        self,
        kind: str,
        station: str = "",
        *,
        how: str = "",
        direction: str = "",
        axis: int | None = None,
        place: int | None = None,
        seat: int | None = None,
    ) -> list[Point]:
        """Return the points of a kind that match all given values, in the order of their keys.

        ``seat`` is that of a further reflector on the flange; None is the tool point.
        """

        def agrees(point: Point) -> bool:
            return (
                station in ("", point.station)
                and how in ("", point.id.how)
                and direction in ("", point.id.direction)
                and axis in (None, point.id.axis)
                and place in (None, point.id.place)
                and seat == point.id.seat
            )

        points = (self.points[key] for key in sorted(self._keys.get(kind, ())))
        return [point for point in points if agrees(point)]

    def measured(self, kind: str) -> Iterator[Point]:
        """Yield the tool points of a kind in the order in which they were first measured."""
        points = (self.points[key] for key in self._keys.get(kind, ()))
        return (point for point in points if point.id.seat is None)

    def recorded(self, point: Point) -> int:
        return self._keys[point.id.kind][point.key]

    def last_recorded(self, besides: Collection[str]) -> int:
        """Return the number of the last point's record, of other kinds than ``besides``."""
        kinds = (keys for kind, keys in self._keys.items() if kind not in besides)
        return max(chain.from_iterable(keys.values() for keys in kinds))

    @property
    def counted(self) -> int:
        """Return the number of points as in plans: without control points."""
        return sum(point.id.group != CONTROL for point in self.points.values())

    @property
    def was_connected(self) -> bool:
        connected = (each.seq for each in self.events if isinstance(each.fact, events.Connected))
        return max(connected, default=0) > self.began

    def temperatures_c(self) -> list[float]:
        """Return the air temperature of every point; none without a weather station."""
        return [*self.celsius.values()]

    def matrix(self, frame: str) -> Array:
        """Return a frame's homogeneous matrix (4, 4)."""
        return self.frames[frame].T


class Records(Protocol):
    """Takes the records of a run; ``path`` is in the folder of its streams."""

    log: Log
    path: Path

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        """Store one record, apply it to the log and return it; raises `NotFinite`."""


class RunJournal(Journal):
    """The journal of a run, open for writing, with its log up to date."""

    def __init__(self, path: Path, run: str, *, create: bool, again: str = "") -> None:
        self.log = Log()
        super().__init__(path, run, create=create, again=again)

    def _take(self, record: Record) -> None:
        self.log.take(record)
        super()._take(record)


def positions_mm(points: Iterable[Point]) -> Array:
    """Return the raw positions (N, 3) in the tracker's frame."""
    return np.array([point.xyz_mm for point in points]).reshape(-1, 3)


def repeated_visits(log: Log) -> list[list[Point]]:
    """Return the visits of each repeated place; on a quick plan its re-visit is one of them."""
    places: dict[int | None, list[Point]] = {}
    for point in log.select("repeatability"):
        places.setdefault(point.id.place, []).append(point)
    for point in log.select("revisit") if places and log.cell.plan.quick else ():
        for points in places.values():
            if point.commanded_deg == points[0].commanded_deg:
                points.append(point)
    return [points for points in places.values() if len(points) > 1]


def commanded_rad(points: Iterable[Point]) -> Array:
    """Return the commanded joints (N, 6)."""
    commanded_deg: Array = np.array([point.commanded_deg for point in points], dtype=float)
    return np.radians(commanded_deg).reshape(-1, 6)


def variances_mm2(points: Sequence[Point]) -> Array:
    """Return the variances (N, 3) of the averaged readings, axes of the tracker's frame."""
    std_mm: Array = np.array([p.std_mm for p in points], dtype=float).reshape(-1, 3)
    return reading_variances_mm2(std_mm, [p.samples for p in points])


def covariances_mm2(points: Sequence[Point], R: Array) -> Array:
    """Return the covariances (N, 3, 3) of the averaged readings, rotated by ``R`` (3, 3)."""
    rotated: Array = np.einsum("ij,nj,kj->nik", R, variances_mm2(points), R)
    return rotated


def of_measured(compute: Callable[[Log, *Args], T]) -> Callable[[Log, *Args], T]:
    """Cache a function of a log's measurements by `Log.once_measured`."""

    @wraps(compute)
    def cached(log: Log, *args: *Args) -> T:
        return log.once_measured(compute, *args)

    return cached


@of_measured
def run_noise(log: Log) -> BeamNoise:
    """Return the noise of readings from the standard deviations of all points of a run."""
    points = list(log.points.values())
    std_mm = [point.std_mm for point in points]
    return beam_noise(positions_mm(points), std_mm, [point.samples for point in points])


def noise_at(noise: BeamNoise, points: Sequence[Point]) -> Array:
    """Return the covariances (N, 3, 3) of points' averaged readings, the tracker's axes."""
    return noise.at(positions_mm(points), [point.samples for point in points])
