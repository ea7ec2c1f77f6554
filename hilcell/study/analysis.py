"""Answers of a study, from its rows: main effects, Pareto front, coverage, next purchases.

Every machine measures all points, so each answer is computed on every machine by itself, and its
interval is that of the mean over machines (Student, 95 %). It says how far another lot of such
machines could differ. One machine alone gives no interval: its targets are no sample of others'.

Effects are those of an additive model of the points that were done. A point's figure is a constant,
and a part of each factor: one of each level, or in proportion along a range. A question to it is a
contrast, a row of weights of these unknowns. It is estimable where it is a weighted sum of the
points' own rows. Any other has no value here; least squares would give it one, with the unknowns
that are smallest together.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, Self

import msgspec
import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import betaincinv, stdtrit  # scipy.stats takes half a second to import

from hilcell.ports import Array
from hilcell.study.case import CANNOT_BE, DONE, FAILED, Row
from hilcell.study.design import Point, chosen
from hilcell.study.factor import Factor
from hilcell.study.study_file import Optimum, Study

UPPER = 0.975  # end of a 95 % interval
SAME = 1e-9  # of numbers that rounding alone sets apart
TOO_LONG = 1e6  # of a design with too many minutes, which are added
NONE = "–"  # stands for a figure that is not estimable
Rows = Sequence[Row]


class Interval(msgspec.Struct, frozen=True):
    """A mean over machines and half its 95 % interval, NaN where one machine gives none."""

    mean: float
    half: float = msgspec.field(name="half95")

    @classmethod
    def of(cls, values: Iterable[float]) -> Self:
        """Return the mean of values, one a machine, with its 95 % interval."""
        found: Array = np.array(list(values), dtype=float)
        if len(found) < 2:
            return cls(float(found.mean()) if len(found) else math.nan, math.nan)
        factor = _student(len(found) - 1)
        return cls(float(found.mean()), factor * float(found.std(ddof=1)) / len(found) ** 0.5)

    @property
    def known(self) -> bool:
        """Whether it is shown to be other than nought, by more than rounding."""
        return self.half >= 0.0 and abs(self.mean) > max(self.half, SAME)

    def text(self, sign: float = 1.0) -> str:
        """Return the figure with its interval, where it has one; a dash for none."""
        if math.isnan(self.mean):
            return NONE
        shown = f"{sign * self.mean:z.4f}".replace("-", "−")  # z: no -0
        return shown if math.isnan(self.half) else f"{shown} ± {self.half:.4f}"

    @property
    def ends(self) -> tuple[float, float]:
        """Return where it ends; the mean twice where there is none."""
        half = self.half if self.half >= 0.0 else 0.0
        return self.mean - half, self.mean + half


class Share(msgspec.Struct, frozen=True):
    """A share of targets (0 to 1) and its 95 % interval, NaN where one machine gives none."""

    mean: float
    low: float = msgspec.field(name="low95")
    high: float = msgspec.field(name="high95")

    @classmethod
    def of(cls, values: Iterable[float], targets: float) -> Self:
        """Return the mean of shares, one a machine, of so many targets together; its interval.

        Clopper and Pearson's, with the effective number of targets that the differences between
        machines leave (Korn and Graubard 1998): targets of one machine go together.
        """
        found: Array = np.clip(np.array(list(values), dtype=float), 0.0, 1.0)
        if len(found) < 2 or not targets > 1.0:
            return cls(float(found.mean()) if len(found) else math.nan, math.nan, math.nan)
        mean, variance = float(found.mean()), float(found.var(ddof=1)) / len(found)
        effective = min(targets, mean * (1.0 - mean) / variance) if variance > 0.0 else targets
        effective *= (_student(targets - 1.0) / _student(len(found) - 1)) ** 2
        within, beyond = effective * mean, effective * (1.0 - mean)
        low = float(betaincinv(within, beyond + 1.0, 1.0 - UPPER)) if within > 0.0 else 0.0
        high = float(betaincinv(within + 1.0, beyond, UPPER)) if beyond > 0.0 else 1.0
        return cls(mean, low, high)

    def text(self) -> str:
        """Return the share in %, with its interval; a dash for none."""
        if math.isnan(self.mean):
            return NONE
        low, high = (f"{100.0 * end:.1f}" for end in self.ends)
        return f"{100.0 * self.mean:.1f}" + (f" ({low} .. {high})" if low != high else "")

    @property
    def ends(self) -> tuple[float, float]:
        """Return where its interval ends; the mean twice where there is none."""
        return (self.low, self.high) if self.low <= self.high else (self.mean, self.mean)


def _student(freedom: float) -> float:
    """Return Student's factor of the interval's upper end."""
    return float(stdtrit(freedom, UPPER))


class Additive:
    """The additive model of points (N, one or more), whose figures may stand beside one another."""

    def __init__(self, factors: Sequence[Factor], points: Sequence[Point]) -> None:
        self._factors = factors
        widths = [1 if each.is_range else len(each.ends) for each in factors]
        ends = np.cumsum([1, *widths])
        self._parts = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._rows = np.zeros((len(points), ends[-1]))
        self._rows[:, 0] = 1.0
        for n, part in enumerate(self._parts):
            shares = np.array([[each.choices[n].share] for each in points])
            self._rows[:, part] = (
                2.0 * shares - 1.0 if factors[n].is_range else shares == range(widths[n])
            )
        self._u, sizes, rows = np.linalg.svd(self._rows, full_matrices=False)
        some = sizes > SAME * sizes[0]
        self._u, self._sizes, self._basis = self._u[:, some], sizes[some], rows[some]
        self._average = self._averaged()

    @property
    def unknowns(self) -> int:
        varies = np.ptp(self._rows, axis=0) > 0.0
        return 1 + sum(
            max(0, int(varies[part].sum()) - (not each.is_range))  # of levels one is the others'
            for each, part in zip(self._factors, self._parts, strict=True)
        )

    def start(self, n: int) -> int:
        """Return the level that changes of a factor are counted from: the first that occurs."""
        if self._factors[n].is_range:
            return 0
        return int(self._rows[:, self._parts[n]].any(axis=0).argmax())

    def mean(self, n: int, level: int) -> Array:
        """Return the contrast of a level, or an end, of a factor with all else averaged."""
        found = self._average.copy()
        is_range = self._factors[n].is_range
        found[self._parts[n]] = (
            2.0 * level - 1.0 if is_range else np.eye(len(self._factors[n].ends))[level]
        )
        return found

    def change(self, n: int, level: int, start: int) -> Array:
        return self.mean(n, level) - self.mean(n, start)

    def estimable(self, contrast: Array) -> bool:
        rest = contrast - self._basis.T @ (self._basis @ contrast)
        return bool(np.linalg.norm(rest) <= SAME * max(1.0, float(np.linalg.norm(contrast))))

    def values(self, contrast: Array, figures: Array) -> Array:
        """Return the contrast of the points' figures (N, K); NaN where it is not estimable."""
        if not self.estimable(contrast):
            return np.full(figures.shape[1], np.nan)
        weights: Array = self._u @ ((self._basis @ contrast) / self._sizes)
        return weights @ figures

    def explained(self, figures: Array) -> float:
        """Return how much of the differences between figures (N,) it explains, 0 to 1.

        NaN where the points leave nothing to check that by.
        """
        if not len(self._basis) < len(figures):
            return math.nan
        total = float(((figures - figures.mean()) ** 2).sum())
        rest = figures - self._u @ (self._u.T @ figures)
        return 1.0 - float((rest**2).sum()) / total if total > 0.0 else 1.0

    def inseparable(self) -> list[list[int]]:
        """Return groups of factors, by number, whose parts the points cannot separate.

        The unknowns fall into the finest groups between which nothing is mixed: those of the
        projector on what is not estimable. The constant is taken off before.
        """
        moved = self._rows - self._rows.mean(axis=0)
        _, sizes, rows = np.linalg.svd(moved[:, 1:], full_matrices=False)
        some = rows[sizes > SAME * max(1.0, float(sizes[0]))]
        mixing = np.abs(np.eye(moved.shape[1] - 1) - some.T @ some) > SAME
        mixed = np.array([
            [mixing[a.start - 1 : a.stop - 1, b.start - 1 : b.stop - 1].any() for b in self._parts]
            for a in self._parts
        ])  # fmt: skip
        count, labels = connected_components(mixed, directed=False)
        groups = [np.flatnonzero(labels == label).tolist() for label in range(count)]
        return [group for group in groups if len(group) > 1]

    def _averaged(self) -> Array:
        """Return all levels that occur alike and the middle of ranges, where that is estimable.

        Else the factors as often as they occur.
        """
        found = np.zeros(self._rows.shape[1])
        found[0] = 1.0
        for factor, part in zip(self._factors, self._parts, strict=True):
            if not factor.is_range:
                occurs = self._rows[:, part].any(axis=0)
                found[part] = occurs / occurs.sum()
        return found if self.estimable(found) else self._rows.mean(axis=0)


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

    def facts(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "point": self.point.number,
            "factors": {choice.factor.name: choice.shown for choice in self.point.choices},
            "accuracy_mm": self.accuracy,
            "minutes": self.minutes,
            "cost": self.point.cost,
            "covered": self.covered,
            "machines": self.machines,
        }


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
        return self.word != self.start and math.isfinite(self.change.mean)

    @property
    def gains(self) -> bool:
        return self.change.known and self.change.mean < 0.0

    @property
    def shown(self) -> str:
        """Return what is shown of the change: that it is a gain, a loss, or neither."""
        if not self.change.known:
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
            "minutes": self.minutes,
            "cost": self.cost,
            "covered": self.covered,
        }


