"""Answers of a study, from its rows: front, next purchases, interactions, a buyer's question.

Every machine measures all points, so each answer is computed on every machine by itself, and its
interval is that of the mean over machines (Student, 95 %). One machine alone gives no interval: its
targets are no sample of others'. Answers are by the simulator's truth where all rows have it; what
the design's own instrument measures, and so its certificate, is beside it.

A design that was not done on every machine with every set of targets beats no other.

An effect is a contrast of an additive model (`additive`). Where not every combination was done,
other combinations would give another effect, on all machines alike: two factors act together. The
machines cannot show that, so its variance is added: that of the points' residuals which machines
share, each by its leverage (clusters in two ways: Cameron, Gelbach and Miller 2011; HC2, of
interactions HC3: MacKinnon and White 1985). A step is shown where the risk that any of its table is
shown by chance is at most 5 % (Holm 1979).
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
from operator import methodcaller
from statistics import fmean
from typing import Generic, Self, TypeVar

import msgspec
import numpy as np

from hilcell.ports import Array
from hilcell.study.additive import Additive, Crossed
from hilcell.study.case import CANNOT_BE, DONE, FAILED, Row
from hilcell.study.design import Point, chosen
from hilcell.study.factor import Factor
from hilcell.study.inference import SHOWN, Interval, OneMachine, Share, Within, holm, p_value
from hilcell.study.study_file import BOUND, Optimum, Study

MEASURED, MINUTES, COVERED, DECIDES = range(4)  # figures of points
UNKNOWN = Interval(math.nan, math.nan)
ALIKE = 1e-6  # of shares that rounding sets apart; one case of a million is more
TINY = 1e-300  # no division by nought
TOO_LONG = 1e6  # of a design with too many minutes, which are added
Rows = Sequence[Row]
Model = TypeVar("Model", Additive, Crossed)


@dataclass(frozen=True, slots=True)
class Design:
    """The result of one point: accuracy, minutes, cost, over all machines that did it.

    ``accuracy`` is as measured, ``truth`` the simulator's; ``one`` is a machine more, by what
    decides. ``equal_to`` is a quicker or cheaper point of the front that it is not shown to beat.
    """

    point: Point
    accuracy: Interval
    truth: Interval
    one: OneMachine
    bound_mm: float
    minutes: float
    covered: Share
    machines: int
    cases: int
    whole: bool  # done on every machine with every set of targets
    on_front: bool = False
    equal_to: int | None = None
    within: Within | None = None  # the limit of the study's question, by what decides
    measured_within: Within | None = None

    @property
    def deciding(self) -> Interval:
        return self.accuracy if math.isnan(self.truth.mean) else self.truth

    def facts(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "point": self.point.number,
            "factors": {choice.factor.name: choice.shown for choice in self.point.choices},
            "accuracy_mm": self.accuracy,
            "true_mm": self.truth,
            "one_machine_mm": self.one,
            "bound95_mm": self.bound_mm,
            "minutes": self.minutes,
            "cost": self.point.cost,
            "covered": self.covered,
            "machines": self.machines,
            "whole": self.whole,
            "equal_to": self.equal_to,
            "question": self.within,
            "question_measured": self.measured_within,
        }


class Ended(msgspec.Struct, frozen=True):
    """How the cases of a level ended: how many have no result, on how many machines, and why."""

    cases: int = 0
    failed: int = 0
    cannot_be: int = 0
    machines: int = 0
    all_machines: int = 0
    kinds: dict[str, int] = {}

    @property
    def without(self) -> int:
        return self.failed + self.cannot_be

    @property
    def failed_share(self) -> float:
        """Return how many failed of those that ran, 0 to 1."""
        return self.failed / max(1, self.cases - self.cannot_be)

    @classmethod
    def of(cls, rows: Rows) -> Ended:
        counts = Counter(row.state for row in rows)
        machines = len({row.machine for row in rows if row.state != DONE})
        every = len({row.machine for row in rows})
        kinds = Counter(kind(row.reason) for row in rows if row.state != DONE)
        first = {kind(row.reason): brief(row.reason) for row in reversed(rows)}
        shown = {first[each]: count for each, count in kinds.most_common()}
        return cls(len(rows), counts[FAILED], counts[CANNOT_BE], machines, every, shown)


@dataclass(frozen=True, slots=True)
class Effect:
    """The accuracy at one level, or at one end of a range, and its change from the start.

    ``mean`` and ``change`` are as measured, ``true_mean`` and ``true_change`` the simulator's.
    """

    factor: Factor
    word: str
    start: str  # the first level that has results, which changes are counted from
    mean: Interval  # the accuracy itself, all else averaged; NaN where it is not estimable
    change: Interval
    true_mean: Interval
    true_change: Interval
    p: float  # of the change by what decides, alone
    minutes: float
    cost: float
    covered: Share
    ended: Ended
    start_ended: Ended
    failing: float  # share of cases that fail, more than at the start, all else averaged; or NaN
    p_holm: float = 1.0  # corrected for all steps
    depends_on: tuple[str, ...] = ()  # factors that the change is shown to depend on

    @property
    def deciding(self) -> Interval:
        return self.change if math.isnan(self.true_change.mean) else self.true_change

    @property
    def is_step(self) -> bool:
        return self.word != self.start and math.isfinite(self.change.mean)

    @property
    def fails(self) -> bool:
        """Whether more cases fail than at its start, all else averaged.

        Of a step that would be a gain it is enough that a greater share of its own cases failed.
        """
        more = self.ended.failed_share - self.start_ended.failed_share > ALIKE
        return self.failing > ALIKE or (more and self._less)

    @property
    def gains(self) -> bool:
        return self._less and not self.fails

    @property
    def _less(self) -> bool:
        """Whether the error is shown to fall."""
        return self.p_holm <= SHOWN and self.deciding.mean < 0.0

    @property
    def shown(self) -> str:
        """Return what is shown of the change: failures, a gain, a loss, or nothing."""
        if self.fails:
            return "fails"
        if not self.p_holm <= SHOWN:
            return "no"
        return "gain" if self.gains else "loss"

    def facts(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "factor": self.factor.name,
            "level": self.word,
            "from": self.start,
            "accuracy_mm": self.mean,
            "change_mm": self.change,
            "true_mm": self.true_mean,
            "true_change_mm": self.true_change,
            "p_holm": self.p_holm,
            "shown": self.shown,
            "depends_on": self.depends_on,
            "minutes": self.minutes,
            "cost": self.cost,
            "covered": self.covered,
            "failing": self.failing,
            "ended": self.ended,
        }


@dataclass(frozen=True, slots=True)
class Interaction:
    """A step's change at two levels of another factor, and by how much they differ."""

    factor: Factor
    start: str
    word: str
    other: Factor
    first: str
    second: str
    at_first: Interval
    at_second: Interval
    difference: Interval
    p: float
    p_holm: float = 1.0

    @property
    def known(self) -> bool:
        return self.p_holm <= SHOWN

    @property
    def size_mm(self) -> float:
        return abs(self.difference.mean)

    def facts(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "factor": self.factor.name,
            "from": self.start,
            "level": self.word,
            "other": self.other.name,
            "at": [self.first, self.second],
            "change_mm": [self.at_first, self.at_second],
            "difference_mm": self.difference,
            "p_holm": self.p_holm,
            "shown": self.known,
        }


