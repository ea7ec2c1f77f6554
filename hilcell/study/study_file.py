"""The study file: a base cell, the factors that vary, machines and seeds; strict TOML."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from hilcell.cell.devices import in_process_cell
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
from hilcell.study.factor import Factor
from hilcell.study.outcome import RESULTS
from hilcell.study.toml_value import toml_value

MOST_CASES = 1_000_000
MOST_FACTORS = 20
MACHINE = ("simulation.machine", "simulation.sizes")
Many = Annotated[int, Meta(ge=1, le=10_000)]
Samples = Annotated[int, Meta(ge=2, le=65_536)]


class Optimum(Frozen, frozen=True, kw_only=True):
    """The aim of an optimiser, which tries at most ``trials`` points, drawn by ``seed``.

    It minimises the accuracy plus ``mm_per_minute`` for each minute, among the points of at most
    ``most_minutes``.
    """

    trials: Annotated[int, Meta(ge=8, le=65_536)]
    most_minutes: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    mm_per_minute: Annotated[float, Meta(ge=0, le=1000)] | None = None
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1)] = 1

    def __post_init__(self) -> None:
        if self.most_minutes is None and self.mm_per_minute is None:
            raise ValueError("most_minutes, mm_per_minute or both are wanted")


class Study(Frozen, frozen=True, kw_only=True):
    """A whole study. ``settings`` are those of the base cell that differ from its file."""

    name: Name
    cell: str = "paper"
    settings: dict[str, Any] = field(default_factory=dict)
    design: Literal["factorial", "sobol", "optimise"] = "factorial"
    samples: Samples | None = None
    optimise: Optimum | None = None
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
            self._optimum_wanted,
            self._drawn_by_sobol,
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
        if self.design != "sobol":
            if self.samples is not None:
                yield 'samples: these are for design = "sobol"'
        elif self.samples is None:
            yield "samples: missing; how many points has the Sobol design?"
        elif self.samples & (self.samples - 1):
            above = 1 << self.samples.bit_length()
            yield f"samples: a power of two is wanted: {above // 2} or {above}"

    def _optimum_wanted(self) -> Iterator[str]:
        if self.design != "optimise":
            if self.optimise is not None:
                yield 'optimise: this is for design = "optimise"'
        elif self.optimise is None:
            yield "optimise: missing; state its trials, and most_minutes or mm_per_minute"

    def _drawn_by_sobol(self) -> Iterator[str]:
        if self.design == "sobol":
            return
        for n, each in enumerate(self.factor):
            for key in ("distribution", "weights"):
                if getattr(each, key) is not None:
                    yield f'factor[{n}].{key}: this is for design = "sobol"'

    def _factors_apart(self) -> Iterator[str]:
        if not 1 <= len(self.factor) <= MOST_FACTORS:
            yield f"factor: 1 to {MOST_FACTORS} are wanted, found {len(self.factor)}"
        names = [str(getattr(each, "name", n)) for n, each in enumerate(self.factor)]
        settings = [key for each in self.factor for key in each.settings_named]
        for key, found in (("name", names), ("setting", settings)):
            for word in sorted({each for each in found if found.count(each) > 1}):
                yield f"factor: two have the {key} {word!r}"
        for whole, part in sorted(set(itertools.permutations(settings, 2))):
            if part.startswith(f"{whole}."):
                yield f"factor: {whole!r} contains {part!r}; one of them would undo the other"
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
        place = "setting" if factor.setting else "levels"
        for line in dict.fromkeys(_never(study, factor)):
            yield f"factor[{n}].{place}: {line}"


def _never(study: Study, factor: Factor) -> Iterator[str]:
    for value in factor.ends:
        given = factor.settings(value)
        try:
            cell = cell_of(study, given)
        except SettingsError as error:
            found = ((_without_line(line), key) for line in error.problems for key in given)
            yield from (line for line, key in found if _is_of(line, key))
            continue
        if any(key.startswith(MACHINE) for key in given):
            yield from _no_machine(cell)


def _is_of(problem: str, key: str) -> bool:
    """Whether a problem of a cell is one of this setting's, whatever others are."""
    unknown = ": unknown key" in problem and problem.startswith(key.partition(".")[0])
    return unknown or problem.startswith((f"{key}:", f"{key}["))


def _no_machine(cell: Cell) -> Iterator[str]:
    """Yield why there is no such machine; one that only goes ill with its cell is a finding."""
    try:
        in_process_cell(cell, seed=1)
    except SettingsError as error:
        if error.source.startswith(MACHINE):
            yield from (f"{error.source}: {line}" for line in error.problems)


def _without_line(problem: str) -> str:
    """Return a problem of a cell file without the number of its line, where it has one."""
    first, _, rest = problem.partition(": ")
    return rest if first.rpartition(":")[2].isdecimal() else problem


def _unknown(name: str, known: Sequence[str] = tuple(RESULTS)) -> str:
    return f"{name!r} is none{did_you_mean(name, known) or '; known: ' + ', '.join(known)}"
