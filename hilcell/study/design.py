"""The cases of a study, numbered: a pure function of its file, the same list anywhere."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hilcell.cell.settings import SettingsError
from hilcell.study.study_file import MOST_CASES, Factor, Study


@dataclass(frozen=True, slots=True)
class Choice:
    """A factor at a point: its value, its name in tables, what it costs.

    ``share`` is the number of its level, or the place in its range from 0 to 1.
    """

    factor: Factor
    value: object
    word: str
    share: float

    @property
    def cost(self) -> float:
        """Return the money."""
        return self._of(self.factor.costs)

    @property
    def minutes(self) -> float:
        """Return the minutes of people."""
        return self._of(self.factor.minutes)

    @property
    def shown(self) -> object:
        """Return what a table keeps: a number, or the name of a level."""
        return self.value if self.factor.is_number else self.word

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
        """Return the settings."""
        return {each.factor.setting: each.value for each in self.choices}

    @property
    def cost(self) -> float:
        """Return the money that its choices cost."""
        return sum(each.cost for each in self.choices)

    @property
    def minutes(self) -> float:
        """Return the minutes of people that its choices cost."""
        return sum(each.minutes for each in self.choices)

    @property
    def words(self) -> str:
        """Return what it is, in a line."""
        return ", ".join(f"{each.factor.name} {each.word}" for each in self.choices)


@dataclass(frozen=True, slots=True)
class Case:
    """One calibration: a point, measured on one machine with one set of targets."""

    number: int
    point: Point
    machine: int
    seed: int


def points(study: Study) -> list[Point]:
    """Return the points of the design; raises `SettingsError` for too many."""
    per_point = study.machines * study.seeds
    count = (study.samples or math.prod(len(factor.ends) for factor in study.factor)) * per_point
    if not count <= MOST_CASES:
        raise SettingsError(study.name, [f"{count} cases, at most {MOST_CASES} are measured"])
    found = _sobol(study) if study.design == "sobol" else _factorial(study)
    return [Point(n, choices) for n, choices in enumerate(found, start=1)]


def cases(study: Study) -> Iterator[Case]:
    """Yield the cases: all points on the first machine before any on the next."""
    drawn = itertools.product(
        range(1, study.machines + 1), range(1, study.seeds + 1), points(study)
    )
    for number, (machine, seed, point) in enumerate(drawn, start=1):
        yield Case(number, point, machine, seed)


def _factorial(study: Study) -> Iterator[tuple[Choice, ...]]:
    return itertools.product(*(_levels(factor) for factor in study.factor))


def _levels(factor: Factor) -> list[Choice]:
    """Return the levels of a factor; of a range its ends."""
    named = zip(factor.ends, factor.names, strict=True)
    return [Choice(factor, value, word, float(n)) for n, (value, word) in enumerate(named)]


def _sobol(study: Study) -> Iterator[tuple[Choice, ...]]:
    """Yield a Sobol sequence, not scrambled: its first point has every factor's first level."""
    from scipy.stats import qmc

    drawn = qmc.Sobol(len(study.factor), scramble=False).random(study.samples or 0)
    for row in drawn:
        yield tuple(
            _drawn(factor, float(share)) for factor, share in zip(study.factor, row, strict=True)
        )


def _drawn(factor: Factor, share: float) -> Choice:
    if not factor.is_range:
        return _levels(factor)[int(share * len(factor.ends))]
    value, at = factor.drawn(share)
    return Choice(factor, value, f"{value:.6g}", at)
