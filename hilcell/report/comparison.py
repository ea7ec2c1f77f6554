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
from typing import Literal

import msgspec
import numpy as np

from hilcell.calibration.errors import OTHERS, Errors, places, validation, visits_mm
from hilcell.calibration.frames import (
    floor_points,
    has_own_place,
    hold_covariance,
    slide_covariance,
    world_covariance,
)
from hilcell.calibration.grid import grid_errors_mm, grid_of, vertex_ids
from hilcell.calibration.measurement_budget import budget_of, expanded_mm
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.errors import HilcellError
from hilcell.geometry.frames import (
    RigidFit,
    cross_matrix,
    point_uncertainty,
)
from hilcell.geometry.statistics import (
    CONFIDENCE,
    Figures,
    lengths_mm,
    pooled_std_mm,
    variance_of_mean,
)
from hilcell.journal.floor_before import FLOOR_NESTS
from hilcell.journal.log import Log, differing
from hilcell.model.frame import TouchedBase
from hilcell.model.point import Sent
from hilcell.ports import Array
from hilcell.present.table import Column

# -- changes between two runs of one cell, each figure with the uncertainty of its change ----------

# {W} is built from floor nests, so frames in {W} and errors in {B} can be compared between two
# set-ups of the tracker. The place of a frame depends on {W}'s own noise, which a lever of metres
# multiplies; without it every station seems to have turned.

Verdict = Literal["within", "beyond", ""]


@dataclass(frozen=True, slots=True)
class Change:
    """One figure of both runs.

    ``change`` is second less first, or the length of a move, which has no first and second.
    95 % of changes keep ``limit`` where nothing drifted, or it is a stated margin; None where
    neither is known.
    """

    group: Literal["validation", "frames", "grid", "air"]
    place: str
    what: str
    unit: str
    first: float | None
    second: float | None
    change: float
    limit: float | None = None

    @property
    def verdict(self) -> Verdict:
        """Return whether the change keeps its limit; empty where it has none."""
        if self.limit is None:
            return ""
        return "within" if abs(self.change) <= self.limit else "beyond"


@dataclass(frozen=True, slots=True)
class GridDrift:
    """How far the error at each vertex moved (mm, in {B}), by the vertex's key, in their order."""

    moved_mm: dict[str, float]
    changes: list[Change]


@dataclass(frozen=True, slots=True)
class Side:
    """One run, and u of one coordinate of a position that it measured, where its budget knows."""

    log: Log
    u_mm: float | None


def side_of(log: Log) -> Side:
    """Return a run as one side of a comparison."""
    budget = budget_of(log)
    return Side(log, budget.u_mm if budget is not None else None)


def frame_changes(first: Side, second: Side) -> list[Change]:
    """Return how far the base and the station frames, as both runs have them, moved in {W}."""
    found: list[Change] = []
    for key, frame in first.log.frames.items():
        if isinstance(frame, TouchedBase):  # two stops are never the same
            continue
        if not all(has_own_place(side.log.cell, key) for side in (first, second)):
            continue
        other = second.log.frames.get(key)
        if frame.covariance and other is not None and other.covariance:
            place = key.replace(".", " ")
            limits = _Pair(first, second).frame_limits(key)
            T_1, T_2 = first.log.matrix(key), second.log.matrix(key)
            R = T_1[:3, :3].T @ T_2[:3, :3]
            sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
            moved = (
                float(np.linalg.norm(T_2[:3, 3] - T_1[:3, 3])),
                math.degrees(math.atan2(float(sine), (float(np.trace(R)) - 1) / 2)),
            )
            for what, unit, change, limit in zip(
                ("moved", "turned"), ("mm", "deg"), moved, limits, strict=True
            ):
                found.append(Change("frames", place, what, unit, None, None, change, limit))
    return found


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two runs of a cell that are compared."""

    first: Side
    second: Side

    def frame_limits(self, key: str) -> tuple[float | None, float | None]:
        """Return the limits of a frame's move in mm and of its turn in deg."""
        both = [_frame_covariance(side, key) for side in (self.first, self.second)]
        covariance = sum((each for each in both if each is not None), np.zeros((6, 6)))
        if any(each is None for each in both):
            return None, None
        factor = length_factor(1)
        moved_mm, turned_rad = (
            factor * math.sqrt(float(np.trace(part)) / 3)
            for part in (covariance[:3, :3], covariance[3:, 3:])
        )
        return moved_mm, math.degrees(turned_rad)

    def vertex_u_mm(self, *, based: bool) -> float | None:
        """Return u of one coordinate of the difference of two errors at a vertex, in {B}.

        {W} cancels: base and vertices were measured in the same set-up. ``based`` adds {B}'s own.
        """
        variances_mm2 = [_vertex_variance_mm2(side) for side in (self.first, self.second)]
        if based:
            variances_mm2 += [base_variance_mm2(side.log) for side in (self.first, self.second)]
        known = [each for each in variances_mm2 if each is not None]
        return math.sqrt(sum(known)) if len(known) == len(variances_mm2) else None


