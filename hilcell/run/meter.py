"""Readings of the tracker: taken at rest, checked, and journalled before they are used.

A reflector that is carried by hand is requested by a prompt; the tracker verifies its position.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hilcell.calibration.controller_pose import check_pose
from hilcell.cell.devices import abilities, aiming_tracker, searching_tracker, two_face_tracker
from hilcell.cell.file import Nest
from hilcell.geometry.frames import inverse
from hilcell.journal.log import world_key
from hilcell.model.events import (
    NoReadingOf,
    PlaceSeen,
    PlaceTaken,
    ReadingTime,
    ReflectorPlaced,
    Three,
)
from hilcell.model.point import Point, PointId, Readings
from hilcell.ports import Array, DeviceError, NoReading, RobotReading, TrackerReading
from hilcell.run.control import HERE, RELEASE, WIDER, Choice
from hilcell.run.interlocks import check_held, check_still, check_strip, reading_time
from hilcell.run.mover import Mover
from hilcell.run.prompts import FLANGE, WIDER_MM, Prompt, Verification, where_looked


class Meter(Mover):
    """Measures at the present pose and journals the point; prompts where the tracker sees nothing
    or the reflector is carried by hand. ``last`` is the newest point of this session.
    """

    TRIES = 3  # of a measurement before the operator is prompted
    SETTLE_S = 0.1  # at least, between two readings of what still moves
    AIM_S = 1.0  # between two looks at a beam that a person aims

    last: Point | None = None

    # -- readings -----------------------------------------------------------------------------

    def measure(
        self, key: str, place: str, near_mm: Array, samples: int, *, back: bool = False
    ) -> TrackerReading | None:
        """Measure the reflector at ``place``, expected at (3,), tracker's frame; ``back``: in the
        second face.

        Tries again, then prompts the operator until the tracker measures the reflector. Returns
        None then: the tracker may have moved and is verified before the next measurement.
        """
        for tries in range(1, self.TRIES + 1):
            try:
                return self._reading(key, near_mm, samples, back=back)
            except NoReading as error:
                failed, cause = error, error.of_point(key)
                said, facts = str(error), cause.facts()
                self.add(NoReadingOf(key=key, tries=tries, reason=said, error=facts))
        not_there = "searched_mm" in failed.fields  # a reflector that was not found
        unproven = not_there and place in self._unframed and not self.log.points
        if looked := where_looked(near_mm, failed):
            cause.found += f"; expected {looked}"
        self.ask(
            Prompt.failed_reading(
                self.cell,
                key,
                place,
                near_mm,
                self.cell.tracker.find_radius_mm,
                failed,
                choices=self._choices(place),
                unproven=unproven,
            ),
            lambda: self._verify_reflector(key, near_mm),
            cause,
            {
                RELEASE: self._release_beam,
                HERE: lambda: self._take_place(HERE, key, place, near_mm),
                WIDER: lambda: self._take_place(WIDER, key, place, near_mm),
            },
        )
        return None

    # -- nests that are not where the cell file says --------------------------------------------

    @property
    def _unframed(self) -> set[str]:
        """Return the nests whose places nobody has measured at this set-up of the tracker."""
        layout, framed = self.cell.layout, world_key(self.log.set_ups.number) in self.log.frames
        return {nest.name for nest in (layout.bar if framed else layout.fixed_nests)}

    def _choices(self, place: str) -> tuple[Choice, ...]:
        """Return the answers by which an operator takes another place for a nest."""
        if place not in self._unframed:
            return ()
        able, found = abilities(self.cell), list[Choice]()
        if able["tracker_aims"]:
            found += [
                Choice(RELEASE, "let go of the beam, to put it on the nest by hand"),
                Choice(HERE, "take the place where the tracker points now"),
            ]
        if able["tracker_searches"]:
            found.append(Choice(WIDER, f"search {WIDER_MM:.0f} mm around"))
        return tuple(found)

    def _release_beam(self) -> Verification:
        try:
            aiming_tracker(self.devices.tracker).release_beam()
        except DeviceError as error:
            return Verification.failed(error, self.clock.pc_s(), RELEASE)
        return Verification(None, "", self.clock.pc_s(), choice=RELEASE)

    def _take_place(self, how: str, key: str, place: str, near_mm: Array) -> Verification:
        """Measure a nest wherever it is, and journal its place for the rest of the run."""
        tracker, reflector = self.devices.tracker, self.cell.tracker.reflector

        def take() -> TrackerReading:
            if how == HERE:
                return aiming_tracker(tracker).measure_aimed(reflector, 1)
            return searching_tracker(tracker).search(near_mm, reflector, 1, WIDER_MM)

        try:
            reading = self._fresh_reading(key, take)
        except DeviceError as error:
            return Verification.failed(error, self.clock.pc_s(), how)
        xyz_mm, off_mm = _three(reading.xyz_mm), float(np.linalg.norm(reading.xyz_mm - near_mm))
        taken = PlaceTaken(
            place=place,
            how=how,
            xyz_mm=xyz_mm,
            expected_mm=_three(near_mm),
            off_mm=off_mm,
            set_up=self.log.set_ups.number,
        )
        self.add(taken)
        return Verification(off_mm, "", reading.taken_s, xyz_mm, choice=how)

    def _nest_near(self, nest: Nest) -> Array:
        """Return where a floor nest (3,) is expected, tracker's frame, or where it was taken."""
        near_mm: Array = self.frames.tracker_from_world(nest.xyz_mm)[0]
        taken = self.log.taken.get(nest.name)
        if taken is not None and taken.set_up == self.log.set_ups.number:
            near_mm = np.array(taken.xyz_mm)
        return near_mm

    def _reading(
        self, key: str, near_mm: Array, samples: int, *, back: bool = False
    ) -> TrackerReading:
        """Return one measurement; raises `NoReading`, and `DeviceError` for an older one."""
        tracker, reflector = self.devices.tracker, self.cell.tracker.reflector
        take = two_face_tracker(tracker).measure_back if back else tracker.measure
        return self._fresh_reading(key, lambda: take(near_mm, reflector, samples))

    def _fresh_reading(self, key: str, take: Callable[[], TrackerReading]) -> TrackerReading:
        """Return a measurement; raises `DeviceError` for one that is older than its request."""
        began_s = self.clock.pc_s()
        reading = take()
        if not reading.taken_s >= began_s:
            raise DeviceError(
                "HC-T31",
                "Tracker",
                f"measure {key}",
                f"result is {began_s - reading.taken_s:.3f} s older than its request",
                act="the answer of an earlier measurement came late; resume",
                fields={"point": key, "late_s": began_s - reading.taken_s},
            )
        return reading

    def settled(
        self, measure: Callable[[], TrackerReading], rested_s: float, most_s: float
    ) -> TrackerReading:
        """Return a reading after a motion and the rest since: the first that spreads no more than
        at rest, or that at the end of the longest rest.
        """
        reading, step_s = measure(), rested_s
        while rested_s < most_s and not reading.std_mm.max() <= self.cell.settle.spread_mm:
            more_s = min(max(step_s, self.SETTLE_S), most_s - rested_s)
            self.clock.wait(more_s)
            reading, rested_s = measure(), rested_s + more_s
        return reading

    def _verify_reflector(self, key: str, near_mm: Array) -> Verification:
        """Measure once; a tracker that fails is a failed verification."""
        try:
            reading = self._reading(key, near_mm, 1)
        except DeviceError as error:
            return Verification.failed(error, self.clock.pc_s())
        off_mm = float(np.linalg.norm(reading.xyz_mm - near_mm))
        return Verification(off_mm, "", reading.taken_s, _three(reading.xyz_mm))

    def record_point(
        self,
        id: PointId,
        station: str,
        reading: TrackerReading,
        robot: RobotReading | None = None,
        **facts: object,
    ) -> Point:
        """Journal a reading with those of rail and robot; raises `DeviceError` for a slide that
        left its station and for a robot pose that differs from its joints.
        """
        rail = self.devices.rail.read()
        if self.held is not None:
            check_strip(self.cell, rail, self.held, f"after measuring {id.key}")
        now_s = self.clock.pc_s()
        body: dict[str, object] = {
            "station": station,
            "frame": "tracker",
            "reflector": reading.reflector,
            "xyz_mm": reading.xyz_mm,
            "std_mm": reading.std_mm,
            "samples": reading.samples,
            "temperature_c": reading.air and reading.air.temperature_c,
            "pressure_mbar": reading.air and reading.air.pressure_mbar,
            "humidity_percent": reading.air and reading.air.humidity_percent,
            "rail_mm": rail.position_mm,
            "strip_mm": rail.strip_mm,
            "readings": Readings(
                ReadingTime(reading.taken_s, now_s - reading.taken_s),
                reading_time(rail, now_s),
                None if robot is None else reading_time(robot, now_s),
                None if robot is None else self.began,
            ),
        }
        if robot is not None:
            check_pose(self.cell.robot, robot, f"measure {id.key}")
            body |= {"joints_deg": np.degrees(robot.joints_rad), "pose": robot.pose}
        self.last = self.point(id, **body | facts)
        return self.last

    # -- floor nests --------------------------------------------------------------------------

    def floor_nest_point(self, id: PointId, nest: Nest) -> Point:
        samples = self.cell.verification_samples if id.kind == "control" else self.cell.nest_samples
        return self.fixed_nest_point(id, nest, samples)

    def fixed_nest_point(
        self, id: PointId, nest: Nest, samples: int, *, back: bool = False, **facts: float
    ) -> Point:
        """Measure a nest on floor or bars, ``back``: in the second face, once in a run's life.

        ``facts`` are further fields of the point.
        """
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self.request_reflector(nest.name, nest.xyz_mm)
        return self._measure_floor_nest(id, nest, samples, back=back, **facts)

    def swapped_point(self, id: PointId, place: str, nest: Nest) -> Point:
        """Measure the reflector of ``place`` in a floor nest after the operator placed it there."""
        if known := self.log.find(id):
            return known
        self.checkpoint()
        self._swap(place, nest)
        return self._measure_floor_nest(id, nest, self.cell.nest_samples)

    def return_reflectors(self, nest: Nest) -> None:
        self.checkpoint()
        self._swap(nest.name, nest)

    def _measure_floor_nest(
        self, id: PointId, nest: Nest, samples: int, *, back: bool = False, **facts: float
    ) -> Point:
        while True:
            near_mm = self._nest_near(nest)
            if reading := self.measure(id.key, nest.name, near_mm, samples, back=back):
                return self.record_point(id, "", reading, None, **facts)

    # -- places that are not known yet --------------------------------------------------------

    def aimed_place(
        self,
        key: str,
        place: str,
        refusal: Callable[[Array], str],
        samples: int,
        *,
        tries: int,
        first: str = "",
    ) -> PlaceSeen | None:
        """Prompt a person to put the beam on ``place``, and measure it there, once in a run.
        ``first`` is done, and answered, before: a reflector is carried there, and rests.

        ``refusal`` takes a position (3,), tracker's frame, and returns why it is not that place, ""
        where it may be. After ``tries`` refused reflectors None. Slide and robot are at rest.
        """
        if known := self._seen(key):
            return known
        self.checkpoint()
        tracker = aiming_tracker(self.devices.tracker)
        reflector = self.cell.tracker.reflector
        tracker.release_beam()
        if first:
            self.pause(first)
        refused: list[str] = []  # the last is "" once the place is found

        def verify() -> Verification:
            self.clock.wait(self.AIM_S)
            try:
                reading = tracker.measure_aimed(reflector, 1)
            except NoReading as error:  # all else, as a lost link, ends the wait
                return Verification.failed(error, self.clock.pc_s())
            why = refusal(reading.xyz_mm)
            refused.append(why)
            if why and len(refused) < tries:
                tracker.release_beam()
                return Verification(None, why, reading.taken_s)
            return Verification(0.0, "", reading.taken_s)

        self.ask(Prompt.aim(place), verify, None)
        if refused[-1]:
            return None
        return self._record_place(key, tracker.measure_aimed(reflector, samples))

    def found_place(self, key: str, near_mm: Array, samples: int, *, radius_mm: float) -> PlaceSeen:
        """Measure a reflector expected near (3,), tracker's frame, by a wide search, once in a run;
        raises `NoReading`.
        """
        if known := self._seen(key):
            return known
        self.checkpoint()
        tracker = searching_tracker(self.devices.tracker)
        reflector = self.cell.tracker.reflector
        for tries in range(1, self.TRIES + 1):
            try:
                reading = tracker.search(near_mm, reflector, samples, radius_mm)
            except NoReading as error:
                if tries == self.TRIES:
                    raise
                self.add(NoReadingOf(key=key, tries=tries, reason=str(error), error=error.facts()))
            else:
                break
        return self._record_place(key, reading)

    def _seen(self, key: str) -> PlaceSeen | None:
        return next((each for each in self.log.happened(PlaceSeen) if each.key == key), None)

    def _record_place(self, key: str, reading: TrackerReading) -> PlaceSeen:
        """Journal a reflector's position; raises `Blocked` where slide or robot moves."""
        rail, robot = self.devices.rail.read(), self.devices.robot.read()
        check_held(self.cell, rail, self.held, f"measure {key}")
        check_still(robot, f"measure {key}")
        x, y, z = (float(value) for value in reading.xyz_mm)
        std_mm = (float(reading.std_mm[0]), float(reading.std_mm[1]), float(reading.std_mm[2]))
        seen = PlaceSeen(
            key=key,
            xyz_mm=(x, y, z),
            std_mm=std_mm,
            samples=reading.samples,
            joints_deg=np.degrees(robot.joints_rad).tolist(),
            strip_mm=rail.strip_mm,
        )
        self.add(seen)
        return seen

    # -- reflectors carried by hand -----------------------------------------------------------

    def request_reflector(self, place: str, nominal_mm: Array) -> None:
        """Request the carried reflector at ``place``, nominally (3,) in {W}, unless it is there.

        Parks the robot; the slide is held. No-op for mounted reflectors.
        """
        if not self.cell.layout.by_hand or self.log.seated == place:
            return
        self.parked()
        rail = self.devices.rail.read()
        check_held(self.cell, rail, self.held, f"place the reflector at {place}")
        near_mm, limit_mm = self._expected(place, nominal_mm, rail.strip_mm)
        prompt = Prompt.placement(self.cell, place, self.log.seated, near_mm, limit_mm)
        result = self.ask(prompt, lambda: self._verify_reflector(f"verify {place}", near_mm), None)
        assert result.xyz_mm is not None  # noqa: S101 - a verified answer has a reading
        self.add(ReflectorPlaced(place=place, xyz_mm=result.xyz_mm, strip_mm=rail.strip_mm))

    def _expected(self, place: str, nominal_mm: Array, strip_mm: float) -> tuple[Array, float]:
        """Return the expected position (3,) of a placed reflector, tracker's frame, and its limit.

        The last position, shifted by the slide's motion for nests on the slide, else the nominal.
        """
        layout = self.cell.layout
        if place in self.log.sights:
            sight = self.log.sights[place]
            rides = place not in {nest.name for nest in layout.fixed_nests}
            T_L_W = inverse(self.frames.tracker_in_world())
            along = T_L_W[:3, :3] @ np.array(layout.rail_direction)
            moved_mm = (strip_mm - sight.strip_mm) * rides * along
            return np.array(sight.xyz_mm) + moved_mm, layout.nest_tolerance_mm
        near_mm = self.frames.tracker_from_world(nominal_mm)[0]
        if "world" not in self.log.frames:
            return near_mm, self.cell.tracker.find_radius_mm
        flange_mm = 20.0  # by the nominal arm
        limit_mm = flange_mm if place == FLANGE else 2 * layout.nest_tolerance_mm
        return near_mm, limit_mm

    def _swap(self, place: str, nest: Nest) -> None:
        """Request the reflector of ``place`` in ``nest``; the robot is parked."""
        self.parked()
        near_mm = self.frames.tracker_from_world(nest.xyz_mm)[0]
        prompt = Prompt.swap(self.cell, place, nest.name, near_mm)
        self.ask(prompt, lambda: self._verify_reflector(f"verify {nest.name}", near_mm), None)


def _three(at_mm: Array) -> Three:
    x, y, z = (float(value) for value in at_mm)
    return x, y, z
