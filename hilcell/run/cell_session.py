"""The guarded hands of a run: what procedures move and measure with.

Every motion passes the interlocks with readings taken for it; every measurement is taken at rest
and journalled before anybody sees it. A point that the journal already holds is returned as it
is: that, and nothing else, is what makes a run resumable.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hilcell.calibration.frames import Frames
from hilcell.cell.devices import Devices
from hilcell.cell.file import Cell, Nest, Station
from hilcell.geometry.frames import inverse
from hilcell.geometry.kinematics import forward
from hilcell.journal.journal import Journal
from hilcell.journal.log import Log, Point, Readings, ReadingTime
from hilcell.journal.point_id import PointId
from hilcell.ports import (
    Array,
    Clock,
    DeviceError,
    NoReading,
    RailReading,
    RobotReading,
    TrackerReading,
)
from hilcell.run.fresh_readings import fresh
from hilcell.run.interlocks import (
    check_held,
    check_joint_limits,
    check_strip,
    rail_may_move,
    robot_may_move,
)
from hilcell.run.prompts import Look, Prompt
from hilcell.run.reflector_prompts import FLANGE, beam_prompt, seat_prompt
from hilcell.run.retake import still_refused
from hilcell.run.states import CALIBRATION, StateMachine
from hilcell.run.strip_loop import approach_station

__all__ = ["FLANGE", "CellSession"]

FLANGE_TOLERANCE_MM = 20.0  # of a seat, by the nominal arm
STRAY_MM = 10.0  # of a pose in the measured base: nominal errors are far less, a lost zero is more
MEASURE_TRIES = 3


class CellSession:
    """A cell with its devices open, as one run sees it. Used by the worker thread alone."""

    def __init__(
        self,
        cell: Cell,
        devices: Devices,
        clock: Clock,
        journal: Journal,
        log: Log,
        *,
        checkpoint: Callable[[], None],
        ask: Callable[[Prompt, Callable[[], Look], NoReading | None], Look],
    ) -> None:
        self.cell, self.devices, self.clock = cell, devices, clock
        self.log, self.frames = log, Frames(cell, log)
        self.checkpoint = checkpoint
        self._ask = ask
        self._journal = journal
        self._held: Station | None = None
        self._arm = cell.robot.arm()
        self._calibration = StateMachine(
            CALIBRATION, log.states["calibration"], lambda body: journal.append("state", "", body)
        )

    # -- what was reached ---------------------------------------------------------------------

    def reached(self, state: str) -> bool:
        """Whether the journal proves this state of the calibration, or a later one."""
        order = CALIBRATION.states
        return order.index(self._calibration.state) >= order.index(state)

    def reach(self, trigger: str) -> None:
        """Take a step of the calibration machine, unless the journal proves that it was taken."""
        target = next(row[2] for row in CALIBRATION.rows if row[0] == trigger)
        if not self.reached(target):
            self._calibration.fire(trigger)

    def event(self, what: str, **facts: object) -> None:
        """Journal something worth knowing."""
        self._journal.append("event", "", {"what": what} | facts)

    def intend(self, key: str, action: str, **facts: object) -> None:
        """Journal what is about to be done."""
        self._journal.append("intent", key, {"action": action} | facts)

    def frame(self, key: str, matrix: Array, **facts: object) -> None:
        """Journal a frame as a homogeneous matrix (4, 4)."""
        self._journal.append("frame", key, {"matrix": matrix} | facts)

    def verdict(self, key: str, *, holds: bool, **facts: object) -> None:
        """Journal a judgement; a verdict that does not hold makes the run's exit code 1."""
        self._journal.append("verdict", key, {"holds": holds} | facts)

    @property
    def seed(self) -> int:
        """Return the run's seed, from which random targets are drawn."""
        return self.log.inputs.seed

    @property
    def folder(self) -> Path:
        """Return the run's folder."""
        return self._journal.path.parent

    @property
    def held(self) -> Station | None:
        """Return the station at which the slide is held."""
        return self._held

    # -- the rail -----------------------------------------------------------------------------

    def home_rail(self) -> None:
        """Find the drive's reference; the robot goes to its safe pose first."""
        self._prepare_rail("rail.home", {})
        self.devices.rail.home()
        self.devices.rail.hold()

    def rail_to(self, position_mm: float) -> None:
        """Move by the drive alone, without the strip, and hold."""
        self._prepare_rail("rail.move", {"position_mm": position_mm})
        self.devices.rail.move_to(position_mm)
        self.devices.rail.settle()
        self._hold_rail()

    def hold_station(self, station: Station, *, again: bool = False) -> None:
        """Bring the slide to ``station`` by the strip and hold it there.

        A slide that a resumed run finds at the station, by the strip, stays there.
        """
        if self._held == station and not again:
            return
        if not again and self._stands_at(station):
            self._held = station
            self.event("station found held", station=station.name)
            return
        self._prepare_rail("rail.approach", {"station": station.name})
        approach = approach_station(self.devices.rail, self.cell.rail, station)
        self._hold_rail()
        reading = self.devices.rail.read()
        check_strip(self.cell, reading, station, "hold")
        self._held = station
        self.event(
            "station held",
            station=station.name,
            tries=approach.tries,
            strip_mm=reading.strip_mm,
            rail_mm=reading.position_mm,
        )

    def _stands_at(self, station: Station) -> bool:
        held = [r.body["station"] for r in self.log.events if r.body["what"] == "station held"]
        if self.log.session < 2 or not held or held[-1] != station.name:
            return False
        reading = self.devices.rail.read()
        off_mm = abs(reading.strip_mm - station.strip_mm)
        return reading.still and not reading.powered and off_mm <= self.cell.rail.strip_tolerance_mm

    def rail_referenced(self) -> bool:
        """Whether drive and absolute strip agree, which proves the drive's reference."""
        reading = self.devices.rail.read()
        return abs(reading.position_mm - reading.strip_mm) <= self.cell.rail.slip_limit_mm

    def _prepare_rail(self, action: str, facts: dict[str, object]) -> None:
        self.checkpoint()
        self._held = None
        parked = self._park_robot()  # read at rest, after its motion ended
        robot = fresh(self.devices.robot.read, self.cell.settle.reading_age_s, parked)
        rail_may_move(self.cell, robot, time.monotonic())
        self.intend("", action, **facts)

    def _fresh_rail(self) -> RailReading:
        return fresh(self.devices.rail.read, self.cell.settle.reading_age_s)

    def _hold_rail(self) -> None:
        self.devices.rail.hold()
        self.clock.wait(self.cell.settle.rail_s)

    # -- the robot ----------------------------------------------------------------------------

    def _park_robot(self) -> RobotReading:
        """Bring the robot to its safe pose unless it is there; return its reading there."""
        safe_rad = np.radians(self.cell.robot.safe_deg)
        now = self.devices.robot.read()
        if bool(np.all(np.abs(now.joints_rad - safe_rad) < 1e-4)):
            return now
        robot_may_move(self.cell, self._fresh_rail(), None, time.monotonic())
        self.intend("", "robot.park")
        return self.devices.robot.move_to(safe_rad, self.cell.robot.speed_percent)

    def park_robot(self) -> None:
        """Bring the robot to its safe pose."""
        self.checkpoint()
        self._park_robot()

    def robot_to(self, joints_rad: Array, what: str) -> RobotReading:
        """Go to joints (6,), every axis from below, and settle.

        Coming from one side on every axis takes the joints' backlash out of the error.
        """
        check_joint_limits(self.cell, joints_rad, what)
        robot_may_move(self.cell, self._fresh_rail(), self._held, time.monotonic())
        self.intend(what, "robot.move", joints_deg=np.degrees(joints_rad))
        before = joints_rad - np.radians(self.cell.robot.approach_deg)
        self.devices.robot.move_to(before, self.cell.robot.speed_percent)
        reading = self.devices.robot.move_to(joints_rad, self.cell.robot.speed_percent)
        self.clock.wait(self.cell.settle.robot_s)
        return reading

    # -- measurements -------------------------------------------------------------------------

    def flange_point(
        self,
        id: PointId,
        station: Station,
        joints_rad: Array,
        *,
        nominal_mm: Array | None = None,
        retake: bool = False,
    ) -> Point:
        """Send the reflector on the flange to joints (6,) and measure it, once in a run's life.

        ``retake`` re-measures it; the later point supersedes, the earlier stays journalled.
        Points that wait to be re-measured come first.
        """
        self.retake_waiting()
        known = self.log.find(id)
        if known is not None and not retake:
            return known
        return self._flange_point(id, station, joints_rad, nominal_mm, retake=retake)

    def retake_waiting(self) -> bool:
        """Re-measure the points that wait for it; return whether there were any.

        Only where nothing is assumed about where slide and robot stand.
        """
        waiting = [self.log.points[key] for key in self.log.retakes]
        for point in waiting:
            if refused := still_refused(self.log, point.key):
                self.event("retake refused", key=point.key, reason=refused)
                continue
            self._flange_point(
                point.id,
                self.cell.station_named(point.station),
                np.radians(point.commanded_deg or ()),
                point.nominal_mm,
                retake=True,
            )
        return bool(waiting)

    def _flange_point(
        self,
        id: PointId,
        station: Station,
        joints_rad: Array,
        nominal_mm: Array | tuple[float, ...] | None,
        *,
        retake: bool,
    ) -> Point:
        self.checkpoint()
        self.hold_station(station)
        self._seat(FLANGE, self._parked_flange_mm(self.frames.base_in_world(station)))
        robot = self.robot_to(joints_rad, id.key)
        expected = self.frames.base_in_world(station) @ forward(self._arm, joints_rad)
        reading = self._measure_in_world(id.key, FLANGE, expected[:3, 3], self.cell.tracker.samples)
        if self.frames.based():
            self._check_expected(id.key, reading, expected[:3, 3], STRAY_MM)
        return self._keep(
            id,
            station.name,
            reading,
            robot,
            nominal_mm=nominal_mm,
            smr_mm=self.cell.robot.smr_mm,
            commanded_deg=np.degrees(joints_rad),
            retaken=retake,
        )

    def pose_points(self, joints_rad: Array, targets: Sequence[tuple[PointId, Array]]) -> None:
        """Go to joints (6,) where the slide stands and measure several reflectors there.

        ``targets`` gives each one's identity and its expected position (3,), tracker's frame.
        """
        missing = [target for target in targets if not self.log.find(target[0])]
        if not missing:
            return
        self.checkpoint()
        robot = self.robot_to(joints_rad, missing[0][0].key)
        for id, near_mm in missing:
            reading = self._measure(id.key, id.target, near_mm, self.cell.tracker.samples)
            self._keep(id, "", reading, robot, commanded_deg=np.degrees(joints_rad))

    def floor_point(self, id: PointId, nest: Nest) -> Point:
        """Measure a nest on the floor."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._seat(nest.name, nest.xyz_mm)
        samples = self.cell.layout.nest_samples
        reading = self._measure_in_world(id.key, nest.name, nest.xyz_mm, samples)
        return self._keep(id, "", reading)

    def slide_point(self, id: PointId, station: Station, nest: Nest, *, samples: int) -> Point:
        """Measure a nest on the slide while ``station`` is held."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self.hold_station(station)
        expected = (self.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        self._seat(nest.name, expected)
        reading = self._measure_in_world(id.key, nest.name, expected, samples)
        if self.frames.based():
            self._check_expected(id.key, reading, expected, 2 * self.cell.layout.nest_tolerance_mm)
        return self._keep(id, station.name, reading)

    def slide_now(self, id: PointId, name: str) -> Point:
        """Measure a nest on the slide, or ``flange``, wherever the slide stands, robot parked."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        rail = self.devices.rail.read()
        T_W_B = self.cell.layout.nominal_base(rail.strip_mm)
        if name == FLANGE:
            expected = self._parked_flange_mm(T_W_B)
        else:
            nests = {nest.name: nest.xyz_mm for nest in self.cell.layout.slide}
            expected = (T_W_B @ np.append(nests[name], 1.0))[:3]
        self._seat(name, expected)
        reading = self._measure_in_world(id.key, name, expected, self.cell.layout.nest_samples)
        return self._keep(id, "", reading)

    def _parked_flange_mm(self, T_W_B: Array) -> Array:
        """Return where the flange's reflector (3,) is in {W} with the robot at its safe pose."""
        at_mm: Array = (T_W_B @ forward(self._arm, np.radians(self.cell.robot.safe_deg)))[:3, 3]
        return at_mm

    # -- a reflector that is carried by hand --------------------------------------------------

    def _seat(self, place: str, nominal_mm: Array) -> None:
        """Have the one reflector carried to ``place``, nominally (3,) in {W}, unless it is there.

        Robot parked, slide held. Mounted reflectors are where they are.
        """
        if not self.cell.layout.by_hand or self.log.seated == place:
            return
        self._park_robot()
        rail = self.devices.rail.read()
        check_held(self.cell, rail, self._held, f"seat the reflector at {place}")
        near_mm, limit_mm = self._expected(place, nominal_mm, rail.strip_mm)
        prompt = seat_prompt(self.cell, place, self.log.seated, near_mm, limit_mm)
        seen = self._ask(prompt, lambda: self._look(f"look at {place}", near_mm), None)
        self.event("seated", place=place, xyz_mm=seen.xyz_mm, strip_mm=rail.strip_mm)

    def _expected(self, place: str, nominal_mm: Array, strip_mm: float) -> tuple[Array, float]:
        """Return where a seated reflector (3,) will be, tracker's frame, and within which distance.

        Where it sat before tells that best; what rides on the slide has moved along the rail since.
        """
        layout = self.cell.layout
        if place in self.log.sights:
            sight = self.log.sights[place]
            rides = place not in {nest.name for nest in layout.floor}
            T_L_W = inverse(self.frames.tracker_in_world())
            along = T_L_W[:3, :3] @ np.array(layout.rail_direction)
            moved_mm = (strip_mm - sight.strip_mm) * rides * along
            return np.array(sight.xyz_mm) + moved_mm, layout.nest_tolerance_mm
        near_mm = self.frames.tracker_from_world(nominal_mm)[0]
        if "world" not in self.log.frames:
            return near_mm, self.cell.tracker.find_radius_mm
        limit_mm = FLANGE_TOLERANCE_MM if place == FLANGE else 2 * layout.nest_tolerance_mm
        return near_mm, limit_mm

    # -- readings -----------------------------------------------------------------------------

    def _measure_in_world(
        self, key: str, place: str, expected_mm: Array, samples: int
    ) -> TrackerReading:
        near_mm = self.frames.tracker_from_world(expected_mm)[0]
        return self._measure(key, place, near_mm, samples)

    def _measure(self, key: str, place: str, near_mm: Array, samples: int) -> TrackerReading:
        while True:
            for tries in range(1, MEASURE_TRIES + 1):
                try:
                    return self._reading(key, near_mm, samples)
                except NoReading as error:
                    cause, reason = error.of_point(key), error.summary
                    facts = cause.facts()
                    self.event("no reading", key=key, tries=tries, reason=str(error), error=facts)
            limit_mm = self.cell.tracker.find_radius_mm
            prompt = beam_prompt(self.cell, key, place, near_mm, limit_mm, reason)
            self._ask(prompt, lambda: self._look(key, near_mm), cause)

    def _reading(self, key: str, near_mm: Array, samples: int) -> TrackerReading:
        """Return one measurement; raises `NoReading`."""
        began_s = time.monotonic()
        reading = self.devices.tracker.measure(near_mm, self.cell.tracker.reflector, samples)
        _check_fresh(key, reading, began_s)
        return reading

    def _look(self, key: str, near_mm: Array) -> Look:
        """Look for the reflector with the beam alone; a tracker that fails sees nothing."""
        try:
            reading = self._reading(key, near_mm, 1)
        except DeviceError as error:
            return Look(None, error.summary, time.monotonic())
        x, y, z = (float(value) for value in reading.xyz_mm)
        off_mm = float(np.linalg.norm(reading.xyz_mm - near_mm))
        return Look(off_mm, "", reading.taken_s, (x, y, z))

    def _check_expected(
        self, key: str, reading: TrackerReading, expected_mm: Array, limit_mm: float
    ) -> None:
        found_mm = self.frames.world_from_tracker(reading.xyz_mm)[0]
        off_mm = float(np.linalg.norm(found_mm - expected_mm))
        if not off_mm <= limit_mm:
            raise DeviceError(
                "HC-T17",
                "Tracker",
                f"measure {key}",
                f"reflector {off_mm:.2f} mm from its expected place",
                wanted=f"<= {limit_mm:.1f} mm",
                act="another reflector was caught, tool, base or tracker moved, or an axis lost "
                "its zero; check, resume",
                fields={"point": key, "off_mm": off_mm, "limit_mm": limit_mm},
            )

    def _keep(
        self,
        id: PointId,
        station: str,
        reading: TrackerReading,
        robot: RobotReading | None = None,
        **facts: Any,
    ) -> Point:
        rail = self.devices.rail.read()
        if self._held is not None:
            check_strip(self.cell, rail, self._held, f"after measuring {id.key}")
        body = {
            "id": id,
            "group": id.group,
            "station": station,
            "frame": "tracker",
            "reflector": reading.reflector,
            "xyz_mm": reading.xyz_mm,
            "std_mm": reading.std_mm,
            "samples": reading.samples,
            "temperature_c": reading.air and reading.air.temperature_c,
            "pressure_mbar": reading.air and reading.air.pressure_mbar,
            "humidity_percent": reading.air and reading.air.humidity_percent,
            "session": self.log.session,
            "rail_mm": rail.position_mm,
            "strip_mm": rail.strip_mm,
            "readings": _times(reading, rail, robot),
        }
        if robot is not None:
            body |= {"joints_deg": np.degrees(robot.joints_rad), "pose": robot.pose}
        self._journal.append("point", id.key, body | facts)
        return self.log.point(id)


def _times(tracker: TrackerReading, rail: RailReading, robot: RobotReading | None) -> Readings:
    now_s = time.monotonic()

    def of(reading: RailReading | RobotReading) -> ReadingTime:
        return ReadingTime(reading.taken_s, now_s - reading.taken_s, reading.ended_s)

    seen = ReadingTime(tracker.taken_s, now_s - tracker.taken_s)
    return Readings(seen, of(rail), None if robot is None else of(robot))


def _check_fresh(key: str, reading: TrackerReading, began_s: float) -> None:
    if not reading.taken_s >= began_s:
        raise DeviceError(
            "HC-T31",
            "Tracker",
            f"measure {key}",
            f"result is {began_s - reading.taken_s:.3f} s older than its request",
            act="an answer of an earlier measurement was still under way; resume",
            fields={"point": key, "late_s": began_s - reading.taken_s},
        )
