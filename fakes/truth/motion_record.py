"""How far and how long something really moved: for tests that judge the bound of a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fakes.truth.transforms import Array


class Travel(NamedTuple):
    """Positions (N,) at the beginning, the lowest and the highest since, and the time in motion."""

    begin: Array
    low: Array
    high: Array
    moving_s: float

    @property
    def excursion(self) -> Array:
        """Return the largest distances (N,) from the beginning."""
        return np.maximum(self.high - self.begin, self.begin - self.low)


class MotionRecord:
    """Positions (N,) between two calls of `take`; each call of `add` ends a monotonic motion."""

    def __init__(self, at: Array) -> None:
        self._begin = self._low = self._high = at
        self._moving_s = 0.0

    def add(self, at: Array, moving_s: float) -> None:
        self._low, self._high = np.minimum(self._low, at), np.maximum(self._high, at)
        self._moving_s += moving_s

    def take(self, at: Array) -> Travel:
        """Return the travel since the last call, up to positions (N,), and begin again there."""
        travel = Travel(self._begin, self._low, self._high, self._moving_s)
        self._begin = self._low = self._high = at
        self._moving_s = 0.0
        return travel
