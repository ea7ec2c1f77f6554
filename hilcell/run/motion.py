"""Motions of slide and robot: each passes the interlocks with readings taken for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hilcell.calibration.controller_pose import check_pose
from hilcell.cell.file import RailTable, Station
from hilcell.journal.journal import StorageError
from hilcell.journal.log import FACTORY_LINKS, Driven, ReadingTime
from hilcell.journal.runs import read_log
from hilcell.ports import Array, DeviceError, Rail, RailReading, RobotReading, StripLost
from hilcell.run.collision import ComingPoses, below, check_way, stops_on_way
from hilcell.run.interlocks import (
    check_joint_limits,
    check_rests,
    check_strip,
    rail_may_move,
    robot_may_move,
)
from hilcell.run.readings import fresh, seen, time_of
from hilcell.run.run_context import RunContext

# The trap: the drive's encoder is blind to backlash. So the last motion always comes from the
# same side, and only the strip, read at rest, says where the slide is.


@dataclass(frozen=True, slots=True)
class Approach:
    """A held station: the reading at rest and how many approaches it took."""

    station: str
    reading: RailReading
    tries: int


def approach_station(rail: Rail, table: RailTable, station: Station) -> Approach:
    """Bring the slide to ``station`` from below; raises `DeviceError` when it does not hold.

    Raises `StripLost` for a strip that does not follow at all. Every approach must shrink the
    error; the side of approach never changes.
    """
    command_mm = station.rail_mm
    error_mm = float("inf")
    for tries in range(1, table.max_approaches + 1):
        rail.move_to(command_mm - table.back_off_mm)
        before = rail.settle()
        rail.move_to(command_mm)
        reading = rail.settle()
        _check_strip_follows(table, station, before, reading)
        found_mm = station.strip_mm - reading.strip_mm
        if abs(found_mm) <= table.strip_tolerance_mm + 1e-9:
            return Approach(station.name, reading, tries)
        if not abs(found_mm) < abs(error_mm):
            break
        error_mm = found_mm
        command_mm += found_mm
    raise DeviceError(
        "HC-S04",
        "Rail",
        f"station {station.name} not held",
        f"strip {reading.strip_mm:.2f} mm",
        wanted=f"{station.strip_mm:.2f} +-{table.strip_tolerance_mm:.2f} mm in {tries} approaches",
        act="check the strip head and the slide's friction, then resume",
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
            wanted=f"<= {table.slip_limit_mm:.2f} mm apart",
            act="the slide slipped or this is another station; home and check the coupling",
            fields={
                "station": station.name,
                "drive_mm": reading.position_mm,
                "strip_mm": reading.strip_mm,
                "limit_mm": table.slip_limit_mm,
            },
        )


# Their volumes are only as right as the cell file. So the robot goes there slowly the first time,
# and an attended run pauses before the first of them, unless the cell file says otherwise. A pose
# is known once this run, or one of those finished before it, was driven there.


class FirstPass:
    """Says how fast the robot may go to a pose, and who has to watch."""

    def __init__(self, run: RunContext, coming: ComingPoses) -> None:
        self._run, self._coming = run, coming
        self._announced = False

    def speed_percent(self, strip_mm: float, joints_rad: Array, what: str) -> float:
        """Return the speed to joints (6,) with the slide there.

        The first pose that is not known is announced; an attended run then pauses here.
        """
        cell = self._run.cell
        usual = cell.robot.speed_percent
        if cell.surroundings is None or not self._coming.leaves_cube(joints_rad):
            return usual
        if any(
            driven.has(strip_mm, joints_rad) for driven in (self._run.log.driven, *self._earlier)
        ):
            return usual
        slow = min(cell.robot.first_pass_percent, usual)
        if not self._announced:
            self._announced = True
            self._announce(what, slow)
        return slow

    def _announce(self, what: str, percent: float) -> None:
        self._run.event("first pass", key=what, speed_percent=percent)
        if self._run.cell.pauses_at_first_pass:
            self._run.pause(
                f"{what}: the robot leaves the grid's cube, to where it was never driven in this "
                f"cell, at {percent:g} %; clear the cell and stay at the E-stop"
            )

    @cached_property
    def _earlier(self) -> list[Driven]:
        """Return where the runs before this one were driven; a deleted one proves nothing."""
        found, plan = [], self._run.log.plan
        for name in plan.driven_by if plan else []:
            try:
                found.append(read_log(self._run.folder.parent / name).driven)
            except StorageError as error:
                self._run.event("earlier run unreadable", run=name, reason=str(error))
        return found


SAME_RAD = 1e-4  # of joints read back: the robot stands at that pose


@dataclass(frozen=True, slots=True)
class Straight:
    """An approach directly from another pose (6,), as in a test cycle, at a speed of its own."""

    from_rad: Array
    speed_percent: float


class Motion:
    """Moves one of both at a time. ``held`` is the station at which the slide is held."""

    def __init__(self, run: RunContext) -> None:
        self._run = run
        self.held: Station | None = None
        self._last: RobotReading | None = None  # since which the robot has not moved
        self.began: ReadingTime | None = None  # the rail's, by which the robot's last motion began
        self._coming = ComingPoses(run.cell)
        self._first_pass = FirstPass(run, self._coming)

    # -- the rail -----------------------------------------------------------------------------

    def home_rail(self) -> None:
        """Find the drive's reference; the robot goes to its safe pose first."""
        if not self._run.cell.has_rail:
            self.park_robot()
            return
        self._prepare_rail("rail.home", {})
        self._run.devices.rail.home()
        self._hold_rail()

    def rail_to(self, position_mm: float) -> None:
        """Move by the drive alone, without the strip, and hold."""
        self._prepare_rail("rail.move", {"position_mm": position_mm})
        self._run.devices.rail.move_to(position_mm)
        self._run.devices.rail.settle()
        self._hold_rail()

    def hold_station(self, station: Station, *, again: bool = False) -> None:
        """Bring the slide to ``station`` by the strip and hold it there.

        A slide that a resumed run finds at the station, by the strip, stays there. Without a rail
        the robot is always found at its station.
        """
        if self.held == station and not again:
            return
        if not self._run.cell.has_rail or (not again and self._stands_at(station)):
            self.held = station
            self._run.event("station found held", station=station.name)
            return
        began = self._prepare_rail("rail.approach", {"station": station.name})
        approach = approach_station(self._run.devices.rail, self._run.cell.rail, station)
        self._hold_rail()
        reading = self._run.devices.rail.read()
        check_strip(self._run.cell, reading, station, "hold")
        self.held = station
        self._run.event(
            "station held",
            station=station.name,
            tries=approach.tries,
            strip_mm=reading.strip_mm,
            rail_mm=reading.position_mm,
            began=began,
        )

    def hold_here(self) -> None:
        """Hold the slide where it stands; no station counts as held."""
        self.held = None
        self._hold_rail()

    def _stands_at(self, station: Station) -> bool:
        held = [r.body["station"] for r in self._run.log.events if r.body["what"] == "station held"]
        if self._run.log.session < 2 or not held or held[-1] != station.name:
            return False
        reading = self._run.devices.rail.read()
        off_mm = abs(reading.strip_mm - station.strip_mm)
        at_rest = reading.still and not reading.powered
        return at_rest and off_mm <= self._run.cell.rail.strip_tolerance_mm

    def rail_referenced(self) -> bool:
        """Whether drive and absolute strip agree, which proves the drive's reference."""
        reading = self._run.devices.rail.read()
        return abs(reading.position_mm - reading.strip_mm) <= self._run.cell.rail.slip_limit_mm

    def _prepare_rail(self, action: str, facts: dict[str, object]) -> ReadingTime:
        """Park the robot and journal the intent; return the reading by which the slide moves."""
        self._run.checkpoint()
        robot, _ = self._check_parked(self.park_robot())  # read at rest, after its motion ended
        self.held = None
        self._run.intend("", action, **facts, seen=seen(robot, self._run.clock.pc_s()))
        return time_of(*self._check_parked(robot))  # the commit may have taken long

    def _check_parked(self, taken: RobotReading) -> tuple[RobotReading, float]:
        """Return a young reading of a robot that lets the slide move, and when it was judged."""
        robot = fresh(
            self._run.devices.robot.read,
            self._run.clock,
            self._run.cell.settle.reading_age_s,
            taken,
        )
        now_s = self._run.clock.pc_s()
        rail_may_move(self._run.cell, robot, now_s)
        return robot, now_s

    def _hold_rail(self) -> None:
        self._run.devices.rail.hold()
        self._run.clock.wait(self._run.cell.settle.rail_s)

    # -- the robot ----------------------------------------------------------------------------

    def park_robot(self) -> RobotReading:
        """Bring the robot to its safe pose unless it is there; return its reading there.

        A slide that has left the station at which it is held stops the run: a resumed one, which
        holds none yet, parks wherever the slide rests. Here, before the first motion, the
        controller's kinematics are compared with the cell file's.
        """
        safe_rad = np.radians(self._run.cell.robot.safe_deg)
        now = self._run.devices.robot.read()
        if now.still:  # a pose that was read under way is not that of its joints
            self._check_kinematics(now)
        if bool(np.all(np.abs(now.joints_rad - safe_rad) < SAME_RAD)):
            return now
        rail = self.check_held(self.held)
        self._last = now
        self.check_way(rail, safe_rad, "park")
        rail = self.check_held(self.held, rail)
        self._run.intend("", "robot.park", seen=seen(rail, self._run.clock.pc_s()))
        return self._drive([safe_rad], self._run.cell.robot.speed_percent, rail, self.held, "park")

    def _check_kinematics(self, robot: RobotReading) -> None:
        """Refuse a controller with other links than the cell file; journal those of its factory."""
        found = check_pose(self._run.cell.robot, robot, "park")
        if not (found.holds or self._run.log.by_factory_links):
            self._run.event(FACTORY_LINKS, off_mm=found.off_mm)

    def robot_to(
        self,
        joints_rad: Array,
        what: str,
        *,
        above: bool = False,
        straight: Straight | None = None,
    ) -> RobotReading:
        """Go to joints (6,), every axis from below, or from ``above``, or ``straight``, and settle.

        Coming from one side on every axis takes the joints' backlash out of the error. A speed that
        is stated does not hold for a first pass.
        """
        check_joint_limits(self._run.cell, joints_rad, what)
        rail = self.check_held(self.held)
        speed_percent = self._first_pass.speed_percent(rail.strip_mm, joints_rad, what)
        rail = self.check_held(self.held, rail)  # the run may have paused
        if straight is None:
            stops = self._stops(rail, joints_rad, what, above)
        else:
            stops = self._straight_stops(rail, straight, joints_rad, what)
            if speed_percent == self._run.cell.robot.speed_percent:
                speed_percent = straight.speed_percent
        rail = self.check_held(self.held, rail)
        place = {"joints_deg": np.degrees(joints_rad), "strip_mm": rail.strip_mm}
        if straight is not None:
            place |= {"from_deg": np.degrees(straight.from_rad), "speed_percent": speed_percent}
        self._run.intend(what, "robot.move", **place, seen=seen(rail, self._run.clock.pc_s()))
        reading = self._drive(stops, speed_percent, rail, self.held, what)
        self._run.clock.wait(self._run.cell.settle.robot_s)
        return reading

    def expect(self, station: Station, joints_rad: Array) -> None:
        """Prove at once the ways to joints (N, 6) that the robot goes to next, in turn."""
        self._coming.expect(station.strip_mm, joints_rad)

    def check_way(self, rail: RailReading, joints_rad: Array, what: str) -> None:
        """Refuse a motion from where the robot rests to joints (6,) that is not clear."""
        if self._run.cell.surroundings is not None:
            check_way(self._run.cell, rail.strip_mm, self._resting_rad(), joints_rad, what)

    def check_held(self, station: Station | None, taken: RailReading | None = None) -> RailReading:
        """Return a young reading of a slide that is held, at ``station``, so the robot may move."""
        return self._check_held(station, taken)[0]

    def _check_held(
        self, station: Station | None, taken: RailReading | None
    ) -> tuple[RailReading, float]:
        """Return the reading, and when it was judged."""
        rail = fresh(
            self._run.devices.rail.read, self._run.clock, self._run.cell.settle.reading_age_s, taken
        )
        now_s = self._run.clock.pc_s()
        robot_may_move(self._run.cell, rail, station, now_s)
        return rail, now_s

    def _stops(self, rail: RailReading, joints_rad: Array, what: str, above: bool) -> list[Array]:
        """Return where to go, in turn, on the way to joints (6,)."""
        cell = self._run.cell
        now_rad = joints_rad if cell.surroundings is None else self._resting_rad()
        if not above and self._coming.clear(rail.strip_mm, now_rad, joints_rad):
            return [below(cell, joints_rad), joints_rad]
        return stops_on_way(cell, rail.strip_mm, now_rad, joints_rad, what, above=above)

    def _straight_stops(
        self, rail: RailReading, straight: Straight, joints_rad: Array, what: str
    ) -> list[Array]:
        """Return where to go, in turn: to the pose to come from, unless the robot rests there."""
        before_rad = straight.from_rad
        there = bool(np.all(np.abs(self._resting_rad() - before_rad) < SAME_RAD))
        if self._run.cell.surroundings is not None:
            check_way(self._run.cell, rail.strip_mm, before_rad, joints_rad, what)
        first = [] if there else self._stops(rail, before_rad, what, above=False)
        return [*first, joints_rad]

    def _resting_rad(self) -> Array:
        """Return the joints (6,) where the robot rests, by a reading young enough to move by."""
        limit_s = self._run.cell.settle.reading_age_s
        robot = fresh(self._run.devices.robot.read, self._run.clock, limit_s, self._last)
        check_rests(self._run.cell, robot, self._run.clock.pc_s())
        self._last = robot
        return robot.joints_rad

    def begin(
        self, rail: RailReading, station: Station | None, joints_rad: Array, what: str
    ) -> RailReading:
        """Judge the readings by which the robot moves to joints (6,), immediately before it does.

        Those at hand may have grown old: by a commit, or by the motion before. Then they are taken
        again, and a robot that may stand elsewhere has its way checked again.
        """
        if self._run.cell.surroundings is not None:
            proven = self._last
            self._resting_rad()
            if self._last is not proven:
                self.check_way(rail, joints_rad, what)
        rail, judged_s = self._check_held(station, rail)
        self._last = None  # nobody knows where a motion that fails has ended
        self.began = time_of(rail, judged_s)
        return rail

    def _drive(
        self,
        stops: list[Array],
        speed_percent: float,
        rail: RailReading,
        station: Station | None,
        what: str,
    ) -> RobotReading:
        """Go to joints (6,) in turn; return the reading at the last of them."""
        for stop in stops:
            rail = self.begin(rail, station, stop, what)
            reading = self._last = self._run.devices.robot.move_to(stop, speed_percent)
        return reading
