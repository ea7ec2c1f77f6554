"""Decision rule for figures against limits, and its outcomes.

Each limit is reduced by a guard band of the expanded uncertainty U, k = 2 (ISO 14253-1; JCGM
106:2012, 8.3.2): accepted where value + U is within the limit, rejected where value - U exceeds it,
undecided in between.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple, Self

from hilcell.language import marked

RULE = marked(
    "guard band: accepted where the figure plus its expanded uncertainty U (k = 2) keeps the limit "
    "(ISO 14253-1; JCGM 106, 8.3.2)"
)


class Outcome(StrEnum):
    """Outcome of a figure, point, station or run, the worst first. ``text`` and ``short`` are for
    people, ``decision`` names the uncertainty as well.
    """

    text: str
    short: str
    decision: str

    def __new__(cls, value: str, text: str = "", short: str = "", decision: str = "") -> Self:
        member = str.__new__(cls, value)
        member._value_, member.text, member.short = value, text, short
        member.decision = decision
        return member

    REJECTED = (
        "rejected",
        marked("out of tolerance"),
        marked("fail"),
        marked("out of tolerance, the uncertainty taken off"),
    )
    UNDECIDED = (
        "undecided",
        marked("undecided"),
        marked("undecided"),
        marked("neither in nor out of tolerance for sure, within the uncertainty of the limit"),
    )
    ACCEPTED = (
        "accepted",
        marked("in tolerance"),
        marked("pass"),
        marked("in tolerance, the uncertainty added"),
    )


def gravest(outcomes: Iterable[Outcome]) -> Outcome:
    return min(outcomes, key=list(Outcome).index, default=Outcome.ACCEPTED)


def outcome_of(value: float, limit: float, U: float) -> Outcome:
    """Decision on one value, all in one unit; NaN is rejected."""
    if value <= limit - U:
        return Outcome.ACCEPTED
    return Outcome.UNDECIDED if value <= limit + U else Outcome.REJECTED


class Figure(NamedTuple):
    """A value, its U (k = 2) and its limit, in ``unit``; None, an unknown value, fails
    every limit.
    """

    name: str
    value: float | None
    unit: str = "mm"
    limit: float | None = None
    U: float | None = None
    form: str = ".4f"

    @property
    def outcome(self) -> Outcome:
        """The decision; NaN is rejected, a value without a limit accepted."""
        if self.limit is None:
            return Outcome.ACCEPTED
        value = math.nan if self.value is None else self.value
        return outcome_of(value, self.limit, self.U or 0.0)

    @property
    def measured(self) -> str:
        if self.value is None:
            return f"{self.name} not known"
        U = "" if self.U is None else f" (U {self.U:{self.form}})"
        return f"{self.name} {self.value:{self.form}} {self.unit}".rstrip() + U

    @property
    def text(self) -> str:
        if self.limit is None:
            return self.measured
        return f"{self.measured}, limit {self.limit:g} {self.unit}".rstrip()

    @property
    def why(self) -> str:
        """The figure against its limit by the rule of its outcome: U taken off, or added."""
        if self.limit is None or self.value is None or self.outcome is Outcome.ACCEPTED:
            return self.text
        pairs = ((self.value, self.form), (self.limit, "g"), (self.U or 0.0, self.form))
        value, limit, U = (f"{size:{form}} {self.unit}".rstrip() for size, form in pairs)
        verb = "exceeds"
        if self.outcome is Outcome.REJECTED:
            end = f" by more than its U of {U}" if self.U else ""
        elif self.value > self.limit:
            end = f", but by less than its U of {U}"
        else:
            verb, end = "keeps", f", but not with its U of {U} added"
        return f"{self.name} {value} {verb} {limit}{end}"
