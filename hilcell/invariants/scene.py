"""The run as the records so far state it; the rules look at it before a record is added to it.

Of the frozen cell it reads the few settings that the rules need.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import msgspec

from hilcell.journal.journal import Record
from hilcell.journal.set_ups import INTERRUPTED, PROOFS
from hilcell.journal.states import OVER, WAITING
from hilcell.model.events import (
    Event,
    OtherEvent,
    OutlierMeasuredAgain,
    RetakeAsked,
    StationFoundHeld,
    StationHeld,
    StreamRecorded,
    TrackerMoved,
    TrackerProven,
    VisitedOnceMore,
    WorldFramedAgain,
)
from hilcell.model.frame import Frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import CHECKS, SEAT, Point
from hilcell.model.records import Intended, StateChanged
from hilcell.typed import typed


class _Station(msgspec.Struct, frozen=True):
    name: str
    strip_mm: float


class _Rail(msgspec.Struct, frozen=True):
    strip_tolerance_mm: float = 0.01


class _Robot(msgspec.Struct, frozen=True):
    safe_deg: tuple[float, ...] = ()


class _Settle(msgspec.Struct, frozen=True):
    robot_s: float = 1.0
    rail_s: float = 2.0
    reading_age_s: float = 0.5  # at most


class _Layout(msgspec.Struct, frozen=True):
    reflectors: str = "mounted"


class _Uncertainty(msgspec.Struct, frozen=True):
    drift_limit_mm: float = 0.02  # of the tracker's frame


class _Simulation(msgspec.Struct, frozen=True):
    address: str = ""


class CellFacts(msgspec.Struct, frozen=True):
    """The cell as it was frozen, as far as the rules need it."""

    station: list[_Station] = []
    rail: _Rail = _Rail()
    robot: _Robot = _Robot()
    settle: _Settle = _Settle()
    layout: _Layout = _Layout()
    uncertainty: _Uncertainty = _Uncertainty()
    simulation: _Simulation | None = None


@dataclass(slots=True)
class Scene:
    """``points`` are those that count, ``unproven`` those since the tracker's last proof."""

    cell: CellFacts = field(default_factory=CellFacts)  # as it was frozen
    time_factor: float = 1.0  # by which the PC's time is shorter than the cell's
    state: str = "idle"
    session: int = 0
    held: str = ""  # the station at which the slide was reported held in this session
    last: Intended | None = None  # motion of this session, and what it was for
    last_key: str = ""
    rail_moved: bool = False  # in this session
    robot_moved: bool = False
    points: dict[str, Point] = field(default_factory=dict)
    dropped: dict[str, Point] = field(default_factory=dict)
    again: set[str] = field(default_factory=set)
    set_up: int = 0
    framed: set[int] = field(default_factory=set)  # set-ups with a {W}
    control: dict[str, Point] = field(default_factory=dict)  # by nest, since the last proof
    unproven: dict[str, int] = field(default_factory=dict)  # the session that added each
    verified: bool = False  # the tracker was proven, or {W} framed, in this session
    interrupted: bool = False  # nobody may have seen the tracker since its last proof

    @property
    def ended(self) -> bool:
        """Whether no session is under way."""
        return self.state in ("idle", *OVER)

    @property
    def waits(self) -> bool:
        """Whether the run waits for the operator."""
        return self.state in WAITING

    def station(self, name: str) -> _Station | None:
        """Return a station of the cell."""
        return next((each for each in self.cell.station if each.name == name), None)

    def take(self, record: Record) -> None:
        """Add a record."""
        match record.fact:
            case StateChanged(machine="run") as life:
                self._take_state(life)
            case Event() | OtherEvent() as event:
                self._take_event(event)
            case PlanRecord(cell=cell, speed=speed):
                self.cell = typed(cell, CellFacts)
                if self.cell.simulation is not None:
                    self.time_factor = math.inf if speed is None else speed
            case Intended() as motion:
                self.last, self.last_key = motion, record.key
                if of_rail(motion):
                    self.held, self.rail_moved = "", True
                else:
                    self.robot_moved = True
            case Point() as point:
                self._take_point(record.key, point)
            case Frame() if is_world(record.key):
                self.framed.add(set_up_of(record.key))
                self._prove()

    def _take_state(self, life: StateChanged) -> None:
        self.state = life.to
        self.interrupted |= life.to in INTERRUPTED
        if life.to == "checking":
            self.session, self.verified = self.session + 1, False
            self.held, self.last, self.last_key = "", None, ""
            self.rail_moved = self.robot_moved = False

    def _take_point(self, key: str, point: Point) -> None:
        self.points[key] = point
        self.again.discard(key)
        if key.startswith("control/"):
            self.control[nest_of(key)] = point
        elif not is_proof(key):
            self.unproven[key] = self.session

    def _take_event(self, event: Event | OtherEvent) -> None:
        match event:
            case StationHeld() | StationFoundHeld():
                self.held = event.station
            case RetakeAsked() | OutlierMeasuredAgain() | VisitedOnceMore():
                self.again.add(event.key)
            case StreamRecorded():
                self.unproven[event.key] = self.session
            case TrackerProven():
                self._prove()
            case TrackerMoved():
                self.set_up = event.set_up
                self._drop(event.invalid)
            case WorldFramedAgain():
                self._drop(event.invalid)

    def _drop(self, keys: list[str]) -> None:
        for key in keys:
            self.unproven.pop(key, None)
            if key in self.points:
                self.dropped[key] = self.points.pop(key)

    def _prove(self) -> None:
        self.unproven.clear()
        self.control.clear()
        self.interrupted, self.verified = False, True


def of_rail(motion: Intended) -> bool:
    """Whether it is the slide that moves."""
    return motion.action.startswith("rail.")


def is_world(frame: str) -> bool:
    """Whether a frame is the {W} of one of the tracker's set-ups."""
    return frame.partition(".")[0] == "world"


def set_up_of(frame: str) -> int:
    """Return the set-up of a {W}."""
    number = frame.partition(".")[2]
    return int(number) if number.isdecimal() else 0


def is_proof(key: str) -> bool:
    """Whether a point frames {W}, proves the tracker, or is one of which nothing is built."""
    return key.partition("/")[0] in (*PROOFS, *CHECKS)


def pose_of(key: str) -> str:
    """Return a key without its reflector: all of a pose are measured where it stands."""
    pose, _, seat = key.rpartition("/")
    return pose if seat.startswith(SEAT) and seat.removeprefix(SEAT).isdecimal() else key


def nest_of(key: str) -> str:
    """Return the nest of a point of {W} or of a proof."""
    return key.rpartition("/")[2]
