"""The checker: the invariants and their rules over the records of a journal, in sequence.

The result has the number of checks of each invariant and its violations.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np

from hilcell.decoding import Json, typed
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import beam_noise, coverage_factor
from hilcell.identity import Identity, changed_asset_kinds
from hilcell.journal.journal import RESTORE_ADVICE, Record, StorageError
from hilcell.journal.log import UNWATCHED_STATES, VERIFICATION_KINDS
from hilcell.model import events
from hilcell.model.frame import Frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import CHECKS, SEAT, Point, Readings
from hilcell.model.records import OVER, WAITING, Ended, Intended, SeenBefore, StateChanged
from hilcell.model.verdicts import Verdict

FUTURE_S = -0.001  # two readings of one clock
NO_READING = SeenBefore(taken_s=math.nan, age_s=math.nan, still=False)  # admits nothing

# The list; comments elsewhere cite its names.
INVARIANTS = {
    "I1": "the slide gets power only with the robot at rest at its safe pose, by a young reading",
    "I2": "the robot moves only with the slide at rest, held, and the strip at the station",
    "I3": "nothing is measured while slide or robot moves or settles",
    "I4": "a measurement is newer than the motion before it, and carries what it was made with",
    "I5": "nothing moves while the run waits or has ended",
    "I6": "the first reason of a fault is kept",
    "I7": "the devices are closed once, in bounded time",
    "I8": "no acknowledged point is lost, none is counted twice",
    "I9": "a resumed run repeats nothing acknowledged, and verifies station and tracker first",
    "I10": "a frame or a result uses only valid points of known set-ups of the tracker",
    "I11": "motions are ordered by the engine that holds the run",
    "I12": "every end leaves slide and robot held",
    "I13": "a lost screen never makes a run go on",
    "I14": "no reading beyond its greatest age is used",
    "I15": "{W} is framed at one set-up, and proven at the tracker's uncertainty",
    "I16": "the tracker is proven at each step's end, and before anything follows a pause",
    "I17": "what did not hold is not passed on as if it did",
    "I18": "who answers after a resume answered before, or it was accepted",
}


class Violation(NamedTuple):
    """A record that breaks an invariant."""

    seq: int
    what: str


@dataclass(slots=True)
class InvariantResult:
    """``inconclusive`` are records of which a device could not report its state."""

    checked: int = 0
    broken: list[Violation] = field(default_factory=list)
    inconclusive: list[Violation] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        return not self.broken

    def count(self, seq: int, holds: bool | None, what: str) -> None:
        """Count one check; None is inconclusive."""
        self.checked += holds is not None
        if not holds:
            (self.inconclusive if holds is None else self.broken).append(Violation(seq, what))


def check_invariants(records: Iterable[Record]) -> dict[str, InvariantResult]:
    """Return the result of each invariant, I1 to I18; raises `StorageError`."""
    results, checker = {name: InvariantResult() for name in INVARIANTS}, Checker()
    for record in records:
        try:
            for invariant, holds, what in checker.checks(record):
                results[invariant].count(record.seq, holds, what)
            checker.take(record)
        except (msgspec.ValidationError, KeyError, TypeError, AttributeError) as error:
            raise StorageError(
                f"record {record.seq} ({record.kind} {record.key or '-'}) is damaged: {error}; "
                f"{RESTORE_ADVICE}",
                code="HC-J02",
            ) from error
    return results


# -- the run by its records so far ----------------------------------------------------------------


class _Station(msgspec.Struct, frozen=True):
    name: str
    strip_mm: float


class _Rail(msgspec.Struct, frozen=True):
    strip_tolerance_mm: float = 0.01


class _Robot(msgspec.Struct, frozen=True):
    safe_deg: tuple[float, ...] = ()


class _Settle(msgspec.Struct, frozen=True):
    robot_s: float = 1.0
    robot_least_s: float = math.inf  # on a quick plan
    rail_least_s: float = math.inf
    rail_s: float = 2.0
    reading_age_s: float = 0.5  # at most


class _Plan(msgspec.Struct, frozen=True):
    quick: bool = False


class _Layout(msgspec.Struct, frozen=True):
    reflectors: str = "mounted"


class _Uncertainty(msgspec.Struct, frozen=True):
    drift_limit_mm: float = 0.02  # of the tracker's frame


class CellFacts(msgspec.Struct, frozen=True):
    """The fields of the frozen cell that the rules need."""

    station: list[_Station] = []
    rail: _Rail = _Rail()
    robot: _Robot = _Robot()
    settle: _Settle = _Settle()
    plan: _Plan = _Plan()
    layout: _Layout = _Layout()
    uncertainty: _Uncertainty = _Uncertainty()
    simulation: Json | None = None

    @property
    def rests_s(self) -> tuple[float, float]:
        """Return the shortest rests of robot and slide before a measurement."""
        settle = self.settle
        if not self.plan.quick:
            return settle.robot_s, settle.rail_s
        return min(settle.robot_s, settle.robot_least_s), min(settle.rail_s, settle.rail_least_s)


@dataclass(slots=True)
class RecordedRun:
    """``points`` are the valid ones, ``unverified`` those since the tracker's last verification."""

    seq: int = 0
    cell: CellFacts = field(default_factory=CellFacts)  # as it was frozen
    time_factor: float = 1.0  # by which the PC's time is shorter than the cell's
    state: str = "idle"
    session: int = 0
    held: str = ""  # the station at which the slide was reported held in this session
    last: Intended | None = None  # motion of this session
    last_key: str = ""
    rail_moved: bool = False  # in this session
    robot_moved: bool = False
    points: dict[str, Point] = field(default_factory=dict)
    dropped: dict[str, Point] = field(default_factory=dict)
    again: set[str] = field(default_factory=set)
    set_up: int = 0
    framed: set[int] = field(default_factory=set)  # set-ups with a {W}
    control: dict[str, Point] = field(default_factory=dict)  # by nest, since the last verification
    unverified: dict[str, int] = field(default_factory=dict)  # the session that added each
    verified: bool = False  # in this session, or {W} framed
    interrupted: bool = False  # the tracker may have been bumped since
    verdicts: dict[str, bool] = field(default_factory=dict)  # by key, whether they pass
    closings: list[events.Closed] = field(default_factory=list)  # of this session
    reason: str = ""  # the first of this session's fault
    over: bool = False  # this session; a refused resume has an end, too
    devices: list[Identity] = field(default_factory=list)  # that answered last
    hilcell: str = ""  # that connected them
    accepted: bool = False  # changes since then

    @property
    def waits(self) -> bool:
        """Whether nothing may move: no session in progress, or waiting for the operator."""
        return self.state in ("idle", *OVER, *WAITING)

    def station(self, name: str) -> _Station | None:
        return next((each for each in self.cell.station if each.name == name), None)

    def take(self, record: Record) -> None:
        self.seq = record.seq
        match record.fact:
            case StateChanged(machine="run") as life:
                self._take_state(life)
            case events.Event() | events.OtherEvent() as event:
                self._take_event(event)
            case PlanRecord() as plan:
                self._take_plan(plan)
            case Intended() as motion:
                self._take_motion(record.key, motion)
            case Point() as point:
                self._take_point(record.key, point)
            case Frame() if is_world(record.key):
                self.framed.add(set_up_of(record.key))
                self._verified()
            case Verdict(holds=holds):
                self.verdicts[record.key] = holds
            case Ended() as end:
                if end.state == "faulted" and not self.over:
                    self.reason = self.reason or end.reason
                self.over = True

    def _take_plan(self, plan: PlanRecord) -> None:
        self.cell = typed(plan.cell, CellFacts)
        if self.cell.simulation is not None:
            self.time_factor = math.inf if plan.speed is None else plan.speed

    def _take_motion(self, key: str, motion: Intended) -> None:
        self.last, self.last_key = motion, key
        if of_rail(motion):
            self.held, self.rail_moved = "", True
        else:
            self.robot_moved = True

    def _take_state(self, life: StateChanged) -> None:
        self.state = life.to
        self.interrupted |= life.to in UNWATCHED_STATES
        if life.to == "checking":
            self.session, self.verified = self.session + 1, False
            self.held, self.last, self.last_key = "", None, ""
            self.rail_moved = self.robot_moved = False
            self.closings, self.reason, self.over = [], "", False
        if life.to == "faulted":
            self.reason = self.reason or life.reason

    def _take_point(self, key: str, point: Point) -> None:
        self.points[key] = point
        self.again.discard(key)
        if key.startswith("control/"):
            self.control[nest_of(key)] = point
        elif not is_verification(key):
            self.unverified[key] = self.session

    def _take_event(self, event: events.Event | events.OtherEvent) -> None:
        self.accepted |= isinstance(event, events.ChangesAccepted)
        match event:
            case events.StationHeld() | events.StationAlreadyHeld():
                self.held = event.station
            case (
                events.RemeasureRequested() | events.OutlierRemeasured() | events.VisitedOnceMore()
            ):
                self.again.add(event.key)
            case events.StreamRecorded():
                self.unverified[event.key] = self.session
            case events.TrackerVerified():
                self._verified()
            case events.TrackerMoved():
                self.set_up = event.set_up
                self._drop(event.invalid)
            case events.WorldRemeasured():
                self._drop(event.invalid)
            case events.SafeStopSent():
                self.reason = self.reason or event.cause
            case events.Closed():
                self.closings.append(event)
            case events.Connected():
                self.devices, self.hilcell = event.devices, event.hilcell
                self.accepted = False

    def _drop(self, keys: list[str]) -> None:
        for key in keys:
            self.unverified.pop(key, None)
            if key in self.points:
                self.dropped[key] = self.points.pop(key)

    def _verified(self) -> None:
        self.unverified.clear()
        self.control.clear()
        self.interrupted, self.verified = False, True


