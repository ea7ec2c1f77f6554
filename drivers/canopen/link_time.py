"""The time in which this PC has listened to a link; every wire deadline is counted in it.

A PC that was busy finds its own deadline passed and the answer, which came in time, still unread.
So the time of a link goes on only when all that has arrived was handed out, and a pause of the PC
counts as `PAUSE_S` at most.
"""

from __future__ import annotations

import time

from hilcell.ports import Clock

PAUSE_S = 0.1
BEHIND_S = 1.0  # a bus that is never empty must not stop the time


class LinkTime:
    """Written by the receiving thread alone; read by any."""

    def __init__(self, clock: Clock) -> None:
        self.listened_s = 0.0
        self.emptied_s = clock.pc_s()  # the frames handed out next came after this moment
        self.counted_s = time.monotonic()

    def emptied(self, now_s: float, pc_s: float) -> None:
        """Note that all that had arrived at ``now_s`` (monotonic), ``pc_s``, was handed out."""
        self._count(now_s)
        self.emptied_s = pc_s

    def behind(self, now_s: float) -> None:
        """Note that more waits to be handed out; one second of that counts as a pause."""
        if now_s - self.counted_s > BEHIND_S:
            self._count(now_s)

    def _count(self, now_s: float) -> None:
        self.listened_s += min(now_s - self.counted_s, PAUSE_S)
        self.counted_s = now_s
