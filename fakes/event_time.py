"""The time of a recording that is replayed: it passes by what is asked, never by itself.

Questions that were asked once only are landmarks, on whatever wire: a driver that asks one is as
far as the recorded one was then. So devices of one motion keep in step, as a strip and its drive.
"""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections.abc import Iterable


class EventTime:
    """Seconds of the recording, one for all wires; safe to use from several threads."""

    def __init__(self) -> None:
        self._landmarks_s: list[float] = []
        self._lock = threading.Lock()
        self.landmark_s = 0.0  # that was passed last

    def expect(self, times_s: Iterable[float]) -> None:
        """Take the times at which a wire was asked what it was asked once only."""
        self._landmarks_s = sorted([*self._landmarks_s, *times_s])

    def part(self) -> tuple[float, float]:
        """Return the times of the landmarks between which the replay is."""
        at = bisect_right(self._landmarks_s, self.landmark_s)
        return self.landmark_s, (self._landmarks_s[at : at + 1] or [float("inf")])[0]

    def pass_landmark(self, time_s: float) -> None:
        """A question was asked that was asked once only, at ``time_s``."""
        with self._lock:
            self.landmark_s = max(self.landmark_s, time_s)
