"""Whether a slide stands, judged from polls of drive and strip, and its readings where it does.

A servo that holds a position dithers. So a slide stands when every poll of a dwell shows a speed
within a window, and all their positions, the drive's and the strip's, lie within windows. A slow
creep passes any window of speed; only the spread of the positions shows it. Polls that agree with
the newest are kept, so a slide that has stood since the last reading is confirmed by one poll and
not by one more dwell.

Motions are the drive's and end by its standstill; only a reading asks for the strip, so a strip
that is lost ends no motion and lets no reading through. One in alarm has no position; then the
drive alone is judged, and `Rest.alarms` says so.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import or_
from statistics import median
from typing import Generic, TypeVar

from drivers.device_errors import RAIL
from drivers.supervision import looks
from hilcell.ports import Clock, DeviceError, RailReading, StripLost

STRIP_SPREAD_MM = 0.02  # at rest
READINGS = 5  # at least, of one dwell; the reading is their median


@dataclass(frozen=True, slots=True)
class Poll:
    """Drive and strip at one look, each in its driver's own unit: counts, or mm; a second."""

    position: float
    velocity: float
    strip: int  # counts
    alarms: int  # of the strip; 0 means that its counts are good
    powered: bool  # the drive has the power to move
    taken_s: float  # since when its oldest part may be true


@dataclass(frozen=True, slots=True)
class Windows:
    """Bounds of a slide at rest, in units of its polls: a second, from lowest to highest."""

    LONGEST_PAUSE_S = 0.1  # far below the time after which a motion counts as unattended

    speed: float
    spread: float
    strip_spread: int
    dwell_s: float

    @property
    def apart_s(self) -> float:
        """Return how far apart the polls of a dwell are at most: a long dwell has more of them."""
        return min(self.dwell_s / (READINGS - 1), self.LONGEST_PAUSE_S) + 0.001

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


class Standstill:
    """The polls of the last dwell, in the cell's time, and those since the slide last moved."""

    HISTORY_S = 60.0  # of the cell; an older poll counts for nothing

    def __init__(self, windows: Windows) -> None:
        self._windows = windows
        self._polls: deque[tuple[float, Poll]] = deque()
        self._still: list[tuple[float, Poll]] = []  # the newest first

    def forget(self) -> None:
        """Begin again: the slide is about to move."""
        self._polls.clear()
        self._still = []

    def take(self, poll: Poll, now_s: float) -> None:
        """Take a poll made at ``now_s``; drop those that neither dwell nor medians need."""
        polls = self._polls
        polls.append((now_s, poll))
        while not now_s - polls[0][0] <= self.HISTORY_S:
            polls.popleft()
        while len(polls) > READINGS and now_s - polls[1][0] >= self._windows.dwell_s:
            polls.popleft()
        self._still = self._newest_within()

    def _newest_within(self) -> list[tuple[float, Poll]]:
        """Return the newest polls whose speeds and positions all lie within the windows."""
        windows, found = self._windows, list[tuple[float, Poll]]()
        positions: list[float] = []
        strips: list[int] = []
        for at_s, poll in reversed(self._polls):
            positions.append(poll.position)
            if not poll.alarms:
                strips.append(poll.strip)
            if not (
                abs(poll.velocity) <= windows.speed
                and max(positions) - min(positions) <= windows.spread
                and max(strips, default=0) - min(strips, default=0) <= windows.strip_spread
            ):
                break
            found.append((at_s, poll))
        return found

    @property
    def begun(self) -> bool:
        """Whether the speed of the newest poll lies within its window."""
        return bool(self._still)

    @property
    def rest(self) -> Rest | None:
        """Return where the slide stands; None while it moves or is not known to stand."""
        still = self._still
        if len(still) < READINGS or not still[0][0] - still[-1][0] >= self._windows.dwell_s:
            return None
        last = [poll for _, poll in still[:READINGS]]
        return Rest(
            median(poll.position for poll in last),
            median(poll.strip for poll in last),
            reduce(or_, (poll.alarms for poll in last)),
        )

    @property
    def unrest(self) -> tuple[float, float, int]:
        """Return the highest speed of the last dwell, and the spreads of drive and strip.

        Raises `ValueError` before the first poll.
        """
        polls = [poll for _, poll in self._polls]
        positions, strips = [poll.position for poll in polls], [poll.strip for poll in polls]
        speed = max(abs(poll.velocity) for poll in polls)
        return speed, max(positions) - min(positions), max(strips) - min(strips)


P = TypeVar("P", bound=Poll)