def _frame_covariance(side: Side, key: str) -> Array | None:
    """Return the covariance (6, 6) of a frame in {W}: its own, {W}'s, the budget's, the strip's."""
    log, u_mm = side.log, side.u_mm
    if u_mm is None or len(floor_points(log)) < FLOOR_NESTS:
        return None
    covariance: Array = log.frames[key].C
    covariance += world_covariance(log, log.matrix(key)[:3, 3])
    covariance[:3, :3] += hold_covariance(log.cell)
    if key == "base":
        covariance[:3, :3] += u_mm**2 * np.eye(3)
    else:
        covariance += slide_covariance(log.cell, log.matrix(key), u_mm**2)
    return covariance


def grid_drift(first: Side, second: Side) -> GridDrift | None:
    """Return how the error at the vertices changed, or nothing where the grids differ.

    An error of {B} moves all vertices together; the rest, which no small rigid motion explains, is
    the arm's.
    """
    if not _Runs(first.log, second.log).same_grid():
        return None
    grid = grid_of(first.log.cell)
    order = tuple(grid.serpentine().T)
    before_mm, after_mm = (grid_errors_mm(side.log)[order] for side in (first, second))
    both = np.isfinite(before_mm + after_mm).all(axis=1)
    if not both.any():
        return None
    before_mm, after_mm, places_mm = (
        each[both] for each in (before_mm, after_mm, grid.serpentine_mm())
    )
    moved_mm = lengths_mm(after_mm - before_mm)
    levers = cross_matrix(places_mm - places_mm.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), levers.shape)
    A = np.concatenate([shifts, -levers], axis=2).reshape(-1, 6)
    values = (after_mm - before_mm).reshape(-1)
    rest: Array = values - A @ np.linalg.lstsq(A, values, rcond=None)[0]
    own_mm = lengths_mm(rest.reshape(-1, 3))
    one_mm, other_mm = (float(lengths_mm(each).mean()) for each in (before_mm, after_mm))
    keys = [id.key for id, known in zip(vertex_ids(grid), both, strict=True) if known]
    worst = int(np.argmax(moved_mm))
    whole, own = (
        _Pair(first, second).vertex_u_mm(based=True),
        _Pair(first, second).vertex_u_mm(based=False),
    )
    where = f"{len(keys)} vertices"
    changes = [
        Change("grid", where, "mean error", "mm", one_mm, other_mm, other_mm - one_mm),
        _move(where, "mean move", float(moved_mm.mean()), 1, whole),
        _move(keys[worst], "largest move", float(moved_mm[worst]), len(keys), whole),
        _move(where, "mean move, rigid part removed", float(own_mm.mean()), 1, own),
    ]
    return GridDrift(dict(zip(keys, moved_mm.tolist(), strict=True)), changes)


@dataclass(frozen=True, eq=False)
class _Runs:
    """Two runs of a cell that are compared."""

    first: Log
    second: Log

    def same_grid(self) -> bool:
        """Whether both have measured errors on the same lattice."""
        one, other = grid_of(self.first.cell), grid_of(self.second.cell)
        alike = one.shape == other.shape and one.pitch_mm == other.pitch_mm
        known = {"world", "base"} <= self.first.frames.keys() & self.second.frames.keys()
        return alike and known and bool(np.array_equal(one.origin_mm, other.origin_mm))

    def air(self) -> Iterator[Change]:
        """Yield the mean temperature of both runs; the limit is that of a calibration's use."""
        celsius = [log.temperatures_c() for log in (self.first, self.second)]
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

    def unfinished(self, live: tuple[bool, bool]) -> Iterator[str]:
        for which, log, lives in zip(
            ("first", "second"), (self.first, self.second), live, strict=True
        ):
            state = log.state
            if state != "finished":
                stands = lives or log.over
                how = f"is {state}" if stands else f"was {state} when its engine was lost"
                yield f"the {which} run {how}: its measured points are compared"

    def notes(self, *, grids: bool) -> Iterator[str]:
        yield "the tracker's place in {W} is of its set-up and is not compared"
        for which, log in (("first", self.first), ("second", self.second)):
            if log.points and not log.temperatures_c():
                yield f"the {which} run's tracker had no weather station: the air is not compared"
        for one, other in differing(self.first.assets, self.second.assets):
            yield f"the {one.kind} differs: {one.text} in the first run, {other.text} in the second"
        seeds = (self.first.inputs.machine_seed, self.second.inputs.machine_seed)
        if None not in seeds and seeds[0] != seeds[1]:
            yield "the machines' seeds differ: these are two simulated cells, not one that drifted"
        measured = [bool(log.select("grid")) for log in (self.first, self.second)]
        if any(measured) and not all(measured):
            yield "only one of the runs measured the grid: it is not compared"
        elif not grids and all(measured):
            yield "the grids differ: their vertices are not compared"
        methods = [log.method for log in (self.first, self.second)]
        if all(methods) and methods[0] != methods[1]:
            yield f"'chosen' is {methods[0]} in the first run, {methods[1]} in the second"

    def settings(self) -> list[Setting]:
        """Return how the frozen inputs differ by key, without the simulation's addresses."""
        one, other = _inputs(self.first), _inputs(self.second)
        keys = [*one, *(key for key in other if key not in one)]
        pairs = ((key, one.get(key, ""), other.get(key, "")) for key in keys)
        return [Setting(*each) for each in pairs if each[1] != each[2]]


