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

Fewer targets do where large errors are not rarer than an exponential law has them: where the hazard
rate of |e| rises, as for normal errors in any number of dimensions, Weibull's and gamma's law from
the exponential on. Then ``P(e > L / c) >= share^(1 / c)`` where P(e > L) is the share or more, and
``P(e > m) >= exp(-1)`` where the mean is m or more (Barlow and Proschan 1965, "Mathematical Theory
of Reliability", chapter 2), so that eight targets within half the maximum and within the mean's
limit show both. These bets and those above share one stake; the poses that the model did not learn
from decide before the first target whether they are made, and they are given up, stake and gain, at
the first error that stands out among the station's own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hilcell.calibration.decision_rule import Guard, guard_band, tolerance_limits
from hilcell.calibration.position_errors import validation
from hilcell.cell.file import BLOCK, Cell
from hilcell.geometry.kinematics import Bools
from hilcell.journal.log import Log
from hilcell.model.events import StationDecided
from hilcell.model.outcome import Outcome, gravest, outcome_of
from hilcell.model.point import Sent
from hilcell.model.results import Decided
from hilcell.model.verdicts import Fitted
from hilcell.ports import Array, HilcellError
from hilcell.run.cell_session import CellSession
from procedures.plan import stations_in_order

OCTANTS = np.array(  # of a box, in an order whose every step crosses one face
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1)]
)


LIGHT = 3.0  # the largest over the median of errors whose hazard rises: 2.2 +- 0.3 of normal ones
STANDS_OUT = 4.0  # of a station's own errors, whose uncertainties differ


def planned_targets(cell: Cell) -> int:
    """Return how many targets a station needs whose errors are normal, with half the mean that is
    accepted; raises `HilcellError` where the plan has too few for any acceptance.
    """
    rule = SequentialRule.of(cell, Guard())
    decision = rule.decide(np.zeros(cell.plan.most_targets))
    if decision.outcome is not Outcome.ACCEPTED:
        raise HilcellError(
            f"plan.most_targets {cell.plan.most_targets}: not enough to accept a station at "
            f"accept_risk {cell.plan.accept_risk:g} and share_above_max "
            f"{cell.plan.share_above_max:g}, even without any error; allow more targets",
            code="HC-C10",
        )
    normal = np.linalg.norm(np.random.default_rng(2014).normal(size=(BLOCK, 3)), axis=1)
    usual_mm = np.tile(normal / normal.mean() * rule.mean_limit_mm / 2, len(normal))
    return replace(rule, rising=True).decide(usual_mm).targets or decision.targets


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
    rule = SequentialRule.of(log.cell, guard_at(log, station)).for_tail(tail(log))
    return rule.decide(chosen.norms_mm)


def tail(log: Log) -> float | None:
    """Return the largest over the median of the errors at poses left out, each by its uncertainty;
    None where unknown.
    """
    fitted = log.verdict(Fitted)
    return None if fitted is None else fitted.tail


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


def rounds(log: Log, station: str) -> Iterator[range]:
    """Yield the numbers of the targets of each next block, until the station is decided."""
    yield range(BLOCK)
    for end in range(2 * BLOCK, log.cell.plan.most_targets + 1, BLOCK):
        if decision_at(log, station).outcome is not Outcome.UNDECIDED:
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
    text, rule = meaning(log.cell, outcome, guard, enough=enough), rule_of(tail(log))
    return Decided(
        outcome=outcome,
        targets=counts,
        text=f"{outcome.text} after {' + '.join(map(str, counts))} targets: {text} ({rule})",
        rule=rule,
        accept_risk=plan.accept_risk,
        reject_risk=plan.reject_risk,
        share_above_max=plan.share_above_max,
    )


