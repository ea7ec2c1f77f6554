"""Readings of the tracker: taken at rest, judged, and journalled before anybody sees them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hilcell.calibration.controller_pose import check_pose
from hilcell.cell.devices import turning_over
from hilcell.journal.log import Point, Readings, ReadingTime
from hilcell.journal.point_id import PointId
from hilcell.ports import (
    Array,
    DeviceError,
    NoReading,
    RailReading,
    RobotReading,
    TrackerReading,
)
from hilcell.run.interlocks import check_strip
from hilcell.run.motion import Motion
from hilcell.run.prompts import Look, Prompt, beam_prompt
from hilcell.run.readings import time_of
from hilcell.run.run_context import RunContext

MEASURE_TRIES = 3

Ask = Callable[[Prompt, Callable[[], Look], NoReading | None], Look]


class Measuring:
    """Measures where slide and robot stand; asks the operator where the beam finds nothing.

    ``prove`` proves the tracker where it is doubtful: while somebody was asked it may have moved.
    """

    def __init__(
        self, run: RunContext, motion: Motion, ask: Ask, prove: Callable[[], None]
    ) -> None:
        self._run, self._motion, self._ask, self._prove = run, motion, ask, prove

    def measure_in_world(
        self,
        key: str,
        place: str,
        expected_mm: Array,
        samples: int,
        limit_mm: float | None = None,
        *,
        on_floor: bool = False,
        back: bool = False,
    ) -> TrackerReading:
        """Measure the reflector at ``place``, expected at (3,) in {W}; see `measure`.

        Raises `DeviceError` where it is further away than ``limit_mm``, once {B} was measured.
        """
        near_mm = self._run.frames.tracker_from_world(expected_mm)[0]
        reading = self.measure(key, place, near_mm, samples, on_floor=on_floor, back=back)
        if limit_mm is not None and self._run.frames.based():
            self._check_expected(key, reading, expected_mm, limit_mm)
        return reading

    def measure(
        self,
        key: str,
        place: str,
        near_mm: Array,
        samples: int,
        *,
        on_floor: bool = False,
        back: bool = False,
    ) -> TrackerReading:
        """Measure the reflector at ``place``, expected at (3,), tracker's frame; in the second face
        of a tracker that turns over where ``back``.

        Tries again, then asks the operator, until there is a good reading. After a question the
        tracker comes first, but for a nest ``on_floor``: those are what proves it.
        """
        while True:
            for tries in range(1, MEASURE_TRIES + 1):
                try:
                    return self._reading(key, near_mm, samples, back=back)
                except NoReading as error:
                    failed, cause = error, error.of_point(key)
                    facts = {"reason": str(error), "error": cause.facts()}
                    self._run.event("no reading", key=key, tries=tries, **facts)
            limit_mm = self._run.cell.tracker.find_radius_mm
            prompt = beam_prompt(self._run.cell, key, place, near_mm, limit_mm, failed)
            self._ask(prompt, lambda: self.look(key, near_mm), cause)
            if not on_floor:
                self._prove()

    def _reading(
        self, key: str, near_mm: Array, samples: int, *, back: bool = False
    ) -> TrackerReading:
        """Return one measurement; raises `NoReading`."""
        tracker = self._run.devices.tracker
        take = turning_over(tracker).measure_back if back else tracker.measure
        reflector, began_s = self._run.cell.tracker.reflector, self._run.clock.pc_s()
        reading = take(near_mm, reflector, samples)
        _check_fresh(key, reading, began_s)
        return reading

    def look(self, key: str, near_mm: Array) -> Look:
        """Look for the reflector with the beam alone; a tracker that fails sees nothing."""
        try:
            reading = self._reading(key, near_mm, 1)
        except DeviceError as error:
            at_s, silent = self._run.clock.pc_s(), not isinstance(error, NoReading)
            return Look(None, error.summary, at_s, lost=silent)
        x, y, z = (float(value) for value in reading.xyz_mm)
        off_mm = float(np.linalg.norm(reading.xyz_mm - near_mm))
        return Look(off_mm, "", reading.taken_s, (x, y, z))

    def _check_expected(
        self, key: str, reading: TrackerReading, expected_mm: Array, limit_mm: float
    ) -> None:
        found_mm = self._run.frames.world_from_tracker(reading.xyz_mm)[0]
        off_mm = math.dist(found_mm, expected_mm)
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

    def keep(
        self,
        id: PointId,
        station: str,
        reading: TrackerReading,
        robot: RobotReading | None = None,
        **facts: Any,
    ) -> Point:
        """Journal a reading with those of rail and robot; raises `DeviceError` for a slide that
        left its station meanwhile, and for a pose that is not that of its joints.
        """
        rail = self._run.devices.rail.read()
        if self._motion.held is not None:
            check_strip(self._run.cell, rail, self._motion.held, f"after measuring {id.key}")
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
            "readings": _times(reading, rail, robot, self._motion.began, self._run.clock.pc_s()),
        }
        if robot is not None:
            check_pose(self._run.cell.robot, robot, f"measure {id.key}")
            body |= {"joints_deg": np.degrees(robot.joints_rad), "pose": robot.pose}
        return self._run.point(id, **body | facts)


def _times(
    tracker: TrackerReading,
    rail: RailReading,
    robot: RobotReading | None,
    began: ReadingTime | None,
    now_s: float,
) -> Readings:
    measured = ReadingTime(tracker.taken_s, now_s - tracker.taken_s)
    if robot is None:
        return Readings(measured, time_of(rail, now_s))
    return Readings(measured, time_of(rail, now_s), time_of(robot, now_s), began)


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