@dataclass(frozen=True, slots=True)
class Answers:
    """All that is computed of a study's rows. ``share`` is explained by main effects alone.

    It is NaN where no more points were done than the model has ``unknowns``; ``apart_mm`` is the
    largest departure of a design from them. ``not_estimable`` says why effects have no figures.
    """

    designs: list[Design]
    covered: Share | None
    counts: Mapping[str, int]
    effects: list[Effect] = field(default_factory=list)
    interactions: list[Interaction] = field(default_factory=list)
    not_estimable: list[str] = field(default_factory=list)
    share: float = math.nan
    apart_mm: float = math.nan
    unknowns: int = 0
    best: Design | None = None  # of an optimiser
    by_truth: bool = False

    @property
    def front(self) -> list[Design]:
        """Return the designs that no other beats in everything, the fastest first."""
        return sorted((each for each in self.designs if each.on_front), key=lambda d: d.minutes)

    @property
    def purchases(self) -> list[Effect]:
        """Return the steps from first levels, the largest gain that is shown first."""
        steps = [each for each in self.effects if each.is_step]
        return sorted(steps, key=lambda each: (not each.gains, each.fails, each.deciding.mean))


def answers(study: Study, rows: Rows) -> Answers:
    counts = Counter(row.state for row in rows)
    done = [row for row in rows if row.state == DONE]
    found = designs(study, rows)
    within = covered(done) if done else None
    by_truth = bool(done) and has_truth(study, done)
    if (wanted := study.optimise) is not None:  # its points crowd round the best: no effects
        best = min(whole(study, found), key=lambda each: value(wanted, each), default=None)
        sound = best is not None and value(wanted, best) < TOO_LONG
        chosen_best = best if sound else None
        return Answers(found, within, counts, best=chosen_best, by_truth=by_truth)
    if not done:
        return Answers(found, within, counts)
    points = {each.point.number: each.point for each in found}
    return _Effects(study, rows, done, points).answers(found, within, counts)


