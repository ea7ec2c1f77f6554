"""Motions of slide and robot, each admitted by the interlocks with readings taken for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from hilcell.calibration.controller_pose import check_pose
from hilcell.calibration.frames import Frames
from hilcell.cell.devices import (
    Devices,
    Rests,
    jogging_rail,
    self_stopping_rail,
    streaming_tracker,
    sweeping_robot,
)
from hilcell.cell.file import Cell, RailTable, Station
from hilcell.journal.journal import StorageError
from hilcell.journal.log import Records, VisitedPoses
from hilcell.journal.runs import read_log
from hilcell.journal.stream_file import StreamFile
from hilcell.model import events
from hilcell.model.events import Event
from hilcell.model.frame import Frame, frame_type
from hilcell.model.point import Point, PointId
from hilcell.model.records import EVENTS
from hilcell.model.verdicts import Verdict, verdict_type
from hilcell.ports import (
    AfterLoss,
    Array,
    Clock,
    DeviceError,
    NoReading,
    Rail,
    RailReading,
    RailTrace,
    RobotReading,
    StripLost,
)
from hilcell.run.collision import UpcomingPoses, below, check_path, check_volumes_known, waypoints
from hilcell.run.interlocks import (
    R,
    check_joint_limits,
    check_rail_may_move,
    check_robot_may_move,
    check_robot_rests,
    check_strip,
    fresh_reading,
    reading_facts,
    reading_time,
)
from hilcell.run.prompts import NO_CHOICES, Prompt, Verification
from hilcell.run.states import CALIBRATION, StateMachine


class Ask(Protocol):
    """Suspends a run until the answer to a prompt, or that its cause is gone, is verified."""

    def __call__(
        self,
        prompt: Prompt,
        verify: Callable[[], Verification],
        cause: NoReading | None,
        choices: Mapping[str, Callable[[], Verification]] = NO_CHOICES,
    ) -> Verification: ...


class RunContext:
    """The state that all layers of a run share. Used by the worker thread alone.

    ``checkpoint`` pauses the run if requested, ``pause`` pauses an attended run, ``ask`` suspends
    it until the operator's answer, or that the cause is gone, is verified.
    """

    def __init__(
        self,
        cell: Cell,
        devices: Devices,
        clock: Clock,
        journal: Records,
        *,
        checkpoint: Callable[[], None],
        ask: Ask,
        pause: Callable[[str], None] = lambda reason: None,
    ) -> None:
        self.cell, self.devices, self.clock = cell, devices, clock
        self.log, self.frames = journal.log, Frames(cell, journal.log)
        self.checkpoint, self.pause, self.ask = checkpoint, pause, ask
        self._journal = journal
        self._calibration = StateMachine(CALIBRATION, journal)

    def reached(self, state: str) -> bool:
        """Whether the journal has this state of the calibration, or a later one."""
        order = CALIBRATION.states
        return order.index(self._calibration.state) >= order.index(state)

    def reach(self, trigger: str) -> None:
        """Take a transition of the calibration machine unless the journal has it."""
        target = next(row[2] for row in CALIBRATION.rows if row[0] == trigger)
        if not self.reached(target):
            self._calibration.fire(trigger)

    def fresh(self, read: Callable[[], R], taken: R | None) -> R:
        """Return ``taken``, or another reading where that is too old for a motion."""
        return fresh_reading(read, self.clock, self.cell.settle.reading_age_s, taken)

    def add(self, event: Event) -> None:
        self._journal.append("event", "", event)

    def event(self, what: str, **facts: object) -> None:
        """Journal a plug-in's event; raises `ValueError` for one of `hilcell.model.events`."""
        if what in EVENTS:
            raise ValueError(f"expected an event of another kind than {what!r}; add its type")
        self._journal.append("event", "", {"what": what} | facts)

    def intend(self, key: str, action: str, **facts: object) -> None:
        self._journal.append("intent", key, {"action": action, "session": self.log.session} | facts)

    def frame(self, key: str, frame: Frame) -> None:
        """Journal a frame; raises `ValueError` for a key that is not of its type."""
        if not frame.calibration and frame_type(key) is not type(frame):
            raise ValueError(f"{key!r} is no key of {type(frame).__name__}")
        self._journal.append("frame", key, frame)

    def verdict(self, key: str, *, holds: bool, **facts: object) -> None:
        """Journal a plug-in's verdict; raises `ValueError` for one of `hilcell.model.verdicts`."""
        if verdict_type(key) is not None:
            raise ValueError(f"expected a verdict of another key than {key!r}; judge by its type")
        self._journal.append("verdict", key, {"holds": holds} | facts)

    def judge(self, key: str, verdict: Verdict) -> None:
        """Journal a verdict; raises `ValueError` for a key that is not of its type."""
        if verdict_type(key) is not type(verdict):
            raise ValueError(f"{key!r} is no key of {type(verdict).__name__}")
        self._journal.append("verdict", key, verdict)

    @property
    def folder(self) -> Path:
        return self._journal.path.parent

    def point(self, id: PointId, **facts: object) -> Point:
        head = {"id": id, "group": id.group, "session": self.log.session}
        if self.log.set_ups.number:
            head["set_up"] = self.log.set_ups.number
        self._journal.append("point", id.key, head | facts)
        return self.log.point(id)


