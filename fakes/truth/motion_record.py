"""How far, how fast and how long something really moved: for tests that judge announced bounds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np

from fakes.truth.transforms import Array

STROKES = 10_000  # kept: more than a commissioning has


@dataclass(slots=True)
class Stroke:
    """One motion: when it began, positions (N,), the planned speed."""

    moment: datetime
    begin: Array
    low: Array
    high: Array
    fastest: Array

    @property
    def began(self) -> str:
        """Return when it began, UTC, as a journal's stamps."""
        return self.moment.isoformat(timespec="milliseconds")


class Travel(NamedTuple):
    """Positions (N,) at the beginning, the lowest and the highest since, and the time in motion."""

    begin: Array
    low: Array
    high: Array
    moving_s: float
    strokes: list[Stroke]

    @property
    def excursion(self) -> Array:
        """Return the largest distances (N,) from the beginning."""
        return np.maximum(self.high - self.begin, self.begin - self.low)


class MotionRecord:
    """Positions (N,) between two calls of `take`; each call of `add` ends a monotonic motion."""

    def __init__(self, at: Array) -> None:
        self._begin = self._at = self._low = self._high = at
        self._moving_s = 0.0
        self._strokes: deque[Stroke] = deque(maxlen=STROKES)

    def begin(self, fastest: Array) -> None:
        """Begin a stroke here; ``fastest`` (N,): its largest planned speeds."""
        at = self._at
        self._strokes.append(Stroke(datetime.now(UTC), at, at, at, fastest))

    def add(self, at: Array, moving_s: float) -> None:
        self._at = at
        self._low, self._high = np.minimum(self._low, at), np.maximum(self._high, at)
        self._moving_s += moving_s
        if self._strokes:
            last = self._strokes[-1]
            last.low, last.high = np.minimum(last.low, at), np.maximum(last.high, at)

    def take(self, at: Array) -> Travel:
        """Return the travel since the last call, up to positions (N,), and begin again there."""
        strokes = [each for each in self._strokes if np.any(each.high > each.low)]
        travel = Travel(self._begin, self._low, self._high, self._moving_s, strokes)
        self._begin = self._at = self._low = self._high = at
        self._moving_s = 0.0
        self._strokes.clear()
        return travel
