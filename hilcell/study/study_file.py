"""The study file: a base cell, the factors that vary, machines and seeds; strict TOML."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import date, time
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, field

from hilcell.cell.devices import in_process_cell
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.settings import (
    SettingsError,
    convert,
    did_you_mean,
    is_read,
    read_text,
    refuse,
    unreadable,
)
from hilcell.cell.source import built_in_cells, parsed
from hilcell.cell.tables import Frozen, Name
from hilcell.decoding import typed
from hilcell.study.case import IDW, RESULTS
from hilcell.study.factor import Factor, is_stated


def toml_text(value: object) -> str:
    """Return a value that TOML or JSON has read, as TOML in one line."""
    if isinstance(value, Mapping):
        inner = (f"{_quoted(str(key))} = {toml_text(each)}" for key, each in value.items())
        return f"{{ {', '.join(inner)} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(toml_text, value))}]"
    if isinstance(value, float):
        return repr(value)  # "inf" and "nan" too, which the cell refuses
    if isinstance(value, date | time):
        return value.isoformat()
    return _quoted(value) if isinstance(value, str) else json.dumps(value)


def _quoted(text: str) -> str:
    """Return a string; TOML knows no halves of a character, and no bare DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


BOUND = "bound95_mm"  # of a target, as the certificate states it
MACHINE = ("simulation.machine", "simulation.sizes")
Many = Annotated[int, Meta(ge=1, le=10_000)]


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
            raise ValueError("expected most_minutes, mm_per_minute or both")


class Question(Frozen, frozen=True, kw_only=True):
    """A buyer's question: is a share of all machines within the limit, at this confidence?"""

    limit_mm: Annotated[float, Meta(gt=0, le=1000)]
    share: Annotated[float, Meta(ge=0.5, le=0.999)] = 0.95
    confidence: Annotated[float, Meta(ge=0.5, le=0.999)] = 0.95


class Study(Frozen, frozen=True, kw_only=True):
    """A whole study. ``settings`` are those of the base cell that differ from its file."""

    name: Name
    cell: str = "paper"
    settings: dict[str, object] = field(default_factory=dict)
    design: Literal["factorial", "sobol", "optimise"] = "factorial"
    samples: Annotated[int, Meta(ge=2, le=65_536)] | None = None
    optimise: Optimum | None = None
    machines: Many = 4
    first_machine: Annotated[int, Meta(ge=1, le=1_000_000)] = 1
    seeds: Many = 1
    accuracy: str = "mean_mm"
    question: Question | None = None
    results: list[str] = field(default_factory=lambda: list(RESULTS))
    money: str = "EUR"
    factor: list[Factor]

    def __post_init__(self) -> None:
        refuse(line for check in self.checks() for line in check() or ())

    def checks(self) -> Sequence[Callable[[], Iterable[str] | None]]:
        """Return checks of the whole, each of which needs a few fields only."""
        return [
            self._results_known,
            self._accuracy_known,
            self._samples_wanted,
            self._optimum_wanted,
            self._drawn_by_sobol,
            self._count_of_factors,
            self._names_apart,
            self._settings_apart,
            self._count_of_cases,
        ]

    @property
    def most_cases(self) -> int:
        """How many cases are measured, by an optimiser at most."""
        points = self.different or math.prod(len(each.ends) for each in self.factor)
        if self.optimise is not None:
            points = self.optimise.trials
        return points * self.machines * self.seeds

    @property
    def numbers(self) -> range:
        """The numbers of the machines, each the seed of its errors."""
        return range(self.first_machine, self.first_machine + self.machines)

    @property
    def different(self) -> int | None:
        """How many points a Sobol design has: its samples, or all that differ."""
        if self.samples is None or any(each.is_range and not each.is_whole for each in self.factor):
            return self.samples
        return min(self.samples, math.prod(len(each.steps) for each in self.factor))

    @property
    def truth(self) -> str | None:
        """The simulator's own figure of the accuracy, where it has one."""
        name = f"true_{self.accuracy.removeprefix('true_')}"
        return name if name in RESULTS else None

    @property
    def has_costs(self) -> bool:
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
            yield f"samples: expected a power of two, {above // 2} or {above}, got {self.samples}"

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
                if is_stated(each, attrgetter(key)):
                    yield f'factor[{n}].{key}: this is for design = "sobol"'

    def _count_of_factors(self) -> Iterator[str]:
        if not 1 <= len(self.factor) <= 20:
            yield f"factor: expected 1 to 20, got {len(self.factor)}"

    def _names_apart(self) -> Iterator[str]:
        names = [each.name for each in self.factor if is_read(each, lambda it: it.name)]
        yield from _twice("name", names)
        columns = ("case", "point", "machine", "seed", "state", "reason", "minutes", "cost")
        for name in names:
            if name in (*RESULTS, *columns):
                yield f"factor: the name {name!r} is that of a column of results; choose another"

    def _settings_apart(self) -> Iterator[str]:
        readable = [each for each in self.factor if is_read(each, lambda it: it.settings_named)]
        settings = [key for each in readable for key in each.settings_named]
        yield from _twice("setting", settings)
        for whole, part in sorted(set(itertools.permutations(settings, 2))):
            if part.startswith(f"{whole}."):
                yield f"factor: {whole!r} contains {part!r}; one of them would undo the other"

    def _count_of_cases(self) -> Iterator[str]:
        if not self.most_cases <= 1_000_000:
            yield f"{self.most_cases} cases, at most 1000000 are measured"


