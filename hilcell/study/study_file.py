"""The study file: a base cell, the factors that vary, machines and seeds; strict TOML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import (
    SettingsError,
    convert,
    did_you_mean,
    read_text,
    refuse,
    unreadable,
)
from hilcell.cell.source import built_in_cells, parsed
from hilcell.cell.tables import Frozen, Name
from hilcell.study.outcome import RESULTS
from hilcell.study.toml_value import toml_value

MOST_CASES = 1_000_000
MOST_FACTORS = 20
Money = Annotated[float, Meta(ge=-1e12, le=1e12)]
Many = Annotated[int, Meta(ge=1, le=10_000)]
Samples = Annotated[int, Meta(ge=2, le=65_536)]


class Factor(Frozen, frozen=True, kw_only=True):
    """One setting of the cell that varies: by ``levels``, or between ``low`` and ``high``.

    The first level, or ``low``, is where `buy next` starts. ``costs`` (money) and ``minutes`` (of
    people, besides the robot's) are one for each level, or two: at low and at high.
    """

    name: Name
    setting: Annotated[str, Meta(min_length=1)]
    levels: list[Any] | None = None
    labels: list[str] | None = None
    low: int | float | None = None
    high: int | float | None = None
    costs: list[Money] | None = None
    minutes: list[Money] | None = None

    def __post_init__(self) -> None:
        refuse(self._problems())

    @property
    def is_range(self) -> bool:
        """Whether it varies between two ends."""
        return self.levels is None

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers, which a table of results keeps as such."""
        return self.labels is None and all(
            isinstance(each, int | float) and not isinstance(each, bool) for each in self.ends
        )

    @property
    def ends(self) -> Sequence[Any]:
        """Return its levels, or low and high."""
        return [self.low, self.high] if self.levels is None else self.levels

    @property
    def names(self) -> list[str]:
        """Return what each level, or each end, is called."""
        return self.labels or [_word(each) for each in self.ends]

    def drawn(self, share: float) -> tuple[float, float]:
        """Return the value at a share (0 to 1) of a range, whole where both ends are; its share."""
        low, high = self.ends
        value = low + share * (high - low)
        if isinstance(low, int) and isinstance(high, int):
            value = round(value)
        return value, (value - low) / (high - low)

    def _problems(self) -> Iterator[str]:
        stated = self.levels is not None, self.low is not None, self.high is not None
        if stated not in ((True, False, False), (False, True, True)):
            yield "levels are wanted, or low and high"
            return
        yield from self._range_problems() if self.is_range else self._level_problems()
        for key in ("labels", "costs", "minutes"):
            given = getattr(self, key)
            if given is not None and len(given) != len(self.ends):
                yield f"{key}: {len(self.ends)} are wanted, found {len(given)}"

    def _range_problems(self) -> Iterator[str]:
        low, high = self.ends
        if not low < high:
            yield f"low {low:g} must be below high {high:g}"
        if self.labels is not None:
            yield "labels are for levels"

    def _level_problems(self) -> Iterator[str]:
        if len(self.ends) < 2:
            yield f"levels: two or more are wanted, found {len(self.ends)}"
        elif len(set(self.names)) < len(self.names):
            yield "levels: two are alike; give each its own, or its own label"


class Study(Frozen, frozen=True, kw_only=True):
    """A whole study. ``settings`` are those of the base cell that differ from its file."""

    name: Name
    cell: str = "paper"
    settings: dict[str, Any] = field(default_factory=dict)
    design: Literal["factorial", "sobol"] = "factorial"
    samples: Samples | None = None
    machines: Many = 4
    seeds: Many = 1
    accuracy: str = "mean_mm"
    results: list[str] = field(default_factory=lambda: list(RESULTS))
    money: str = "EUR"
    factor: list[Factor]

    def __post_init__(self) -> None:
        refuse(line for check in self.checks() for line in check() or ())

    def checks(self) -> Sequence[Any]:
        """Return checks of the whole, each of which needs a few fields only."""
        return [
            self._results_known,
            self._accuracy_known,
            self._samples_wanted,
            self._factors_apart,
        ]

    @property
    def has_costs(self) -> bool:
        """Whether any factor costs money."""
        return any(factor.costs is not None for factor in self.factor)

    def _results_known(self) -> Iterator[str]:
        for name in self.results:
            if name not in RESULTS:
                yield f"results: {_unknown(name)}"
        if len(set(self.results)) < len(self.results):
            yield "results: one is named twice"

    def _accuracy_known(self) -> Iterator[str]:
        lengths = [name for name in RESULTS if name.endswith("_mm")]
        if self.accuracy not in lengths:
            yield f"accuracy: {_unknown(self.accuracy, lengths)}"

    def _samples_wanted(self) -> Iterator[str]:
        if self.design == "factorial":
            if self.samples is not None:
                yield 'samples: these are for design = "sobol"'
        elif self.samples is None:
            yield "samples: missing; how many points has the Sobol design?"
        elif self.samples & (self.samples - 1):
            above = 1 << self.samples.bit_length()
            yield f"samples: a power of two is wanted: {above // 2} or {above}"

    def _factors_apart(self) -> Iterator[str]:
        if not 1 <= len(self.factor) <= MOST_FACTORS:
            yield f"factor: 1 to {MOST_FACTORS} are wanted, found {len(self.factor)}"
        for key in ("name", "setting"):
            found = [str(getattr(each, key, n)) for n, each in enumerate(self.factor)]
            for word in sorted({each for each in found if found.count(each) > 1}):
                yield f"factor: two have the {key} {word!r}"
        for each in self.factor:
            if each.name in (*RESULTS, *COLUMNS):
                yield f"factor: the name {each.name!r} is one of a result"


COLUMNS = ("case", "point", "machine", "seed", "state", "reason", "minutes", "cost")


def read_study(path: Path) -> Study:
    """Read a study file; raises one `SettingsError` with every problem, the factors' too."""
    source = str(path)
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(source, error, "study file") from error
    study = convert(parsed(text, source), Study, source)
    if study.cell not in built_in_cells():
        study = msgspec.structs.replace(study, cell=str(path.parent / study.cell))
    if problems := [*_unlike_the_cell(study)]:
        raise SettingsError(source, problems)
    return study


def cell_of(study: Study, values: Mapping[str, object]) -> Cell:
    """Return the base cell with these settings; raises `SettingsError`."""
    given = {**study.settings, **values}
    return load_cell(study.cell, {key: toml_value(value) for key, value in given.items()})


def _unlike_the_cell(study: Study) -> Iterator[str]:
    """Yield what is wrong with the base cell, and values that a factor's setting can never take.

    A value that only goes ill with the others' is not refused: its cases cannot be, which is a
    finding of the study.
    """
    try:
        base = cell_of(study, {})
    except SettingsError as error:
        yield from (f"cell {study.cell}: {line}" for line in error.problems)
        return
    if base.simulation is None:
        yield f"cell {study.cell}: it has real devices only; a study simulates"
        return
    for n, factor in enumerate(study.factor):
        for line in dict.fromkeys(_never(study, factor)):
            yield f"factor[{n}].setting: {line}"


def _never(study: Study, factor: Factor) -> Iterator[str]:
    top = factor.setting.partition(".")[0]
    for value in factor.ends:
        try:
            cell_of(study, {factor.setting: value})
        except SettingsError as error:
            for line in error.problems:
                place = _without_line(line)
                if place.startswith((f"{factor.setting}:", f"{factor.setting}[")) or (
                    ": unknown key" in line and place.startswith(top)
                ):
                    yield place


def _without_line(problem: str) -> str:
    """Return a problem of a cell file without the number of its line, where it has one."""
    first, _, rest = problem.partition(": ")
    return rest if first.rpartition(":")[2].isdecimal() else problem


def _unknown(name: str, known: Sequence[str] = tuple(RESULTS)) -> str:
    return f"{name!r} is none{did_you_mean(name, known) or '; known: ' + ', '.join(known)}"


def _word(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)
