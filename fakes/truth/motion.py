"""Motion of one axis with constant accelerations: trapezoids and braking, on plant time.

A trapezoid that is too short for its speed is a triangle.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from fakes.truth.transforms import Array


class Segment(NamedTuple):
    """Constant acceleration from ``start_s`` on; the last segment of a path stands still."""

    start_s: float
    position: float
    velocity: float
    acceleration: float


class Path:
    """Segments one after another; the unit of length is the caller's."""

    def __init__(self, start_s: float, position: float, velocity: float = 0.0) -> None:
        self._segments = [Segment(start_s, position, velocity, 0.0)]
        self._starts_s = [start_s]

    @property
    def start_s(self) -> float:
        """Return when the motion starts."""
        return self._starts_s[0]

    @property
    def end_s(self) -> float:
        """Return when the motion has ended."""
        return self._starts_s[-1]

    @property
    def end(self) -> float:
        """Return where it ends."""
        return self._segments[-1].position

    def brake(self, deceleration: float) -> Path:
        """Append braking to standstill."""
        velocity = self._segments[-1].velocity
        if velocity:
            sign = math.copysign(deceleration, -velocity)
            self._append(abs(velocity) / deceleration, sign, end_velocity=0.0)
        return self

    def travel(self, target: float, speed: float, acceleration: float) -> Path:
        """Append a trapezoid from standstill to ``target``."""
        distance = abs(target - self.end)
        if distance:
            sign = math.copysign(1.0, target - self.end)
            # Two roots: the product of a tiny distance and a small acceleration may be 0.
            peak = min(speed, math.sqrt(distance) * math.sqrt(acceleration))
            cruise_s = max(0.0, distance / peak - peak / acceleration)
            self._append(peak / acceleration, sign * acceleration, end_velocity=sign * peak)
            self._append(cruise_s, 0.0, end_velocity=sign * peak)
            self._append(peak / acceleration, -sign * acceleration, end_velocity=0.0)
            last = self._segments[-1]
            self._segments[-1] = Segment(last.start_s, target, 0.0, 0.0)
        return self

    def _append(self, duration_s: float, acceleration: float, end_velocity: float) -> None:
        last = self._segments[-1]
        self._segments[-1] = Segment(last.start_s, last.position, last.velocity, acceleration)
        end_s = last.start_s + duration_s
        end = last.position + (last.velocity + 0.5 * acceleration * duration_s) * duration_s
        self._segments.append(Segment(end_s, end, end_velocity, 0.0))
        self._starts_s.append(end_s)

    def at(self, now_s: float) -> tuple[float, float]:
        """Return position and velocity at ``now_s``; before the start it stands there."""
        segment = self._segments[max(0, bisect_right(self._starts_s, now_s) - 1)]
        passed_s = max(0.0, now_s - segment.start_s)
        velocity = segment.velocity + segment.acceleration * passed_s
        return segment.position + 0.5 * (segment.velocity + velocity) * passed_s, velocity

    def positions(self, times_s: Array) -> Array:
        """Return the positions at times (N,)."""
        segments = np.array(self._segments)
        taken = np.searchsorted(self._starts_s, times_s, side="right").clip(1) - 1
        start_s, position, velocity, acceleration = segments[taken].T
        passed_s = np.maximum(0.0, times_s - start_s)
        then = velocity + acceleration * passed_s
        found: Array = position + 0.5 * (velocity + then) * passed_s
        return found

    def corners(self, after_s: float, until_s: float) -> list[float]:
        """Return the positions where segments began in ``after_s < t <= until_s``."""
        low = bisect_right(self._starts_s, after_s)
        high = bisect_right(self._starts_s, until_s)
        return [segment.position for segment in self._segments[low:high]]
