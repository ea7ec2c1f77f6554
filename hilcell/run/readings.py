"""The readings that admit motions: young enough, and as the journal keeps them with an intent."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from hilcell.model.events import ReadingTime
from hilcell.ports import Clock, RailReading, RobotReading

# A PC that did not run between a reading and its use has an old reading and a device that is
# well. So it reads again; the interlocks judge the age of the new reading all the same.

TRIES = 5
SHARE = 0.8  # of the limit: the rest is left until the motion begins

R = TypeVar("R", RailReading, RobotReading)


def fresh(read: Callable[[], R], clock: Clock, limit_s: float, taken: R | None = None) -> R:
    """Return ``taken`` if it is well below ``limit_s`` old, or the first of some readings that is.

    Where none is, the last one is returned.
    """
    reading = read() if taken is None else taken
    for _ in range(TRIES - 1):
        if clock.pc_s() - reading.taken_s <= SHARE * limit_s:
            break
        reading = read()
    return reading


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
