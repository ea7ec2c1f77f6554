"""When a motion has failed: it gets no further, or it takes far longer than was planned.

A fixed deadline would end a slow motion that is well, and none at all would let an arm creep for
ever. So the time that a motion may take follows from its plan, in the cell's time, and it passes
only as fast as the override lets the motion go: an override that is lowered on the way is no fault.
A simulated cell may run faster than any clock, so a motion is overdue only after the real time of a
stall as well: that is no pause of a busy PC.
"""

from __future__ import annotations

import numpy as np

from drivers.supervision import Patience
from hilcell.ports import Array


class MotionLimits:
    """Progress and time of one motion of several axes."""

    PLANNED_TIMES = 3.0  # the plan knows no ramps, no blending and no limits of torque
    MARGIN_S = 10.0
    LOOK_S = 1.0  # progress is looked at once in several polls

    def __init__(self, planned_s: float, stall_s: float, progress: float) -> None:
        """``planned_s`` is the motion's duration at full override; ``progress`` in axis units."""
        self.limit_s = self.PLANNED_TIMES * planned_s + self.MARGIN_S
        self.spent_s = 0.0
        self._stall_s, self._progress = stall_s, progress
        self._patience = Patience(stall_s, self.LOOK_S)
        self._at_least = Patience(stall_s, self.LOOK_S)
        self._position: Array | None = None
        self._stands = False
        self._now_s: float | None = None
        self._share = 1.0

    def stalled(self, position: Array) -> bool:
        """Whether no axis has got further by ``progress`` for ``stall_s`` of real time."""
        self._stands = self._position is not None and bool(
            np.all(np.abs(position - self._position) <= self._progress)
        )
        if not self._stands:
            self._position, self._patience = position, Patience(self._stall_s, self.LOOK_S)
            return False
        return self._patience.over()

    def overdue(self, now_s: float, override_percent: float) -> bool:
        """Whether the motion has taken longer than it may; ``now_s`` is the cell's time.

        Between two looks the lower of their overrides counts. A robot that stands is stalled, not
        overdue.
        """
        share = override_percent / 100.0
        if self._now_s is not None:
            self.spent_s += (now_s - self._now_s) * min(share, self._share)
        self._now_s, self._share = now_s, share
        real = self._at_least.over()
        return real and not self._stands and not self.spent_s <= self.limit_s


def planned_s(distance_deg: Array, speed_deg_s: Array, speed_percent: float) -> float:
    """Return how long the slowest axis takes at full override, without ramps."""
    return float(np.max(np.abs(distance_deg) / speed_deg_s)) * 100.0 / speed_percent