def of_rail(motion: Intended) -> bool:
    return motion.action.startswith("rail.")


def is_world(frame: str) -> bool:
    """Whether a frame is the {W} of one of the tracker's set-ups."""
    return frame.partition(".")[0] == "world"


def set_up_of(frame: str) -> int:
    number = frame.partition(".")[2]
    return int(number) if number.isdecimal() else 0


def is_verification(key: str) -> bool:
    """Whether a point frames {W}, verifies the tracker, or is a mere check."""
    return key.partition("/")[0] in (*VERIFICATION_KINDS, *CHECKS)


def pose_key(key: str) -> str:
    """Return a key without its reflector: all reflectors of a pose are measured together."""
    pose, _, seat = key.rpartition("/")
    return pose if seat.startswith(SEAT) and seat.removeprefix(SEAT).isdecimal() else key


def nest_of(key: str) -> str:
    return key.rpartition("/")[2]


# -- the rules ------------------------------------------------------------------------------------

# The invariant, whether it holds (None: inconclusive), and what is wrong if not.
Check: TypeAlias = tuple[str, bool | None, str]


class Checker(RecordedRun):
    """Checks each record against the records before it, which `take` applies."""

    def checks(self, record: Record) -> Iterator[Check]:
        """Yield the checks of a record, before it is taken."""
        yield "I8", record.seq == self.seq + 1, f"record {self.seq} came before"
        match record.fact:
            case Intended() as motion:
                yield from self._motion(record.key, motion)
            case Point() as point:
                yield from self._point(record, point)
            case Frame() as frame:
                yield from self._frame(record.key, frame)
            case StateChanged(machine="run") as life:
                yield from self._life(life)
            case Ended() as end:
                yield from self._end(end)
            case events.Event() as event:
                yield from self._event(record.seq, event)

    def _event(self, seq: int, event: events.Event) -> Iterator[Check]:
        match event:
            case events.StationHeld(began=events.ReadingTime(age_s=age_s)):
                yield self._young("the motion before began", age_s)
            case events.StreamRecorded(key=key):
                yield from self._followed(key)
            case events.SlideJogged(key=key):
                ordered = self.last is not None and self.last.action == "rail.jog"
                yield "I1", ordered, f"{key}: the slide was jogged by no admitted motion"
            case events.StepBegun(name=name):
                here = [key for key, session in self.unverified.items() if session == self.session]
                yield from self._closed(f"step {name}", here)
            case events.TrackerVerified():
                yield from self._verification()
            case events.TrackerMoved(invalid=invalid):
                kept = sorted(self.unverified.keys() - set(invalid))
                yield "I10", not kept, f"kept {', '.join(kept)} of a tracker that had moved"
            case events.Closed(took_s=took_s):
                yield "I7", 0.0 <= took_s <= 15.0, f"the teardown took {took_s:.1f} s, at most 15 s"
            case events.AlarmsAcknowledged(until=until):
                unseen = f"alarms up to record {until} were acknowledged before it was written"
                yield "I17", until < seq, unseen
            case events.Connected() if self.devices:
                yield self._identities(event)

    # -- motions --------------------------------------------------------------------------------

    def _motion(self, key: str, motion: Intended) -> Iterator[Check]:
        action, seen = motion.action, motion.seen or NO_READING
        yield "I5", not self.waits, f"{action} begun while {self.state}"
        found = f"{action} ordered by session {motion.session}, {self.session} holds the run"
        yield "I11", motion.session == self.session, found
        if of_rail(motion):
            last = self.last
            parked = last is None or of_rail(last) or last.action == "robot.park"
            yield "I1", parked, f"{action}: the robot was not parked before"
        elif key and key in self.points:
            yield "I9", key in self.again, f"{key} is acknowledged, and is driven to again"
        yield self._young(action, seen.age_s)
        if of_rail(motion):
            wrong = self._not_parked(seen)
            yield "I1", not wrong, f"{action}: {wrong}"
        else:
            wrong = self._not_held(seen)
            yield "I2", not wrong, f"{action} {key}: {wrong}"

    def _young(self, motion: str, age_s: float) -> Check:
        limit_s = self.cell.settle.reading_age_s
        what = f"{motion} by a reading {age_s:.3f} s old, at most {limit_s:g} s"
        return "I14", FUTURE_S <= age_s <= limit_s, what

    def _not_parked(self, seen: SeenBefore) -> str:
        """Return why a reading does not show the robot parked and at rest, else ""."""
        safe_deg = self.cell.robot.safe_deg
        pairs = zip(seen.joints_deg, safe_deg, strict=False)
        off_deg = max((abs(found - safe) for found, safe in pairs), default=math.nan)
        if len(seen.joints_deg) != len(safe_deg) or not off_deg <= 0.1:
            return f"the robot was {off_deg:.2f} deg off its safe pose"
        return self._before_end(seen) if seen.still else "the robot was moving"

    def _not_held(self, seen: SeenBefore) -> str:
        """Return why a reading does not show the slide at rest and held, else ""."""
        if not seen.still:
            return "the slide was moving"
        if seen.powered is not False:
            return "the drive had power to move"
        found_mm = math.nan if seen.strip_mm is None else seen.strip_mm
        limit_mm, station = 2 * self.cell.rail.strip_tolerance_mm, self.station(self.held)
        if station is not None and not abs(found_mm - station.strip_mm) <= limit_mm + 1e-9:
            wanted = f"{station.strip_mm:.2f} +-{limit_mm:.2f} mm"
            return f"strip {found_mm:.2f} mm, the station {wanted}"
        return self._before_end(seen)

    @staticmethod
    def _before_end(seen: SeenBefore) -> str:
        """Return that a reading was taken before the end of the motion, else ""."""
        after = seen.ended_s is None or seen.taken_s >= seen.ended_s
        return "" if after else "the reading was taken before the motion had ended"

    # -- points -------------------------------------------------------------------------------

    def _point(self, record: Record, point: Point) -> Iterator[Check]:
        key, readings = record.key, point.readings
        if readings is not None and readings.began is not None:
            yield self._young("the motion before began", readings.began.age_s)
        yield "I3", not self.waits, f"{key} measured while {self.state}"
        yield "I8", key not in self.points or point.retaken, f"{key} counted twice"
        found = f"{key} measured by session {point.session}, {self.session} holds the run"
        yield "I11", point.session == self.session, found
        yield from self._carries(record, point)
        if point.station:
            yield from self._at_station(key, point)
        if readings is not None:
            yield from self._times(key, readings)
        if self.session > 1 and self.framed and not is_verification(key):
            yield "I9", self.verified, f"{key} added before the tracker was verified"
        what = f"{key} is of set-up {point.set_up}, the tracker at {self.set_up}"
        yield "I15", point.set_up == self.set_up, what
        if not is_verification(key):
            yield from self._followed(key)

    def _carries(self, record: Record, point: Point) -> Iterator[Check]:
        missing = [] if "temperature_c" in record.body else ["temperature_c"]  # null: not measured
        missing += ["readings"] if point.readings is None else []
        if point.station and point.commanded_deg and point.smr_mm is None:
            missing.append("smr_mm")
        yield "I4", not missing, f"{record.key} lacks {', '.join(missing)}"
        if point.commanded_deg and point.group != "campaign":
            last = self.last_key or "none"
            here = pose_key(last) == pose_key(record.key)
            yield "I4", here, f"{record.key}: the last motion: {last}"

    def _at_station(self, key: str, point: Point) -> Iterator[Check]:
        name = point.station
        what = f"{key}: {name} was not found held since the run resumed"
        yield "I9" if self.session > 1 else "I2", self.held == name, what
        station = self.station(name)
        wanted_mm = math.nan if station is None else station.strip_mm
        limit_mm = 2 * self.cell.rail.strip_tolerance_mm
        strip_mm = math.nan if point.strip_mm is None else point.strip_mm
        held = abs(strip_mm - wanted_mm) <= limit_mm + 1e-9
        yield "I2", held, f"{key}: strip {strip_mm:.2f} mm at {name}"

    def _times(self, key: str, readings: Readings) -> Iterator[Check]:
        taken_s, (robot_s, rail_s) = readings.tracker.taken_s, self.cell.rests_s
        axes = [("slide", readings.rail, self.rail_moved, rail_s)]
        if readings.robot is not None:
            axes.append(("robot", readings.robot, self.robot_moved, robot_s))
        for name, reading, moved, rest_s in axes:
            if moved:
                rested_s = math.nan if reading.ended_s is None else taken_s - reading.ended_s
                wanted_s = rest_s / self.time_factor
                what = f"{rested_s:.3f} s after the {name}'s motion, expected {wanted_s:g} s"
                yield "I3", rested_s >= wanted_s, f"{key}: {what}"
                yield "I4", rested_s >= 0.0, f"{key}: older than the {name}'s motion"
        yield "I14", readings.rail.taken_s >= taken_s, f"{key}: the rail was not read after it"
        read = (readings.tracker, readings.rail, readings.robot)
        ages = [each.age_s for each in read if each is not None]
        known = all(FUTURE_S <= age_s < math.inf for age_s in ages)
        yield "I14", known, f"{key}: readings {ages} s old"

    # -- set-ups and verifications of the tracker ---------------------------------------------

    @property
    def _mounted(self) -> bool:
        """Whether all nests have reflectors; a carried one verifies the tracker less often."""
        return self.cell.layout.reflectors == "mounted"

    def _followed(self, key: str) -> Iterator[Check]:
        """Check that the tracker is verified first after a pause."""
        if self._mounted and self.framed and self.state != "checking":
            what = f"{key} added before the tracker was proven after a pause"
            yield "I16", not self.interrupted, what

    def _closed(self, before: str, unverified: list[str]) -> Iterator[Check]:
        """Check that nothing is unverified before the next step, or before the end."""
        if self._mounted and self.framed:
            what = f"{len(unverified)} points unproven before {before}: {', '.join(unverified[:3])}"
            yield "I16", not unverified, what

    def _frame(self, key: str, frame: Frame) -> Iterator[Check]:
        if is_world(key):
            yield from self._world(key)
        if not frame.points:
            return
        lost = [each for each in frame.points if each not in self.points]
        yield "I10", not lost, f"{key} is built of {', '.join(lost[:3])}, not valid"
        of = {self.points[each].set_up for each in frame.points if each in self.points}
        what = f"{key} is built of points of set-ups {sorted(of)}, {{W}} known of "
        what += f"{sorted(self.framed)}"
        known = of == {set_up_of(key)} if is_world(key) else of <= self.framed
        yield "I15" if is_world(key) else "I10", known, what

    def _world(self, key: str) -> Iterator[Check]:
        """Check a {W}: from nests at its own set-up, unmoved since the first."""
        number = set_up_of(key)
        before, now = self._nests(0), self._nests(number)
        what = f"{key} framed at set-up {self.set_up} by {len(now)} nests"
        yield "I15", number == self.set_up and len(now) >= 3, what
        for one, other in combinations(sorted(before.keys() & now.keys()), 2) if number else ():
            four = (before[one], before[other], now[one], now[other])
            then, there, here, away = (point.xyz_mm for point in four)
            off_mm = abs(math.dist(here, away) - math.dist(then, there))
            limit_mm = self._limit_mm(*four)
            what = f"{key}: {one} to {other} changed by {off_mm:.3f} mm, at most {limit_mm:.3f}"
            yield "I15", off_mm <= limit_mm, what

    def _verification(self) -> Iterator[Check]:
        """Check a verification by its points: no nest has moved since {W} was framed."""
        before, now = self._nests(self.set_up), self.control
        yield "I15", bool(before) and before.keys() == now.keys(), "nests missing"
        for nest in before.keys() & now.keys():
            off_mm = math.dist(before[nest].xyz_mm, now[nest].xyz_mm)
            limit_mm = self._limit_mm(before[nest], now[nest])
            what = f"proven with {nest} {off_mm:.3f} mm off, at most {limit_mm:.3f} mm"
            yield "I15", off_mm <= limit_mm, what

    def _nests(self, set_up: int) -> dict[str, Point]:
        """Return the points of which {W} was framed at a set-up, by nest."""
        return {
            nest_of(key): point
            for key, point in self.points.items()
            if key.startswith("world/") and point.set_up == set_up
        }

    def _limit_mm(self, *points: Point) -> float:
        """Return the limit of differences of points: stated drift and the noise of all points so
        far, at these positions.
        """
        found = [point for point in self.points.values() if self._finite(point)]
        if not all(self._finite(point) for point in points):
            return math.nan
        noise = beam_noise(*self._columns(found or points))
        at_mm, _, samples = self._columns(points)
        noise_mm2 = float(np.trace(noise.at(at_mm, samples), axis1=-2, axis2=-1).sum())
        drift_mm = math.sqrt(3.0) * self.cell.uncertainty.drift_limit_mm
        return drift_mm + coverage_factor(4.0, noise.freedom) * math.sqrt(noise_mm2)

    @staticmethod
    def _finite(point: Point) -> bool:
        """Whether position and scatter of a point are finite."""
        return all(map(math.isfinite, (*point.xyz_mm, *point.std_mm))) and point.samples >= 1

    @staticmethod
    def _columns(points: Sequence[Point]) -> tuple[Array, Array, Array]:
        """Return positions (N, 3), standard deviations (N, 3) and numbers of samples (N,)."""
        rows = [(point.xyz_mm, point.std_mm, point.samples) for point in points]
        at_mm, std_mm, samples = zip(*rows, strict=True)
        return np.array(at_mm), np.array(std_mm), np.array(samples, dtype=float)

    # -- states, teardowns and ends -----------------------------------------------------------

    def _life(self, life: StateChanged) -> Iterator[Check]:
        state = self.state
        yield "I9", life.before == state, f"state was {state}, not {life.before}"
        if life.to == "running" and state in WAITING:
            # "look" is of an unattended run, after a failed reading.
            may = ("command",) if state == "paused" else ("command", "answer", "look")
            yield "I13", life.by in may, f"{state} went on by {life.by or 'nobody'}"
        if life.to in OVER:
            count = len(self.closings)
            yield "I7", count == 1, f"teardown ran {count} times"
            yield from self._held(life.to)
        if life.to == "faulted":
            yield self._first_reason(life.reason)
        if life.to == "finished":
            yield from self._closed("the run's end", list(self.unverified))

    def _held(self, to: str) -> Iterator[Check]:
        """Check that slide and robot were left held; inconclusive if a device failed and the run
        ended with a fault.
        """
        problems = self.closings[-1].problems if self.closings else {}
        for device in ("Rail", "Robot"):
            problem = problems.get(device, "")
            if problem and to == "faulted":
                yield "I12", None, f"{device}: {problem}"
            else:
                what = f"{device}: {problem or 'it was not closed'}"
                yield "I12", bool(self.closings) and not problem, what

    def _first_reason(self, reason: str) -> Check:
        first = self.reason or reason
        kept = f"the reason became {reason!r}, first it was {first!r}"
        return "I6", bool(reason) and reason == first, kept

    def _end(self, end: Ended) -> Iterator[Check]:
        if end.state == "faulted" and not self.over:
            yield self._first_reason(end.reason)
        if end.state == "finished":
            failed = sorted(key for key, holds in self.verdicts.items() if not holds)
            what = f"exit {end.exit}, and {', '.join(failed)} does not hold"
            yield "I17", not (failed and end.exit == 0), what
            if isinstance(counts := end.result.get("points"), dict):
                yield from self._counts(counts)

    def _counts(self, counts: dict[str, int]) -> Iterator[Check]:
        """Check that the result counts each valid point once."""
        valid = Counter(point.group for point in self.points.values())
        dropped = {point.group for point in self.dropped.values()}
        more = sorted(group for group in dropped if counts.get(group, 0) > valid[group])
        yield "I10", not more, f"the result counts points that are not valid: {', '.join(more)}"
        wrong = [g for g in sorted({*valid, *counts}) if counts.get(g, 0) != valid[g]]
        figures = ", ".join(f"{g} {counts.get(g, 0)} of {valid[g]}" for g in wrong)
        yield "I8", not wrong, f"the result counts {figures}"

    def _identities(self, event: events.Connected) -> Check:
        before, now = ({each.kind: each for each in of} for of in (self.devices, event.devices))
        changed = changed_asset_kinds(before, now)
        changed += ["hilcell"] if self.hilcell not in ("", event.hilcell) else []
        what = f"changed, and nobody has accepted it: {', '.join(changed)}"
        return "I18", self.accepted or not changed, what
