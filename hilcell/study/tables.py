"""The answers of a study as tables of text, and as plain values for programs."""

from __future__ import annotations

import math
import re
from collections import Counter
from functools import partial
from operator import attrgetter, itemgetter

from hilcell.present.table import Column, Table
from hilcell.study.analysis import NONE, Design, Effect, Rows, answers, whole
from hilcell.study.case import CANNOT_BE, DONE, FAILED, RESULTS
from hilcell.study.design import Case
from hilcell.study.study_file import Optimum, Study


def point_columns(study: Study) -> list[Column[Design | Case]]:
    """Return the number of a point, and a column for each factor."""
    factors = enumerate(each.title for each in study.factor)
    return [
        Column("point", lambda row: str(row.point.number)),
        *(Column[Design | Case](title, partial(_choice, n)) for n, title in factors),
    ]


def _choice(n: int, row: Design | Case) -> str:
    return row.point.choices[n].word


class Summary:
    """The answers of a study to its rows: as tables, in a sentence, and as plain values."""

    def __init__(self, study: Study, rows: Rows) -> None:
        self.study, self.rows = study, rows
        self.found = answers(study, rows)

    def tables(self) -> dict[str, Table]:
        """Return all tables by their names in the page; some may be empty."""
        return {
            "best": self._best(),
            "front": self.front(),
            "purchases": self.purchases(),
            "effects": self.effects(),
            "reasons": self._reasons(),
        }

    def _design_columns(self) -> list[Column[Design]]:
        """Return the columns of a design: point and factors, minutes, accuracy."""
        return [
            *point_columns(self.study),
            Column("minutes", attrgetter("minutes"), form=".0f"),
            Column(self.study.accuracy[:-3], lambda row: row.accuracy.text(), "mm", "s"),
        ]

    def _best(self) -> Table:
        """Return the best design that an optimiser has found, and the one it was begun with."""
        study, found = self.study, self.found
        best, wanted = found.best, study.optimise
        if best is None or wanted is None:
            return Table((), ())
        tried = [best, *(each for each in found.designs if each.point.number == 1 and each != best)]
        goal = [f"{study.accuracy[:-3]} error"]
        if wanted.mm_per_minute:
            goal.append(f"{wanted.mm_per_minute:g} mm a minute")
        most = f", in at most {wanted.most_minutes:g} minutes" if wanted.most_minutes else ""
        note = (
            f"The least {' + '.join(goal)}{most}, of {len(found.designs)} designs that were tried; "
            "then the design that the search began with. The best of many was lucky as well: "
            "measure it again in a study with more machines."
        )
        return Table(self._design_columns(), tried, "Best design found", note)

    def front(self) -> Table:
        """Return the designs that no other beats in everything, the fastest first."""
        study, found = self.study, self.found
        of_all = study.machines * study.seeds
        columns = self._design_columns()
        if study.has_costs:
            columns.insert(-1, Column(study.money, lambda row: row.point.cost, form="g"))
        columns.append(Column("covered", lambda row: row.covered.text(), "%", "s"))
        if any(each.cases < of_all for each in found.front):
            columns.append(Column("done", lambda row: f"{row.cases} of {of_all}", form="s"))
        against = "accuracy, minutes and money" if study.has_costs else "accuracy and minutes"
        note = (
            f"Of {len(found.designs)} designs these are beaten by no other in {against}."
            if len(found.designs) > 1
            else "No other design has a result."
        ) + f" {RESULTS[study.accuracy][0].capitalize()}."
        return Table(columns, found.front, "Pareto front", note + self._one_machine())

    def purchases(self) -> Table:
        """Return what each step from a first level gains, the largest gain that is shown first."""
        columns: list[Column[Effect]] = [
            Column("factor", attrgetter("factor.title")),
            Column("from", attrgetter("start")),
            Column("to", attrgetter("word")),
            Column("gain", lambda row: row.change.text(-1.0), "mm", "s"),
            Column("shown", attrgetter("shown"), form="s"),
            Column("more minutes", lambda row: _signed(row.minutes), form="s"),
        ]
        if self.study.has_costs:
            columns.append(
                Column(f"more {self.study.money}", lambda row: _signed(row.cost), form="s")
            )
        note = (
            "Gain: by how much the error falls when this factor alone changes, all else averaged."
        )
        if any(each.word != each.start and not each.is_step for each in self.found.effects):
            note += " Steps that the cases cannot separate are left out; main effects say why."
        return Table(columns, self.found.purchases, "Buy next", note + self._one_machine())

    def effects(self) -> Table:
        """Return the accuracy at each level of each factor, all else averaged."""
        found = self.found
        columns: list[Column[Effect]] = [
            Column("factor", attrgetter("factor.title")),
            Column("level", attrgetter("word")),
            Column(self.study.accuracy[:-3], lambda row: row.mean.text(), "mm", "s"),
            Column(
                "change",
                lambda row: row.change.text() if row.word != row.start else None,
                "mm",
                "s",
            ),
            Column("minutes", lambda row: _signed(row.minutes), form="s"),
            Column("covered", lambda row: row.covered.text(), "%", "s"),
        ]
        note = "\n".join([*found.not_estimable, self._explained()])
        if found.covered is not None:
            within = f"{found.covered.text()} % of targets lie within their 95 % bound."
            note += f"Over all designs {within}"
        return Table(columns, found.effects, "Main effects", note)

    def _explained(self) -> str:
        found = self.found
        if found.unknowns == 1:  # nothing varies
            return ""
        counts = f"(designs: {len(found.designs)}, unknowns: {found.unknowns})"
        if math.isnan(found.share):
            return f"Whether effects add up is not checked, as there are too few designs {counts}. "
        share = f"{100.0 * found.share:.0f} % of the differences between designs"
        return f"Main effects alone explain {share} {counts}. "

    def _reasons(self) -> Table:
        """Return why cases were not done, the most frequent reason first."""
        bad = [(row.state, _brief(row.reason)) for row in self.rows if row.state != DONE]
        counts = Counter((state, _kind(reason)) for state, reason in bad)
        first = {(state, _kind(reason)): reason for state, reason in reversed(bad)}
        most = 10
        more = len(counts) - most
        note = f"And {more} more reasons." if more > 0 else ""
        columns: list[Column[tuple[tuple[str, str], int]]] = [
            Column("state", lambda row: row[0][0]),
            Column("reason", lambda row: first[row[0]]),
            Column("cases", itemgetter(1), form="d"),
        ]
        return Table(columns, counts.most_common(most), "Cases without a result", note)

    def counts(self) -> str:
        study, planned, counts = self.study, self.study.most_cases, self.found.counts
        ended = [
            f"{counts[state]} {state}" for state in (DONE, CANNOT_BE, FAILED) if state in counts
        ]
        kept = sum(counts.values())
        if study.optimise is not None:
            cases = f"{kept} cases, at most {planned}: {', '.join(ended) or 'none measured'}"
            return cases + (self._none_found(study.optimise) if kept else "")
        waiting = [f"{planned - kept} not measured yet"] if kept < planned else []
        return f"{planned} cases: {', '.join([*ended, *waiting]) or 'none measured'}"

    def _none_found(self, wanted: Optimum) -> str:
        """Return why a search has no best design; nothing where it has one."""
        minutes = [each.minutes for each in whole(self.study, self.found.designs)]
        if not minutes:
            return "; no design was done on every machine"
        if self.found.best is not None or wanted.most_minutes is None:
            return ""
        shortest = math.ceil(10.0 * min(minutes)) / 10.0  # never below the limit that it exceeds
        most = f"no design of at most {wanted.most_minutes:g} minutes"
        return f"; {most}, the shortest took {shortest:g}"

    def _one_machine(self) -> str:
        covered = self.found.covered
        if covered is None or not math.isnan(covered.low):
            return ""
        alone = self.study.machines == 1
        why = "state more `machines`" if alone else "the others are not measured yet"
        return f" Without intervals: one machine gives no interval; {why}."

    def facts(self) -> dict[str, object]:
        """Return the answers as plain values; NaN, which JSON has as null, where there is none."""
        study, found = self.study, self.found
        return {
            "study": study.name,
            "accuracy": study.accuracy,
            "cases": study.most_cases,
            "counts": dict(found.counts),
            "best": None if found.best is None else found.best.facts(),
            "front": [each.facts() for each in found.front],
            "designs": [each.facts() for each in found.designs],
            "effects": [each.facts() for each in found.effects],
            "buy_next": [each.facts() for each in found.purchases],
            "covered": found.covered,
            "explained": found.share,
            "not_estimable": found.not_estimable,
        }


def _brief(reason: str) -> str:
    """Return the first cause of a refusal, without its list of poses and what to do about it."""
    lines = reason.splitlines()
    first = lines[1] if len(lines) > 1 else reason
    return first.partition(": pose ")[0].partition("; ")[0].strip()


def _kind(reason: str) -> str:
    """Return a reason without its figures: cases of one kind are counted together."""
    return re.sub(r"\d+", "0", reason).replace("-0", "0").replace("+0", "0")


def _signed(value: float) -> str:
    """Return a difference; a dash where it is not known."""
    if math.isnan(value):
        return NONE
    shown = f"{value:+.0f}"
    return "0" if float(shown) == 0.0 else shown.replace("-", "−")
