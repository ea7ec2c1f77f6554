"""Rules of motions: I1, I2, I5, I11, I14, and I9 for motions to what is acknowledged."""

from __future__ import annotations

import math

from hilcell.invariants.scene import Scene, of_rail
from hilcell.invariants.tally import Tally
from hilcell.journal.journal import Record
from hilcell.model.events import StationHeld
from hilcell.model.point import Point, Readings
from hilcell.model.records import Intended, SeenBefore

SAFE_POSE_DEG = 0.1
FUTURE_S = -0.001  # two readings of one clock
NOT_SEEN = SeenBefore(taken_s=math.nan, age_s=math.nan, still=False)  # admits nothing


class Motions:
    """Judges each motion by what was known when it was journalled."""

    def __init__(self, tally: Tally, scene: Scene) -> None:
        self._check, self._scene = tally.check, scene

    def take(self, record: Record) -> None:
        """Judge a record."""
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
        wrong = _not_parked(seen, self._scene)
        self._check("I1", record, not wrong, f"{motion.action}: {wrong}")

    def _robot(self, record: Record, motion: Intended) -> None:
        scene, key = self._scene, record.key
        if key and key in scene.points:
            asked = key in scene.again
            self._check("I9", record, asked, f"{key} is acknowledged, and is driven to again")
        seen = motion.seen or NOT_SEEN
        self._young(record, motion.action, seen.age_s)
        station = scene.station(scene.held)
        wanted_mm = None if station is None else station.strip_mm
        wrong = _not_held(seen, wanted_mm, 2 * scene.cell.rail.strip_tolerance_mm)
        self._check("I2", record, not wrong, f"{motion.action} {key}: {wrong}")

    def _young(self, record: Record, motion: str, age_s: float) -> None:
        limit_s = self._scene.cell.settle.reading_age_s
        young = FUTURE_S <= age_s <= limit_s
        what = f"{motion} by a reading {age_s:.3f} s old, at most {limit_s:g} s"
        self._check("I14", record, young, what)


def _not_parked(seen: SeenBefore, scene: Scene) -> str:
    """Return why a reading does not say that the robot rests at its safe pose; "" where it does."""
    safe_deg = scene.cell.robot.safe_deg
    pairs = zip(seen.joints_deg, safe_deg, strict=False)
    off_deg = max((abs(found - safe) for found, safe in pairs), default=math.nan)
    if len(seen.joints_deg) != len(safe_deg) or not off_deg <= SAFE_POSE_DEG:
        return f"the robot was {off_deg:.2f} deg off its safe pose"
    return _before_end(seen) if seen.still else "the robot was moving"


def _not_held(seen: SeenBefore, wanted_mm: float | None, limit_mm: float) -> str:
    """Return why a reading does not say that the slide rests and is held; "" where it does."""
    if not seen.still:
        return "the slide was moving"
    if seen.powered is not False:
        return "the drive had power to move"
    found_mm = math.nan if seen.strip_mm is None else seen.strip_mm
    if wanted_mm is not None and not abs(found_mm - wanted_mm) <= limit_mm + 1e-9:
        return f"strip {found_mm:.2f} mm, the station {wanted_mm:.2f} +-{limit_mm:.2f} mm"
    return _before_end(seen)


def _before_end(seen: SeenBefore) -> str:
    """Return that a reading was taken before the motion had ended; "" where it was not."""
    late = seen.ended_s is None or seen.taken_s >= seen.ended_s
    return "" if late else "the reading was taken before the motion had ended"
