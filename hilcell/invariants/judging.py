"""The checker: the invariants in words, and their rules over the records of a journal, in order.

It says for each how often it was judged, and where it is broken.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.geometry.beam_noise import beam_noise
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import coverage_factor
from hilcell.journal.journal import FETCH, Record, StorageError
from hilcell.journal.log import INTERRUPTED, PROOFS, other_assets
from hilcell.journal.states import OVER, WAITING
from hilcell.model.events import (
    AlarmsAcknowledged,
    Asset,
    ChangesAccepted,
    Closed,
    Connected,
    Event,
    OtherEvent,
    OutlierMeasuredAgain,
    RetakeAsked,
    SafeStopSent,
    StationFoundHeld,
    StationHeld,
    StepBegun,
    StreamRecorded,
    TrackerMoved,
    TrackerProven,
    VisitedOnceMore,
    WorldFramedAgain,
)
from hilcell.model.frame import Frame
from hilcell.model.plan import PlanRecord
from hilcell.model.point import CHECKS, SEAT, Point, Readings
from hilcell.model.records import Ended, Intended, SeenBefore, StateChanged
from hilcell.model.verdicts import Verdict
from hilcell.typed import typed

FUTURE_S = -0.001  # two readings of one clock
NOT_SEEN = SeenBefore(taken_s=math.nan, age_s=math.nan, still=False)  # admits nothing


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


class Break(NamedTuple):
    """A place where an invariant is broken."""

    seq: int
    what: str


@dataclass(slots=True)
class Proof:
    """``unproven`` are places where the journal says that a device could not tell."""

    checked: int = 0
    broken: list[Break] = field(default_factory=list)
    unproven: list[Break] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        return not self.broken


def judge(records: Iterable[Record]) -> dict[str, Proof]:
    """Return the verdict of each invariant, I1 to I18; raises `StorageError`."""
    verdicts, scene = {name: Proof() for name in INVARIANTS}, Scene()
    kinds = (_LifeRules, _Motions, _Measurements, _TrackerSetUps, _Identities)
    rules: list[Rules] = [each(verdicts, scene) for each in kinds]
    for record in records:
        try:
            for each in rules:
                each.take(record)
            scene.take(record)
        except (msgspec.ValidationError, KeyError, TypeError, AttributeError) as error:
            raise StorageError(
                f"record {record.seq} ({record.kind} {record.key or '-'}) is damaged: {error}; "
                f"{FETCH}",
                code="HC-J02",
            ) from error
    return verdicts


# -- the run as the records so far state it: rules look at it before a record is added ------------


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
    return motion.action.startswith("rail.")


def is_world(frame: str) -> bool:
    """Whether a frame is the {W} of one of the tracker's set-ups."""
    return frame.partition(".")[0] == "world"


def set_up_of(frame: str) -> int:
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


# -- the rules ------------------------------------------------------------------------------------


class Rules:
    """Judge each record by what the records before it say."""

    def __init__(self, verdicts: dict[str, Proof], scene: Scene) -> None:
        self._verdicts, self._scene = verdicts, scene

    def take(self, record: Record) -> None:
        raise NotImplementedError

    def _check(self, invariant: str, record: Record, holds: bool, what: str) -> None:
        """Count one check; ``what`` says what is wrong where it does not hold."""
        verdict = self._verdicts[invariant]
        verdict.checked += 1
        if not holds:
            verdict.broken.append(Break(record.seq, what))


