"""Whether errors are in tolerance, from as few random targets as stated risks allow.

Two claims must be shown: the mean of the 3D errors is below its limit, and not more than a share
of the volume is above the maximum. The mean is judged by betting (Waudby-Smith and Ramdas 2024,
"Estimating means of bounded random variables by betting"): a bet on a mean below m multiplies its
stake by ``1 + f (m - x) / (b - m)`` at each error x <= b. Where the mean is m or above, no stake is
expected to grow, so by Ville's inequality one ever reaches 1 / risk with a probability of at most
the risk, however often one looks. Nothing is assumed about the errors' distribution.

Targets come in blocks, one in each of as many equal parts of the volume, uniform in its part.
Within a block errors are then not alike, but the product's expectation is at most that of alike
ones (the geometric mean of the parts' factors is at most their arithmetic mean), so the inequality
holds at the ends of blocks, and only there may one look.

A target above the maximum disproves the calibration: none may be. That none of n was shows at
``(1 - share)^n <= risk`` that the share is less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilcell.geometry.kinematics import Array
from hilcell.model.outcome import Outcome

Flags = NDArray[np.bool_]
STAKES = np.linspace(0.05, 0.95, 10)  # the mean of fair bets is a fair bet


@dataclass(frozen=True, slots=True)
class Decision:
    """The outcome, and after how many targets it stood."""

    outcome: Outcome
    targets: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialRule:
    """Limits, risks and the block.

    ``accept_risk`` is that of accepting errors whose mean is at its limit or above, or whose
    share above the maximum is ``share`` or more; ``reject_risk`` is that of rejecting for the mean
    errors whose mean is at its limit or below.
    """

    mean_limit_mm: float
    max_limit_mm: float
    share: float
    accept_risk: float
    reject_risk: float
    block: int

    def decide(self, errors_mm: ArrayLike) -> Decision:
        """Return the decision at the first block's end at which errors (N,) decide, in order."""
        errors = np.asarray(errors_mm, dtype=float)
        ends = np.arange(self.block, len(errors) + 1, self.block)
        fits = errors <= self.max_limit_mm  # NaN does not
        within, errors = np.logical_and.accumulate(fits), np.where(fits, errors, self.max_limit_mm)
        accepted = within & self._below(errors) & self._rarely_above(len(errors))
        rejected = ~within | self._above(errors)
        for end in ends.tolist():
            if rejected[end - 1]:
                return Decision(Outcome.REJECTED, end)
            if accepted[end - 1]:
                return Decision(Outcome.ACCEPTED, end)
        return Decision(Outcome.UNDECIDED, int(ends[-1]) if len(ends) else 0)

    def _below(self, errors: Array) -> Flags:
        """Return after each error (N,) whether the mean is shown to be below its limit."""
        bound_mm = max(self.max_limit_mm, 2 * self.mean_limit_mm)
        gains = (self.mean_limit_mm - errors) / (bound_mm - self.mean_limit_mm)
        return _won(gains, self.accept_risk)

    def _above(self, errors: Array) -> Flags:
        """Return after each error (N,) whether the mean is shown to be above its limit."""
        return _won(errors / self.mean_limit_mm - 1.0, self.reject_risk)

    def _rarely_above(self, count: int) -> Flags:
        """Return after each of ``count`` errors within the maximum whether they are enough."""
        return (1.0 - self.share) ** np.arange(1, count + 1) <= self.accept_risk


def _won(gains: Array, risk: float) -> Flags:
    """Return after each gain (N,), >= -1, whether the bets' mean has reached 1 / risk."""
    logs = np.cumsum(np.log1p(STAKES * gains[:, None]), axis=0)
    won: Flags = np.logaddexp.reduce(logs, axis=1) - np.log(len(STAKES)) >= -np.log(risk)
    return won
