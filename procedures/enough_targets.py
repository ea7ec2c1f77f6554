"""A quick validation: as few targets at each station as its verdict needs at the stated risks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.calibration.decision import NO_GUARD, Guard, guard_of, limits_of, limits_within
from hilcell.calibration.errors import validation
from hilcell.cell.file import Cell
from hilcell.geometry.sequential import Decision, SequentialRule
from hilcell.journal.log import Log
from hilcell.model.events import StationDecided
from hilcell.model.outcome import Outcome, gravest, outcome_of
from hilcell.model.point import Sent
from hilcell.model.results import Decided
from hilcell.ports import Array, HilcellError
from hilcell.run.cell_session import CellSession

OCTANTS = np.array(  # of a box, in an order whose every step crosses one face
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 0, 1), (0, 0, 1)]
)
BLOCK = len(OCTANTS)
LEAST_MM = 1e-6  # a limit that no error keeps, where U leaves nothing of the tolerance


def rule_of(cell: Cell, guard: Guard = NO_GUARD) -> SequentialRule:
    """Return the rule by which each station is judged.

    Its limits are the tolerances less ``guard``, as in `hilcell.calibration.decision`.
    """
    within = limits_within(limits_of(cell), guard)
    return SequentialRule(
        mean_limit_mm=max(within.mean_mm, LEAST_MM),
        max_limit_mm=max(within.max_mm, LEAST_MM),
        share=cell.plan.share_above_max,
        accept_risk=cell.plan.accept_risk,
        reject_risk=cell.plan.reject_risk,
        block=BLOCK,
    )


def least_targets(cell: Cell) -> int:
    """Return how many targets an acceptance needs at least; raises `HilcellError` where the plan
    has fewer.
    """
    decision = rule_of(cell).decide(np.zeros(cell.plan.most_targets))
    if decision.outcome is not Outcome.ACCEPTED:
        raise HilcellError(
            f"plan.most_targets {cell.plan.most_targets}: not enough to accept a station at "
            f"accept_risk {cell.plan.accept_risk:g} and share_above_max "
            f"{cell.plan.share_above_max:g}, even without any error; allow more targets",
            code="HC-C10",
        )
    return decision.targets


def octant_targets(cell: Cell, seed: int, low_mm: Array, high_mm: Array) -> dict[str, Array]:
    """Return targets (N, 3) in {B} by station, the grid's first: in blocks, one in each octant.

    Each is uniform in its octant of the box from ``low_mm`` (3,) to ``high_mm`` (3,), so that
    every block covers the box.
    """
    blocks, half_mm = cell.plan.most_targets // BLOCK, (high_mm - low_mm) / 2
    others = [station.name for station in cell.station if station.name != cell.grid.station]
    drawn = {}
    for number, name in enumerate([cell.grid.station, *others]):
        inside = np.random.default_rng([seed, 2014, number]).uniform(size=(blocks * BLOCK, 3))
        drawn[name] = low_mm + half_mm * (np.tile(OCTANTS, (blocks, 1)) + inside)
    return drawn


def decision_at(log: Log, station: str) -> Decision:
    """Return what the corrected targets measured so far at a station have shown."""
    chosen = validation(log, [station]).get(Sent.CHOSEN)
    if chosen is None:
        return rule_of(log.cell).decide([])
    return rule_of(log.cell, guard_at(log, station)).decide(chosen.norms_mm)


def guard_at(log: Log, station: str) -> Guard:
    """Return the U by which a station was decided: that of then, not of what is measured later."""
    for decided in reversed(log.happened(StationDecided)):
        if decided.station == station:
            return Guard(decided.mean_U_mm, decided.max_U_mm)
    return guard_of(log, len(validation(log, [station])[Sent.CHOSEN]))


def keep_guard(session: CellSession, station: str) -> None:
    """Journal the U by which a station was decided, once."""
    if station not in [each.station for each in session.log.happened(StationDecided)]:
        guard = guard_at(session.log, station)
        session.add(StationDecided(station=station, mean_U_mm=guard.mean_mm, max_U_mm=guard.max_mm))


def rounds(log: Log, station: str, how: str) -> Iterator[range]:
    """Yield the numbers of the targets of each next block, until the station is decided.

    Of uncorrected targets, which decide nothing, one block shows the error before.
    """
    yield range(BLOCK)
    for end in range(2 * BLOCK, log.cell.plan.most_targets + 1, BLOCK):
        if how != Sent.CHOSEN or decision_at(log, station).outcome is not Outcome.UNDECIDED:
            return
        yield range(end - BLOCK, end)


def judgement(log: Log, stations: list[str]) -> Decided:
    """Return the outcome at ``stations``, the targets of each, and what it means.

    More targets cannot accept what is shown to be above a tolerance less U. It is out of tolerance
    only by the rule of all results: where a figure less U is above the tolerance, too.
    """
    decisions = [decision_at(log, station) for station in stations]
    counts = [each.targets for each in decisions]
    chosen, limits = validation(log, stations)[Sent.CHOSEN], limits_of(log.cell)
    guard, figures = guard_of(log, len(chosen)), chosen.figures
    by_station: list[Outcome] = [
        Outcome.ACCEPTED if each.outcome is Outcome.ACCEPTED else Outcome.UNDECIDED
        for each in decisions
    ]
    outcome = gravest([
        *by_station,
        outcome_of(figures.mean, limits.mean_mm, guard.mean_mm),
        outcome_of(figures.max, limits.max_mm, guard.max_mm),
    ])  # fmt: skip
    enough = all(
        each.outcome is Outcome.REJECTED
        for each in decisions
        if each.outcome is not Outcome.ACCEPTED
    )
    text = meaning(log.cell, outcome, guard, enough=enough)
    return Decided(
        outcome=outcome,
        targets=counts,
        text=f"{outcome.words} after {' + '.join(map(str, counts))} targets: {text}",
        accept_risk=log.cell.plan.accept_risk,
        reject_risk=log.cell.plan.reject_risk,
        share_above_max=log.cell.plan.share_above_max,
    )


def meaning(cell: Cell, outcome: Outcome, guard: Guard, *, enough: bool) -> str:
    """Return in words what an outcome has shown of the tolerances, or has not.

    ``enough``: more targets would not change it.
    """
    plan, limits = cell.plan, limits_of(cell)
    within = limits_within(limits, guard)
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
