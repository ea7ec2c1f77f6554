"""Answers of a study, from its rows: main effects, Pareto front, coverage, next purchases.

Every machine measures all points, so each answer is computed on every machine by itself, and its
interval is that of the mean over machines (Student, 95 %). It says how far another lot of such
machines could differ. One machine alone gives no interval.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hilcell.ports import Array
from hilcell.study.case import DONE
from hilcell.study.design import Point, chosen
from hilcell.study.factor import Factor
from hilcell.study.intervals import Interval, Share, interval, share
from hilcell.study.study_file import Optimum, Study

TOO_LONG = 1e6  # of a design with too many minutes, which are added
Rows = Sequence[Mapping[str, Any]]


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
    """The accuracy at one level, or at one end of a range, and its change from the first."""

    factor: Factor
    word: str
    mean: Interval  # the accuracy itself, all else averaged
    change: Interval  # from the first level
    minutes: float  # from the first level
    cost: float
    covered: Share


@dataclass(frozen=True, slots=True)
class Answers:
    """All that is computed of a study's rows. ``share`` is what main effects alone explain."""

    designs: list[Design]
    effects: list[Effect]
    covered: Share | None
    share: float
    counts: Mapping[str, int]
    best: Design | None = None  # of an optimiser

    @property
    def front(self) -> list[Design]:
        """Return the designs that no other beats in everything, the fastest first."""
        return sorted((each for each in self.designs if each.on_front), key=lambda d: d.minutes)

    @property
    def purchases(self) -> list[Effect]:
        """Return the steps from first levels, the largest gain that is shown first."""
        first = {id(each.factor): each.word for each in reversed(self.effects)}
        steps = [each for each in self.effects if each.word != first[id(each.factor)]]
        return sorted(steps, key=lambda each: (not _gains(each), each.change.mean))


def _gains(step: Effect) -> bool:
    return step.change.known and step.change.mean < 0.0


def answers(study: Study, rows: Rows) -> Answers:
    """Compute the answers of all rows that are there."""
    counts: dict[str, int] = defaultdict(int)
    for row in rows:
        counts[row["state"]] += 1
    done = [row for row in rows if row["state"] == DONE]
    found = designs(study, done)
    if study.optimise is not None:  # its points are crowded round the best: no design for effects
        return Answers(found, [], covered(done) if done else None, float("nan"), dict(counts),
                       best_of(study, study.optimise, found))  # fmt: skip
    return Answers(
        found,
        _effects(study, done) if done else [],
        covered(done) if done else None,
        _share(study, done) if done else float("nan"),
        dict(counts),
    )


def best_of(study: Study, wanted: Optimum, found: Sequence[Design]) -> Design | None:
    """Return the design with the least value, of those that every machine did."""
    whole = [each for each in found if each.cases == study.machines * study.seeds]
    best = min(whole, key=lambda each: value(wanted, each), default=None)
    return None if best is None or not value(wanted, best) < TOO_LONG else best


def value(wanted: Optimum, design: Design) -> float:
    """Return what an optimiser minimises."""
    if wanted.most_minutes is not None and not design.minutes <= wanted.most_minutes:
        return TOO_LONG + design.minutes
    return design.accuracy.mean + (wanted.mm_per_minute or 0.0) * design.minutes


def over_machines(rows: Rows, key: str) -> Interval:
    """Return the mean over machines of each machine's own mean."""
    return interval(np.mean([row[key] for row in own]) for own in _by(rows, "machine").values())


def covered(rows: Rows) -> Share:
    """Return the share of targets within their own bound, each machine counted alike."""
    shares = [np.mean([row["covered"] for row in own]) for own in _by(rows, "machine").values()]
    return share(map(float, shares), sum(row["targets"] for row in rows))


def points_of(study: Study, rows: Rows) -> dict[int, Point]:
    """Return the points of rows by number."""
    return {row["point"]: chosen(study, row) for row in _first_of_each(rows)}


def _first_of_each(rows: Rows) -> Iterable[Mapping[str, Any]]:
    return {row["point"]: row for row in reversed(rows)}.values()