def read_study(path: Path) -> Study:
    """Read a study file; raises one `SettingsError` with every problem, the factors' too."""
    source = str(path)
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        raise unreadable(source, error, "study file") from error

    stated = parsed(text, source)

    def unlike_the_cell(found: Study) -> Iterator[str]:
        if is_read(found, lambda it: (it.cell, it.settings)):
            yield from _AgainstCell(found, _place(found.cell, path.parent)).problems(stated)

    study = convert(stated, Study, source, unlike_the_cell)
    return msgspec.structs.replace(study, cell=_place(study.cell, path.parent))


def _place(cell: str, folder: Path) -> str:
    return cell if cell in built_in_cells() else str(folder / cell)


def study_cell(study: Study, values: Mapping[str, object]) -> Cell:
    """Return the base cell with these settings; raises `SettingsError`."""
    return _cell(study.cell, {**study.settings, **values})


def _cell(where: str, settings: Mapping[str, object]) -> Cell:
    return load_cell(where, {key: toml_text(value) for key, value in settings.items()})


class _AgainstCell:
    """A study beside its base cell: the errors of that, and values that no setting can take.

    A value that only goes ill with the others' is not refused: its cases cannot be, which is a
    finding of the study. Factors are tried without the settings of the base cell that are wrong.
    """

    def __init__(self, study: Study, where: str) -> None:
        self.study, self.where = study, where
        self.sound = dict(study.settings)
        self.accuracy = study.accuracy if is_read(study, lambda it: it.accuracy) else ""

    def problems(self, stated: Mapping[str, object]) -> Iterator[str]:
        base: list[str] = []
        while new := [line for line in self.wrong_base() if line not in base]:
            base += new
            plain = [self.without_line(line) for line in new]
            for key in [*self.sound]:
                if any(self.is_of(line, key) or line.startswith(f"{key} ") for line in plain):
                    del self.sound[key]
        yield from (f"cell {self.where}: {line}" for line in base)
        known = {self.without_line(line) for line in base}
        factors = self.study.factor if is_read(self.study, lambda it: it.factor) else ()
        for n, factor in enumerate(factors):
            if not is_read(factor, lambda it: it.setting):
                continue
            place = "setting" if factor.setting else "levels"
            whole = is_read(factor, lambda it: it.ends)
            values = factor.ends if whole else self.finite_levels(stated, n)
            for line in dict.fromkeys(self.never(factor, values)):
                if line not in known:
                    yield f"factor[{n}].{place}: {line}"

    def wrong_base(self) -> Iterator[str]:
        try:
            cell = _cell(self.where, self.sound)
        except SettingsError as error:
            yield from error.problems
            return
        if cell.simulation is None:
            yield "it has real devices only; a study simulates"
        else:
            yield from self.no_machine(cell)
        yield from self.never_run(cell)

    def never(self, factor: Factor, values: Sequence[object]) -> Iterator[str]:
        """Yield why values of a factor, as far as they could be read, can never be."""
        values = [value for value in values if value is not None]
        if not factor.setting:  # each is a table of settings, where it is sound
            values = [value for value in values if isinstance(value, Mapping)]
        for given in map(factor.settings, values):
            try:
                cell = _cell(self.where, {**self.sound, **given})
            except SettingsError as error:
                lines = [self.without_line(line) for line in error.problems]
                yield from (line for line in lines for key in given if self.is_of(line, key))
                continue
            if any(key.startswith(MACHINE) for key in given):
                yield from self.no_machine(cell)
            yield from self.never_run(cell)

    def never_run(self, cell: Cell) -> Iterator[str]:
        """Yield why no run of this cell has the study's accuracy, or nobody can measure it."""
        if cell.plan.quick and self.accuracy == IDW:
            yield (
                "plan.quick: a quick plan sends no targets by the paper's method, so it has no "
                f'{IDW}; leave plan.quick out, or state another accuracy, such as "mean_mm"'
            )
        if cell.layout.by_hand:
            yield (
                "layout.reflectors: by_hand: an operator must carry the reflector, and "
                'cases run unattended; set layout.reflectors = "mounted"'
            )

    @staticmethod
    def no_machine(cell: Cell) -> Iterator[str]:
        """Yield why there is no such machine; one that only goes ill with its cell is a finding."""
        try:
            in_process_cell(cell, seed=1)
        except SettingsError as error:
            if error.source == "in_process_cells":
                yield from (f"simulation.simulator: {line}" for line in error.problems)
            elif error.source.startswith(MACHINE):
                yield from (f"{error.source}: {line}" for line in error.problems)

    @staticmethod
    def finite_levels(stated: Mapping[str, object], n: int) -> Sequence[object]:
        """Return the levels of the factor of a number whose others are not finite."""
        factor = typed(stated["factor"], list[object])[n]
        levels = factor.get("levels") if isinstance(factor, Mapping) else None
        some = levels if isinstance(levels, list) else []
        return [each for each in some if not (isinstance(each, float) and not math.isfinite(each))]

    @staticmethod
    def is_of(problem: str, key: str) -> bool:
        """Whether a problem of a cell is one of this setting's, whatever others are."""
        unknown = ": unknown key" in problem and problem.startswith(key.partition(".")[0])
        return unknown or problem.startswith((f"{key}:", f"{key}["))

    @staticmethod
    def without_line(problem: str) -> str:
        """Return a problem of a cell file without the number of its line, where it has one."""
        first, _, rest = problem.partition(": ")
        return rest if first.rpartition(":")[2].isdecimal() else problem


def _twice(kind: str, words: Sequence[str]) -> Iterator[str]:
    for word in sorted({each for each in words if words.count(each) > 1}):
        yield f"factor: two have the {kind} {word!r}"


def _unknown(name: str, known: Sequence[str] = tuple(RESULTS)) -> str:
    return f"{name!r} is no result{did_you_mean(name, known) or '; known: ' + ', '.join(known)}"
