"""The reading that admits a motion, as the journal keeps it with the motion's intent."""

from __future__ import annotations

import numpy as np

from hilcell.journal.log import ReadingTime
from hilcell.ports import RailReading, RobotReading


def time_of(reading: RailReading | RobotReading, now_s: float) -> ReadingTime:
    """Return when a reading was taken, and how old it is."""
    return ReadingTime(reading.taken_s, now_s - reading.taken_s, reading.ended_s)


def seen(reading: RailReading | RobotReading, now_s: float) -> dict[str, object]:
    """Return a reading of the other device: it rests, and is held or where it may be."""
    when = time_of(reading, now_s)
    facts = {"taken_s": when.taken_s, "age_s": when.age_s, "ended_s": when.ended_s}
    if isinstance(reading, RobotReading):
        state: dict[str, object] = {"joints_deg": np.degrees(reading.joints_rad)}
    else:
        state = {"strip_mm": reading.strip_mm, "powered": reading.powered}
    return facts | {"still": reading.still} | state
