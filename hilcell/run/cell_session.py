"""The interface of a run for procedures: guarded motions and points.

Its layers each know only the one below: `RunContext` has cell, devices and journal, `Mover` moves
slide and robot, `Meter` measures, `Watch` verifies tracker, slide and ambient temperature. A point
that the journal already has is returned unchanged, which makes a run resumable.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from hilcell.cell.file import Nest, Station
from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import forward
from hilcell.model.events import RemeasureRefused, StreamRecorded
from hilcell.model.point import Point, PointId
from hilcell.ports import Array
from hilcell.run.mover import StraightApproach, SweepCommand
from hilcell.run.prompts import FLANGE
from hilcell.run.states import remeasure_refusal
from hilcell.run.watch import Watch


class CellSession(Watch):
    """A cell with its devices open, as one run sees it. Used by the worker thread alone."""

    @property
    def seed(self) -> int:
        return self.log.inputs.seed

    def sweep(self, order: SweepCommand) -> StreamRecorded:
        """Sweep one axis with the tracker streaming, once in a run's life; see `Mover.sweep`."""
        if order.key in self.log.streams:
            return self.log.streams[order.key]
        self.checkpoint()
        self.verify_tracker_if_due()
        return super().sweep(order)

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
        straight: StraightApproach | None = None,
    ) -> Point:
        """Move the reflector on the flange to joints (6,) and measure it, once a run.

        Every axis comes from below, from above where the point's ``side`` is +1, or ``straight``
        from another pose. ``retake`` re-measures it; the later point supersedes the earlier.
        ``seats``: the other reflectors on the flange are measured as points of their own.
        ``nominal_deg`` (3,) are A, B, C of the target in {W}; they are recorded with several
        reflectors. The ambient temperature is checked and waiting points are re-measured first.
        """
        self.check_ambient_temperature()
        self.retake_waiting()
        count = len(self.cell.robot.seats_mm) if seats else 1
        ids = [id.at_seat(seat) for seat in range(1, count + 1)]
        waiting = [each for each in ids if retake or self.log.find(each) is None]
        if waiting:
            nominal = nominal_mm, nominal_deg if count > 1 else None
            self._flange_points(
                waiting, station, joints_rad, nominal, retake=retake, straight=straight
            )
        return self.log.point(id)

    def retake_waiting(self) -> bool:
        """Re-measure the waiting points; return whether there were any.

        Afterwards slide and robot may be elsewhere.
        """
        waiting = [self.log.points[key] for key in self.log.retakes]
        for point in waiting:
            if refused := remeasure_refusal(self.log, point):
                self.add(RemeasureRefused(key=point.key, reason=refused))
                continue
            station = self.cell.station_named(point.station)
            joints_rad = np.radians(point.commanded_deg or ())
            nominal = point.nominal_mm, point.nominal_deg
            self._flange_points([point.id], station, joints_rad, nominal, retake=True)
        return bool(waiting)

    def flange_at(self, station: Station) -> None:
        self.checkpoint()
        self.hold_station(station)
        if self.cell.layout.by_hand:
            self.request_reflector(
                FLANGE, self._parked_flange_mm(self.frames.base_in_world(station))
            )

    def _flange_points(
        self,
        ids: Sequence[PointId],
        station: Station,
        joints_rad: Array,
        nominal: tuple[object, object],
        *,
        retake: bool,
        straight: StraightApproach | None = None,
    ) -> None:
        """Move to joints (6,) and measure reflectors on the flange; ``nominal`` is the tool
        point's target, mm and deg, or None.
        """
        self.checkpoint()
        self.verify_tracker_if_due()
        self.flange_at(station)
        facts = {"nominal_mm": nominal[0]}
        facts |= {} if nominal[1] is None else {"nominal_deg": nominal[1]}
        above, what = ids[0].side > 0, ids[0].key
        rest = self.rests.robot_s, self.cell.settle.robot_s
        robot = self.robot_to(joints_rad, what, above=above, straight=straight, rest_s=rest[0])
        T_W_T = self.frames.base_in_world(station) @ forward(self.cell.robot.arm(), joints_rad)
        seats_mm, samples = self.cell.robot.seats_mm, self.cell.tracker.samples
        stray_mm = 10.0  # in the measured base: nominal errors are far less, a lost zero is more
        for n, id in enumerate(ids):
            smr_mm = seats_mm[0 if id.seat is None else id.seat - 1]
            at_mm = apply(T_W_T, (smr_mm - seats_mm[0])[None])[0]
            place = FLANGE if id.seat is None else f"{FLANGE} {id.seat}"
            measure = partial(
                self.measured_in_world, id.key, place, at_mm, samples, limit_mm=stray_mm
            )
            reading = measure() if n else self.settled(measure, *rest)
            self.record_point(
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
        """Move to joints (6,) without moving the slide and measure several reflectors.

        ``targets`` are identities and expected positions (3,), tracker's frame.
        """
        missing = [target for target in targets if not self.log.find(target[0])]
        if not missing:
            return
        self.checkpoint()
        robot = self.robot_to(joints_rad, missing[0][0].key)
        for id, near_mm in missing:
            reading = self.measured(id.key, id.target, near_mm, self.cell.tracker.samples)
            self.record_point(id, "", reading, robot, commanded_deg=np.degrees(joints_rad))

    def slide_point(self, id: PointId, station: Station, nest: Nest, *, samples: int) -> Point:
        """Measure a nest on the slide while ``station`` is held."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self.check_ambient_temperature()
        self.verify_tracker_if_due()
        self.hold_station(station)
        expected = (self.frames.base_in_world(station) @ np.append(nest.xyz_mm, 1.0))[:3]
        self.request_reflector(nest.name, expected)
        limit_mm = 2 * self.cell.layout.nest_tolerance_mm
        reading = self.measured_in_world(id.key, nest.name, expected, samples, limit_mm)
        return self.record_point(id, station.name, reading)

    def slide_now(self, id: PointId, name: str) -> Point:
        """Measure a slide nest, or ``flange``, at any slide position with the robot parked."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self.verify_tracker_if_due()
        rail = self.devices.rail.read()
        T_W_B = self.cell.layout.nominal_base(rail.strip_mm)
        if name == FLANGE:
            expected = self._parked_flange_mm(T_W_B)
        else:
            nests = {nest.name: nest.xyz_mm for nest in self.cell.layout.slide}
            expected = (T_W_B @ np.append(nests[name], 1.0))[:3]
        self.request_reflector(name, expected)
        samples = self.cell.nest_samples
        reading = self.measured_in_world(id.key, name, expected, samples)
        return self.record_point(id, "", reading)

    def _parked_flange_mm(self, T_W_B: Array) -> Array:
        """Return the flange reflector (3,) in {W} at the robot's safe pose."""
        robot = self.cell.robot
        T_B_T = forward(robot.arm(), np.radians(robot.safe_deg))
        at_mm: Array = apply(T_W_B, T_B_T[:3, 3][None])[0]
        return at_mm