# -- motions --------------------------------------------------------------------------------------


# The trap: the drive's encoder does not show backlash. So the last motion always comes from the
# same side, and only the strip, read at rest, gives the slide's position.


def approach_station(rail: Rail, table: RailTable, station: Station) -> int:
    """Bring the slide to ``station`` from below; return the number of approaches.

    Every approach must reduce the error. Raises `DeviceError` where the station is not reached,
    `StripLost` for a strip that does not follow the drive.
    """
    command_mm = station.rail_mm
    error_mm = float("inf")
    for tries in range(1, table.max_approaches + 1):
        rail.move_to(command_mm - table.back_off_mm)
        before = rail.settle()
        rail.move_to(command_mm)
        reading = rail.settle()
        _check_strip_follows(table, station, before, reading)
        off_mm = station.strip_mm - reading.strip_mm
        if abs(off_mm) <= table.strip_tolerance_mm + 1e-9:
            return tries
        if not abs(off_mm) < abs(error_mm):
            break
        error_mm = off_mm
        command_mm += off_mm
    raise DeviceError(
        "HC-S04",
        "Rail",
        f"station {station.name} not held",
        f"strip {reading.strip_mm:.2f} mm",
        expected=f"{station.strip_mm:.2f} +-{table.strip_tolerance_mm:.2f} mm in {tries} "
        "approaches",
        fields={
            "station": station.name,
            "strip_mm": reading.strip_mm,
            "wanted_mm": station.strip_mm,
            "tolerance_mm": table.strip_tolerance_mm,
            "tries": tries,
        },
    )


def _check_strip_follows(
    table: RailTable, station: Station, before: RailReading, reading: RailReading
) -> None:
    motor_mm = abs(reading.position_mm - before.position_mm)
    strip_mm = abs(reading.strip_mm - before.strip_mm)
    if motor_mm > 0.4 and not strip_mm > 0.0:
        raise StripLost(
            "HC-S02",
            "Rail",
            f"approach of {station.name}",
            f"strip frozen at {reading.strip_mm:.2f} mm while the drive moved {motor_mm:.2f} mm",
            act="check the strip head and its cable",
            fields={"station": station.name, "strip_mm": reading.strip_mm, "moved_mm": motor_mm},
        )
    slip_mm = reading.position_mm - reading.strip_mm
    if not abs(slip_mm) <= table.slip_limit_mm:
        raise DeviceError(
            "HC-S03",
            "Rail",
            f"approach of {station.name}",
            f"drive {reading.position_mm:.2f} mm and strip {reading.strip_mm:.2f} mm differ",
            expected=f"<= {table.slip_limit_mm:.2f} mm apart",
            fields={
                "station": station.name,
                "drive_mm": reading.position_mm,
                "strip_mm": reading.strip_mm,
                "limit_mm": table.slip_limit_mm,
            },
        )