class _Motions(Rules):
    """Judges motions by what was known when each was journalled: I1, I2, I5, I11, I14.

    I9 for motions to what is acknowledged.
    """

    def take(self, record: Record) -> None:
        match record.fact:
            case Intended() as motion:
                self._motion(record, motion)
            case StationHeld(began=began) if began is not None:
                self._young(record, "the motion before began", began.age_s)
            case Point(readings=Readings(began=began)) if began is not None:
                self._young(record, "the motion before began", began.age_s)

    def _motion(self, record: Record, motion: Intended) -> None:
        scene = self._scene
        action = motion.action
        allowed = not (scene.ended or scene.waits)
        self._check("I5", record, allowed, f"{action} begun while {scene.state}")
        found = f"{action} ordered by session {motion.session}, {scene.session} holds the run"
        self._check("I11", record, motion.session == scene.session, found)
        if of_rail(motion):
            self._rail(record, motion)
        else:
            self._robot(record, motion)

    def _rail(self, record: Record, motion: Intended) -> None:
        last = self._scene.last
        parked = last is None or of_rail(last) or last.action == "robot.park"
        self._check("I1", record, parked, f"{motion.action}: the robot was not parked before")
        seen = motion.seen or NOT_SEEN
        self._young(record, motion.action, seen.age_s)
        wrong = self._not_parked(seen)
        self._check("I1", record, not wrong, f"{motion.action}: {wrong}")

    def _robot(self, record: Record, motion: Intended) -> None:
        scene, key = self._scene, record.key
        if key and key in scene.points:
            asked = key in scene.again
            self._check("I9", record, asked, f"{key} is acknowledged, and is driven to again")
        seen = motion.seen or NOT_SEEN
        self._young(record, motion.action, seen.age_s)
        wrong = self._not_held(seen)
        self._check("I2", record, not wrong, f"{motion.action} {key}: {wrong}")

    def _young(self, record: Record, motion: str, age_s: float) -> None:
        limit_s = self._scene.cell.settle.reading_age_s
        young = FUTURE_S <= age_s <= limit_s
        what = f"{motion} by a reading {age_s:.3f} s old, at most {limit_s:g} s"
        self._check("I14", record, young, what)

    def _not_parked(self, seen: SeenBefore) -> str:
        """Return why a reading does not say that the robot is parked and at rest, or ""."""
        safe_deg = self._scene.cell.robot.safe_deg
        pairs = zip(seen.joints_deg, safe_deg, strict=False)
        off_deg = max((abs(found - safe) for found, safe in pairs), default=math.nan)
        if len(seen.joints_deg) != len(safe_deg) or not off_deg <= 0.1:
            return f"the robot was {off_deg:.2f} deg off its safe pose"
        return self._before_end(seen) if seen.still else "the robot was moving"

    def _not_held(self, seen: SeenBefore) -> str:
        """Return why a reading does not say that the slide rests and is held; "" where it does."""
        if not seen.still:
            return "the slide was moving"
        if seen.powered is not False:
            return "the drive had power to move"
        scene, found_mm = self._scene, math.nan if seen.strip_mm is None else seen.strip_mm
        limit_mm, station = 2 * scene.cell.rail.strip_tolerance_mm, scene.station(scene.held)
        if station is not None and not abs(found_mm - station.strip_mm) <= limit_mm + 1e-9:
            wanted = f"{station.strip_mm:.2f} +-{limit_mm:.2f} mm"
            return f"strip {found_mm:.2f} mm, the station {wanted}"
        return self._before_end(seen)

    @staticmethod
    def _before_end(seen: SeenBefore) -> str:
        """Return that a reading was taken before the motion had ended; "" where it was not."""
        after = seen.ended_s is None or seen.taken_s >= seen.ended_s
        return "" if after else "the reading was taken before the motion had ended"


