"""Two runs of one cell side by side: the drift between the calibrations.

A pure function of two logs. Figures of two runs always differ; only a change beyond its stated
uncertainty is drift, and figures that depend on the tracker's set-up are not compared at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import msgspec
import numpy as np

from hilcell.calibration.contribution import expanded_mm
from hilcell.calibration.errors import OTHERS, Errors, places, validation
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.errors import HilcellError
from hilcell.geometry.statistics import Figures, variance_of_mean
from hilcell.journal.asset import differing
from hilcell.journal.log import Log
from hilcell.journal.ways_sent import Sent
from hilcell.present.table import Column
from hilcell.report.drift import Change, Side, base_variance_mm2, frame_changes, grid_drift, side_of


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting that differs: its path, and its value in both runs, empty where it is missing."""

    key: str
    first: str
    second: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """Changes between two runs. ``moved_mm`` is the change of the error at each vertex."""

    settings: list[Setting]
    changes: list[Change]
    moved_mm: dict[str, float]
    notes: list[str]

    @property
    def drifted(self) -> list[Change]:
        """Return the changes beyond their limits; the air's are a reason, not a drift."""
        return [c for c in self.changes if c.verdict == "beyond" and c.group != "air"]

    @property
    def verdict(self) -> str:
        """Return the whole in one sentence."""
        judged = [c for c in self.changes if c.verdict and c.group != "air"]
        if not judged:
            return "no uncertainty is stated for the figures of both runs: nothing is judged"
        if not self.drifted:
            return f"no drift: all {len(judged)} judged changes are within their uncertainty"
        return f"drift: {len(self.drifted)} of {len(judged)} judged changes are beyond it"


def compare_runs(
    first: Log, second: Log, *, live: tuple[bool, bool] = (False, False)
) -> Comparison:
    """Return the changes from the first run to the second; ``live``: whose engine is at work.

    Raises `HilcellError` for runs of different cells, for a simulated beside a real one, and for
    runs that have nothing in common.
    """
    _refuse_others(first, second)
    sides = side_of(first), side_of(second)
    drift = grid_drift(*sides)
    changes = [
        *_validation(*sides),
        *frame_changes(*sides),
        *(drift.changes if drift is not None else []),
    ]
    if not changes:
        raise HilcellError(
            f"nothing to compare: {_has(first)} and {_has(second)} have no frame, grid or "
            "validation in common; compare two calibrations"
        )
    return Comparison(
        _settings(first, second),
        [*changes, *_air(first, second)],
        drift.moved_mm if drift is not None else {},
        [*_unfinished(first, second, live), *_notes(first, second, grids=drift is not None)],
    )


def _refuse_others(first: Log, second: Log) -> None:
    one, other = first.cell, second.cell
    if (one.name, one.serial) != (other.name, other.serial):
        raise HilcellError(
            f"runs of different cells are not compared: the first is of {one.name} serial "
            f"{one.serial}, the second of {other.name} serial {other.serial}"
        )
    if first.inputs.simulated != second.inputs.simulated:
        which = "first" if first.inputs.simulated else "second"
        raise HilcellError(f"the {which} run was simulated, the other was not: nothing to compare")


def _has(log: Log) -> str:
    return f"a {log.inputs.procedure} ({log.state}, {len(log.points)} points)"


# -- figures --------------------------------------------------------------------------------------


def _validation(first: Side, second: Side) -> Iterator[Change]:
    """Yield the figures of |e| per place, before and after."""
    there = places(second.log.cell)
    for place, stations in places(first.log.cell).items():
        if there.get(place) == stations:
            series, other = (validation(side.log, stations) for side in (first, second))
            for how in (how for how in series if how in other):
                yield from _validated(place, how, (first, series[how]), (second, other[how]))


def _validated(
    place: str, how: Sent, first: tuple[Side, Errors], second: tuple[Side, Errors]
) -> Iterator[Change]:
    """Yield the change of each figure; the mean alone has a limit."""
    figures = zip(Figures._fields, first[1].figures, second[1].figures, strict=True)
    for what, one_mm, two_mm in figures:
        limit_mm = _mean_limit_mm(how, first, second) if what == "mean" else None
        change_mm, figure = two_mm - one_mm, f"{how} {what}"
        yield Change("validation", place, figure, "mm", one_mm, two_mm, change_mm, limit_mm)


def _mean_limit_mm(how: Sent, *runs: tuple[Side, Errors]) -> float | None:
    """Return U of a change of the mean: which targets were drawn, the measurement's u, {B}'s.

    {B} counts before only: a correction learnt in a run's {B} makes up for where that {B} is.
    """
    variance_mm2 = 0.0
    for side, errors in runs:
        base_mm2 = base_variance_mm2(side.log)
        if side.u_mm is None or base_mm2 is None or len(errors) < 2:
            return None
        variance_mm2 += variance_of_mean(errors.norms_mm)
        variance_mm2 += side.u_mm**2 + (base_mm2 if how == Sent.BEFORE else 0.0)
    return expanded_mm(math.sqrt(variance_mm2))


