"""Rules of single measurements: I2, I3, I4, I14, and I8, I9, I11 for points."""

from __future__ import annotations

import math

import msgspec

from hilcell.invariants.bodies import Measured
from hilcell.invariants.motions import FUTURE_S
from hilcell.invariants.scene import Scene, is_proof, pose_of
from hilcell.invariants.tally import Tally
from hilcell.journal.journal import Record
from hilcell.journal.log import Readings, ReadingTime

CARRIES = ("reflector", "temperature_c", "frame", "station")  # None where nothing measures it


class Measurements:
    """Judges each point."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._check, self._scene = tally.check, scene

    def take(self, record: Record) -> None:
        """Judge a record."""
        if record.kind != "point":
            return
        point, scene, key = msgspec.convert(record.body, Measured), self._scene, record.key
        allowed = not (scene.ended or scene.waits)
        self._check("I3", record, allowed, f"{key} measured while {scene.state}")
        once = key not in scene.points or point.retaken
        self._check("I8", record, once, f"{key} counted twice")
        found = f"{key} measured by session {point.session}, {scene.session} holds the run"
        self._check("I11", record, point.session == scene.session, found)
        self._carries(record, point)
        if point.station:
            self._at_station(record, point)
        self._times(record, point.readings)
        if scene.session > 1 and scene.framed and not is_proof(key):
            what = f"{key} added before the tracker was verified"
            self._check("I9", record, scene.verified, what)

    def _carries(self, record: Record, point: Measured) -> None:
        missing = [name for name in CARRIES if name not in record.body]
        if point.station and point.commanded_deg and point.smr_mm is None:
            missing.append("smr_mm")
        self._check("I4", record, not missing, f"{record.key} lacks {', '.join(missing)}")
        if point.commanded_deg and point.group != "campaign":
            last = self._scene.last_key or "none"
            here = pose_of(last) == pose_of(record.key)
            self._check("I4", record, here, f"{record.key}: the last motion: {last}")

    def _at_station(self, record: Record, point: Measured) -> None:
        scene, name = self._scene, point.station
        resumed = scene.session > 1
        what = f"{record.key}: {name} was not found held since the run resumed"
        self._check("I9" if resumed else "I2", record, scene.held == name, what)
        station = scene.station(name)
        wanted_mm = math.nan if station is None else station.strip_mm
        limit_mm = 2 * scene.cell.rail.strip_tolerance_mm
        held = abs(point.strip_mm - wanted_mm) <= limit_mm + 1e-9
        self._check("I2", record, held, f"{record.key}: strip {point.strip_mm:.2f} mm at {name}")

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
        ages = [each.age_s for each in (readings.tracker, readings.rail, *_one(readings.robot))]
        known = all(FUTURE_S <= age_s < math.inf for age_s in ages)
        self._check("I14", record, known, f"{key}: readings {ages} s old")

    def _rested(self, record: Record, name: str, rested_s: float, rest_s: float) -> None:
        wanted_s = rest_s / self._scene.inputs.time_factor
        what = f"{record.key}: {rested_s:.3f} s after the {name}'s motion, wanted {wanted_s:g} s"
        self._check("I3", record, rested_s >= wanted_s, what)
        self._check("I4", record, rested_s >= 0.0, f"{record.key}: older than the {name}'s motion")


def _one(reading: ReadingTime | None) -> list[ReadingTime]:
    return [] if reading is None else [reading]
