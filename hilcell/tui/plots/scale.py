"""Vertical scales: where a value stands, and ticks of 1, 2 and 5 with the same decimals.

A limit never lies on the frame: a scale goes on by at least a whole step beyond it. A scale only
grows (`before`), so that a plot of a live run does not jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hilcell.ports import Array

LEAST, MOST = 1e-4, 1e4  # of a log scale, mm: below any tracker's resolution, beyond any cell
FINEST, LARGEST = 1e-6, 1e9  # step and value of an even scale
LOG_LOW, LOG_HIGH = 0.01, 2.0  # of a log scale that nothing extends, mm
ROOM = 1.5  # rows from tick to tick, in the mean
ROUNDING = 1e-9  # relative: a step is its own multiple


@dataclass(frozen=True, slots=True)
class Scale:
    """A scale from its lowest to its highest tick; ``step`` is 0 where it is logarithmic."""

    low: float
    high: float
    step: float = 0.0

    @property
    def is_log(self) -> bool:
        """Whether equal distances are equal ratios."""
        return not self.step

    @property
    def decimals(self) -> int:
        """Return the decimals that every tick is written with."""
        least = self.low if self.is_log else self.step
        return max(0, -math.floor(math.log10(least) + ROUNDING))

    def share(self, values: Array) -> Array:
        """Return where values (N,) stand, 0 at the lowest tick and 1 at the highest; NaN stays.

        A value beyond an end stands at that end.
        """
        at, low, high = np.asarray(values, dtype=float), self.low, self.high
        if self.is_log:
            with np.errstate(divide="ignore", invalid="ignore"):
                at, low, high = np.log(np.maximum(at, 0.0)), math.log(low), math.log(high)
        return np.clip((at - low) / (high - low), 0.0, 1.0)

    def rows(self, values: Array, height: int) -> Array:
        """Return the depths (N,) of values in rows from the top; a tick is at a row's middle."""
        return (1.0 - self.share(values)) * (height - 1) + 0.5

    def ticks(self, height: int) -> list[tuple[int, float]]:
        """Return row and value of each tick, from the top; fewer where rows are few."""
        found: list[tuple[int, float]] = []
        for values in self._ladders():
            at = np.floor(self.rows(np.array(values), height)).astype(int).tolist()
            found = sorted(zip(at, values, strict=True))
            apart = all(a[0] < b[0] for a, b in pairwise(found))
            if apart and found[-1][0] - found[0][0] >= ROOM * (len(found) - 1):
                return found
        return found[:1]

    def _ladders(self) -> Iterable[list[float]]:
        """Yield the ticks, fewer each time."""
        if self.is_log:
            steps = steps_between(self.low, self.high)
            yield steps
            yield [step for step in steps if float(f"{step:e}".partition("e")[0]) == 1.0]
        else:
            step = self.step
            while step <= self.high - self.low:
                first, last = math.ceil(self.low / step - ROUNDING), self.high / step + ROUNDING
                yield [n * step for n in range(first, math.floor(last) + 1)]
                step = step_above(step)
        yield [self.low, self.high]
        yield [self.high]


def log_scale(values: Array, limits: Sequence[float] = (), before: Scale | None = None) -> Scale:
    """Return a log scale for values (N,) in mm, of whole steps of 1, 2 and 5."""
    known = [each for each in np.asarray(values, dtype=float).tolist() if LEAST <= each <= MOST]
    lows, highs = [LOG_LOW], [LOG_HIGH]
    lows += [step_at_most(each) for each in known] + [step_below(each) for each in limits]
    highs += [step_at_least(each) for each in known] + [step_above(each) for each in limits]
    if before is not None and before.is_log:
        lows, highs = [*lows, before.low], [*highs, before.high]
    return Scale(min(lows), max(highs))


def even_scale(
    values: Array, limits: Sequence[float] = (), height: int = 24, before: Scale | None = None
) -> Scale:
    """Return an even scale for values (N,), zero among them; its step is 1, 2 or 5."""
    found = np.asarray(values, dtype=float)
    held = [0.0, *limits, *found[np.abs(found) <= LARGEST].tolist()]
    if before is not None and not before.is_log:
        held += [before.low, before.high]
    low, high = min(held), max(held)
    step = step_at_least(max((high - low or 1.0) / max(2, height // 3), FINEST))
    first, last = math.floor(low / step + ROUNDING), math.ceil(high / step - ROUNDING)
    first -= any(not first * step < each for each in limits)
    last += any(not each < last * step for each in limits)
    return Scale(first * step, max(last, first + 1) * step, step)


def steps_between(low: float, high: float) -> list[float]:
    """Return the steps of 1, 2 and 5 from one to another, both among them."""
    found = [low]
    while found[-1] < high * (1 - ROUNDING):
        found.append(step_above(found[-1]))
    return found


def step_at_least(value: float) -> float:
    """Return the least of 1, 2, 5 x 10^n that is not below a value."""
    return next(each for each in _around(value) if each >= value * (1 - ROUNDING))


def step_at_most(value: float) -> float:
    """Return the greatest of 1, 2, 5 x 10^n that is not above a value."""
    return next(each for each in reversed(_around(value)) if each <= value * (1 + ROUNDING))


def step_above(value: float) -> float:
    """Return the least step above a value."""
    return next(each for each in _around(value) if each > value * (1 + ROUNDING))


def step_below(value: float) -> float:
    """Return the greatest step below a value."""
    return next(each for each in reversed(_around(value)) if each < value * (1 - ROUNDING))


def _around(value: float) -> list[float]:
    tens = math.floor(math.log10(value))
    return [float(f"{step:g}e{n}") for n in (tens - 1, tens, tens + 1) for step in (1, 2, 5)]