def whole(study: Study, found: Sequence[Design]) -> list[Design]:
    return [each for each in found if each.whole]


def value(wanted: Optimum, design: Design) -> float:
    if wanted.most_minutes is not None and not design.minutes <= wanted.most_minutes:
        return TOO_LONG + design.minutes
    return design.deciding.mean + (wanted.mm_per_minute or 0.0) * design.minutes


def has_truth(study: Study, done: Rows) -> bool:
    name = study.truth
    figures = (row.figures.get(name) for row in done) if name else ()
    return name is not None and all(each is not None and math.isfinite(each) for each in figures)


def covered(rows: Rows) -> Share:
    """Return the share of targets within their own bound, each machine counted alike."""
    shares = [_mean(own, "covered") for own in by_number(rows, "machine").values()]
    return Share.of(shares, sum(row.figure("targets") for row in rows))


def _mean(rows: Rows, figure: str) -> float:
    return fmean(row.figure(figure) for row in rows)


def by_number(rows: Rows, of: str) -> dict[int, list[Row]]:
    """Return rows by the numbers of their points or machines, in that order."""
    found: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        found[getattr(row, of)].append(row)
    return dict(sorted(found.items()))


def designs(study: Study, rows: Rows) -> list[Design]:
    """Return the points with a result; those that no other beats are on the front."""
    done = [row for row in rows if row.state == DONE]
    decides = study.truth if study.truth and has_truth(study, done) else study.accuracy
    found, figures = [], []
    for own in by_number(rows, "point").values():
        if any(row.state == DONE for row in own):
            design, by_machine = _design(study, own, decides)
            found.append(design)
            figures.append(by_machine)
    return _with_front(found, figures)


def _design(study: Study, own: Rows, decides: str) -> tuple[Design, Array]:
    """Return the design of a point's rows, and the figures that decide, one a machine."""
    done = [row for row in own if row.state == DONE]
    machines = by_number(done, "machine").values()
    accuracy = np.array([_mean(each, study.accuracy) for each in machines])
    deciding = np.array([_mean(each, decides) for each in machines])
    truth = deciding if decides == study.truth else np.array([math.nan])
    bounds = [row.figures.get(BOUND) for row in done]
    bound_mm = math.nan if None in bounds else fmean(each or 0.0 for each in bounds)
    judged: list[Within | None] = [None, None]
    if (asked := study.question) is not None:
        every = [each for each in by_number(own, "machine").values() if len(each) == study.seeds]
        judged = [
            Within.of(
                np.array([_worst(each, figure) for each in every]),
                asked.limit_mm,
                asked.share,
                asked.confidence,
            )
            for figure in (decides, study.accuracy)
        ]
    return Design(
        chosen(study, own[0]), Interval.of(accuracy), Interval.of(truth), OneMachine.of(deciding),
        bound_mm, _mean(done, "minutes"), covered(done), len(machines), len(done),
        len(done) == study.machines * study.seeds, False, None, *judged,
    ), deciding  # fmt: skip


def _worst(rows: Rows, figure: str) -> float:
    """Return the largest figure of a machine's sets of targets; NaN where one has no result."""
    every = [row.figure(figure) if row.state == DONE else math.nan for row in rows]
    return float(np.max(every))