def rule_of(tail: float | None) -> str:
    """Return for which errors the test holds, and why."""
    if tail is None:
        return "test for errors of any distribution"
    shown = f"the largest error at poses left out is {tail:.1f} times their median, by uncertainty"
    if tail <= LIGHT:
        return f"test for errors of rising hazard rate: {shown}, at most {LIGHT:g}"
    return f"test for errors of any distribution: {shown}, not at most {LIGHT:g}"


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
    rising: bool = False  # hazard rate of the errors

    def for_tail(self, tail: float | None) -> SequentialRule:
        """Return the rule for errors with a tail; a heavy one might have been taken for a light
        one, and that has a half of the risk.
        """
        if tail is None:
            return self
        if tail <= LIGHT:
            return replace(self, rising=True)
        return replace(self, accept_risk=self.accept_risk / 2)

    def decide(self, errors_mm: ArrayLike) -> Decision:
        """Return the decision at the first block's end at which errors (N,) decide, in order."""
        errors = np.asarray(errors_mm, dtype=float)
        ends = np.arange(self.block, len(errors) + 1, self.block)
        fits = errors <= self.max_limit_mm  # NaN does not
        within, errors = np.logical_and.accumulate(fits), np.where(fits, errors, self.max_limit_mm)
        accepted = within & self._below(errors) & self._seldom_above(errors)
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
        if not self.rising:
            return self._won(gains, self.accept_risk)
        beyond = np.exp(-1.0)  # the least probability of an error above the limit of the mean
        made = 0.52 * self._all_within(errors, self.mean_limit_mm, beyond)  # eight are enough
        some = np.where(errors <= self.mean_limit_mm, beyond / (1.0 - beyond), -1.0)
        made += 0.3 * np.exp(np.cumsum(np.log1p(0.7 * some)))
        won: Bools = self._light(errors) * made + 0.18 * self._made(gains) >= 1.0 / self.accept_risk
        return won

    def _light(self, errors: Array) -> Bools:
        """Return after each error (N,) whether none has stood out at the end of a block."""
        light = np.ones(len(errors), dtype=np.bool_)
        for end in range(self.block, len(errors) + 1, self.block):
            if not errors[:end].max() <= STANDS_OUT * np.median(errors[:end]):
                light[end - 1 :] = False
                break
        return light

    def _seldom_above(self, errors: Array) -> Bools:
        """Return after each error (N,) whether the share above the maximum is shown to be less."""
        parts = {2.0: 0.96, 1.5: 0.02, 1.0: 0.02} if self.rising else {1.0: 1.0}
        made = [
            part * self._all_within(errors, self.max_limit_mm / c, self.share ** (1.0 / c))
            for c, part in parts.items()
        ]
        won: Bools = np.sum(made, axis=0) >= 1.0 / self.accept_risk
        return won

    @staticmethod
    def _all_within(errors: Array, limit: float, beyond: float) -> Array:
        """Return after each error (N,) what a bet makes of 1 that none is above a limit, fair where
        ``beyond`` is the probability of that.
        """
        within = np.logical_and.accumulate(errors <= limit)
        return np.asarray(within * (1.0 - beyond) ** -np.arange(1.0, len(errors) + 1.0))

    def _above(self, errors: Array) -> Bools:
        """Return after each error (N,) whether the mean is shown to be above its limit."""
        return self._won(errors / self.mean_limit_mm - 1.0, self.reject_risk)

    @staticmethod
    def _won(gains: Array, risk: float) -> Bools:
        """Return after each gain (N,), >= -1, whether the bets' mean has reached 1 / risk."""
        won: Bools = SequentialRule._made(gains) >= 1.0 / risk
        return won

    @staticmethod
    def _made(gains: Array) -> Array:
        """Return after each gain (N,) what bets make of 1, in the mean."""
        stakes = np.linspace(0.05, 0.95, 10)  # the mean of fair bets is a fair bet
        logs = np.cumsum(np.log1p(stakes * gains[:, None]), axis=0)
        made: Array = np.exp(np.logaddexp.reduce(logs, axis=1) - np.log(len(stakes)))
        return made

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