class _TrackerSetUps(Rules):
    """Judges what was measured at which set-up, and when the tracker was proven."""

    def take(self, record: Record) -> None:
        scene = self._scene
        match record.fact:
            case Point() as point:
                self._point(record, point)
            case Frame() as frame:
                self._frame(record, frame)
            case StateChanged(machine="run", to="finished"):
                self._closed(record, "the run's end", list(scene.unproven))
            case StepBegun(name=name):
                here = [key for key, session in scene.unproven.items() if session == scene.session]
                self._closed(record, f"step {name}", here)
            case StreamRecorded(key=key):
                self._followed(record, key)
            case TrackerProven():
                self._proof(record)
            case TrackerMoved(invalid=invalid):
                kept = sorted(scene.unproven.keys() - set(invalid))
                what = f"kept {', '.join(kept)} of a tracker that had moved"
                self._check("I10", record, not kept, what)

    def _point(self, record: Record, point: Point) -> None:
        scene = self._scene
        what = f"{record.key} is of set-up {point.set_up}, the tracker at {scene.set_up}"
        self._check("I15", record, point.set_up == scene.set_up, what)
        if not is_proof(record.key):
            self._followed(record, record.key)

    def _followed(self, record: Record, key: str) -> None:
        """Judge what is added: after a pause the tracker comes first."""
        scene = self._scene
        if self._mounted and scene.framed and scene.state != "checking":
            what = f"{key} added before the tracker was proven after a pause"
            self._check("I16", record, not scene.interrupted, what)

    def _closed(self, record: Record, before: str, unproven: list[str]) -> None:
        """Judge the end of what was measured before a step, or before the end.

        A step that an earlier session has begun goes on, and is proven first.
        """
        if self._mounted and self._scene.framed:
            what = f"{len(unproven)} points unproven before {before}: {', '.join(unproven[:3])}"
            self._check("I16", record, not unproven, what)

    @property
    def _mounted(self) -> bool:
        """Whether all nests have reflectors; one that is carried proves the tracker less often."""
        return self._scene.cell.layout.reflectors == "mounted"

    def _frame(self, record: Record, frame: Frame) -> None:
        scene = self._scene
        if is_world(record.key):
            self._world(record)
        if not frame.points:
            return
        lost = [key for key in frame.points if key not in scene.points]
        what = f"{record.key} is built of {', '.join(lost[:3])}, not valid"
        self._check("I10", record, not lost, what)
        of = {scene.points[key].set_up for key in frame.points if key in scene.points}
        what = f"{record.key} is built of points of set-ups {sorted(of)}, {{W}} known of "
        what += f"{sorted(scene.framed)}"
        known = of == {set_up_of(record.key)} if is_world(record.key) else of <= scene.framed
        self._check("I15" if is_world(record.key) else "I10", record, known, what)

    def _world(self, record: Record) -> None:
        """Judge a {W}: of nests at its own set-up, which stand as they did at the first."""
        number = set_up_of(record.key)
        nests = self._nests(number)
        what = f"{record.key} framed at set-up {self._scene.set_up} by {len(nests)} nests"
        self._check("I15", record, number == self._scene.set_up and len(nests) >= 3, what)
        if number:
            for what, off_mm, limit_mm in self._changes(self._nests(0), nests):
                text = f"{record.key}: {what} changed by {off_mm:.3f} mm, at most {limit_mm:.3f}"
                self._check("I15", record, off_mm <= limit_mm, text)

    def _proof(self, record: Record) -> None:
        """Judge the proof by its points: each nest is where it was when {W} was framed."""
        before, now = self._nests(self._scene.set_up), self._scene.control
        self._check("I15", record, bool(before) and before.keys() == now.keys(), "nests missing")
        for nest in before.keys() & now.keys():
            off_mm = math.dist(before[nest].xyz_mm, now[nest].xyz_mm)
            limit_mm = self._limit_mm(before[nest], now[nest])
            what = f"proven with {nest} {off_mm:.3f} mm off, at most {limit_mm:.3f} mm"
            self._check("I15", record, off_mm <= limit_mm, what)

    def _nests(self, set_up: int) -> dict[str, Point]:
        """Return the points of which {W} was framed at a set-up, by nest."""
        points = self._scene.points.items()
        return {
            nest_of(key): point
            for key, point in points
            if key.startswith("world/") and point.set_up == set_up
        }

    def _changes(
        self, before: dict[str, Point], now: dict[str, Point]
    ) -> Iterator[tuple[str, float, float]]:
        """Yield each two nests, by how much their distance has changed, and its limit."""
        for one, other in combinations(sorted(before.keys() & now.keys()), 2):
            four = (before[one], before[other], now[one], now[other])
            then, there, here, away = (point.xyz_mm for point in four)
            off_mm = abs(math.dist(here, away) - math.dist(then, there))
            yield f"{one} to {other}", off_mm, self._limit_mm(*four)

    def _limit_mm(self, *points: Point) -> float:
        """Return by how much points may differ: stated drift, and the readings' noise.

        The noise is what all points so far have shown, at the places of these.
        """
        found = [point for point in self._scene.points.values() if self._stated(point)]
        if not all(self._stated(point) for point in points):
            return math.nan
        noise = beam_noise(*self._columns(found or points))
        at_mm, _, samples = self._columns(points)
        noise_mm2 = float(np.trace(noise.at(at_mm, samples), axis1=-2, axis2=-1).sum())
        drift_mm = math.sqrt(3.0) * self._scene.cell.uncertainty.drift_limit_mm
        return drift_mm + coverage_factor(4.0, noise.freedom) * math.sqrt(noise_mm2)

    @staticmethod
    def _stated(point: Point) -> bool:
        """Whether a point's place and scatter are numbers."""
        return all(map(math.isfinite, (*point.xyz_mm, *point.std_mm))) and point.samples >= 1

    @staticmethod
    def _columns(points: Sequence[Point]) -> tuple[Array, Array, Array]:
        """Return positions (N, 3), standard deviations (N, 3) and numbers of samples (N,)."""
        rows = [(point.xyz_mm, point.std_mm, point.samples) for point in points]
        at_mm, std_mm, samples = zip(*rows, strict=True)
        return np.array(at_mm), np.array(std_mm), np.array(samples, dtype=float)


