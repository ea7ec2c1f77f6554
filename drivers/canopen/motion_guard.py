"""Bounds of one slide, and guards of one motion: its speed and its scale.

The unit of 606Ch and 6081h is a setting of the drive (CiA 402-2, 60A9h, or its maker's own): a
drive in rpm or in 0.1 counts/s moves at another speed than ordered and reports it back as right.
Positions (6064h) and time do not depend on that unit.

A position was sampled before the end of its poll, and after the poll before, or the one before that
where a frame came twice. So durations and speeds are intervals: a PC that polls late widens them.
The largest step counts as the next largest: homing sets a new reference, and a reference may be
lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.canopen.process_image import Snapshot
from drivers.device_errors import RAIL
from drivers.slide import ScaleGuard, Windows
from hilcell.ports import Array


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds that a healthy slide never exceeds, in counts and seconds, and the scale to mm."""

    counts_per_mm: float
    strip_counts_per_mm: float
    strip_at_sync: bool  # it is on the drive's bus
    lowest: int
    highest: int
    speed: float
    acceleration: float
    homing_s: float  # planned, from the far end of the travel
    window: int  # arrived, or progress
    windows: Windows  # at rest

    def mm(self, counts: float) -> str:
        return f"{counts / self.counts_per_mm:.3f} mm"

    def travel_s(self, distance: float) -> float:
        """Planned duration of a motion over ``distance``, from rest to rest."""
        peak = min(self.speed, math.sqrt(abs(distance) * self.acceleration))
        return abs(distance) / peak + peak / self.acceleration if peak else 0.0

    @property
    def ramp_s(self) -> float:
        return self.speed / self.acceleration


OVERSPEED = 1.2


@dataclass(frozen=True, slots=True)
class SpeedBounds:
    """Bounds by the last polls; each value (n - 2,), of the window from poll i to the newest."""

    gone: Array  # displacement up to now, without the excess of the largest step
    path: Array  # all steps
    at_least_s: Array
    at_most_s: Array
    between_s: Array  # the longest time between two polls
    slowest: Array  # by the drive; 0 where it has changed its direction
    fastest: Array
    seen_s: Array  # from poll to poll
    said: Array  # the distance by the drive's speeds

    @staticmethod
    def _sums(values: Array) -> Array:
        """Return the sum of each value and those behind it."""
        return np.cumsum(values[::-1])[::-1]

    @staticmethod
    def _tops(values: Array) -> Array:
        """Return the largest of each value and those behind it."""
        return np.maximum.accumulate(values[::-1])[::-1]

    @staticmethod
    def _jumps(steps: Array) -> Array:
        """Return by how much the largest of each step and those behind it exceeds the next one."""
        found, largest, size, next_size = [], 0.0, 0.0, 0.0
        for step in steps[::-1].tolist():
            if abs(step) > size:
                largest, size, next_size = step, abs(step), size
            else:
                next_size = max(next_size, abs(step))
            found.append(math.copysign(size - next_size, largest))
        return np.array(found[::-1])

    @classmethod
    def of(cls, since_s: Array, until_s: Array, position: Array, speed: Array) -> SpeedBounds:
        """Bounds by polls, arrays (n,): each taken between ``since_s`` and ``until_s``. ``speed``
        is signed, by the drive; units are the caller's.
        """
        steps, size = np.diff(position), np.abs(speed)
        forward = speed * np.sign(speed[-1])
        seen_s = np.diff(until_s)
        count = len(position) - 2
        return cls(
            gone=np.abs(cls._sums(steps) - cls._jumps(steps))[:count],
            path=cls._sums(np.abs(steps))[:count],
            at_least_s=np.maximum(0.0, since_s[-1] - until_s)[:count],
            at_most_s=(until_s[-1] - since_s)[:count],
            between_s=cls._tops(until_s - since_s)[:count],
            slowest=np.maximum(0.0, -cls._tops(-forward))[:count],
            fastest=cls._tops(size)[:count],
            seen_s=cls._sums(seen_s)[:count],
            said=cls._sums(seen_s * (size[1:] + size[:-1]) / 2)[:count],
        )


@dataclass(frozen=True, slots=True)
class Speeds:
    """Mean speeds over a window, by positions and time and by 606Ch, and its distance."""

    by_positions: float
    by_drive: float
    distance: float

    @property
    def factor(self) -> float:
        return self.by_positions / self.by_drive if self.by_drive else np.inf