def _with_front(found: Sequence[Design], figures: Sequence[Array]) -> list[Design]:
    """Return designs with those on the front, and the equals there; figures are by machine.

    A design is not shown to beat one that is as quick and as cheap unless the differences of their
    machines show it, at one of all other designs: the best of many was lucky as well. One machine
    alone judges none.
    """
    able = [n for n, each in enumerate(found) if each.whole]
    places = np.array(
        [[found[n].deciding.mean, found[n].minutes, found[n].point.cost] for n in able]
    ).reshape(-1, 3)
    front = sorted(
        (able[n] for n in front_of(places)), key=lambda n: (found[n].minutes, found[n].point.cost)
    )
    marked = list(found)
    for at, n in enumerate(front):
        own, equal = found[n], None
        for other in front[:at] if len(figures[n]) > 1 else ():
            gain = figures[other] - figures[n]
            one_sided = 0.5 * p_value(gain) if gain.mean() > 0.0 else 1.0
            cheaper = found[other].point.cost <= own.point.cost
            if cheaper and not one_sided * (len(able) - 1) <= SHOWN:
                equal = found[other].point.number
                break
        marked[n] = replace(own, on_front=True, equal_to=equal)
    return marked


def front_of(places: Array) -> list[int]:
    """Return which places (N, 3) no other equals in everything and beats in something.

    Whatever beats a place comes before it in the order of their figures, or is beaten as well.
    """
    kept: list[int] = []
    order = np.lexsort(places.T[::-1])
    front = np.empty_like(places)
    for n in order.tolist():
        before, place = front[: len(kept)], places[n]
        beaten = (before <= place).all(axis=1) & (before < place).any(axis=1)
        if not beaten.any():
            front[len(kept)] = place
            kept.append(n)
    return kept


