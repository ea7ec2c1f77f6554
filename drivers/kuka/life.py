"""The PC's life sign to the program ``hilcell.src``: without it a robot in motion brakes by itself.

While a motion is under way the program runs a timer of the controller up to zero; there it brakes,
latches like HC_STOP, and drops the command. The PC sets the timer back with each sign. A sign comes
only from the thread that watches the motion: an engine that hangs gives none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from drivers.kuka.c3 import C3Connection

LIFE_S = 1.5  # longer than the PC may be late itself (`Supervision`), so that it reports that first
EVERY_S = 0.2
TIMER, LIMIT = "$TIMER[10]", "HC_LIFE"
LOST = 8  # HC_ERR


class LifeSign:
    """Signs of life to one controller's program, from its first motion on."""

    def __init__(self) -> None:
        self._due_s = math.inf

    def begin(self, write: Callable[[str, str], None]) -> None:
        """A motion is about to begin: tell the program how long the PC may keep silent."""
        if self._due_s == math.inf:
            write(LIMIT, str(round(LIFE_S * 1000)))
        self._due_s = time.monotonic() + EVERY_S

    def give(self, line: C3Connection) -> None:
        """Give a sign, if one is due."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + EVERY_S
            line.write(TIMER, str(round(-LIFE_S * 1000)))
