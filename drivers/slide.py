"""The slide by drive and strip: standstill, readings at rest, agreement of the scales.

A servo that holds a position dithers. So a slide is at rest when every poll of a dwell shows a
speed within a window, and all positions, of drive and strip, lie within windows: only their spread
shows a slow creep. Polls that agree with the newest are kept, so a slide at rest since the last
reading is confirmed by one poll.

Motions are the drive's and end by its standstill; only a reading needs the strip, so a lost strip
ends no motion and allows no reading. A strip in alarm has no position: the drive alone is judged,
and `Rest.alarms` has the alarms.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from heapq import nlargest
from operator import or_
from statistics import median
from typing import Generic, TypeVar

from drivers.device_errors import RAIL
from drivers.supervision import polls
from hilcell.ports import Clock, DeviceError, RailReading, StripLost

STRIP_SPREAD_MM = 0.02  # at rest
READINGS = 5  # at least, of one dwell; the reading is their median


@dataclass(frozen=True, slots=True)
class Poll:
    """Drive and strip at one poll, in the units of the driver: counts, or mm; per second."""

    position: float
    velocity: float
    strip: int  # counts
    alarms: int  # of the strip; 0: its counts are valid
    powered: bool  # the drive has the power to move
    taken_s: float  # age of its oldest part


@dataclass(frozen=True, slots=True)
class Windows:
    """Bounds of a slide at rest, in the units of its polls."""

    LONGEST_PAUSE_S = 0.1  # far below the time after which a motion counts as unattended

    speed: float
    spread: float
    strip_spread: int
    dwell_s: float

    @property
    def interval_s(self) -> float:
        """The longest time between two polls of a dwell: a long dwell has more of them."""
        return min(self.dwell_s / (READINGS - 1), self.LONGEST_PAUSE_S) + 0.001

    @property
    def polls(self) -> int:
        return max(READINGS, math.ceil(self.dwell_s / self.interval_s) + 1)


@dataclass(frozen=True, slots=True)
class Rest:
    """Where a slide is at rest, in the units of its polls: medians of the last `READINGS`.

    ``alarms`` are the strip's in any of them: then its median is invalid.
    """

    position: float
    strip: float
    alarms: int = 0


class Standstill:
    """The polls of the last dwell, in the cell's time, and those since the slide last moved."""

    HISTORY_S = 60.0  # of the cell; older polls are dropped

    def __init__(self, windows: Windows) -> None:
        self._windows = windows
        self._polls: deque[tuple[float, Poll]] = deque()
        self._still: list[tuple[float, Poll]] = []  # the newest first

    def forget(self) -> None:
        """Drop all polls: the slide is about to move."""
        self._polls.clear()
        self._still = []

    def add(self, poll: Poll, now_s: float) -> None:
        """Add a poll made at ``now_s``; drop those that neither dwell nor medians need."""
        polls = self._polls
        polls.append((now_s, poll))
        while not now_s - polls[0][0] <= self.HISTORY_S:
            polls.popleft()
        while len(polls) > READINGS and now_s - polls[1][0] >= self._windows.dwell_s:
            polls.popleft()
        self._still = self._newest_within()

    def _newest_within(self) -> list[tuple[float, Poll]]:
        """Return the newest polls whose speeds and positions all lie within the windows."""
        windows, still = self._windows, list[tuple[float, Poll]]()
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
            still.append((at_s, poll))
        return still

    @property
    def seems_still(self) -> bool:
        return bool(self._still)

    @property
    def rest(self) -> Rest | None:
        """Where the slide is at rest; None while it moves or is not known to be at rest."""
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
    def spreads(self) -> tuple[float, float, int]:
        """The highest speed of the last dwell, and the spreads of drive and strip.

        Raises `ValueError` before the first poll.
        """
        polls = [poll for _, poll in self._polls]
        positions, strips = [poll.position for poll in polls], [poll.strip for poll in polls]
        speed = max(abs(poll.velocity) for poll in polls)
        return speed, max(positions) - min(positions), max(strips) - min(strips)


P = TypeVar("P", bound=Poll)


