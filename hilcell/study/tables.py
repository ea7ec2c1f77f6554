"""The answers of a study as tables of text, and as plain values for programs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter, itemgetter
from typing import TypeVar

from hilcell.present.table import Column, Table
from hilcell.sanitize import counted
from hilcell.study.analysis import Design, Effect, Interaction, Rows, answers, brief, kind, whole
from hilcell.study.case import CANNOT_BE, DONE, FAILED, RESULTS
from hilcell.study.design import Case
from hilcell.study.inference import NONE, SHOWN, Within
from hilcell.study.study_file import Optimum, Study

T = TypeVar("T")


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
            "question": self.question(),
            "front": self.front(),
            "certificates": self.certificates(),
            "purchases": self.purchases(),
            "interactions": self.interactions(),
            "effects": self.effects(),
            "reasons": self._reasons(),
        }

    def _design_columns(self, errors: int = 2) -> list[Column[Design]]:
        """Return the columns of a design: point and factors, minutes, money, so many errors."""
        study = self.study
        columns: list[Column[Design]] = [
            *point_columns(study),
            Column("minutes", attrgetter("minutes"), form=".0f"),
        ]
        if study.has_costs:
            columns.append(Column(study.money, attrgetter("point.cost"), form="g"))
        return [*columns, *self._errors()[:errors]]

    @property
    def _error(self) -> str:
        """The error that decides, in words."""
        figure = self.study.accuracy[:-3].removeprefix("true_")
        return f"{figure} {'true ' if self.found.by_truth else ''}error"

    def _errors(self) -> list[Column[Design]]:
        """Return the columns of the accuracy: the truth where it is known, then as measured."""
        return self._accuracies(lambda row: row.accuracy.text(), lambda row: row.truth.text())

    def _accuracies(
        self, measured: Callable[[T], str], true: Callable[[T], str], of: str = ""
    ) -> list[Column[T]]:
        """Return a column of the accuracy, or two where the truth is known beside it."""
        name = of or self.study.accuracy[:-3].removeprefix("true_")
        both = [Column(f"true {name}", true, "mm", "s")] if self.found.by_truth else []
        if self.study.accuracy != self.study.truth or not both:
            both.append(Column(f"measured {name}" if both else name, measured, "mm", "s"))
        return both

    def _best(self) -> Table:
        """Return the best design that an optimiser has found, and the one it was begun with."""
        study, found = self.study, self.found
        best, wanted = found.best, study.optimise
        if best is None or wanted is None:
            return Table((), ())
        tried = [best, *(each for each in found.designs if each.point.number == 1 and each != best)]
        goal = [self._error]
        if wanted.mm_per_minute:
            goal.append(f"{wanted.mm_per_minute:g} mm a minute")
        most = f", in at most {wanted.most_minutes:g} minutes" if wanted.most_minutes else ""
        note = (
            f"The least {' + '.join(goal)}{most}, of {counted(len(found.designs), 'design')}; "
            "then the design that the search began with. The best of many was lucky as well: "
            "measure it again on new machines (first_machine)."
        )
        return Table(self._design_columns(), tried, "Best design found", note)

    def question(self) -> Table:
        """Return the answers to the buyer's question: of the front, and of all that say yes.

        Where no design is on the front, those with the most machines within.
        """
        asked = self.study.question
        if asked is None:
            return Table((), ())
        judged = [(each, each.within) for each in self.found.designs if each.within]
        if self.found.front:
            which = "the Pareto front, and every design with a yes"
            listed = [each for each, own in judged if each.on_front or own.answer == "yes"]
            listed.sort(key=attrgetter("minutes"))
        else:
            most = 10
            which = (
                f"no design was done on every machine, so the {most} with the most machines within"
            )
            judged.sort(key=lambda pair: (-pair[1].within, pair[0].minutes))
            listed = [each for each, _ in judged[:most]]
        columns: list[Column[Design]] = [
            *self._design_columns(0),
            Column("within", lambda row: _within(row.within), form="s"),
            Column("share at least", lambda row: 100.0 * _low(row.within), "%", ".1f"),
            Column("answer", lambda row: row.within.answer if row.within else None, form="s"),
            Column("more", lambda row: row.within.more or None if row.within else None),
            Column("if normal", lambda row: _tolerance(row.within), "mm", "s"),
        ]
        if self.found.by_truth:
            columns.append(
                Column("within as measured", lambda row: _within(row.measured_within), form="s")
            )
        title = (
            f"Question: do {100.0 * asked.share:g} % of machines have a {self._error} within "
            f"{asked.limit_mm:g} mm, {100.0 * asked.confidence:g} % sure?"
        )
        note = (
            f"Listed: {which}. Within: machines within the limit, of those that were measured with "
            "every set of targets; a machine on which the design failed is not within. More: so "
            "many further machines would give a yes if all of them were within. Do not add "
            "machines until it says yes: ask again on new machines (first_machine), with the "
            "number fixed ahead. Share at least: exact for any distribution (Clopper and Pearson), "
            "of each design by itself. The best of many designs was lucky as well: measure it in a "
            "study of its own. If normal: the limit that this share of machines keeps if they are "
            "normally distributed."
        )
        return Table(columns, listed, title, note)

    def front(self) -> Table:
        """Return the designs that no other beats in everything, the fastest first."""
        study, found = self.study, self.found
        columns = self._design_columns(1)  # certificates say what is measured
        if not found.by_truth:
            columns.append(Column("covered", lambda row: row.covered.text(), "%", "s"))
        columns.append(Column("one machine", lambda row: row.one.text(), "mm", "s"))
        if any(each.equal_to for each in found.front):
            columns.append(Column("no better than", attrgetter("equal_to")))
        able = len(whole(study, found.designs))
        without = len(found.designs) - able
        against = "accuracy, minutes and money" if study.has_costs else "accuracy and minutes"
        note = f"Of {able} designs these are beaten by no other in {against}. " if able > 1 else ""
        if without:
            note += f"Not done on every machine, so not compared: {counted(without, 'design')}. "
        if not able:
            note = "No design was done on every machine with every set of targets. "
        if any(each.equal_to for each in found.front):
            note += (
                "No better than: a quicker or cheaper design that it is not shown to beat; the "
                f"risk that a design goes unmarked by chance is at most {100.0 * SHOWN:g} %. "
            )
        note += f"{RESULTS[study.accuracy][0].capitalize()}, with the 95 % interval of the mean."
        note += " One machine: where the one that you buy lies, 95 % sure, if machines are normal."
        return Table(columns, found.front, "Pareto front", note + self._one_machine())

    def certificates(self) -> Table:
        """Return what the customer's certificates say of the front, beside the truth."""
        if not self.found.by_truth:
            return Table((), ())
        columns: list[Column[Design]] = [
            point_columns(self.study)[0],
            *self._errors(),
            Column[Design]("95 % bound of a target", attrgetter("bound_mm"), "mm", ".3f"),
            Column[Design]("covered", lambda row: row.covered.text(), "%", "s"),
        ]
        note = (
            "A certificate has the measured figure, with the errors of its instrument, and the "
            "bound; covered: targets that were measured within theirs."
        )
        return Table(columns, self.found.front, "What certificates say", note)

    def purchases(self) -> Table:
        """Return what each step from a first level gains, the largest gain that is shown first."""
        purchases = self.found.purchases
        gains: list[Column[Effect]] = self._accuracies(
            lambda row: row.change.text(-1.0), lambda row: row.true_change.text(-1.0), "gain"
        )
        columns: list[Column[Effect]] = [
            Column("factor", attrgetter("factor.title")),
            Column("from", attrgetter("start")),
            Column("to", attrgetter("word")),
            *gains,
            Column("shown", attrgetter("shown"), form="s"),
            Column("more minutes", lambda row: _signed(row.minutes), form="s"),
        ]
        if self.study.has_costs:
            columns.append(
                Column(f"more {self.study.money}", lambda row: _signed(row.cost), form="s")
            )
        if any(each.depends_on for each in purchases):
            columns.append(Column("depends on", lambda row: ", ".join(row.depends_on)))
        ended = [each for each in purchases if each.ended.kinds or each.start_ended.kinds]
        if ended:
            columns.append(Column("without a result", _ended, form="s"))
        steps = len(purchases)
        note = (
            "Gain: by how much the error falls when this factor alone changes, all else averaged. "
            f"Shown: for {counted(steps, 'step')} together, the risk that chance shows one is at "
            f"most {100.0 * SHOWN:g} %, if the machines' differences are normal (Holm). Fails: "
            "more cases fail than at the first level, all else averaged; of a step that would be a "
            "gain, also where a greater share of its own cases failed. Failures are counted, not "
            "tested: where all are of one machine, another lot may have none."
        )
        if any(math.isinf(each.deciding.half) for each in purchases):
            note += f" ± {NONE}: no design is left over to check whether effects add up."
        if any(each.word != each.start and not each.is_step for each in self.found.effects):
            note += " Steps that the cases cannot separate are left out; main effects say why."
        return Table(columns, purchases, "Buy next", note + self._one_machine() + _kinds(ended))

    def interactions(self) -> Table:
        """Return what steps depend on, the clearest first."""
        found = sorted(self.found.interactions, key=lambda each: (each.p, -each.size_mm))
        columns: list[Column[Interaction]] = [
            Column("factor", attrgetter("factor.title")),
            Column("from", attrgetter("start")),
            Column("to", attrgetter("word")),
            Column("beside", attrgetter("other.title")),
            Column("gain at", lambda row: f"{row.first}: {row.at_first.text(-1.0)}", "mm"),
            Column("and at", lambda row: f"{row.second}: {row.at_second.text(-1.0)}", "mm"),
            Column("differ by", lambda row: row.difference.text(-1.0), "mm", "s"),
            Column("shown", lambda row: "yes" if row.known else "no", form="s"),
        ]
        note = (
            f"The clearest of {len(found)} that were tested; the risk that chance shows any is at "
            f"most {100.0 * SHOWN:g} % (Holm). Where one is shown, the gain of Buy next is an "
            "average only."
        )
        if any(math.isinf(each.difference.half) for each in found[:10]):
            note += f" ± {NONE}: no design is left over to check whether effects add up."
        return Table(columns, found[:10], "Interactions", note)

    def effects(self) -> Table:
        """Return the accuracy at each level of each factor, all else averaged."""
        found = self.found
        means: list[Column[Effect]] = self._accuracies(
            lambda row: row.mean.text(), lambda row: row.true_mean.text()
        )
        changes: list[Column[Effect]] = self._accuracies(
            lambda row: row.change.text() if row.word != row.start else "",
            lambda row: row.true_change.text() if row.word != row.start else "",
            "change",
        )
        columns: list[Column[Effect]] = [
            Column("factor", attrgetter("factor.title")),
            Column("level", attrgetter("word")),
            *means,
            *changes,
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
        designs = counted(len(found.designs), "design")
        counts = f"({designs}, {counted(found.unknowns, 'fitted figure')})"
        if math.isnan(found.share):
            return f"Whether effects add up is not checked, as there are too few designs {counts}. "
        share = f"{100.0 * found.share:.1f} % of the differences between designs"
        apart = f"the largest difference between a design and their sum is {found.apart_mm:.4f} mm"
        return f"Main effects alone explain {share} {counts}; {apart}. "

    def _reasons(self) -> Table:
        """Return why cases were not done, the most frequent reason first."""
        bad = [row for row in self.rows if row.state != DONE]
        counts = Counter((row.state, kind(row.reason)) for row in bad)
        first = {(row.state, kind(row.reason)): brief(row.reason) for row in reversed(bad)}
        pairs = {(row.state, kind(row.reason), row.machine) for row in bad}
        machines = Counter((state, reason) for state, reason, _ in pairs)
        most = 10
        more = len(counts) - most
        note = "Figures in a reason are those of its first case."
        note += f" And {more} more reasons." if more > 0 else ""
        columns: list[Column[tuple[tuple[str, str], int]]] = [
            Column("state", lambda row: row[0][0]),
            Column("reason", lambda row: first[row[0]]),
            Column("cases", itemgetter(1), form="d"),
            Column("machines", lambda row: machines[row[0]], form="d"),
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
            "decided_by": study.truth if found.by_truth else study.accuracy,
            "designs": [each.facts() for each in found.designs],
            "effects": [each.facts() for each in found.effects],
            "buy_next": [each.facts() for each in found.purchases],
            "interactions": [each.facts() for each in found.interactions],
            "covered": found.covered,
            "explained": found.share,
            "apart_mm": found.apart_mm,
            "not_estimable": found.not_estimable,
        }


def _within(judged: Within | None) -> str:
    return f"{judged.within} of {judged.machines}" if judged else NONE


def _low(judged: Within | None) -> float:
    return judged.share_low if judged else math.nan


def _tolerance(judged: Within | None) -> str:
    known = judged is not None and math.isfinite(judged.tolerance_mm)
    return f"{judged.tolerance_mm:.3f}" if judged and known else NONE


def _ended(row: Effect) -> str:
    """Return how many cases of a step's two levels have no result, of the second by machines."""
    first, own = row.start_ended, row.ended
    cases = f"{first.without} of {first.cases} → {own.without} of {own.cases}"
    return f"{cases} ({own.machines} of {own.all_machines} machines)" if own.without else cases


def _kinds(steps: Sequence[Effect]) -> str:
    """Return, a line a level, why cases of steps that fail have no result."""
    levels = {(row.factor.title, row.word): row.ended for row in steps if row.fails}
    return "".join(
        f"\n{title} {word}: {count} x {reason}"
        for (title, word), ended in levels.items()
        for reason, count in list(ended.kinds.items())[:3]
    )


def _signed(value: float) -> str:
    """Return a difference; a dash where it is not known."""
    if math.isnan(value):
        return NONE
    shown = f"{value:+.0f}"
    return "0" if float(shown) == 0.0 else shown.replace("-", "−")
