"""Inference from the figures of some machines to all such machines: intervals, shares, tests.

Figures are one a machine: its errors are the draw, so machines are the sample.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from functools import cache
from typing import Literal, Self

import msgspec
import numpy as np
from scipy.special import betaincinv, stdtr, stdtrit  # scipy.stats takes half a second to import

from hilcell.ports import Array

UPPER = 0.975  # end of a 95 % interval
SHOWN = 0.05  # risk that any step of a table is shown though it does nothing
SAME = 1e-9  # of numbers that rounding alone sets apart
NONE = "–"  # stands for a figure that is not estimable


class Interval(msgspec.Struct, frozen=True):
    """A mean over machines and half its 95 % interval, NaN where one machine gives none."""

    mean: float
    half: float = msgspec.field(name="half95")

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return the mean of values, one a machine, with its 95 % interval."""
        return cls.with_misfit(np.array(list(values), dtype=float), 0.0, math.inf)

    @classmethod
    def with_misfit(cls, values: Array, variance: float, freedom: float) -> Self:
        """Return the mean of values, one a machine, with a variance that machines share.

        ``freedom`` are the degrees of freedom of that variance (Welch and Satterthwaite).
        """
        if len(values) < 2:
            return cls(float(values.mean()) if len(values) else math.nan, math.nan)
        error, together = _error(values, variance, freedom)
        return cls(float(values.mean()), float(stdtrit(together, UPPER)) * error)

    @property
    def known(self) -> bool:
        """Whether it is shown to be other than nought, by more than rounding."""
        return self.half >= 0.0 and abs(self.mean) > max(self.half, SAME)

    def text(self, sign: float = 1.0) -> str:
        """Return the figure with its interval, where it has one; a dash for what is not known."""
        if math.isnan(self.mean):
            return NONE
        shown = f"{sign * self.mean:z.4f}".replace("-", "−")  # z: no -0
        if math.isnan(self.half):
            return shown
        return f"{shown} ± {NONE if math.isinf(self.half) else f'{self.half:.4f}'}"

    @property
    def ends(self) -> tuple[float, float]:
        """Return where it ends; the mean twice where there is none."""
        half = self.half if self.half >= 0.0 else 0.0
        return self.mean - half, self.mean + half


class OneMachine(msgspec.Struct, frozen=True):
    """Where the figure of one machine more lies, 95 % sure, if machines are normal; or NaN."""

    low: float = msgspec.field(name="low95")
    high: float = msgspec.field(name="high95")

    @classmethod
    def of(cls, values: Array) -> Self:
        if len(values) < 2:
            return cls(math.nan, math.nan)
        half = Interval.of(values).half * math.sqrt(len(values) + 1.0)
        return cls(max(0.0, float(values.mean()) - half), float(values.mean()) + half)

    def text(self) -> str:
        return NONE if math.isnan(self.low) else f"{self.low:.3f} .. {self.high:.3f}"


class Share(msgspec.Struct, frozen=True):
    """A share of targets (0 to 1) and its 95 % interval, NaN where one machine gives none."""

    mean: float
    low: float = msgspec.field(name="low95")
    high: float = msgspec.field(name="high95")

    @classmethod
    def of(cls, values: Iterable[float], targets: float) -> Self:
        """Return the mean of shares, one a machine, of so many targets together; its interval.

        Clopper and Pearson's, with the effective number of targets that the differences between
        machines leave (Korn and Graubard 1998): targets of one machine go together.
        """
        found: Array = np.clip(np.array(list(values), dtype=float), 0.0, 1.0)
        if len(found) < 2 or not targets > 1.0:
            return cls(float(found.mean()) if len(found) else math.nan, math.nan, math.nan)
        mean, variance = float(found.mean()), float(found.var(ddof=1)) / len(found)
        effective = min(targets, mean * (1.0 - mean) / variance) if variance > 0.0 else targets
        effective *= float(stdtrit(targets - 1.0, UPPER) / stdtrit(len(found) - 1.0, UPPER)) ** 2
        within, beyond = effective * mean, effective * (1.0 - mean)
        low = float(betaincinv(within, beyond + 1.0, 1.0 - UPPER)) if within > 0.0 else 0.0
        high = float(betaincinv(within + 1.0, beyond, UPPER)) if beyond > 0.0 else 1.0
        return cls(mean, low, high)

    def text(self) -> str:
        """Return the share in %, with its interval; a dash for none."""
        if math.isnan(self.mean):
            return NONE
        # Rounded twice: 93.75 and 93.74999999999999 are one figure.
        mean, low, high = (f"{round(100.0 * each, 9):.1f}" for each in (self.mean, *self.ends))
        return mean + (f" ({low} .. {high})" if low != high else "")

    @property
    def ends(self) -> tuple[float, float]:
        """Return where its interval ends; the mean twice where there is none."""
        return (self.low, self.high) if self.low <= self.high else (self.mean, self.mean)


