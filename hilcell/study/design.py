"""The numbered cases of a study, a pure function of its file."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hilcell.decoding import typed
from hilcell.study.case import Level, Row
from hilcell.study.factor import Factor
from hilcell.study.study_file import Optimum, Study


@dataclass(frozen=True, slots=True)
class Choice:
    """A factor's value at a point, its name in tables, and its cost.

    ``share`` is the number of its level, or the position in its range from 0 to 1.
    """

    factor: Factor
    value: object
    word: str
    share: float

    @property
    def cost(self) -> float:
        return self._of(self.factor.costs)

    @property
    def minutes(self) -> float:
        return self._of(self.factor.minutes)

    @property
    def shown(self) -> Level:
        """The value in a table: a number, or the name of a level."""
        if self.factor.is_number and isinstance(self.value, int | float):
            return self.value
        return self.word

    def _of(self, each: Sequence[float] | None) -> float:
        if each is None:
            return 0.0
        if not self.factor.is_range:
            return each[int(self.share)]
        return each[0] + self.share * (each[1] - each[0])


@dataclass(frozen=True, slots=True)
class Point:
    """One design of the cell: a choice of every factor; numbered from 1."""

    number: int
    choices: tuple[Choice, ...]

    @property
    def values(self) -> Mapping[str, object]:
        return dict(
            setting for each in self.choices for setting in each.factor.settings(each.value).items()
        )

    @property
    def cost(self) -> float:
        return sum(each.cost for each in self.choices)

    @property
    def minutes(self) -> float:
        """Working time of people for its choices."""
        return sum(each.minutes for each in self.choices)

    @property
    def words(self) -> str:
        return ", ".join(f"{each.factor.name} {each.word}" for each in self.choices)


@dataclass(frozen=True, slots=True)
class Case:
    """One calibration: a point, on one machine with one set of targets."""

    number: int
    point: Point
    machine: int
    seed: int


def points(study: Study) -> list[Point]:
    """Return the points of the design; for an optimiser, its first generation."""
    match study.design, study.optimise:
        case "optimise", Optimum() as wanted:
            drawn = [choices_at(study, place) for place in places(study, generation(study, wanted))]
            found = iter({point_key(each): each for each in drawn}.values())
        case "sobol", _:
            found = iter(distinct(study, study.different or 0))
        case _:
            ends = (each.span if each.is_range else range(len(each.ends)) for each in study.factor)
            found = (choices_at(study, place) for place in itertools.product(*ends))
    return [Point(n, choices) for n, choices in enumerate(found, start=1)]


def distinct(study: Study, count: int) -> list[tuple[Choice, ...]]:
    """Return so many different points of a Sobol sequence; a repeated one is drawn again.

    Rare levels could take for ever: after eight times as many draws, combinations come in order.
    """
    draws = itertools.chain.from_iterable(places(study, n) for n in (count, 8 * count))
    found: dict[tuple[float, ...], tuple[Choice, ...]] = {}
    in_order = map(list, itertools.product(*(each.steps for each in study.factor)))
    for place in itertools.chain(draws, in_order):
        if len(found) == count:
            break
        choices = choices_at(study, place)
        found.setdefault(point_key(choices), choices)
    return list(found.values())


def cases(study: Study) -> Iterator[Case]:
    """Yield the cases of `points`: all points on one machine before the next machine.

    For an optimiser, whose points are not known in advance: all machines at one point first.
    """
    found = points(study)
    if study.optimise is not None:
        yield from (case for point in found for case in cases_at(study, point))
        return
    runs = itertools.product(study.numbers, range(1, study.seeds + 1))
    drawn = ((point, *run) for run in runs for point in found)
    yield from (Case(number, *each) for number, each in enumerate(drawn, start=1))


def cases_at(study: Study, point: Point) -> list[Case]:
    """Return the cases of an optimiser's point: the same machines and seeds at each."""
    runs = itertools.product(study.numbers, range(1, study.seeds + 1))
    first = 1 + (point.number - 1) * study.machines * study.seeds
    return [Case(first + n, point, *run) for n, run in enumerate(runs)]


def chosen(study: Study, row: Row) -> Point:
    """Return the point of a row of results; raises `ValueError` for an unknown level."""
    return Point(row.point, tuple(_found(each, row.levels[each.name]) for each in study.factor))


def choice(factor: Factor, value: float) -> Choice:
    """Return a choice by the number of its level, or the value in its range."""
    if factor.is_range:
        low, high = factor.span
        value = round(value) if factor.is_whole else float(value)
        return Choice(factor, value, f"{value:.6g}", (value - low) / (high - low))
    level = round(value)
    return Choice(factor, factor.ends[level], factor.names[level], float(level))


def _found(factor: Factor, shown: Level) -> Choice:
    if factor.is_range:
        return choice(factor, typed(shown, float))
    known: Sequence[object] = factor.ends if factor.is_number else factor.names
    return choice(factor, known.index(shown))


def places(study: Study, count: int) -> list[list[float]]:
    """Return a Sobol sequence in values of ranges and numbers of levels.

    Not scrambled: its first point has the first level of every factor.
    """
    from scipy.stats import qmc

    shares = qmc.Sobol(len(study.factor), scramble=False).random_base2((count - 1).bit_length())
    return [
        [
            each.drawn(share) if each.is_range else float(each.level(share))
            for each, share in zip(study.factor, row, strict=True)
        ]
        for row in shares[:count].tolist()
    ]


def choices_at(study: Study, place: Sequence[float]) -> tuple[Choice, ...]:
    """Return the choices at a place: values of ranges, numbers of levels."""
    return tuple(choice(*each) for each in zip(study.factor, place, strict=True))


def generation(study: Study, wanted: Optimum) -> int:
    return min(wanted.trials, max(8, 4 * len(study.factor)))


def point_key(choices: Sequence[Choice]) -> tuple[float, ...]:
    """Return the identity of a point: whole numbers and levels are rounded."""
    return tuple(each.share for each in choices)