class Standing(Generic[P]):
    """The polls of one slide, and what they say of its rest; used by one thread."""

    POLL_S = 0.02
    SETTLE_S = 10.0  # wire deadline, beside the dwell
    STRIP_TRIES = 3  # dwells

    def __init__(
        self,
        poll: Callable[[str], P],
        clock: Clock,
        windows: Windows,
        *,
        units_per_mm: float,
        strip_counts_per_mm: float,
        alarm_text: Callable[[int], str],
    ) -> None:
        """``poll`` looks once, for an operation; its position is in units, ``windows`` as well."""
        self._poll, self._clock, self._windows = poll, clock, windows
        self._units_per_mm, self._strip_per_mm = units_per_mm, strip_counts_per_mm
        self._alarm_text = alarm_text
        self.standstill = Standstill(windows)
        self.now_s = 0.0  # of the cell, at the last poll

    @property
    def rest(self) -> Rest | None:
        """Return where the slide stands by the last polls; None while it is not known to stand."""
        return self.standstill.rest

    def poll(self, operation: str) -> P:
        now = self._poll(operation)
        self.now_s = self._clock.now_s()
        self.standstill.take(now, self.now_s)
        return now

    def pause(self) -> None:
        """Wait for the next poll; a slide that seems to stand is polled as its dwell needs it."""
        apart_s = self._windows.apart_s if self.standstill.begun else 0.0
        self._clock.wait(max(self.POLL_S, apart_s))

    def confirm(self, operation: str) -> P:
        """Poll once, or for a dwell where older polls do not prove that the slide stands."""
        now = self.poll(operation)
        for _ in range(self._windows.polls):
            if self.rest is not None or not self.standstill.begun:
                break
            self.pause()
            now = self.poll(operation)
        return now

    def check_strip(self, operation: str, now: P) -> P:
        """Return ``now``, or a later poll of a strip in alarm; raises `StripLost` if it stays so.

        Nothing else asks the strip: motions are the drive's, and end by the drive's standstill.
        """
        for _ in range(self.STRIP_TRIES * self._windows.polls):
            if not self._alarms(now):
                return now
            self.pause()
            now = self.poll(operation)
        if not (alarms := self._alarms(now)):
            return now
        raise StripLost(
            "HC-S01",
            RAIL.name,
            operation,
            f"strip sensor: {self._alarm_text(alarms)}",
            act="check the strip and its head, then resume",
            fields={"alarms": alarms},
        )

    def read(self, ended_s: float | None) -> RailReading:
        """Return a reading whose strip reads, of a slide that may move; raises `DeviceError`.

        ``ended_s`` is when the last motion was seen to have ended.
        """
        return self._reading(self.check_strip("read", self.confirm("read")), ended_s)

    def settle(self, ended_s: float | None) -> RailReading:
        """Return a reading of a slide at rest whose strip reads; raises `DeviceError`."""
        limit_s = self.SETTLE_S + self._windows.dwell_s
        for _ in looks(limit_s):
            now = self.poll("settle")
            if self.rest is not None:
                now = self.check_strip("settle", now)
            if self.rest is not None:  # a strip that is back may show that the slide moves
                return self._reading(now, ended_s)
            self.pause()
        raise self._restless(now, limit_s)

    def _reading(self, now: P, ended_s: float | None) -> RailReading:
        """Return the poll ``now``, or the medians of which it is the newest part."""
        rest = self.rest
        at: Poll | Rest = now if rest is None else rest
        return RailReading(
            position_mm=at.position / self._units_per_mm,
            strip_mm=at.strip / self._strip_per_mm,
            velocity_mm_s=now.velocity / self._units_per_mm,
            still=rest is not None,
            powered=now.powered,
            taken_s=now.taken_s,
            ended_s=ended_s,
        )

    def _alarms(self, now: P) -> int:
        """Return the strip's alarms in the polls that a reading is made of."""
        return now.alarms if self.rest is None else self.rest.alarms

    def _restless(self, now: P, limit_s: float) -> DeviceError:
        strip_mm, speed_mm_s = now.strip / self._strip_per_mm, now.velocity / self._units_per_mm
        windows = self._windows
        return RAIL.failed(
            "HC-S06",
            "settle",
            f"strip {strip_mm:.2f} mm, speed {speed_mm_s:.3f} mm/s",
            expected=f"{READINGS} readings within +-1 count, the drive's within "
            f"{windows.spread / self._units_per_mm:.3f} mm, <= "
            f"{windows.speed / self._units_per_mm:.3f} mm/s, over {windows.dwell_s:.2f} s, "
            f"within {limit_s:.0f} s",
            strip_mm=strip_mm,
            speed_mm_s=speed_mm_s,
            waited_s=self.SETTLE_S,
        )


def strip_spread(counts_per_mm: float) -> int:
    """Return the window of a strip at rest, in counts: one about the middle at least."""
    return max(2, round(STRIP_SPREAD_MM * counts_per_mm))


def check_travel(position_mm: float, lowest_mm: float, highest_mm: float) -> None:
    """Refuse a target outside the travel; raises `DeviceError`."""
    if not lowest_mm <= position_mm <= highest_mm:
        raise RAIL.failed(
            "HC-R36",
            "move",
            f"target {position_mm:.3f} mm",
            expected=f"{lowest_mm:.1f} .. {highest_mm:.1f} mm",
            target_mm=position_mm,
            lowest_mm=lowest_mm,
            highest_mm=highest_mm,
        )