def _move(where: str, what: str, change_mm: float, count: int, u_mm: float | None) -> Change:
    limit_mm = None if u_mm is None else length_factor(count) * u_mm
    return Change("grid", where, what, "mm", None, None, change_mm, limit_mm)


def _vertex_variance_mm2(side: Side) -> float | None:
    """Return the measurement's and the robot's share, where places were visited again."""
    log = side.log
    visited_mm = visits_mm(log)
    if side.u_mm is None or not visited_mm:
        return None
    return side.u_mm**2 + pooled_std_mm(visited_mm) ** 2


def base_variance_mm2(log: Log) -> float | None:
    """Return the variance of one coordinate of the grid's centre, as {B} carries it."""
    frame = log.frames.get("base")
    if frame is None or not frame.covariance:
        return None
    base = RigidFit(log.matrix("base"), frame.C, np.empty((0, 3)), 0.0)
    centre_mm = log.cell.grid.centre.matrix()[:3, 3]
    return point_uncertainty(base, centre_mm) ** 2 / 3


def length_factor(count: int) -> float:
    """Return k so that with 95 % the largest of ``count`` 3D lengths is at most k u.

    u is the standard uncertainty of one coordinate, all coordinates normal and independent.
    """
    from scipy.special import chdtri

    return math.sqrt(float(chdtri(3, 1.0 - CONFIDENCE ** (1.0 / count))))


# -- two runs side by side ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting that differs: its path, and its value in both runs, empty where it is missing."""

    key: str
    first: str
    second: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """Changes between two runs. ``moved_mm`` is the change of the error at each vertex.

    ``unfinished``: a run had not measured all of its plan, so that more may come to light.
    """

    settings: list[Setting]
    changes: list[Change]
    moved_mm: dict[str, float]
    notes: list[str]
    unfinished: bool

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
            so_far = " so far" if self.unfinished else ""
            return (
                f"no drift{so_far}: all {len(judged)} judged changes are within their uncertainty"
            )
        return f"drift: {len(self.drifted)} of {len(judged)} judged changes are beyond it"


def compare_runs(
    first: Log, second: Log, *, live: tuple[bool, bool] = (False, False)
) -> Comparison:
    """Return the changes from the first run to the second; ``live``: whose engine is at work.

    Raises `HilcellError` for runs of different cells, for a simulated beside a real one, and for
    runs that have nothing in common.
    """
    one, other = first.cell, second.cell
    if (one.name, one.serial) != (other.name, other.serial):
        raise HilcellError(
            f"runs of different cells are not compared: the first is of {one.name} serial "
            f"{one.serial}, the second of {other.name} serial {other.serial}"
        )
    if first.inputs.simulated != second.inputs.simulated:
        which = "first" if first.inputs.simulated else "second"
        raise HilcellError(f"the {which} run was simulated, the other was not: nothing to compare")
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
    runs = _Runs(first, second)
    unfinished = list(runs.unfinished(live))
    return Comparison(
        runs.settings(),
        [*changes, *runs.air()],
        drift.moved_mm if drift is not None else {},
        [*unfinished, *runs.notes(grids=drift is not None)],
        bool(unfinished),
    )


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


# -- words ----------------------------------------------------------------------------------------


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


def _figure(name: str, change: Change) -> str | None:
    value: float | None = getattr(change, name)
    sign = "+" if name == "change" and change.first is not None else ""  # a length has none
    digits = {"mm": 4, "deg": 5}
    return None if value is None else f"{value:{sign}.{digits.get(change.unit, 2)}f}"


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
