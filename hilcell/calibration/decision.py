"""The decision rule for mean and largest error: accepted only where both surely keep their limits.

A guard band as wide as the expanded uncertainty U (k = 2) is taken off each limit (ISO 14253-1;
JCGM 106:2012, 8.3.2): conformity is shown where figure + U keeps the limit, the contrary where
figure - U is above it, and in between neither is. Exit code, screen, report and `compensate` ask
this one rule, the sequential one of a quick plan takes its limits from it.

U is that of the measurement (`measurement_budget`). |e| never changes by more than the
position measured, so u of one coordinate, along e, bounds that of a single 3D error, and of the
largest of many; in their mean the noise of readings averages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from hilcell.calibration.contribution import expanded_mm
from hilcell.calibration.measurement_budget import budget_of
from hilcell.cell.file import Cell
from hilcell.geometry.sequential import Outcome
from hilcell.geometry.statistics import figures_of, lengths_mm, rectangular_variance
from hilcell.journal.log import Log
from hilcell.ports import Array, HilcellError

GRAVEST: tuple[Outcome, ...] = ("rejected", "undecided", "accepted")
RULE = (
    "guard band: accepted where the figure plus its expanded uncertainty U (k = 2) keeps the limit "
    "(ISO 14253-1; JCGM 106, 8.3.2)"
)


class Limits(NamedTuple):
    """Limits of mean and largest 3D error, mm."""

    mean_mm: float
    max_mm: float


class Guard(NamedTuple):
    """Expanded uncertainties of mean and largest 3D error, mm."""

    mean_mm: float
    max_mm: float


NO_GUARD = Guard(0.0, 0.0)  # before anything is measured


class Judged(msgspec.Struct, frozen=True):
    """Figures against their limits, as verdicts in journals and calibration files have them.

    U is None in verdicts of earlier versions, which did not add it.
    """

    holds: bool
    mean_mm: float
    mean_tolerance_mm: float
    max_mm: float
    max_tolerance_mm: float
    mean_U_mm: float | None = None
    max_U_mm: float | None = None
    outcome: Outcome | None = None
    decision: str = ""

    @property
    def figures(self) -> str:
        """Return the figures beside their limits."""
        return (
            f"mean {_with_u(self.mean_mm, self.mean_U_mm)} mm, wanted <= "
            f"{self.mean_tolerance_mm:g}; largest {_with_u(self.max_mm, self.max_U_mm)} mm, wanted "
            f"<= {self.max_tolerance_mm:g}"
        )


def limits_of(cell: Cell) -> Limits:
    """Return the limits that a cell states."""
    return Limits(cell.validation.mean_tolerance_mm, cell.validation.max_tolerance_mm)


def check_limits(cell: Cell) -> None:
    """Raise `HilcellError` where the stated uncertainties alone leave nothing of a limit.

    Hours of measurement could then accept nothing.
    """
    stated = cell.uncertainty
    limits_mm = (stated.tracker_limit_mm, stated.smr_centring_limit_mm)
    least_mm = expanded_mm(math.sqrt(sum(map(rectangular_variance, limits_mm))))
    for name, limit_mm in (("mean", cell.validation.mean_tolerance_mm),
                           ("max", cell.validation.max_tolerance_mm)):  # fmt: skip
        if not limit_mm > least_mm:
            raise HilcellError(
                f"validation.{name}_tolerance_mm {limit_mm:g}: nothing could be accepted, the "
                f"tracker and the reflector's centring alone have U = {least_mm:.3f} mm (k = 2); "
                "wanted more",
                code="HC-C10",
            )


def guard_of(log: Log, count: int) -> Guard:
    """Return U of the mean and of the largest of ``count`` 3D errors that a run measured.

    Raises `HilcellError` where it has framed no {W}: then it has measured none.
    """
    budget = budget_of(log)
    if budget is None:
        raise HilcellError("no error is judged: no position was measured in {W}", code="HC-C21")
    return Guard(budget.of_mean_of(count), budget.U_mm)


def limits_within(limits: Limits, guard: Guard) -> Limits:
    """Return the limits that a measured figure must keep: less U, which may leave nothing."""
    return Limits(limits.mean_mm - guard.mean_mm, limits.max_mm - guard.max_mm)


def judged(
    mean_mm: float,
    max_mm: float,
    limits: Limits,
    guard: Guard,
    *,
    also: Outcome = "accepted",
    words: str = "",
) -> Judged:
    """Return the decision on mean and largest error.

    ``also`` is the outcome of another test that must accept as well, ``words`` what it says.
    """
    outcome = gravest(
        [
            also,
            outcome_of(mean_mm, limits.mean_mm, guard.mean_mm),
            outcome_of(max_mm, limits.max_mm, guard.max_mm),
        ]
    )
    return Judged(
        outcome == "accepted",
        mean_mm,
        limits.mean_mm,
        max_mm,
        limits.max_mm,
        guard.mean_mm,
        guard.max_mm,
        outcome,
        words or WORDS[outcome],
    )


def judged_again(stated: Judged, limits: Limits | None = None) -> Judged:
    """Return the decision on a verdict's figures, by its own or other limits.

    What a verdict of earlier versions does not state counts as nought.
    """
    own = Limits(stated.mean_tolerance_mm, stated.max_tolerance_mm)
    guard = Guard(stated.mean_U_mm or 0.0, stated.max_U_mm or 0.0)
    return judged(stated.mean_mm, stated.max_mm, limits or own, guard)


def judged_errors(log: Log, errors_mm: Array) -> Judged:
    """Return the decision on 3D errors (N, 3) that a run measured, by its cell's limits."""
    found = figures_of(lengths_mm(errors_mm))
    return judged(found.mean, found.max, limits_of(log.cell), guard_of(log, len(errors_mm)))


def outcome_of(value_mm: float, limit_mm: float, U_mm: float) -> Outcome:
    """Return the decision on one figure; NaN is rejected."""
    if value_mm <= limit_mm - U_mm:
        return "accepted"
    return "undecided" if value_mm <= limit_mm + U_mm else "rejected"


def gravest(outcomes: Sequence[Outcome]) -> Outcome:
    """Return the gravest of outcomes."""
    return min(outcomes, key=GRAVEST.index)


WORDS: dict[Outcome, str] = {
    "accepted": "in tolerance, the uncertainty added",
    "undecided": "neither in nor out of tolerance for sure: within the uncertainty of the limit",
    "rejected": "out of tolerance, the uncertainty taken off",
}


def _with_u(value_mm: float, U_mm: float | None) -> str:
    return f"{value_mm:.4f}" if U_mm is None else f"{value_mm:.4f} + U {U_mm:.4f}"
