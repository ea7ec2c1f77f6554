"""Whether a slide stands, judged from polls: a servo that holds a position dithers.

A slide stands when every poll of a dwell shows a speed within a window, and all their positions,
the drive's and the strip's, lie within windows. A slow creep passes any window of speed; only the
spread of the positions shows it. A strip in alarm has no position; then the drive alone is judged,
and `Rest.alarms` says so. Polls that agree with the newest are kept, so a slide that has
stood since the last reading is confirmed by one poll and not by one more dwell.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import reduce
from operator import or_
from statistics import median
from typing import Protocol

READINGS = 5  # at least, of one dwell; the reading is their median
HISTORY_S = 60.0  # of the cell; an older poll counts for nothing
LONGEST_PAUSE_S = 0.1  # far below the time after which a motion counts as unattended
ROUNDING_S = 0.001


class Poll(Protocol):
    """Drive and strip at one look, each in its driver's own unit: counts, or mm."""

    @property
    def position(self) -> float:
        """Return the drive's position."""

    @property
    def velocity(self) -> float:
        """Return the drive's speed, a second."""

    @property
    def strip(self) -> int:
        """Return the strip's counts."""

    @property
    def alarms(self) -> int:
        """Return the strip's alarms; 0 means that its counts are good."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Bounds of a slide at rest, in units of its polls: a second, from lowest to highest."""

    speed: float
    spread: float
    strip_spread: int
    dwell_s: float

    @property
    def apart_s(self) -> float:
        """Return how far apart the polls of a dwell are at most: a long dwell has more of them."""
        return min(self.dwell_s / (READINGS - 1), LONGEST_PAUSE_S) + ROUNDING_S

    @property
    def polls(self) -> int:
        """Return how many polls see a whole dwell."""
        return max(READINGS, math.ceil(self.dwell_s / self.apart_s) + 1)


@dataclass(frozen=True, slots=True)
class Rest:
    """Where a slide stands, in its polls' units: medians of the last `READINGS` of them.

    ``alarms`` are the strip's in any of them: then its median says nothing.
    """

    position: float
    strip: float
    alarms: int = 0


@dataclass(frozen=True, slots=True)
class Unrest:
    """The most that the polls of the last dwell have shown, in their units."""

    speed: float
    spread: float
    strip_spread: int


class Standstill:
    """The polls since the slide last moved, in the cell's time."""

    def __init__(self, windows: Windows) -> None:
        self._windows = windows
        self._polls: deque[tuple[float, Poll]] = deque()
        self._recent: deque[tuple[float, Poll]] = deque()  # of a dwell, all of them

    def forget(self) -> None:
        """Begin again: the slide is about to move."""
        self._polls.clear()
        self._recent.clear()

    def take(self, poll: Poll, now_s: float) -> None:
        """Take a poll made at ``now_s``, and drop those that no longer count."""
        self._recent.append((now_s, poll))
        self._drop_needless(self._recent, now_s)
        if not abs(poll.velocity) <= self._windows.speed:
            self._polls.clear()
            return
        self._polls.append((now_s, poll))
        self._drop_moved()
        self._drop_needless(self._polls, now_s)

    @property
    def begun(self) -> bool:
        """Whether the speed of the newest poll lies within its window."""
        return bool(self._polls)

    @property
    def rest(self) -> Rest | None:
        """Return where the slide stands; None while it moves or is not known to stand."""
        polls = self._polls
        if len(polls) < READINGS or not polls[-1][0] - polls[0][0] >= self._windows.dwell_s:
            return None
        last = [poll for _, poll in polls][-READINGS:]
        return Rest(
            median(poll.position for poll in last),
            median(poll.strip for poll in last),
            reduce(or_, (poll.alarms for poll in last)),
        )

    @property
    def unrest(self) -> Unrest:
        """Return why the slide does not stand; raises `ValueError` before the first poll."""
        polls = [poll for _, poll in self._recent]
        positions, strips = [poll.position for poll in polls], [poll.strip for poll in polls]
        return Unrest(
            max(abs(poll.velocity) for poll in polls),
            max(positions) - min(positions),
            max(strips) - min(strips),
        )

    def _drop_moved(self) -> None:
        """Keep the newest polls whose positions all lie within the windows."""
        windows, kept = self._windows, 0
        positions: list[float] = []
        strips: list[int] = []
        for _, poll in reversed(self._polls):
            positions.append(poll.position)
            if not poll.alarms:
                strips.append(poll.strip)
            if not (
                max(positions) - min(positions) <= windows.spread
                and max(strips, default=0) - min(strips, default=0) <= windows.strip_spread
            ):
                break
            kept += 1
        while len(self._polls) > kept:
            self._polls.popleft()

    def _drop_needless(self, polls: deque[tuple[float, Poll]], now_s: float) -> None:
        """Drop polls that are too old, and those that neither dwell nor medians need."""
        while not now_s - polls[0][0] <= HISTORY_S:
            polls.popleft()
        while len(polls) > READINGS and now_s - polls[1][0] >= self._windows.dwell_s:
            polls.popleft()
