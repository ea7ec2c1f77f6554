"""The guarded hands of a run: procedures move and measure with them.

A point that the journal already holds is returned as it is: that, and nothing else, is what makes
a run resumable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hilcell.cell.devices import Devices
from hilcell.cell.file import Cell, Nest, Station
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Point
from hilcell.journal.point_id import PointId
from hilcell.journal.run_journal import Records
from hilcell.ports import Array, Clock, RailReading, RobotReading, StripLost
from hilcell.run.measuring import Ask, Measuring
from hilcell.run.motion import Motion, Straight
from hilcell.run.operator import Operator
from hilcell.run.prompts import FLANGE
from hilcell.run.remeasure import still_refused
from hilcell.run.room_guard import RoomGuard
from hilcell.run.run_context import RunContext
from hilcell.run.station_guard import StationGuard
from hilcell.run.strip_guard import StripGuard
from hilcell.run.tracker_guard import TrackerGuard

__all__ = ["FLANGE", "CellSession"]

STRAY_MM = 10.0  # of a pose in the measured base: nominal errors are far less, a lost zero is more


class CellSession(RunContext):
    """A cell with its devices open, as one run sees it. Used by the worker thread alone."""

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
        super().__init__(cell, devices, clock, journal, checkpoint, pause)
        self._motion = Motion(self)
        self._measuring = Measuring(self, self._motion, ask, self.prove_where_doubtful)
        self._operator = Operator(self, self._motion, self._measuring, ask)
        self._guard = TrackerGuard(self, self.floor_point)
        self._room = RoomGuard(self, ask)
        self._strip = StripGuard(self, self._motion, ask)
        self._stations = StationGuard(self, self._motion, self._guard, self._held_point)
        self._arm = cell.robot.arm()
        self._parked_mm = forward(self._arm, np.radians(cell.robot.safe_deg))[:3, 3]  # in {B}

    # -- motions ------------------------------------------------------------------------------

    @property
    def held(self) -> Station | None:
        """Return the station at which the slide is held."""
        return self._motion.held

    def home_rail(self) -> None:
        """Find the drive's reference; the robot goes to its safe pose first."""
        self._motion.home_rail()

    def rail_to(self, position_mm: float) -> None:
        """Move by the drive alone, without the strip, and hold."""
        self._motion.rail_to(position_mm)

    def hold_station(self, station: Station, *, again: bool = False) -> None:
        """Bring the slide to ``station`` by the strip, hold it there, and prove that it is there.

        ``again`` approaches it where it is held, and leaves the proof to the caller.
        """
        if again:
            self._motion.hold_station(station, again=True)
        else:
            self._stations.hold(station)

    def rail_referenced(self) -> bool:
        """Whether drive and absolute strip agree, which proves the drive's reference."""
        return self._motion.rail_referenced()

    def await_strip(self, lost: StripLost) -> None:
        """Hold the slide and suspend the run until its strip reads well; no station is held."""
        self._strip.wait(lost)

    def park_robot(self) -> None:
        """Bring the robot to its safe pose."""
        self.checkpoint()
        self._motion.park_robot()

    def robot_to(self, joints_rad: Array, what: str) -> RobotReading:
        """Go to joints (6,), every axis from below, and settle."""
        return self._motion.robot_to(joints_rad, what)

    def expect(self, station: Station, joints_rad: Array) -> None:
        """Prove at once the ways to joints (N, 6) that the robot goes to next, in turn."""
        self._motion.expect(station, joints_rad)

    def check_way(self, rail: RailReading, joints_rad: Array, what: str) -> None:
        """Refuse a motion from where the robot rests to joints (6,) that is not clear."""
        self._motion.check_way(rail, joints_rad, what)

    def check_held(self) -> RailReading:
        """Return a young reading of a slide that is held, at its station, so the robot may move."""
        return self._motion.check_held(self.held)

    def begin_sweep(self, rail: RailReading, joints_rad: Array, what: str) -> None:
        """Judge the readings by which the robot sweeps to joints (6,), immediately before it."""
        self._motion.begin(rail, self.held, joints_rad, what)

    # -- the tracker's set-up -----------------------------------------------------------------

    def frame_world(self) -> None:
        """Frame {W} from the floor nests, or prove that the frame in the journal still holds."""
        self._guard.frame_world()

    def close_step(self, *, carried: bool = False) -> None:
        """Prove the tracker at the end of a step that has measured something.

        Where the reflector is carried by hand to the nests, only if ``carried``.
        """
        if carried or not self.cell.layout.by_hand:
            self._guard.prove_new()

    def prove_where_doubtful(self) -> None:
        """Prove it after a pause, and after many points."""
        self._guard.prove_where_doubtful()

    # -- points -------------------------------------------------------------------------------

    def flange_point(
        self,
        id: PointId,
        station: Station,
        joints_rad: Array,
        *,
        nominal_mm: Array | None = None,
        nominal_deg: Array | None = None,
        retake: bool = False,
        seats: bool = False,
        straight: Straight | None = None,
    ) -> Point:
        """Send the reflector on the flange to joints (6,) and measure it, once in a run's life.

        Every axis comes from below, or from above where the point's ``side`` is +1, or all come
        ``straight`` from another pose.
        ``retake`` re-measures it; the later point supersedes, the earlier stays journalled.
        ``seats``: the other reflectors on the flange are measured there as well, each a point of
        its own. ``nominal_deg`` (3,) are A, B, C of the target in {W}, kept where they are.
        Points that wait to be re-measured come first, and a room that is as it was.
        """
        self._room.check()
        self.retake_waiting()
        count = len(self.cell.robot.seats_mm) if seats else 1
        ids = [id.at_seat(seat) for seat in range(1, count + 1)]
        waiting = [each for each in ids if retake or self.log.find(each) is None]
        if waiting:
            facts = {"nominal_mm": nominal_mm}
            if nominal_deg is not None and count > 1:
                facts["nominal_deg"] = nominal_deg
            self._flange_points(
                waiting, station, joints_rad, facts, retake=retake, straight=straight
            )
        return self.log.point(id)

    def retake_waiting(self) -> bool:
        """Re-measure the points that wait for it; return whether there were any.

        Only where nothing is assumed about where slide and robot stand.
        """
        waiting = [self.log.points[key] for key in self.log.retakes]
        for point in waiting:
            if refused := still_refused(self.log, point.key):
                self.event("retake refused", key=point.key, reason=refused)
                continue
            facts: dict[str, Any] = {"nominal_mm": point.nominal_mm}
            if point.nominal_deg is not None:
                facts["nominal_deg"] = point.nominal_deg
            self._flange_points(
                [point.id],
                self.cell.station_named(point.station),
                np.radians(point.commanded_deg or ()),
                facts,
                retake=True,
            )
        return bool(waiting)

    def flange_at(self, station: Station) -> None:
        """Hold ``station`` and have the reflector on the flange."""
        self.checkpoint()
        self.hold_station(station)
        if self.cell.layout.by_hand:
            self._operator.seat(FLANGE, self._parked_flange_mm(self.frames.base_in_world(station)))

    def _flange_points(
        self,
        ids: Sequence[PointId],
        station: Station,
        joints_rad: Array,
        facts: Mapping[str, Any],
        *,
        retake: bool,
        straight: Straight | None = None,
    ) -> None:
        """Go to joints (6,) and measure reflectors on the flange there; only of the tool point is a
        nominal target known.
        """
        self.checkpoint()
        self._guard.prove_where_doubtful()
        self.flange_at(station)
        above, what = ids[0].side > 0, ids[0].key
        robot = self._motion.robot_to(joints_rad, what, above=above, straight=straight)
        T_W_T = self.frames.base_in_world(station) @ forward(self._arm, joints_rad)
        seats_mm, samples = self.cell.robot.seats_mm, self.cell.tracker.samples
        for n, id in enumerate(ids):
            smr_mm = seats_mm[0 if id.seat is None else id.seat - 1]
            at_mm = apply(T_W_T, (smr_mm - seats_mm[0])[None])[0]
            place = FLANGE if id.seat is None else f"{FLANGE} {id.seat}"
            reading = self._measuring.measure_in_world(id.key, place, at_mm, samples, STRAY_MM)
            self._measuring.keep(
                id,
                station.name,
                reading,
                self.devices.robot.read() if n else robot,
                **(facts if id.seat is None else {}),
                smr_mm=smr_mm,
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
            reading = self._measuring.measure(id.key, id.target, near_mm, self.cell.tracker.samples)
            self._measuring.keep(id, "", reading, robot, commanded_deg=np.degrees(joints_rad))

    def floor_point(self, id: PointId, nest: Nest) -> Point:
        """Measure a nest on the floor."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._operator.seat(nest.name, nest.xyz_mm)
        proves = id.kind == "control"
        samples = self.cell.proof_samples if proves else self.cell.nest_samples
        reading = self._measuring.measure_in_world(
            id.key, nest.name, nest.xyz_mm, samples, on_floor=True
        )
        return self._measuring.keep(id, "", reading)

    def back_point(self, id: PointId, nest: Nest, samples: int) -> Point:
        """Measure a nest on the floor in the tracker's second face."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        reading = self._measuring.measure_in_world(
            id.key, nest.name, nest.xyz_mm, samples, on_floor=True, back=True
        )
        return self._measuring.keep(id, "", reading)

    def borrowed_point(self, id: PointId, place: str, nest: Nest) -> Point:
        """Measure the reflector of ``place`` in a floor nest, once it was carried there."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._operator.borrow(place, nest)
        reading = self._measuring.measure_in_world(
            id.key, nest.name, nest.xyz_mm, self.cell.nest_samples, on_floor=True
        )
        return self._measuring.keep(id, "", reading)

    def restored(self, nest: Nest) -> None:
        """Have every borrowed reflector put back where it belongs."""
        self.checkpoint()
        self._operator.borrow(nest.name, nest)

    def slide_point(self, id: PointId, station: Station, nest: Nest, *, samples: int) -> Point:
        """Measure a nest on the slide while ``station`` is held."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._room.check()
        self._guard.prove_where_doubtful()
        self.hold_station(station)
        expected = (self.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        self._operator.seat(nest.name, expected)
        limit_mm = 2 * self.cell.layout.nest_tolerance_mm
        reading = self._measuring.measure_in_world(id.key, nest.name, expected, samples, limit_mm)
        return self._measuring.keep(id, station.name, reading)

    def _held_point(self, id: PointId, station: Station, nest: Nest) -> Point:
        """Measure a nest on a slide that is held, as quickly as a target."""
        expected = (self.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        samples = self.cell.tracker.samples
        reading = self._measuring.measure_in_world(id.key, nest.name, expected, samples)
        return self._measuring.keep(id, station.name, reading)

    def slide_now(self, id: PointId, name: str) -> Point:
        """Measure a nest on the slide, or ``flange``, wherever the slide stands, robot parked."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._guard.prove_where_doubtful()
        rail = self.devices.rail.read()
        T_W_B = self.cell.layout.nominal_base(rail.strip_mm)
        if name == FLANGE:
            expected = self._parked_flange_mm(T_W_B)
        else:
            nests = {nest.name: nest.xyz_mm for nest in self.cell.layout.slide}
            expected = (T_W_B @ np.append(nests[name], 1.0))[:3]
        self._operator.seat(name, expected)
        samples = self.cell.nest_samples
        reading = self._measuring.measure_in_world(id.key, name, expected, samples)
        return self._measuring.keep(id, "", reading)

    def _parked_flange_mm(self, T_W_B: Array) -> Array:
        """Return where the flange's reflector (3,) is in {W} with the robot at its safe pose."""
        at_mm: Array = apply(T_W_B, self._parked_mm[None])[0]
        return at_mm
