"""Readings that are young enough to move by, also on a PC that is busy now and then.

A PC that did not run between a reading and its use has an old reading and a device that is well. So
it reads again; the interlocks judge the age of the new reading all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from hilcell.ports import Clock, RailReading, RobotReading

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
