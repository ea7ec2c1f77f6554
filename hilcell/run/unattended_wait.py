"""How an unattended run waits until the cause of a failed reading has gone: bounded, and patient.

A person who walks through the beam is gone in seconds, a lamp that dazzles the tracker in an hour.
So looks come after 10 s, 20 s, 40 s and so on; when the time is over, the run ends as a fault. A
cause that comes back soon after a good look is looked at ever more seldom, too: a look at a strip
that was frozen is no proof before the slide has moved.
"""

from __future__ import annotations

import math

from hilcell.ports import Clock

FIRST_LOOK_S, LONGEST_APART_S = 10.0, 300.0
SLICE_S = 0.5  # in which an answer of somebody who attends after all is noticed


class UnattendedWait:
    """All waits of one session: together at most ``limit_s`` of the cell's time."""

    def __init__(self, clock: Clock, limit_s: float) -> None:
        self._clock, self._left_s = clock, limit_s
        self._apart_s = self._due_s = FIRST_LOOK_S
        self._looked_s = -math.inf

    @property
    def over(self) -> bool:
        """Whether no time is left."""
        return not self._left_s > 0.0

    def begin(self) -> None:
        """Begin a wait: the first look comes soon, unless the same cause may be back at once."""
        if not self._clock.now_s() - self._looked_s <= self._apart_s:
            self._apart_s = self._due_s = FIRST_LOOK_S

    def look_due(self) -> bool:
        """Let a slice of time pass; return whether to look now."""
        slice_s = min(SLICE_S, self._left_s)
        self._clock.wait(slice_s)
        self._left_s -= slice_s
        self._due_s -= slice_s
        if self._due_s > 0.0 and not self.over:
            return False
        self._apart_s = min(2.0 * self._apart_s, LONGEST_APART_S)
        self._due_s = self._apart_s
        self._looked_s = self._clock.now_s()
        return True
