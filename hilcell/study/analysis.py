"""Answers of a study, from its rows: main effects, Pareto front, coverage, next purchases.

Every machine measures all points, so each answer is computed on every machine by itself, and its
interval is that of the mean over machines (Student, 95 %). It says how far another lot of such
machines could differ. One machine alone gives no interval.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hilcell.ports import Array
from hilcell.study.additive import Additive
from hilcell.study.case import CANNOT_BE, DONE, FAILED, Row
from hilcell.study.design import Point, chosen
from hilcell.study.factor import Factor
from hilcell.study.intervals import Interval, Share, interval, share
from hilcell.study.study_file import Optimum, Study

Steps = Collection[tuple[str, str]]


def not_estimable(
    study: Study, model: Additive, done: Collection[Point], tried: Collection[Point], steps: Steps,
    counts: Mapping[str, int],
) -> list[str]:  # fmt: skip
    """Return why steps other than ``steps`` (factor, level) have no figures, and what would help.

    ``done`` are the points of the model; ``tried`` those of all rows, in ``counts`` by state.
    """
    lines = [line for n in range(len(study.factor)) for line in _unseen(n, model, done)]
    lines += _mixed(study, model, len(done))
    helped = [_help(study, counts)] if lines else []
    for n, factor in enumerate(study.factor):
        lines += _extrapolated(n, factor, done, tried)
        lines += _apart(n, factor, model, steps)
    return [*lines, *helped]


def _unseen(n: int, model: Additive, done: Collection[Point]) -> Iterator[str]:
    """Yield that a factor did not vary, or which of its levels have no result."""
    choices = [each.choices[n] for each in done]
    factor, seen = choices[0].factor, {each.share for each in choices}
    if len(seen) == 1:
        yield (
            f"{factor.title}: every design with a result has {choices[0].word}, so its effect is "
            "unknown."
        )
    elif not factor.is_range:
        never = [word for level, word in enumerate(factor.names) if level not in seen]
        start = model.start(n)
        since = f"; changes are counted from {factor.names[start]}" if start else ""
        if never:
            yield f"{factor.title}: no design with {_listed(never, 'or')} has a result{since}."


def _mixed(study: Study, model: Additive, designs: int) -> Iterator[str]:
    for group in model.inseparable():
        names = _listed([study.factor[n].title for n in group], "and")
        few = f" (designs: {designs}, unknowns: {model.unknowns})" * (designs < model.unknowns)
        yield (
            f"{names} change together in the designs with results{few}: effects without a figure "
            "cannot be separated."
        )


def _extrapolated(
    n: int, factor: Factor, done: Collection[Point], tried: Collection[Point]
) -> Iterator[str]:
    """Yield where the results of a range end, if further cases had none."""
    if factor.is_range:
        found = sorted((each.choices[n] for each in done), key=lambda each: each.share)
        wanted = [each.choices[n].share for each in tried]
        low, high = found[0], found[-1]
        if low.share < high.share and (min(wanted) < low.share or high.share < max(wanted)):
            yield (
                f"{factor.title}: results lie between {low.word} and {high.word} only; beyond "
                "them its effect is extrapolated."
            )


def _apart(n: int, factor: Factor, model: Additive, steps: Steps) -> Iterator[str]:
    """Yield the steps that only machines together would show."""
    start = model.start(n)
    words = [
        word
        for level, word in enumerate(factor.names)
        if level != start
        and (factor.name, word) not in steps
        and model.estimable(model.change(n, level, start))
    ]
    if words:
        yield (
            f"{factor.title}: no machine by itself has the results that show the change to "
            f"{_listed(words, 'or')}."
        )


def _help(study: Study, counts: Mapping[str, int]) -> str:
    if (waiting := study.most_cases - sum(counts.values())) > 0:
        return f"Cases that are not measured yet: {waiting}."
    if study.samples is not None:
        unknowns = 1 + sum(1 if f.is_range else len(f.ends) - 1 for f in study.factor)
        wanted = max(2 * study.samples, 1 << (2 * unknowns - 1).bit_length())
        return f"More samples would help, {wanted} for example."
    if counts.get(CANNOT_BE, 0) or counts.get(FAILED, 0):
        return "Levels that can all be combined would help; see the cases without a result."
    return "More levels or combinations would help."


def _listed(words: Collection[str], last: str) -> str:
    *before, end = words
    return f"{', '.join(before)} {last} {end}" if before else end


TOO_LONG = 1e6  # of a design with too many minutes, which are added
Rows = Sequence[Row]


@dataclass(frozen=True, slots=True)
class Design:
    """The result of one point: accuracy, minutes, cost, over all machines that did it."""

    point: Point
    accuracy: Interval
    minutes: float
    covered: Share
    machines: int
    cases: int
    on_front: bool


@dataclass(frozen=True, slots=True)
class Effect:
    """The accuracy at one level, or at one end of a range, and its change from the start."""

    factor: Factor
    word: str
    start: str  # the first level that has results, which changes are counted from
    mean: Interval  # the accuracy itself, all else averaged; NaN where it is not estimable
    change: Interval
    minutes: float
    cost: float
    covered: Share

    @property
    def is_step(self) -> bool:
        """Whether it is a change that is estimable."""
        return self.word != self.start and math.isfinite(self.change.mean)


@dataclass(frozen=True, slots=True)
class Answers:
    """All that is computed of a study's rows. ``share`` is what main effects alone explain.

    It is NaN where no more points were done than the model has ``unknowns``.
    ``not_estimable`` says why effects have no figures.
    """

    designs: list[Design]
    covered: Share | None
    counts: Mapping[str, int]
    effects: list[Effect] = field(default_factory=list)
    not_estimable: list[str] = field(default_factory=list)
    share: float = float("nan")
    unknowns: int = 0
    best: Design | None = None  # of an optimiser

    @property
    def front(self) -> list[Design]:
        """Return the designs that no other beats in everything, the fastest first."""
        return sorted((each for each in self.designs if each.on_front), key=lambda d: d.minutes)

    @property
    def purchases(self) -> list[Effect]:
        """Return the steps from first levels, the largest gain that is shown first."""
        steps = [each for each in self.effects if each.is_step]
        return sorted(steps, key=lambda each: (not _gains(each), each.change.mean))


def _gains(step: Effect) -> bool:
    return step.change.known and step.change.mean < 0.0


def answers(study: Study, rows: Rows) -> Answers:
    """Compute the answers of all rows that are there."""
    counts: dict[str, int] = defaultdict(int)
    for row in rows:
        counts[row.state] += 1
    done = [row for row in rows if row.state == DONE]
    found = designs(study, done)
    within = covered(done) if done else None
    if study.optimise is not None:  # its points are crowded round the best: no design for effects
        return Answers(found, within, dict(counts), best=best_of(study, study.optimise, found))
    if not done:
        return Answers(found, within, dict(counts))
    all_points = points_of(study, done)
    model = Additive(study.factor, list(all_points.values()))
    effects = _effects(study, model, done)
    steps = {(each.factor.name, each.word) for each in effects if each.is_step}
    return Answers(
        found,
        within,
        dict(counts),
        effects,
        not_estimable(
            study, model, all_points.values(), points_of(study, rows).values(), steps, counts
        ),
        model.explained(_means(study, done)),
        model.unknowns,
    )


def best_of(study: Study, wanted: Optimum, found: Sequence[Design]) -> Design | None:
    """Return the design with the least value, of those that every machine did."""
    best = min(whole(study, found), key=lambda each: value(wanted, each), default=None)
    return None if best is None or not value(wanted, best) < TOO_LONG else best


def whole(study: Study, found: Sequence[Design]) -> list[Design]:
    """Return the designs that every machine did."""
    return [each for each in found if each.cases == study.machines * study.seeds]


def value(wanted: Optimum, design: Design) -> float:
    """Return what an optimiser minimises."""
    if wanted.most_minutes is not None and not design.minutes <= wanted.most_minutes:
        return TOO_LONG + design.minutes
    return design.accuracy.mean + (wanted.mm_per_minute or 0.0) * design.minutes


def over_machines(rows: Rows, key: str) -> Interval:
    """Return the mean over machines of each machine's own mean."""
    return interval(_mean(own, key) for own in _by_machine(rows))