@dataclass(frozen=True, slots=True)
class Answers:
    """All that is computed of a study's rows. ``share`` is explained by main effects alone.

    It is NaN where no more points were done than the model has ``unknowns``.
    ``not_estimable`` says why effects have no figures.
    """

    designs: list[Design]
    covered: Share | None
    counts: Mapping[str, int]
    effects: list[Effect] = field(default_factory=list)
    not_estimable: list[str] = field(default_factory=list)
    share: float = math.nan
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
        return sorted(steps, key=lambda each: (not each.gains, each.change.mean))


def answers(study: Study, rows: Rows) -> Answers:
    counts = Counter(row.state for row in rows)
    done = [row for row in rows if row.state == DONE]
    found = designs(study, done)
    within = covered(done) if done else None
    if (wanted := study.optimise) is not None:  # its points crowd round the best: no effects
        best = min(whole(study, found), key=lambda each: value(wanted, each), default=None)
        sound = best is not None and value(wanted, best) < TOO_LONG
        return Answers(found, within, counts, best=best if sound else None)
    if not done:
        return Answers(found, within, counts)
    all_points = design_points(study, done)
    model = Additive(study.factor, list(all_points.values()))
    effects = _effects(study, model, done)
    steps = {(each.factor.name, each.word) for each in effects if each.is_step}
    tried = design_points(study, rows).values()
    gaps = _Gaps(study, model, all_points.values(), tried, steps, counts)
    figures = np.array([_mean(own, study.accuracy) for own in _by(done, "point").values()])
    return Answers(
        found, within, counts, effects, gaps.words(), model.explained(figures), model.unknowns
    )