class SlideMonitor(Generic[P]):
    """Polls one slide and reads it at rest; used by one thread."""

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
        """``poll`` polls once, for an operation; its position is in units, ``windows`` as well."""
        self._poll, self._clock, self._windows = poll, clock, windows
        self._units_per_mm, self._strip_per_mm = units_per_mm, strip_counts_per_mm
        self._alarm_text = alarm_text
        self.standstill = Standstill(windows)
        self.now_s = 0.0  # of the cell, at the last poll

    @property
    def rest(self) -> Rest | None:
        return self.standstill.rest

    def poll(self, operation: str) -> P:
        now = self._poll(operation)
        self.now_s = self._clock.now_s()
        self.standstill.add(now, self.now_s)
        return now

    def pause(self) -> None:
        """Wait for the next poll, in the interval of a dwell where the slide seems still."""
        interval_s = self._windows.interval_s if self.standstill.seems_still else 0.0
        self._clock.wait(max(self.POLL_S, interval_s))

    def confirm(self, operation: str) -> P:
        """Poll once, or for a dwell where older polls do not show that the slide is at rest."""
        now = self.poll(operation)
        for _ in range(self._windows.polls):
            if self.rest is not None or not self.standstill.seems_still:
                break
            self.pause()
            now = self.poll(operation)
        return now

    def check_strip(self, operation: str, now: P) -> P:
        """Return ``now``, or a later poll of a strip in alarm; raises `StripLost` if it stays so.

        Nothing else needs the strip: motions are the drive's, and end by the drive's standstill.
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
            fields={"alarms": alarms},
        )

    def read(self, ended_s: float | None) -> RailReading:
        """Return a reading with a valid strip, of a slide that may move; raises `DeviceError`.

        ``ended_s`` is when the end of the last motion was detected.
        """
        return self._reading(self.check_strip("read", self.confirm("read")), ended_s)

    def settle(self, ended_s: float | None) -> RailReading:
        """Return a reading at rest with a valid strip; raises `DeviceError`."""
        limit_s = self.SETTLE_S + self._windows.dwell_s
        for _ in polls(limit_s):
            now = self.poll("settle")
            if self.rest is not None:
                now = self.check_strip("settle", now)
            if self.rest is not None:  # a strip that reads again may show that the slide moves
                return self._reading(now, ended_s)
            self.pause()
        raise self._not_at_rest(now, limit_s)

    def _reading(self, now: P, ended_s: float | None) -> RailReading:
        """Return the poll ``now``, or the medians whose newest poll it is."""
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
        return now.alarms if self.rest is None else self.rest.alarms

    def _not_at_rest(self, now: P, limit_s: float) -> DeviceError:
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
    """Return the window of a strip at rest, in counts: at least one about the middle."""
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


class ScaleGuard:
    """Compares the distances of one motion by drive and strip: a wrong scale makes them differ.

    A wrong scale shows in every step of a motion. All other differences arise at once, and are
    judged at rest: a reference set by homing, a strip that has jumped, a slide that slipped at its
    start. So the largest step does not count, nor does the next one of a strip that is not read at
    the SYNC of the drive. Where one of the two does not move at all, or the strip is in alarm,
    scales are not judged; the next step includes what was missed.
    """

    SHARE = 0.05  # of the distance; scales of real slides differ by far less
    APART_MM = 5.0
    LAG_S = 0.1  # between the two readings of a strip on a wire of its own

    def __init__(self, still_mm: float, speed_mm_s: float, *, synchronous: bool) -> None:
        """``still_mm``: noise of either at rest; ``synchronous``: both are read at one SYNC."""
        self._still_mm = still_mm
        self._apart_mm = self.APART_MM + self.LAG_S * speed_mm_s
        self._last: tuple[float, float] | None = None
        self._drive_mm = self._strip_mm = 0.0
        self._uncounted, self._parted_mm = 1 if synchronous else 2, [0.0]

    def add(self, drive_mm: float, strip_mm: float) -> None:
        """Add a poll without strip alarms."""
        last = self._last
        if last is None:
            self._last = drive_mm, strip_mm
            return
        drive_step_mm, strip_step_mm = drive_mm - last[0], strip_mm - last[1]
        if min(abs(drive_step_mm), abs(strip_step_mm)) > self._still_mm:
            self._drive_mm += drive_step_mm
            self._strip_mm += strip_step_mm
            self._parted_mm.append(abs(strip_step_mm - drive_step_mm))
            self._last = drive_mm, strip_mm

    def contradiction(self) -> tuple[float, float] | None:
        """Return the distances by drive and strip, in mm, where they differ too much; else None."""
        drive_mm, strip_mm = self._drive_mm, self._strip_mm
        apart_mm = abs(strip_mm - drive_mm) - sum(nlargest(self._uncounted, self._parted_mm))
        allowed_mm = self._apart_mm + self.SHARE * max(abs(strip_mm), abs(drive_mm))
        return None if apart_mm <= allowed_mm else (drive_mm, strip_mm)

    def check(self, operation: str) -> None:
        """Raise `DeviceError` where the distances by drive and strip differ too much."""
        if (distances := self.contradiction()) is None:
            return
        drive_mm, strip_mm = distances
        ratio = strip_mm / drive_mm if drive_mm else float("inf")
        act = (
            "correct counts_per_mm of the drive or of the strip by that ratio, or check coupling "
            "and strip head; then home the rail"
        )
        if ratio < 0:
            act = (
                "drive and strip count in opposite directions: change the polarity of the drive "
                "(607Eh of CiA 402) or the strip's direction of counting; then home the rail"
            )
        raise RAIL.failed(
            "HC-R47",
            operation,
            f"the slide went {drive_mm:.1f} mm by the drive and {strip_mm:.1f} mm by "
            f"the strip: a ratio of {ratio:.4g}",
            expected=f"one distance within {self.SHARE:.0%}",
            act=act,
            drive_mm=drive_mm,
            strip_mm=strip_mm,
            ratio=ratio,
        )