SAME_POSE_RAD = 1e-4  # of joints read back


@dataclass(frozen=True, slots=True)
class StraightApproach:
    """An approach directly from another pose (6,), at a speed of its own."""

    from_rad: Array
    speed_percent: float


@dataclass(frozen=True)
class SweepCommand:
    """A sweep of one axis (0 to 5) from joints (6,); the reflector begins at (3,) mm."""

    key: str
    start_rad: Array
    axis: int
    end_rad: float
    speed_rad_s: float
    near_mm: Array  # the tracker's frame
    rate_hz: float

    @property
    def target_rad(self) -> Array:
        joints_rad = self.start_rad.copy()
        joints_rad[self.axis] = self.end_rad
        return joints_rad


class RobotMotion:
    """A motion of the robot while the slide is held at ``station``.

    Old readings are taken again before use and checked at each use. ``robot`` is None where the
    robot may have moved since. ``began``: the rail's reading by which it last began to move.
    """

    def __init__(
        self, run: RunContext, station: Station | None, robot: RobotReading | None
    ) -> None:
        self._run, self._station = run, station
        self._rail: RailReading | None = None
        self.robot = robot
        self.began: events.ReadingTime | None = None

    @property
    def strip_mm(self) -> float:
        return self.slide()[0].strip_mm

    def slide(self) -> tuple[RailReading, float]:
        """Return the slide's reading and when it was checked; raises `Blocked`."""
        run = self._run
        self._rail = rail = run.fresh(run.devices.rail.read, self._rail)
        checked_s = run.clock.pc_s()
        check_robot_may_move(run.cell, rail, self._station, checked_s)
        return rail, checked_s

    def resting_rad(self) -> Array:
        """Return the joints (6,) of the robot at rest; raises `Blocked`."""
        run = self._run
        self.robot = robot = run.fresh(run.devices.robot.read, self.robot)
        check_robot_rests(run.cell, robot, run.clock.pc_s())
        return robot.joints_rad

    def check_path(self, joints_rad: Array, what: str) -> None:
        """Raise `Blocked` where the path to joints (6,) is not clear."""
        if self._run.cell.surroundings is not None:
            check_path(self._run.cell, self.strip_mm, self.resting_rad(), joints_rad, what)

    def begin(self, joints_rad: Array, what: str) -> None:
        """Check both readings immediately before the robot moves to joints (6,).

        If the robot had to be read again, its path is checked again.
        """
        if self._run.cell.surroundings is not None:
            checked = self.robot
            self.resting_rad()
            if self.robot is not checked:
                self.check_path(joints_rad, what)
        self.began = reading_time(*self.slide())
        self.robot = None

    def drive(self, stops: list[Array], speed_percent: float, what: str) -> RobotReading:
        """Move to joints (6,) in sequence; return the reading at the last."""
        for stop in stops:
            self.begin(stop, what)
            reading = self.robot = self._run.devices.robot.move_to(stop, speed_percent)
        return reading