def covered(rows: Rows) -> Share:
    """Return the share of targets within their own bound, each machine counted alike."""
    shares = [_mean(own, "covered") for own in _by_machine(rows)]
    return share(shares, sum(row.figure("targets") for row in rows))


def points_of(study: Study, rows: Rows) -> dict[int, Point]:
    """Return the points of rows by number, in that order."""
    return {number: chosen(study, own[0]) for number, own in _by_point(rows).items()}


def _mean(rows: Rows, figure: str) -> float:
    return float(np.mean([row.figure(figure) for row in rows]))


def _by_point(rows: Rows) -> dict[int, list[Row]]:
    found: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        found[row.point].append(row)
    return dict(sorted(found.items()))


def _by_machine(rows: Rows) -> list[list[Row]]:
    found: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        found[row.machine].append(row)
    return [own for _, own in sorted(found.items())]


def designs(study: Study, done: Rows) -> list[Design]:
    """Return the designs of rows that were done."""
    by_point, all_points = _by_point(done), points_of(study, done)
    places: Array = np.array([
        [
            over_machines(own, study.accuracy).mean,
            _mean(own, "minutes"),
            all_points[number].cost,
        ]
        for number, own in by_point.items()
    ]).reshape(-1, 3)  # fmt: skip
    return [
        Design(
            all_points[number],
            over_machines(own, study.accuracy),
            float(place[1]),
            covered(own),
            len(_by_machine(own)),
            len(own),
            on_front(place, places),
        )
        for (number, own), place in zip(by_point.items(), places, strict=True)
    ]


