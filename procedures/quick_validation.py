"""A quick validation: as few targets at each station as its verdict needs at the stated risks.

Two claims: the mean of the 3D errors is below its limit, and not more than a share of the volume is
above the maximum. The mean is judged by betting (Waudby-Smith and Ramdas 2024, "Estimating means of
bounded random variables by betting"): a bet on a mean below m multiplies its stake by ``1 + f (m -
x) / (b - m)`` at each error x <= b. Where the mean is m or above, no stake is expected to grow, so
by Ville's inequality one ever reaches 1 / risk with a probability of at most the risk, at any
number of evaluations and for any distribution.

Targets come in blocks, one in each of as many equal parts of the volume, uniform in its part. The
product's expectation over a block is at most that of identically distributed errors (the geometric
mean of the parts' factors is at most their arithmetic mean), so the inequality holds at the ends of
blocks, and only there the data may be evaluated.

A target above the maximum disproves the calibration. None of n shows at ``(1 - share)^n <= risk``
that the share is less.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hilcell.calibration.decision_rule import Guard, guard_band, tolerance_limits
from hilcell.calibration.position_errors import validation
from hilcell.cell.file import Cell
from hilcell.geometry.kinematics import Bools
from hilcell.journal.log import Log
from hilcell.model.events import StationDecided
from hilcell.model.outcome import Outcome, gravest, outcome_of
from hilcell.model.point import Sent
from hilcell.model.results import Decided
from hilcell.ports import Array, HilcellError
from hilcell.run.cell_session import CellSession
from procedures.plan import stations_in_order

OCTANTS = np.array(  # of a box, in an order whose every step crosses one face
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1)]
)
BLOCK = len(OCTANTS)


def least_targets(cell: Cell) -> int:
    """Return how many targets an acceptance needs at least; raises `HilcellError` where the plan
    has fewer.
    """
    decision = SequentialRule.of(cell, Guard()).decide(np.zeros(cell.plan.most_targets))
    if decision.outcome is not Outcome.ACCEPTED:
        raise HilcellError(
            f"plan.most_targets {cell.plan.most_targets}: not enough to accept a station at "
            f"accept_risk {cell.plan.accept_risk:g} and share_above_max "
            f"{cell.plan.share_above_max:g}, even without any error; allow more targets",
            code="HC-C10",
        )
    return decision.targets


def octant_targets(cell: Cell, seed: int, low_mm: Array, high_mm: Array) -> dict[str, Array]:
    """Targets (N, 3) in {B} by station, the grid's first: in blocks, one in each octant. Each is
    uniform in its octant of the box from ``low_mm`` (3,) to ``high_mm`` (3,).
    """
    blocks, half_mm = cell.plan.most_targets // BLOCK, (high_mm - low_mm) / 2
    drawn = {}
    for number, station in enumerate(stations_in_order(cell)):
        inside = np.random.default_rng([seed, 2014, number]).uniform(size=(blocks * BLOCK, 3))
        drawn[station.name] = low_mm + half_mm * (np.tile(OCTANTS, (blocks, 1)) + inside)
    return drawn


def decision_at(log: Log, station: str) -> Decision:
    """Return what the corrected targets measured so far at a station have shown."""
    chosen = validation(log, [station]).get(Sent.CHOSEN)
    if chosen is None:
        return SequentialRule.of(log.cell, Guard()).decide([])
    return SequentialRule.of(log.cell, guard_at(log, station)).decide(chosen.norms_mm)


def guard_at(log: Log, station: str) -> Guard:
    """Return the U by which a station was decided, without later measurements."""
    for decided in reversed(log.happened(StationDecided)):
        if decided.station == station:
            return Guard(decided.mean_U_mm, decided.max_U_mm)
    return guard_band(log, validation(log, [station])[Sent.CHOSEN].error_mm)


def record_guard(session: CellSession, station: str) -> None:
    """Journal the U by which a station was decided, once."""
    if station not in [each.station for each in session.log.happened(StationDecided)]:
        guard = guard_at(session.log, station)
        session.add(StationDecided(station=station, mean_U_mm=guard.mean_mm, max_U_mm=guard.max_mm))


def rounds(log: Log, station: str, how: str) -> Iterator[range]:
    """Yield the numbers of the targets of each next block, until the station is decided.
    Uncorrected targets decide nothing: one block shows the error before.
    """
    yield range(BLOCK)
    for end in range(2 * BLOCK, log.cell.plan.most_targets + 1, BLOCK):
        if how != Sent.CHOSEN or decision_at(log, station).outcome is not Outcome.UNDECIDED:
            return
        yield range(end - BLOCK, end)


def judgement(log: Log, stations: list[str]) -> Decided:
    """Outcome at ``stations``, the targets of each, and its meaning.

    More targets cannot accept what is shown to be above a tolerance less U. It is out of tolerance
    only where a figure less U is above the tolerance, too.
    """
    decisions = [decision_at(log, station) for station in stations]
    counts, plan = [each.targets for each in decisions], log.cell.plan
    chosen, limits = validation(log, stations)[Sent.CHOSEN], tolerance_limits(log.cell)
    guard, figures = guard_band(log, chosen.error_mm), chosen.figures
    by_station: list[Outcome] = [
        Outcome.ACCEPTED if each.outcome is Outcome.ACCEPTED else Outcome.UNDECIDED
        for each in decisions
    ]
    outcome = gravest([
        *by_station,
        outcome_of(figures.mean, limits.mean_mm, guard.mean_mm),
        outcome_of(figures.max, limits.max_mm, guard.max_mm),
    ])  # fmt: skip
    enough = all(each.outcome is not Outcome.UNDECIDED for each in decisions)
    text = meaning(log.cell, outcome, guard, enough=enough)
    return Decided(
        outcome=outcome,
        targets=counts,
        text=f"{outcome.text} after {' + '.join(map(str, counts))} targets: {text}",
        accept_risk=plan.accept_risk,
        reject_risk=plan.reject_risk,
        share_above_max=plan.share_above_max,
    )


def meaning(cell: Cell, outcome: Outcome, guard: Guard, *, enough: bool) -> str:
    """Return the explanation of an outcome; ``enough``: more targets would not change it."""
    plan, limits = cell.plan, tolerance_limits(cell)
    within = guard.within(limits)
    if outcome is Outcome.ACCEPTED:
        return (
            f"it is shown, at a risk of {plan.accept_risk:.1%} each, that the mean is below "
            f"{within.mean_mm:.3f} mm, and that less than {plan.share_above_max:.1%} of the volume "
            f"is above {within.max_mm:.3f} mm (the tolerances less U)"
        )
    if outcome is Outcome.REJECTED:
        return "the mean or the largest error less its U is above its tolerance"
    if not enough:
        return (
            "neither that the tolerances less U are kept is shown nor the contrary; allow more in "
            "plan.most_targets"
        )
    return (
        f"the errors are within U of the tolerances: U of the mean is {guard.mean_mm:.3f} mm of "
        f"{limits.mean_mm:g}, of a single error {guard.max_mm:.3f} mm of {limits.max_mm:g}; more "
        "targets do not help, a smaller U does"
    )


@dataclass(frozen=True, slots=True)
class Decision:
    """The outcome and its number of targets."""

    outcome: Outcome
    targets: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SequentialRule:
    """Limits, risks and the block.

    ``accept_risk``: of accepting errors whose mean is at its limit or above, or whose share above
    the maximum is ``share`` or more; ``reject_risk``: of rejecting for the mean errors whose mean
    is at its limit or below.
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
        shares = (1.0 - self.share) ** np.arange(1, len(errors) + 1)  # all within the maximum
        accepted = within & self._below(errors) & (shares <= self.accept_risk)
        rejected = ~within | self._above(errors)
        for end in ends.tolist():
            if rejected[end - 1]:
                return Decision(Outcome.REJECTED, end)
            if accepted[end - 1]:
                return Decision(Outcome.ACCEPTED, end)
        return Decision(Outcome.UNDECIDED, int(ends[-1]) if len(ends) else 0)

    def _below(self, errors: Array) -> Bools:
        """Return after each error (N,) whether the mean is shown to be below its limit."""
        bound_mm = max(self.max_limit_mm, 2 * self.mean_limit_mm)
        gains = (self.mean_limit_mm - errors) / (bound_mm - self.mean_limit_mm)
        return self._won(gains, self.accept_risk)

    def _above(self, errors: Array) -> Bools:
        """Return after each error (N,) whether the mean is shown to be above its limit."""
        return self._won(errors / self.mean_limit_mm - 1.0, self.reject_risk)

    @staticmethod
    def _won(gains: Array, risk: float) -> Bools:
        """Return after each gain (N,), >= -1, whether the bets' mean has reached 1 / risk."""
        stakes = np.linspace(0.05, 0.95, 10)  # the mean of fair bets is a fair bet
        logs = np.cumsum(np.log1p(stakes * gains[:, None]), axis=0)
        won: Bools = np.logaddexp.reduce(logs, axis=1) - np.log(len(stakes)) >= -np.log(risk)
        return won

    @staticmethod
    def of(cell: Cell, guard: Guard) -> SequentialRule:
        """Return the rule by which each station is judged.

        Its limits are the tolerances less ``guard``, as in `hilcell.calibration.decision_rule`.
        """
        within = guard.within(tolerance_limits(cell))
        least_mm = 1e-6  # a limit that no error keeps, where U leaves nothing of the tolerance
        return SequentialRule(
            mean_limit_mm=max(within.mean_mm, least_mm),
            max_limit_mm=max(within.max_mm, least_mm),
            share=cell.plan.share_above_max,
            accept_risk=cell.plan.accept_risk,
            reject_risk=cell.plan.reject_risk,
            block=BLOCK,
        )