class _Effects:
    """Effects and interactions of the points that were done, fitted on each machine by itself.

    A machine did a point where it did it with all sets of targets that any machine was given.
    """

    def __init__(self, study: Study, rows: Rows, done: Rows, points: Mapping[int, Point]) -> None:
        self.study, self.rows, self.done = study, rows, done
        self.by_truth = has_truth(study, done)
        by_point = by_number(rows, "point").items()
        self.tried = {n: points.get(n) or chosen(study, own[0]) for n, own in by_point}
        decides = study.truth if self.by_truth and study.truth else study.accuracy
        self.fits = self._fits(done, [study.accuracy, "minutes", "covered", decides])
        self.points = {each.number: each for each in self.fits.points}
        self.model = Additive(study.factor, self.fits.points)
        self.failures = self._fits([row for row in rows if row.state != CANNOT_BE], ["failed"])

    def _fits(self, rows: Rows, names: Sequence[str]) -> _Fits:
        """Return figures by point and machine, the mean of sets of targets."""
        numbers, points = np.unique([row.point for row in rows], return_inverse=True)
        machines, on = np.unique([row.machine for row in rows], return_inverse=True)
        counts = np.zeros((len(numbers), len(machines)))
        sums = np.zeros((len(numbers), len(machines), len(names)))
        np.add.at(counts, (points, on), 1.0)
        np.add.at(sums, (points, on), [[_figure(row, name) for name in names] for row in rows])
        did = counts == counts.max()
        some, any_of = did.any(axis=1), did.any(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            figures = np.moveaxis(
                np.where(did[:, :, None], sums / counts[:, :, None], np.nan), 2, 0
            )
        known = [self.tried[number] for number in numbers[some].tolist()]
        return _Fits(self.study, known, figures[:, some][:, :, any_of])

    def answers(
        self, found: list[Design], within: Share | None, counts: Mapping[str, int]
    ) -> Answers:
        study, model = self.study, self.model
        effects = self.effects()
        corrected = holm(np.array([each.p if each.is_step else math.nan for each in effects]))
        crossed = self.interactions()
        together = holm(np.array([each.p for each in crossed]))
        crossed = [
            replace(each, p_holm=float(p)) for each, p in zip(crossed, together, strict=True)
        ]
        effects = [
            replace(each, p_holm=float(p), depends_on=tuple(dict.fromkeys(
                (i.other if i.factor == each.factor else i.factor).title
                for i in crossed if i.known and each.is_step and (
                    (i.factor, i.word) == (each.factor, each.word)
                    or (i.other, i.second) == (each.factor, each.word))
            )))
            for each, p in zip(effects, corrected, strict=True)
        ]  # fmt: skip
        steps = {(each.factor.name, each.word) for each in effects if each.is_step}
        gaps = _Gaps(study, model, self.points.values(), self.tried.values(), steps, counts)
        figures = self.fits.figures[DECIDES]
        on_all = np.isfinite(figures).all(axis=0)
        means = np.nanmean(figures[:, on_all] if on_all.any() else figures, axis=1)
        apart_mm = float(np.abs(model.rest(means)).max()) if model.freedom > 0 else math.nan
        return Answers(
            found, within, counts, effects, crossed, gaps.words(), model.explained(means),
            apart_mm, model.unknowns, by_truth=self.by_truth,
        )  # fmt: skip

    def effects(self) -> list[Effect]:
        study, model = self.study, self.model
        fitted, failing = self.fits.additive(), self.failures.additive()
        targets, ended = self._targets(), self._ended()
        found = []
        for n, factor in enumerate(study.factor):
            costs, start = factor.costs or [0.0] * len(factor.ends), model.start(n)
            changes = [
                fitted.contrast(partial(self._change, n, level, start))
                for level in range(len(factor.names))
            ]
            steps = changes[:start] + changes[start + 1 :]
            nothing = not any(len(each.known(MEASURED)) for each in steps)
            for level, word in enumerate(factor.names):
                mean = fitted.contrast(partial(self._mean, n, level))
                change = changes[level]
                if level == start and nothing:  # nothing is counted from it
                    change = change.without_values()
                found.append(
                    Effect(
                        factor,
                        word,
                        factor.names[start],
                        mean.over_machines(MEASURED),
                        change.interval(MEASURED),
                        mean.over_machines(DECIDES) if self.by_truth else UNKNOWN,
                        change.interval(DECIDES) if self.by_truth else UNKNOWN,
                        change.p(DECIDES),
                        Interval.of(change.known(MINUTES)).mean,
                        costs[level] - costs[start],
                        Share.of(mean.known(COVERED), targets[n][level]),
                        ended[n][level],
                        ended[n][start],
                        failing.contrast(partial(self._change, n, level, start)).interval(0).mean,
                    )
                )
        return found

    @staticmethod
    def _change(n: int, level: int, start: int, fit: Additive) -> Array:
        return fit.weights(fit.change(n, level, start))

    @staticmethod
    def _mean(n: int, level: int, fit: Additive) -> Array:
        return fit.weights(fit.mean(n, level))

    def interactions(self) -> list[Interaction]:
        """Return what each step of a factor depends on: every level of each later factor."""
        found = []
        for n, m in combinations(range(len(self.study.factor)), 2):
            fitted = self.fits.crossed(n, m)
            factor, other = self.study.factor[n], self.study.factor[m]
            start, first = self.model.start(n), self.model.start(m)
            for level, second in product(range(len(factor.names)), range(len(other.names))):
                if level == start or second == first:
                    continue
                differ = fitted.contrast(methodcaller("difference", level, start, second, first))
                if not len(differ.known(DECIDES)):
                    continue
                at_first, at_second = (
                    fitted.contrast(methodcaller("change", level, start, beside)).interval(DECIDES)
                    for beside in (first, second)
                )
                found.append(
                    Interaction(
                        factor,
                        factor.names[start],
                        factor.names[level],
                        other,
                        other.names[first],
                        other.names[second],
                        at_first,
                        at_second,
                        differ.interval(DECIDES),
                        differ.p(DECIDES),
                    )
                )
        return found

    def _targets(self) -> list[list[float]]:
        """Return, by factor, the targets at each level; half of all at either end of a range."""
        found = [[0.0] * len(factor.ends) for factor in self.study.factor]
        for row in self.done:
            for counts, each in zip(found, self.tried[row.point].choices, strict=True):
                if each.factor.is_range:
                    counts[:] = [count + 0.5 * row.figure("targets") for count in counts]
                else:
                    counts[int(each.share)] += row.figure("targets")
        return found

    def _ended(self) -> list[list[Ended]]:
        """Return, by factor, how the cases of each level ended; of a range, of its nearer end."""
        found: list[list[list[Row]]] = [[[] for _ in f.ends] for f in self.study.factor]
        for row in self.rows:
            for levels, each in zip(found, self.tried[row.point].choices, strict=True):
                nearer = each.share > 0.5 if each.factor.is_range else each.share
                levels[int(nearer)].append(row)
        return [[Ended.of(own) for own in levels] for levels in found]


@dataclass(frozen=True, eq=False)
class _Contrast:
    """A contrast of each figure on each machine (F, M), NaN where it is not estimable.

    ``shared`` (F,) is the variance that machines share, with ``freedom`` (F,).
    """

    values: Array
    shared: Array
    freedom: Array

    def known(self, figure: int) -> Array:
        values: Array = self.values[figure]
        return values[np.isfinite(values)]

    def interval(self, figure: int) -> Interval:
        shared, freedom = float(self.shared[figure]), float(self.freedom[figure])
        return Interval.with_misfit(self.known(figure), shared, freedom)

    def over_machines(self, figure: int) -> Interval:
        """Return the interval without what machines share."""
        return Interval.of(self.known(figure))

    def p(self, figure: int) -> float:
        shared, freedom = float(self.shared[figure]), float(self.freedom[figure])
        return p_value(self.known(figure), shared, freedom)

    def without_values(self) -> Self:
        return replace(self, values=np.full_like(self.values, np.nan))


def _figure(row: Row, name: str) -> float:
    return float(row.state == FAILED) if name == "failed" else row.figure(name)


class _Fits:
    """Figures (F, P, M) of points on machines; machines that did the same points share a model."""

    def __init__(self, study: Study, points: Sequence[Point], figures: Array) -> None:
        self.points, self.figures = points, figures
        did = np.isfinite(figures).all(axis=0)
        patterns, of = np.unique(did, axis=1, return_inverse=True)
        self.pattern_of, self.patterns = of.ravel(), patterns.T
        self._models: list[Additive] = [
            Additive(study.factor, [points[n] for n in np.flatnonzero(own).tolist()])
            for own in self.patterns
        ]
        combinations = math.prod(len(each.ends) for each in study.factor)
        at_ends = all(
            each.share in range(len(each.factor.ends)) for point in points for each in point.choices
        )
        self.complete = bool(did.all()) and at_ends and len(points) == combinations

    def additive(self) -> _Fitted[Additive]:
        return _Fitted(self, self._models)

    def crossed(self, n: int, other: int) -> _Fitted[Crossed]:
        return _Fitted(self, [each.crossed(n, other) for each in self._models])


class _Fitted(Generic[Model]):
    """One model, fitted on each machine: contrasts there, and what machines share of the error."""

    def __init__(self, of: _Fits, models: Sequence[Model]) -> None:
        self._of = of
        self._models: Sequence[Model] = models
        self._freedom = float(max(each.freedom for each in models))
        self._rests = np.zeros_like(of.figures)  # by leverage
        for n, (own, model) in enumerate(zip(of.patterns, models, strict=True)):
            free = 1.0 - model.leverage
            scale = np.where(free > 1e-6, np.maximum(free, 1e-6) ** -model.caution, 0.0)
            for figures, rests in zip(of.figures, self._rests, strict=True):
                at = np.ix_(own, of.pattern_of == n)
                rests[at] = model.rest(figures[at]) * scale[:, None]

    def contrast(self, weights_of: Callable[[Model], Array]) -> _Contrast:
        """Return the contrast with these weights of a machine's points.

        Machines share no variance where every combination was done; it is not bounded where no
        point is left to check it by.
        """
        by_pattern = np.zeros((self._rests.shape[1], len(self._models)))
        for n, (own, model) in enumerate(zip(self._of.patterns, self._models, strict=True)):
            weights = weights_of(model)
            by_pattern[own, n] = weights
            by_pattern[~own, n] = 0.0 if np.isfinite(weights).all() else np.nan
        weights = by_pattern[:, self._of.pattern_of]
        values = np.einsum("pm,fpm->fm", weights, np.nan_to_num(self._of.figures))
        known = np.isfinite(weights).all(axis=0)
        count, shared = int(known.sum()), np.zeros(len(values))
        if self._of.complete or count < 2:
            return _Contrast(values, shared, np.full(len(values), math.inf))
        if not self._freedom > 0.0:
            return _Contrast(values, shared + math.inf, np.ones(len(values)))
        each = (weights * self._rests)[:, :, known] / count
        points = each.sum(axis=2) ** 2
        shared = np.maximum(0.0, points.sum(axis=1) - (each**2).sum(axis=(1, 2)))
        kurtosis = (points**2).sum(axis=1) / np.maximum(points.sum(axis=1) ** 2, TINY)
        freedom = np.minimum(self._freedom, 3.0 / np.maximum(kurtosis, TINY))  # chi², 1 a point
        return _Contrast(values, shared * count / (count - 1.0), np.maximum(1.0, freedom))


def brief(reason: str) -> str:
    """Return the first cause of a refusal, without its list of poses and what to do about it."""
    lines = reason.splitlines()
    first = lines[1] if len(lines) > 1 else reason
    return first.partition(": pose ")[0].partition("; ")[0].strip()


def kind(reason: str) -> str:
    """Return a reason without its figures: cases of one kind are counted together."""
    return re.sub(r"\d+", "0", brief(reason)).replace("-0", "0").replace("+0", "0")


@dataclass(frozen=True, eq=False)
class _Gaps:
    """Why steps other than ``steps`` (factor, level) have no figures, and what would help.

    ``done`` are the points of the model; ``tried`` those of all rows, in ``counts`` by state.
    """

    study: Study
    model: Additive
    done: Collection[Point]
    tried: Collection[Point]
    steps: Collection[tuple[str, str]]
    counts: Mapping[str, int]

    def words(self) -> list[str]:
        factors = [*enumerate(self.study.factor)]
        lines = [line for n, factor in factors for line in self.unseen(n, factor)]
        lines += self.mixed()
        helped = [self.help()] if lines else []
        for n, factor in factors:
            lines += [*self.extrapolated(n, factor), *self.apart(n, factor)]
        return [*lines, *helped]

    def unseen(self, n: int, factor: Factor) -> Iterator[str]:
        """Yield that a factor did not vary, or which of its levels have no result."""
        seen = {each.choices[n].share: each.choices[n].word for each in self.done}
        if len(seen) == 1:
            every = f"every design with a result has {seen.popitem()[1]}"
            yield f"{factor.title}: {every}, so its effect is unknown."
        elif not factor.is_range:
            never = [word for level, word in enumerate(factor.names) if level not in seen]
            start = self.model.start(n)
            since = f"; changes are counted from {factor.names[start]}" if start else ""
            if never:
                yield f"{factor.title}: no design with {_listed(never, 'or')} has a result{since}."

    def mixed(self) -> Iterator[str]:
        designs, unknowns = len(self.done), self.model.unknowns
        few = f" ({designs} designs for {unknowns} fitted figures)" * (designs < unknowns)
        for group in self.model.inseparable():
            names = _listed([self.study.factor[n].title for n in group], "and")
            yield (
                f"{names} change together in the designs with results{few}: effects without a "
                "figure cannot be separated."
            )

    def extrapolated(self, n: int, factor: Factor) -> Iterator[str]:
        """Yield where the results of a range end, if further cases had none."""
        if factor.is_range:
            found = sorted((each.choices[n] for each in self.done), key=lambda each: each.share)
            wanted = [each.choices[n].share for each in self.tried]
            low, high = found[0], found[-1]
            if low.share < high.share and (min(wanted) < low.share or high.share < max(wanted)):
                yield (
                    f"{factor.title}: results lie between {low.word} and {high.word} only; beyond "
                    "them its effect is extrapolated."
                )

    def apart(self, n: int, factor: Factor) -> Iterator[str]:
        """Yield the steps that only machines together would show."""
        start = self.model.start(n)
        words = [
            word
            for level, word in enumerate(factor.names)
            if level != start
            and (factor.name, word) not in self.steps
            and self.model.estimable(self.model.change(n, level, start))
        ]
        if words:
            yield (
                f"{factor.title}: no machine by itself has the results that show the change to "
                f"{_listed(words, 'or')}."
            )

    def help(self) -> str:
        if (waiting := self.study.most_cases - sum(self.counts.values())) > 0:
            return f"Cases that are not measured yet: {waiting}."
        if self.study.samples is not None and self.study.samples == self.study.different:
            unknowns = 1 + sum(1 if f.is_range else len(f.ends) - 1 for f in self.study.factor)
            wanted = max(2 * self.study.samples, 1 << (2 * unknowns - 1).bit_length())
            return f"More samples would help, {wanted} for example."
        if self.counts.get(CANNOT_BE, 0) or self.counts.get(FAILED, 0):
            return "Levels that can all be combined would help; see the cases without a result."
        return "More levels or combinations would help."


def _listed(words: Collection[str], last: str) -> str:
    *before, end = words
    return f"{', '.join(before)} {last} {end}" if before else end