class _LifeRules(Rules):
    """Judges states, teardowns and ends."""

    def __init__(self, verdicts: dict[str, Proof], scene: Scene) -> None:
        super().__init__(verdicts, scene)
        self._seq = 0
        self._closings: list[Closed] = []  # of this session
        self._reason = ""  # the first of this session's fault
        self._ended = False  # this session; a resume that was refused ends once more
        self._failed: set[str] = set()  # the keys of verdicts that do not hold now

    def take(self, record: Record) -> None:
        gap = f"record {self._seq} came before"
        self._check("I8", record, record.seq == self._seq + 1, gap)
        self._seq = record.seq
        match record.fact:
            case Verdict(holds=holds):
                (self._failed.discard if holds else self._failed.add)(record.key)
            case StateChanged(machine="run") as life:
                self._life(record, life)
            case Ended() as end:
                self._end(record, end)
            case Closed(took_s=took_s) as closed:
                self._closings.append(closed)
                what = f"the teardown took {took_s:.1f} s, at most 15 s"
                self._check("I7", record, 0.0 <= took_s <= 15.0, what)
            case SafeStopSent(cause=cause):
                self._reason = self._reason or cause
            case AlarmsAcknowledged(until=until):
                unseen = f"alarms up to record {until} were acknowledged before it was written"
                self._check("I17", record, until < record.seq, unseen)

    def _life(self, record: Record, life: StateChanged) -> None:
        state = self._scene.state
        what = f"state was {state}, not {life.before}"
        self._check("I9", record, life.before == state, what)
        if life.to == "running" and state in WAITING:
            # A good look is an unattended run's, after a failed reading.
            may = ("command",) if state == "paused" else ("command", "answer", "look")
            found = f"{state} went on by {life.by or 'nobody'}"
            self._check("I13", record, life.by in may, found)
        if life.to == "checking":
            self._closings, self._reason, self._ended = [], "", False
        if life.to in OVER:
            count = len(self._closings)
            self._check("I7", record, count == 1, f"teardown ran {count} times")
            self._held(record, life.to)
        if life.to == "faulted":
            self._first_reason(record, life.reason)

    def _held(self, record: Record, to: str) -> None:
        """Judge that slide and robot were left held: a device that cannot tell is no proof.

        Then the run has not ended well, and says so.
        """
        problems = self._closings[-1].problems if self._closings else {}
        for device in ("Rail", "Robot"):
            problem = problems.get(device, "")
            if problem and to == "faulted":
                unknown = Break(record.seq, f"{device}: {problem}")
                self._verdicts["I12"].unproven.append(unknown)
            else:
                held, what = bool(self._closings) and not problem, problem or "it was not closed"
                self._check("I12", record, held, f"{device}: {what}")

    def _first_reason(self, record: Record, reason: str) -> None:
        self._reason = self._reason or reason
        kept = f"the reason became {reason!r}, first it was {self._reason!r}"
        self._check("I6", record, bool(reason) and reason == self._reason, kept)

    def _end(self, record: Record, end: Ended) -> None:
        if end.state == "faulted" and not self._ended:
            self._first_reason(record, end.reason)
        self._ended = True
        if end.state == "finished":
            failed = ", ".join(sorted(self._failed))
            what = f"exit {end.exit}, and {failed} does not hold"
            self._check("I17", record, not (self._failed and end.exit == 0), what)
            if isinstance(counts := end.result.get("points"), dict):
                self._counts(record, counts)

    def _counts(self, record: Record, counts: dict[str, int]) -> None:
        """Judge that the result counts each valid point once."""
        points, dropped = self._scene.points, self._scene.dropped
        valid = Counter(point.group for point in points.values())
        more = {
            group
            for group in {point.group for point in dropped.values()}
            if counts.get(group, 0) > valid[group]
        }
        what = f"the result counts points that are not valid: {', '.join(sorted(more))}"
        self._check("I10", record, not more, what)
        wrong = [g for g in sorted({*valid, *counts}) if counts.get(g, 0) != valid[g]]
        figures = ", ".join(f"{g} {counts.get(g, 0)} of {valid[g]}" for g in wrong)
        self._check("I8", record, not wrong, f"the result counts {figures}")