class Within(msgspec.Struct, frozen=True):
    """How many machines are within a limit, and what that shows of all such machines.

    The share lies between ``share_low`` and ``share_high``, each at the question's confidence
    (Clopper and Pearson 1934): exact whatever the distribution. ``more`` machines, if all hold,
    show a yes; None after a no. ``tolerance_mm`` is beside it: the limit that the share of machines
    keeps if machines are normal (NaN where one has no figure).
    """

    machines: int
    within: int
    share_low: float
    share_high: float
    answer: Literal["yes", "no", "not shown yet"]
    more: int | None
    tolerance_mm: float

    @classmethod
    def of(cls, figures_mm: Array, limit_mm: float, share: float, confidence: float) -> Self:
        """Judge machines (M,); one that has no result, NaN, is not within the limit."""
        machines, within = len(figures_mm), int((figures_mm <= limit_mm).sum())
        low, high, needed = _binomial(machines, within, share, confidence)
        tolerance_mm = tolerance_limit(figures_mm, share, confidence)
        if high < share:
            return cls(machines, within, low, high, "no", None, tolerance_mm)
        more = needed - machines
        answer: Literal["yes", "not shown yet"] = "not shown yet" if more else "yes"
        return cls(machines, within, low, high, answer, more, tolerance_mm)


@cache
def _binomial(
    machines: int, within: int, share: float, confidence: float
) -> tuple[float, float, int]:
    """Return both limits of the share, and how many machines show it if all others hold."""
    from scipy.stats import beta, binom

    beyond, risk = machines - within, 1.0 - confidence
    low = float(beta.ppf(risk, within, beyond + 1)) if within else 0.0
    high = float(beta.ppf(confidence, within + 1, beyond)) if beyond else 1.0

    def shows(count: int) -> bool:
        return bool(binom.cdf(beyond, count, 1.0 - share) <= risk)

    counts = range(machines, 1_000_000)
    return low, high, counts[bisect.bisect_left(counts, True, key=shows)]


def tolerance_limit(figures: Array, share: float, confidence: float) -> float:
    """Return the one-sided limit of a share of normal machines (ISO 16269-6); NaN for one alone."""
    if len(figures) < 2:
        return math.nan
    factor = _tolerance_factor(len(figures), share, confidence)
    return float(figures.mean() + factor * figures.std(ddof=1))


@cache
def _tolerance_factor(count: int, share: float, confidence: float) -> float:
    from scipy.stats import nct, norm

    root = math.sqrt(count)
    return float(nct.ppf(confidence, count - 1, float(norm.ppf(share)) * root)) / root


def p_value(values: Array, variance: float = 0.0, freedom: float = math.inf) -> float:
    """Return Student's two-sided p of the mean of values, one a machine, against nought.

    NaN for one machine; ``variance`` and ``freedom`` as for `Interval.with_misfit`.
    """
    if len(values) < 2:
        return math.nan
    error, together = _error(values, variance, freedom)
    mean = abs(float(values.mean()))
    if mean <= SAME:
        return 1.0
    return 2.0 * float(stdtr(together, -mean / error)) if error > 0.0 else 0.0


def holm(values: Array) -> Array:
    """Return p-values (N,) corrected for their number (Holm 1979); NaN is 1, and none of them."""
    found = np.ones(len(values))
    tested = np.flatnonzero(np.isfinite(values))
    order = tested[np.argsort(values[tested], kind="stable")]
    left = np.arange(len(order), 0, -1)
    found[order] = np.minimum(1.0, np.maximum.accumulate(values[order] * left))
    return found


def _error(values: Array, variance: float, freedom: float) -> tuple[float, float]:
    """Return the standard error of a mean over machines, and its degrees of freedom."""
    own, free = float(values.var(ddof=1)) / len(values), len(values) - 1.0
    both = own + variance
    if not 0.0 < both < math.inf:
        return math.sqrt(both), free
    return math.sqrt(both), both**2 / (own**2 / free + variance**2 / freedom)