class Mover(RunContext):
    """Moves slide or robot, one at a time, each by readings that the interlocks admit.

    The slide moves while the robot is parked (`_prepare_rail`), the robot while the slide is held
    (`admitted`). ``held`` is the station at which the slide is held, None for none; ``began`` the
    rail's reading by which the robot's last motion began.
    """

    JOINT_POLL_S = 0.25  # between two polls of the joints; a motion has hundreds

    held: Station | None = None
    began: events.ReadingTime | None = None
    _robot: RobotReading | None = None  # since which the robot has not moved
    _announced = False  # a first pass

    @cached_property
    def rests(self) -> Rests:
        return Rests.of(self.cell)

    @cached_property
    def _upcoming(self) -> UpcomingPoses:
        return UpcomingPoses(self.cell)

    # -- the rail -----------------------------------------------------------------------------

    def home_rail(self) -> None:
        """Reference the drive; the robot moves to its safe pose first."""
        if not self.cell.has_rail:
            self.parked()
            return
        self._prepare_rail("rail.home", {})
        self.devices.rail.home()
        self._hold_rail(self.rests.rail_s)

    def rail_to(self, position_mm: float) -> None:
        """Move by the drive alone, without the strip, and hold."""
        self._prepare_rail("rail.move", {"position_mm": position_mm})
        self.devices.rail.move_to(position_mm)
        self.devices.rail.settle()
        self._hold_rail()

    def jog_rail(
        self,
        key: str,
        distance_mm: float,
        *,
        bound_mm: float,
        speed_mm_s: float,
        stop_after_mm: float | None = None,
    ) -> events.SlideJogged:
        """Move the slide a little with its scale unproved, once in a run; see `ports.Jogs`."""
        for known in self.log.happened(events.SlideJogged):
            if known.key == key:
                return known
        rail = jogging_rail(self.devices.rail)
        self._prepare_rail("rail.jog", {"distance_mm": distance_mm, "bound_mm": bound_mm})
        trace = rail.jog(
            distance_mm, bound_mm=bound_mm, speed_mm_s=speed_mm_s, stop_after_mm=stop_after_mm
        )
        self._hold_rail()
        return self._jogged(key, distance_mm, bound_mm, speed_mm_s, trace)

    def jog_until_lost(
        self, key: str, distance_mm: float, *, bound_mm: float, speed_mm_s: float
    ) -> tuple[events.SlideJogged, AfterLoss | None]:
        """Move the slide a little, until a person pulls its cable, and wait for its return.

        Return the jog and how the device stood then; None where the link was never lost.
        """
        rail = self_stopping_rail(self.devices.rail)
        found: list[AfterLoss] = []

        def verify() -> Verification:
            try:
                found.append(rail.regain())
                self.devices.rail.read()
            except DeviceError as error:
                return Verification.failed(error, self.clock.pc_s())
            return Verification(0.0, "", self.clock.pc_s())

        self._prepare_rail("rail.jog", {"distance_mm": distance_mm, "bound_mm": bound_mm})
        trace = rail.jog_until_lost(distance_mm, bound_mm=bound_mm, speed_mm_s=speed_mm_s)
        jogged = self._jogged(key, distance_mm, bound_mm, speed_mm_s, trace)
        if trace.stopped_by == "lost":
            self.ask(Prompt.plug_in(), verify, None)
        self._hold_rail()
        return jogged, found[0] if found else None

    def _jogged(
        self, key: str, distance_mm: float, bound_mm: float, speed_mm_s: float, trace: RailTrace
    ) -> events.SlideJogged:
        jogged = events.SlideJogged(
            key=key,
            distance_mm=distance_mm,
            bound_mm=bound_mm,
            speed_mm_s=speed_mm_s,
            stopped_by=trace.stopped_by,
            taken_s=(trace.taken_s - trace.taken_s[0]).tolist(),
            drive_mm=trace.drive_mm.tolist(),
            strip_mm=trace.strip_mm.tolist(),
            velocity_mm_s=trace.velocity_mm_s.tolist(),
        )
        self.add(jogged)
        return jogged

    def hold_station(self, station: Station, *, again: bool = False) -> None:
        """Bring the slide to ``station`` by the strip and hold it there.

        In a resumed run a slide that is at the station, by the strip, stays there. Without a rail
        the robot is always at its station.
        """
        if self.held == station and not again:
            return
        if not self.cell.has_rail or (not again and self._is_at(station)):
            self.held = station
            self.add(events.StationAlreadyHeld(station=station.name))
            return
        began = self._prepare_rail("rail.approach", {"station": station.name})
        tries = approach_station(self.devices.rail, self.cell.rail, station)
        self._hold_rail(None if again else self.rests.rail_s)
        reading = self.devices.rail.read()
        check_strip(self.cell, reading, station, "hold")
        self.held = station
        self.add(
            events.StationHeld(
                station=station.name,
                tries=tries,
                strip_mm=reading.strip_mm,
                rail_mm=reading.position_mm,
                began=began,
            )
        )

    def _is_at(self, station: Station) -> bool:
        held = [each.station for each in self.log.happened(events.StationHeld)]
        if self.log.session < 2 or not held or held[-1] != station.name:
            return False
        reading = self.devices.rail.read()
        off_mm = abs(reading.strip_mm - station.strip_mm)
        at_rest = reading.still and not reading.powered
        return at_rest and off_mm <= self.cell.rail.strip_tolerance_mm

    def rail_referenced(self) -> bool:
        """Whether drive and absolute strip agree, which verifies the drive's reference."""
        reading = self.devices.rail.read()
        return abs(reading.position_mm - reading.strip_mm) <= self.cell.rail.slip_limit_mm

    def await_strip(self, lost: StripLost) -> None:
        """Hold the slide and suspend the run until the strip reads well.

        It may have been moved by hand, so no station counts as held afterwards.
        """
        self.held = None
        self._hold_rail()
        prompt = Prompt(
            title="The strip cannot be read",
            text=f"{lost.summary}. The slide is held. Clean the strip at the head, check "
            "the head's mount and distance, and its cable.",
            place="the strip",
            expected_mm=None,
            limit_mm=self.cell.rail.slip_limit_mm,
            reason=lost.summary,
        )
        self.ask(prompt, lambda: self._verify_strip(lost), lost)
        self.add(events.StripBack())

    def _verify_strip(self, lost: StripLost) -> Verification:
        """Read the strip; a frozen one must agree with the drive within the slip limit.

        After an alarm of the strip the drive may have no reference yet.
        """
        try:
            reading = self.devices.rail.read()
        except DeviceError as error:
            return Verification.failed(error, self.clock.pc_s())
        if not reading.still:
            return Verification(
                None, f"the slide moves at {reading.velocity_mm_s:.3f} mm/s", reading.taken_s
            )
        off_mm = abs(reading.strip_mm - reading.position_mm) if lost.code == "HC-S02" else 0.0
        why = f"strip {reading.strip_mm:.2f} mm, drive {reading.position_mm:.2f} mm"
        return Verification(off_mm, why, reading.taken_s)

    def _prepare_rail(self, action: str, facts: dict[str, object]) -> events.ReadingTime:
        """Park the robot and journal the intent; return the reading by which the slide moves."""
        self.checkpoint()
        robot, _ = self._check_parked(self.parked())  # read at rest, after its motion ended
        self.held = None
        self.intend("", action, **facts, seen=reading_facts(robot, self.clock.pc_s()))
        return reading_time(*self._check_parked(robot))  # the commit may have been slow

    def _check_parked(self, taken: RobotReading) -> tuple[RobotReading, float]:
        """Return a recent reading of a parked robot and when it was checked."""
        robot = self.fresh(self.devices.robot.read, taken)
        now_s = self.clock.pc_s()
        check_rail_may_move(self.cell, robot, now_s)
        return robot, now_s

    def _hold_rail(self, rest_s: float | None = None) -> None:
        """Hold the slide and rest: the whole time unless the tracker shows the rest afterwards."""
        self.devices.rail.hold()
        self.clock.wait(self.cell.settle.rail_s if rest_s is None else rest_s)

    # -- the robot ----------------------------------------------------------------------------

    @contextmanager
    def admitted(self) -> Iterator[RobotMotion]:
        """Admit one motion of the robot; raises `Blocked` where the slide is not held.

        After a failure the robot's pose is unknown, and it is read again before the next one.
        """
        motion, self._robot = RobotMotion(self, self.held, self._robot), None
        motion.slide()
        yield motion
        self._robot, self.began = motion.robot, motion.began

    def park_robot(self) -> None:
        self.checkpoint()
        self.parked()

    def parked(self, percent: float | None = None) -> RobotReading:
        """Return a reading of the robot at its safe pose, to which it moves unless it is there.

        ``percent`` of full speed: None for the cell file's.

        A slide that has left its held station stops the run; a resumed run, which holds none yet,
        parks at any slide position. Here, before the first motion, the controller's kinematics are
        compared with the cell file's.
        """
        safe_rad = np.radians(self.cell.robot.safe_deg)
        now = self.devices.robot.read()
        if now.still:  # while moving, pose and joints differ
            kinematics = check_pose(self.cell.robot, now, "park")
            if not (kinematics.holds or self.log.by_factory_links):
                self.add(events.FactoryLinks(off_mm=kinematics.off_mm))
        if bool(np.all(np.abs(now.joints_rad - safe_rad) < SAME_POSE_RAD)):
            return now
        self._robot = now
        with self.admitted() as motion:
            motion.check_path(safe_rad, "park")
            self.intend("", "robot.park", seen=reading_facts(*motion.slide()))
            usual = self.cell.robot.speed_percent
            return motion.drive([safe_rad], usual if percent is None else percent, "park")

    def robot_to(
        self,
        joints_rad: Array,
        what: str,
        *,
        above: bool = False,
        straight: StraightApproach | None = None,
        rest_s: float | None = None,
    ) -> RobotReading:
        """Move to joints (6,), every axis from below, ``above`` or ``straight``, and rest.

        ``rest_s`` is less than the whole time only where the tracker shows the rest. Approaching
        from one side on every axis takes the joints' backlash out of the error. The speed of a
        ``straight`` approach does not apply to a first pass.
        """
        usual_percent = self.cell.robot.speed_percent
        check_joint_limits(self.cell, joints_rad, what)
        with self.admitted() as motion:
            speed_percent = self._speed_percent(motion.strip_mm, joints_rad, what)
            if straight is None:
                stops = self._stops(motion, joints_rad, what, above)
            else:
                stops = self._straight_stops(motion, straight, joints_rad, what)
                if speed_percent == usual_percent:
                    speed_percent = straight.speed_percent
            rail, checked_s = motion.slide()
            place = {"joints_deg": np.degrees(joints_rad), "strip_mm": rail.strip_mm}
            if straight is not None:
                place |= {"from_deg": np.degrees(straight.from_rad), "speed_percent": speed_percent}
            self.intend(what, "robot.move", **place, seen=reading_facts(rail, checked_s))
            reading = motion.drive(stops, speed_percent, what)
        self.clock.wait(self.cell.settle.robot_s if rest_s is None else rest_s)
        return reading

    def expect(self, station: Station, joints_rad: Array) -> None:
        """Prove the paths to the next joints (N, 6), in sequence, at once."""
        self._upcoming.expect(station.strip_mm, joints_rad)

    def _stops(self, motion: RobotMotion, joints_rad: Array, what: str, above: bool) -> list[Array]:
        now_rad = joints_rad if self.cell.surroundings is None else motion.resting_rad()
        if not above and self._upcoming.clear(motion.strip_mm, now_rad, joints_rad):
            return [below(self.cell, joints_rad), joints_rad]
        return waypoints(self.cell, motion.strip_mm, now_rad, joints_rad, what, above=above)

    def _straight_stops(
        self, motion: RobotMotion, straight: StraightApproach, joints_rad: Array, what: str
    ) -> list[Array]:
        """Return the waypoints, from the start of the approach unless the robot is there."""
        before_rad = straight.from_rad
        there = bool(np.all(np.abs(motion.resting_rad() - before_rad) < SAME_POSE_RAD))
        if self.cell.surroundings is not None:
            check_path(self.cell, motion.strip_mm, before_rad, joints_rad, what)
        first = [] if there else self._stops(motion, before_rad, what, above=False)
        return [*first, joints_rad]

    # Outside the cube the volumes are only as right as the cell file. So the robot moves there
    # slowly the first time, and an attended run pauses before the first such pose unless the cell
    # file disables that. A pose is known once this or an earlier finished run has moved there.

    def _speed_percent(self, strip_mm: float, joints_rad: Array, what: str) -> float:
        """Return the speed to joints (6,); announce the first unknown pose and pause."""
        usual = self.cell.robot.speed_percent
        if self.cell.surroundings is None or not self._upcoming.leaves_cube(joints_rad):
            return usual
        known = (self.log.visited_poses, *self._visited_before)
        if any(visited.has(strip_mm, joints_rad) for visited in known):
            return usual
        slow = min(self.cell.robot.first_pass_percent, usual)
        if not self._announced:
            self._announced = True
            self.add(events.FirstPassBegun(key=what, speed_percent=slow))
            if self.cell.pauses_at_first_pass:
                self.pause(
                    f"{what}: the robot leaves the grid's cube at {slow:g} % speed, for a pose "
                    "that is new in this cell; clear the cell and stay at the E-stop"
                )
        return slow

    @cached_property
    def _visited_before(self) -> list[VisitedPoses]:
        """Return the poses of earlier runs; a deleted run has none."""
        found, plan = [], self.log.plan
        for name in plan.driven_by if plan else []:
            try:
                found.append(read_log(self.folder.parent / name).visited_poses)
            except StorageError as error:
                self.add(events.EarlierRunUnreadable(run=name, reason=str(error)))
        return found

    # -- sweeps with the tracker streaming ------------------------------------------------------

    def sweep(self, order: SweepCommand) -> events.StreamRecorded:
        """Move to the start, sweep with the slide at rest, and return the journal's record of it.

        Tracker and robot have no common clock. So samples have the tracker's time and the window of
        the cell's clock in which they arrived, joints the cell's clock before and after each
        request; the reader of the stream pairs them.
        """
        tracker, robot = streaming_tracker(self.devices.tracker), sweeping_robot(self.devices.robot)
        check_joint_limits(self.cell, order.target_rad, order.key)
        check_volumes_known(self.cell, order.key)
        self.robot_to(order.start_rad, order.key, rest_s=self.rests.robot_s)
        reflector = self.cell.tracker.reflector
        joints_deg = np.degrees(order.target_rad)
        with self.admitted() as motion:
            motion.check_path(order.target_rad, order.key)
        with self.admitted() as motion:
            target = {"axis": order.axis + 1, "joints_deg": joints_deg}
            self.intend(order.key, "robot.sweep", **target, seen=reading_facts(*motion.slide()))
            with (
                StreamFile(self.folder, order.key) as file,
                tracker.stream(order.near_mm, reflector, order.rate_hz) as stream,
                robot.sweep(order.axis, order.end_rad, order.speed_rad_s) as sweep,
            ):
                stream.kickoff()
                motion.begin(order.target_rad, order.key)
                sweep.kickoff()
                while not sweep.ended:
                    self.clock.wait(self.JOINT_POLL_S)
                    file.take((), [sweep.collect()])
                    file.take(stream.collect())
                sweep.complete()
                file.take(stream.complete())
                measured = msgspec.structs.replace(
                    file.finish(),
                    set_up=self.log.set_ups.number,
                    axis=order.axis + 1,
                    speed_deg_s=float(np.degrees(sweep.speed_rad_s)),
                    rate_hz=stream.rate_hz,
                    start_deg=np.degrees(order.start_rad).tolist(),
                    end_deg=joints_deg.tolist(),
                    reflector=reflector,
                    session=self.log.session,
                )
        self.add(measured)
        return measured