def _air(first: Log, second: Log) -> Iterator[Change]:
    """Yield the mean temperature of both runs; its limit is the margin of a calibration's use."""
    celsius = [log.temperatures_c() for log in (first, second)]
    if all(celsius):
        pair = [float(np.mean(each)) for each in celsius]
        yield Change(
            "air",
            "at the tracker",
            "mean temperature",
            "°C",
            pair[0],
            pair[1],
            pair[1] - pair[0],
            TEMPERATURE_MARGIN_K,
        )


# -- words ----------------------------------------------------------------------------------------


def _unfinished(first: Log, second: Log, live: tuple[bool, bool]) -> Iterator[str]:
    for which, log, lives in zip(("first", "second"), (first, second), live, strict=True):
        state = log.state
        if state != "finished":
            stands = lives or log.over
            how = f"is {state}" if stands else f"was {state} when its engine was lost"
            yield f"the {which} run {how}: its measured points are compared"


def _notes(first: Log, second: Log, *, grids: bool) -> Iterator[str]:
    yield "the tracker's place in {W} is of its set-up and is not compared"
    for which, log in (("first", first), ("second", second)):
        if log.points and not log.temperatures_c():
            yield f"the {which} run's tracker had no weather station: the air is not compared"
    for one, other in differing(first.assets, second.assets):
        yield f"the {one.kind} differs: {one.text} in the first run, {other.text} in the second"
    seeds = (first.inputs.machine_seed, second.inputs.machine_seed)
    if None not in seeds and seeds[0] != seeds[1]:
        yield "the machines' seeds differ: these are two simulated cells, not one that drifted"
    measured = [bool(log.select("grid")) for log in (first, second)]
    if any(measured) and not all(measured):
        yield "only one of the runs measured the grid: it is not compared"
    elif not grids and all(measured):
        yield "the grids differ: their vertices are not compared"
    methods = [str(log.verdicts.get("fit", {}).get("method", "")) for log in (first, second)]
    if all(methods) and methods[0] != methods[1]:
        yield f"'chosen' is {methods[0]} in the first run, {methods[1]} in the second"


def _settings(first: Log, second: Log) -> list[Setting]:
    """Return the differences of the frozen inputs by key, the simulation's addresses left out."""
    one, other = _inputs(first), _inputs(second)
    keys = [*one, *(key for key in other if key not in one)]
    pairs = ((key, one.get(key, ""), other.get(key, "")) for key in keys)
    return [Setting(*each) for each in pairs if each[1] != each[2]]


def _inputs(log: Log) -> dict[str, str]:
    inputs = log.inputs
    cell = {key: value for key, value in inputs.cell.items() if key != "simulation"}
    run = {"procedure": inputs.procedure, "seed": inputs.seed, "unattended": inputs.unattended}
    machine = {} if inputs.machine_seed is None else {"machine_seed": inputs.machine_seed}
    versions = {"versions": {"hilcell": inputs.versions.get("hilcell", "")}}
    return dict(_leaves(run | machine | versions | cell, ""))


def _leaves(value: object, path: str) -> Iterator[tuple[str, str]]:
    """Yield the plain values of a table by their paths; members of lists go by their names."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list) and any(isinstance(each, Mapping) for each in value):
        for number, each in enumerate(value, start=1):
            name = each.get("name", number) if isinstance(each, Mapping) else number
            yield from _leaves(each, f"{path}[{name}]")
    else:
        yield path, value if isinstance(value, str) else msgspec.json.encode(value).decode()


# -- A change between two runs in words: every row says which station it is about ------------------

# The station stands first, so that rows differ where a column is narrow, too.

_GRID, _STATION = "grid/", "station "  # begin the places of a vertex and of a station's frame


def where_words(change: Change) -> str:
    """Return what changed: *S300 targets*, *S300 frame*, *grid point 1-2-0*."""
    match change.group:
        case "validation":
            return "other stations" if change.place == OTHERS else f"{change.place} targets"
        case "frames":
            station = change.place.removeprefix(_STATION)
            return f"{station} frame" if station != change.place else f"robot {change.place}"
        case "grid" if change.place.startswith(_GRID):
            return f"grid point {change.place.removeprefix(_GRID)}"
        case "grid":
            return change.place.replace("vertices", "grid points")
    return "air at tracker"


def figure_words(change: Change) -> str:
    """Return the figure that changed: *corrected: mean*, which is of |e|."""
    if change.group != "validation":
        return change.what
    how, _, figure = change.what.partition(" ")
    return f"{Sent(how).short}: {'95 %' if figure == 'p95' else figure}"


_DIGITS = {"mm": 4, "deg": 5}


def _figure(name: str, change: Change) -> str | None:
    value: float | None = getattr(change, name)
    sign = "+" if name == "change" and change.first is not None else ""  # a length has none
    return None if value is None else f"{value:{sign}.{_DIGITS.get(change.unit, 2)}f}"


CHANGES: tuple[Column[Change], ...] = (
    Column("where", where_words),
    Column("what", figure_words),
    *(
        Column[Change](name, partial(_figure, name), form="s")
        for name in ("first", "second", "change", "limit")
    ),
    Column("unit", attrgetter("unit")),
    Column("verdict", attrgetter("verdict")),
)