def _by(rows: Rows, key: str) -> dict[int, list[Mapping[str, Any]]]:
    found: dict[int, list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        found[row[key]].append(row)
    return dict(sorted(found.items()))


def designs(study: Study, done: Rows) -> list[Design]:
    """Return the designs of rows that were done."""
    by_point, all_points = _by(done, "point"), points_of(study, done)
    places: Array = np.array([
        [
            over_machines(own, study.accuracy).mean,
            float(np.mean([row["minutes"] for row in own])),
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
            len(_by(own, "machine")),
            len(own),
            on_front(place, places),
        )
        for (number, own), place in zip(by_point.items(), places, strict=True)
    ]


def on_front(place: Array, places: Array) -> bool:
    """Whether no place (N, 3) is as good as (3,) in everything and better in something."""
    as_good, better = (places <= place).all(axis=1), (places < place).any(axis=1)
    return not bool((as_good & better).any())


def _effects(study: Study, done: Rows) -> list[Effect]:
    """Return the effects of an additive model, fitted on each machine by itself."""
    all_points = points_of(study, done)
    by_machine = _by(done, "machine").values()
    targets = _targets(study, all_points, done)
    fits = {
        key: [_fitted(study, all_points, own, key) for own in by_machine]
        for key in (study.accuracy, "minutes", "covered")
    }
    found = []
    for n, factor in enumerate(study.factor):
        costs = factor.costs or [0.0] * len(factor.ends)
        for level, word in enumerate(factor.names):
            mean, change, minutes, within = (
                [fit[n][level] - (fit[n][0] if relative else 0.0) for fit in fits[key]]
                for key, relative in (
                    (study.accuracy, False), (study.accuracy, True), ("minutes", True),
                    ("covered", False),
                )
            )  # fmt: skip
            known = [each for each in mean if np.isfinite(each)]
            if known:
                found.append(
                    Effect(
                        factor,
                        word,
                        interval(known),
                        _known(change),
                        _known(minutes).mean,
                        costs[level] - costs[0],
                        share(filter(np.isfinite, within), targets[n][level]),
                    )
                )
    return found


def _targets(study: Study, all_points: Mapping[int, Point], done: Rows) -> list[list[float]]:
    """Return, by factor, the targets at each level; half of all at either end of a range."""
    found = [[0.0] * len(factor.ends) for factor in study.factor]
    for row in done:
        for counts, each in zip(found, all_points[row["point"]].choices, strict=True):
            if each.factor.is_range:
                counts[:] = [count + 0.5 * row["targets"] for count in counts]
            else:
                counts[int(each.share)] += row["targets"]
    return found


def _known(values: Iterable[float]) -> Interval:
    return interval(each for each in values if np.isfinite(each))


def _seen(study: Study, found: Sequence[Point]) -> list[list[int]]:
    """Return the levels that occur, by factor; none of a range."""
    return [
        [] if factor.is_range else sorted({int(each.choices[n].share) for each in found})
        for n, factor in enumerate(study.factor)
    ]


def _columns(study: Study, found: Sequence[Point]) -> Array:
    """Return the additive model's matrix (N, 1 + columns): sum-to-zero levels, ranges -1 to 1.

    Levels that do not occur have no column: nothing is known of them.
    """
    columns: list[Array] = [np.ones(len(found))]
    for n, (factor, seen) in enumerate(zip(study.factor, _seen(study, found), strict=True)):
        at = np.array([each.choices[n].share for each in found])
        if factor.is_range:
            columns.append(2.0 * at - 1.0)
        else:
            columns += [(at == level).astype(float) - (at == seen[-1]) for level in seen[:-1]]
    return np.stack(columns, axis=1)


def _fitted(
    study: Study, all_points: Mapping[int, Point], own: Rows, key: str
) -> list[list[float]]:
    """Return, by factor, the value at each level or end with all else that occurs averaged.

    NaN for a level that no case was done with.
    """
    own_points = [all_points[row["point"]] for row in own]
    values = np.array([row[key] for row in own], dtype=float)
    found = np.linalg.lstsq(_columns(study, own_points), values, rcond=None)[0]
    levels, at = [], 1
    for factor, seen in zip(study.factor, _seen(study, own_points), strict=True):
        if factor.is_range:
            levels.append([float(found[0] - found[at]), float(found[0] + found[at])])
            at += 1
            continue
        some = found[at : at + len(seen) - 1]
        effects = dict(zip(seen, [*some, -some.sum()], strict=True))
        at += len(seen) - 1
        levels.append(
            [
                float(found[0] + effects[level]) if level in effects else float("nan")
                for level in range(len(factor.ends))
            ]
        )
    return levels


def _share(study: Study, done: Rows) -> float:
    """Return how much of the differences between points the main effects explain, 0 to 1."""
    all_points = points_of(study, done)
    by_point = _by(done, "point")
    values = np.array([np.mean([row[study.accuracy] for row in own]) for own in by_point.values()])
    A = _columns(study, [all_points[number] for number in by_point])
    total = float(((values - values.mean()) ** 2).sum())
    if not total > 0.0:
        return 1.0
    rest = values - A @ np.linalg.lstsq(A, values, rcond=None)[0]
    return 1.0 - float((rest**2).sum()) / total