class SpeedGuard:
    """Compares the drive's speed with positions and time, over the polls of one motion."""

    POLLS = 50  # one second of polls
    CONTRADICTION = 1.5  # filters, and speeds that change between two polls
    FASTER_LAG_S, SLOWER_LAG_S = 0.02, 0.06  # of the filters of 606Ch, up the ramp and down
    # Distances from which on a slide counts as faster, or slower, than its drive reports.
    FAST_MM, SLOW_MM = 0.5, 2.0

    def __init__(
        self, now_s: float, speed: float, acceleration: float, units_per_mm: float
    ) -> None:
        """``now_s`` is the cell's time before the motion; speeds are in units of a position."""
        self._before_s = self._now_s = now_s
        self._speed, self._acceleration = speed, acceleration
        self._units_per_mm = units_per_mm
        self._polls: deque[tuple[float, float, float, float]] = deque(maxlen=self.POLLS)
        self._bounds: SpeedBounds | None = None

    def add(self, position: float, speed: float, now_s: float) -> None:
        """Add a poll that has ended at ``now_s``; one at the same time is ignored."""
        if not now_s > self._now_s:
            return
        self._polls.append((self._before_s, now_s, position, speed))
        self._before_s, self._now_s = self._now_s, now_s
        if len(self._polls) > 2:
            self._bounds = SpeedBounds.of(*np.array(self._polls, dtype=float).T)

    def contradiction(self) -> Speeds | None:
        """Speeds of a window in which 606Ch contradicts the positions, or None."""
        if (found := self._bounds) is None:
            return None
        most = found.fastest + self._acceleration * (found.between_s / 2 + self.FASTER_LAG_S)
        least = np.maximum(0.0, found.slowest - self._acceleration * self.SLOWER_LAG_S)
        longest = self._distance(self.FAST_MM, self.CONTRADICTION * most, found.at_most_s)
        shortest = self._distance(-self.SLOW_MM, least / self.CONTRADICTION, found.at_least_s)
        agree = (found.gone <= longest) & (found.path >= shortest)
        return self._speeds(found, ~agree)

    def overspeed(self) -> Speeds | None:
        """Speeds of a window in which the positions prove overspeed, or None."""
        if (found := self._bounds) is None:
            return None
        allowed = np.full_like(found.gone, OVERSPEED * self._speed)
        longest = self._distance(self.FAST_MM, allowed, found.at_most_s)
        return self._speeds(found, ~(found.gone <= longest))

    def _distance(self, margin_mm: float, speed: Array, duration_s: Array) -> Array:
        return margin_mm * self._units_per_mm + speed * duration_s

    def _speeds(self, found: SpeedBounds, where: NDArray[np.bool_]) -> Speeds | None:
        """Mean speeds of the longest window ``where`` a bound is broken, or None."""
        if not where.any():
            return None
        longest = int(np.argmax(where))
        seen_s = max(float(found.seen_s[longest]), np.finfo(float).eps)
        way, said = float(found.path[longest]), float(found.said[longest])
        return Speeds(way / seen_s, said / seen_s, way)


class MotionGuard:
    """Checks one motion by positions, times and strip, independently of the drive's speed."""

    FROZEN = 0.01  # no unit of speed differs so far from another

    def __init__(self, limits: Limits, before: Snapshot, now_s: float) -> None:
        """``before`` is a poll before the motion, which has ended at ``now_s`` of the cell."""
        self._limits = limits
        per_mm, strip_per_mm = limits.counts_per_mm, limits.strip_counts_per_mm
        self._speed = SpeedGuard(now_s, limits.speed, limits.acceleration, per_mm)
        still_mm = limits.windows.strip_spread / strip_per_mm
        self._scale = ScaleGuard(still_mm, limits.speed / per_mm, synchronous=limits.strip_at_sync)
        self._take_scale(before)

    def add(self, now: Snapshot, now_s: float) -> None:
        """Add a poll that has ended at ``now_s`` of the cell."""
        self._speed.add(now.position, now.velocity, now_s)
        self._take_scale(now)

    def _take_scale(self, now: Snapshot) -> None:
        limits = self._limits
        if not now.alarms:
            self._scale.add(
                now.position / limits.counts_per_mm, now.strip / limits.strip_counts_per_mm
            )

    def check_unit(self, operation: str, now: Snapshot) -> None:
        """Raise `DeviceError` where positions and time contradict the drive's speed."""
        limits = self._limits
        if (seen := self._speed.contradiction()) is None:
            return
        act = (
            "correct speed_unit, acceleration_unit or counts_per_turn in [rail.options], or the "
            "drive's own units; then resume"
        )
        if seen.factor < self.FROZEN:
            act = "the position (6064h) does not follow: check the drive's encoder; then resume"
        raise RAIL.failed(
            "HC-R46",
            operation,
            f"speed {limits.mm(seen.by_positions)}/s by positions (6064h) and time, "
            f"{limits.mm(seen.by_drive)}/s by the drive (606Ch): a factor of {seen.factor:.3g}",
            expected="one speed by both",
            act=act,
            position_mm=now.position / limits.counts_per_mm,
            speed_mm_s=seen.by_positions / limits.counts_per_mm,
            drive_speed_mm_s=seen.by_drive / limits.counts_per_mm,
            factor=seen.factor,
            way_mm=seen.distance / limits.counts_per_mm,
        )

    def check(self, operation: str, now: Snapshot) -> None:
        """Raise `DeviceError` for too high a speed by positions, or a strip with another scale."""
        limits = self._limits
        if (seen := self._speed.overspeed()) is not None:
            allowed = OVERSPEED * limits.speed
            raise RAIL.failed(
                "HC-R33",
                operation,
                f"speed {limits.mm(seen.by_positions)}/s by positions (6064h) and time, "
                f"allowed {limits.mm(allowed)}/s",
                position_mm=now.position / limits.counts_per_mm,
                speed_mm_s=seen.by_positions / limits.counts_per_mm,
                allowed_mm_s=allowed / limits.counts_per_mm,
            )
        self._scale.check(operation)
