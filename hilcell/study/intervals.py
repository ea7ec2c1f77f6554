"""Means over machines and shares of targets, with their 95 % intervals.

One machine gives no interval: targets of one machine are no sample of others'.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv, stdtrit  # scipy.stats takes half a second to import

from hilcell.ports import Array

LEVEL = 0.95
UPPER = 0.5 + LEVEL / 2.0
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean over machines and half its 95 % interval, NaN where one machine gives none."""

    mean: float
    half: float

    @property
    def known(self) -> bool:
        """Whether it is shown to be other than nought, by more than rounding."""
        return self.half >= 0.0 and abs(self.mean) > max(self.half, ROUNDING)

    @property
    def reversed(self) -> Interval:
        """Return it with the other sign."""
        return Interval(-self.mean, self.half)

    @property
    def ends(self) -> tuple[float, float]:
        """Return where it ends; the mean twice where there is none."""
        half = self.half if self.half >= 0.0 else 0.0
        return self.mean - half, self.mean + half


@dataclass(frozen=True, slots=True)
class Share:
    """A share of targets (0 to 1) and its 95 % interval, NaN where one machine gives none."""

    mean: float
    low: float
    high: float

    @property
    def ends(self) -> tuple[float, float]:
        """Return where its interval ends; the mean twice where there is none."""
        return (self.low, self.high) if self.low <= self.high else (self.mean, self.mean)


def interval(values: Iterable[float]) -> Interval:
    """Return the mean of values, one a machine, with its 95 % interval."""
    found: Array = np.array(list(values), dtype=float)
    if len(found) < 2:
        return Interval(float(found.mean()) if len(found) else float("nan"), float("nan"))
    factor = _student(len(found) - 1)
    return Interval(float(found.mean()), factor * float(found.std(ddof=1)) / len(found) ** 0.5)


def share(values: Iterable[float], targets: float) -> Share:
    """Return the mean of shares, one a machine, of so many targets together; its interval.

    Clopper and Pearson's, with the effective number of targets that the differences between
    machines leave (Korn and Graubard 1998): targets of one machine go together.
    """
    found: Array = np.clip(np.array(list(values), dtype=float), 0.0, 1.0)
    if len(found) < 2 or not targets > 1.0:
        return Share(
            float(found.mean()) if len(found) else float("nan"), float("nan"), float("nan")
        )
    mean, variance = float(found.mean()), float(found.var(ddof=1)) / len(found)
    effective = min(targets, mean * (1.0 - mean) / variance) if variance > 0.0 else targets
    effective *= (_student(targets - 1.0) / _student(len(found) - 1)) ** 2
    within, beyond = effective * mean, effective * (1.0 - mean)
    low = float(betaincinv(within, beyond + 1.0, 1.0 - UPPER)) if within > 0.0 else 0.0
    high = float(betaincinv(within + 1.0, beyond, UPPER)) if beyond > 0.0 else 1.0
    return Share(mean, low, high)


def _student(freedom: float) -> float:
    """Return Student's factor of the interval's upper end."""
    return float(stdtrit(freedom, UPPER))