class _Measurements(Rules):
    """Judges each point."""

    def take(self, record: Record) -> None:
        point, scene, key = record.fact, self._scene, record.key
        if not isinstance(point, Point):
            return
        allowed = not (scene.ended or scene.waits)
        self._check("I3", record, allowed, f"{key} measured while {scene.state}")
        once = key not in scene.points or point.retaken
        self._check("I8", record, once, f"{key} counted twice")
        found = f"{key} measured by session {point.session}, {scene.session} holds the run"
        self._check("I11", record, point.session == scene.session, found)
        self._carries(record, point)
        if point.station:
            self._at_station(record, point)
        if point.readings is not None:
            self._times(record, point.readings)
        if scene.session > 1 and scene.framed and not is_proof(key):
            what = f"{key} added before the tracker was verified"
            self._check("I9", record, scene.verified, what)

    def _carries(self, record: Record, point: Point) -> None:
        missing = [] if "temperature_c" in record.body else ["temperature_c"]  # null: not measured
        missing += ["readings"] if point.readings is None else []
        if point.station and point.commanded_deg and point.smr_mm is None:
            missing.append("smr_mm")
        self._check("I4", record, not missing, f"{record.key} lacks {', '.join(missing)}")
        if point.commanded_deg and point.group != "campaign":
            last = self._scene.last_key or "none"
            here = pose_of(last) == pose_of(record.key)
            self._check("I4", record, here, f"{record.key}: the last motion: {last}")

    def _at_station(self, record: Record, point: Point) -> None:
        scene, name = self._scene, point.station
        resumed = scene.session > 1
        what = f"{record.key}: {name} was not found held since the run resumed"
        self._check("I9" if resumed else "I2", record, scene.held == name, what)
        station = scene.station(name)
        wanted_mm = math.nan if station is None else station.strip_mm
        limit_mm = 2 * scene.cell.rail.strip_tolerance_mm
        strip_mm = math.nan if point.strip_mm is None else point.strip_mm
        held = abs(strip_mm - wanted_mm) <= limit_mm + 1e-9
        self._check("I2", record, held, f"{record.key}: strip {strip_mm:.2f} mm at {name}")

    def _times(self, record: Record, readings: Readings) -> None:
        scene, key = self._scene, record.key
        taken_s, settle = readings.tracker.taken_s, scene.cell.settle
        axes = [("slide", readings.rail, scene.rail_moved, settle.rail_s)]
        if readings.robot is not None:
            axes.append(("robot", readings.robot, scene.robot_moved, settle.robot_s))
        for name, reading, moved, rest_s in axes:
            if moved:
                rested_s = math.nan if reading.ended_s is None else taken_s - reading.ended_s
                self._rested(record, name, rested_s, rest_s)
        confirmed = readings.rail.taken_s >= taken_s
        self._check("I14", record, confirmed, f"{key}: the rail was not read after it")
        read = (readings.tracker, readings.rail, readings.robot)
        ages = [each.age_s for each in read if each is not None]
        known = all(FUTURE_S <= age_s < math.inf for age_s in ages)
        self._check("I14", record, known, f"{key}: readings {ages} s old")

    def _rested(self, record: Record, name: str, rested_s: float, rest_s: float) -> None:
        wanted_s = rest_s / self._scene.time_factor
        what = f"{record.key}: {rested_s:.3f} s after the {name}'s motion, expected {wanted_s:g} s"
        self._check("I3", record, rested_s >= wanted_s, what)
        self._check("I4", record, rested_s >= 0.0, f"{record.key}: older than the {name}'s motion")


class _Identities(Rules):
    """Compares what answered with what answered before."""

    def __init__(self, verdicts: dict[str, Proof], scene: Scene) -> None:
        super().__init__(verdicts, scene)
        self._before: dict[str, Asset] = {}
        self._hilcell = ""
        self._accepted = False  # since the last connection

    def take(self, record: Record) -> None:
        match record.fact if record.kind == "event" else None:
            case ChangesAccepted():
                self._accepted = True
            case Connected() as event:
                self._connected(record, event)

    def _connected(self, record: Record, event: Connected) -> None:
        now = {each.kind: each for each in event.devices}
        hilcell = event.hilcell
        if self._before:
            changed = other_assets(self._before, now)
            changed += ["hilcell"] if self._hilcell not in ("", hilcell) else []
            what = f"changed, and nobody has accepted it: {', '.join(changed)}"
            self._check("I18", record, self._accepted or not changed, what)
        self._before, self._hilcell, self._accepted = now, hilcell, False