def whole(study: Study, found: Sequence[Design]) -> list[Design]:
    return [each for each in found if each.cases == study.machines * study.seeds]


def value(wanted: Optimum, design: Design) -> float:
    if wanted.most_minutes is not None and not design.minutes <= wanted.most_minutes:
        return TOO_LONG + design.minutes
    return design.accuracy.mean + (wanted.mm_per_minute or 0.0) * design.minutes


def covered(rows: Rows) -> Share:
    """Return the share of targets within their own bound, each machine counted alike."""
    shares = [_mean(own, "covered") for own in _by(rows, "machine").values()]
    return Share.of(shares, sum(row.figure("targets") for row in rows))


def design_points(study: Study, rows: Rows) -> dict[int, Point]:
    """Return the points of rows by number, in that order."""
    return {number: chosen(study, own[0]) for number, own in _by(rows, "point").items()}


def _mean(rows: Rows, figure: str) -> float:
    return float(np.mean([row.figure(figure) for row in rows]))


def _by(rows: Rows, of: Literal["point", "machine"]) -> dict[int, list[Row]]:
    found: dict[int, list[Row]] = defaultdict(list)
    for row in rows:
        found[getattr(row, of)].append(row)
    return dict(sorted(found.items()))


def designs(study: Study, done: Rows) -> list[Design]:
    found = []
    for own in _by(done, "point").values():
        machines = _by(own, "machine").values()
        accuracy = Interval.of(_mean(each, study.accuracy) for each in machines)
        point, minutes = chosen(study, own[0]), _mean(own, "minutes")
        found.append(Design(point, accuracy, minutes, covered(own), len(machines), len(own), False))
    places = np.array([[each.accuracy.mean, each.minutes, each.point.cost] for each in found])
    return [
        replace(each, on_front=on_front(place, places))
        for each, place in zip(found, places, strict=True)
    ]


def on_front(place: Array, places: Array) -> bool:
    """Whether no place (N, 3) is as good as (3,) in everything and better in something."""
    as_good, better = (places <= place).all(axis=1), (places < place).any(axis=1)
    return not bool((as_good & better).any())


def _effects(study: Study, model: Additive, done: Rows) -> list[Effect]:
    """Return the effects of an additive model, fitted on each machine by itself."""
    all_points = design_points(study, done)
    targets = _targets(study, all_points, done)
    keys = (study.accuracy, "minutes", "covered")
    fits = [
        (
            Additive(study.factor, [all_points[row.point] for row in own]),
            np.array([[row.figure(key) for key in keys] for row in own], dtype=float),
        )
        for own in _by(done, "machine").values()
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
                    Share.of(filter(np.isfinite, means[:, 2]), targets[n][level]),
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
    return Interval.of(each for each in values if np.isfinite(each))


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
        few = f" (designs: {designs}, unknowns: {unknowns})" * (designs < unknowns)
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
        if self.study.samples is not None:
            unknowns = 1 + sum(1 if f.is_range else len(f.ends) - 1 for f in self.study.factor)
            wanted = max(2 * self.study.samples, 1 << (2 * unknowns - 1).bit_length())
            return f"More samples would help, {wanted} for example."
        if self.counts.get(CANNOT_BE, 0) or self.counts.get(FAILED, 0):
            return "Levels that can all be combined would help; see the cases without a result."
        return "More levels or combinations would help."


def _listed(words: Collection[str], last: str) -> str:
    *before, end = words
    return f"{', '.join(before)} {last} {end}" if before else end