def on_front(place: Array, places: Array) -> bool:
    """Whether no place (N, 3) is as good as (3,) in everything and better in something."""
    as_good, better = (places <= place).all(axis=1), (places < place).any(axis=1)
    return not bool((as_good & better).any())


def _effects(study: Study, model: Additive, done: Rows) -> list[Effect]:
    """Return the effects of an additive model, fitted on each machine by itself."""
    all_points = points_of(study, done)
    by_machine = _by_machine(done)
    targets = _targets(study, all_points, done)
    keys = (study.accuracy, "minutes", "covered")
    fits = [
        (
            Additive(study.factor, [all_points[row.point] for row in own]),
            np.array([[row.figure(key) for key in keys] for row in own], dtype=float),
        )
        for own in by_machine
    ]
    found = []
    for n, factor in enumerate(study.factor):
        costs, start = factor.costs or [0.0] * len(factor.ends), model.start(n)
        changes: Array = np.array([
            [fit.values(fit.change(n, level, start), own) for fit, own in fits]
            for level in range(len(factor.names))
        ])  # fmt: skip
        if not np.isfinite(np.delete(changes, start, axis=0)).any():
            changes[start] = np.nan  # nothing is counted from it
        for level, word in enumerate(factor.names):
            means = np.array([fit.values(fit.mean(n, level), own) for fit, own in fits])
            found.append(
                Effect(
                    factor,
                    word,
                    factor.names[start],
                    _known(means[:, 0]),
                    _known(changes[level, :, 0]),
                    _known(changes[level, :, 1]).mean,
                    costs[level] - costs[start],
                    share(filter(np.isfinite, means[:, 2]), targets[n][level]),
                )
            )
    return found


def _targets(study: Study, all_points: Mapping[int, Point], done: Rows) -> list[list[float]]:
    """Return, by factor, the targets at each level; half of all at either end of a range."""
    found = [[0.0] * len(factor.ends) for factor in study.factor]
    for row in done:
        for counts, each in zip(found, all_points[row.point].choices, strict=True):
            if each.factor.is_range:
                counts[:] = [count + 0.5 * row.figure("targets") for count in counts]
            else:
                counts[int(each.share)] += row.figure("targets")
    return found


def _known(values: Iterable[float]) -> Interval:
    return interval(each for each in values if np.isfinite(each))


def _means(study: Study, done: Rows) -> Array:
    """Return the accuracy of each point that was done, in the order of their numbers."""
    return np.array([_mean(own, study.accuracy) for own in _by_point(done).values()])
