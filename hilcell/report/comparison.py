"""Two runs of one cell side by side: the drift between the calibrations.

A pure function of two logs. Figures of two runs always differ; only a change beyond its stated
uncertainty is drift, and figures that depend on the tracker's set-up are not compared at all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter, methodcaller
from typing import Literal

import msgspec
import numpy as np

from hilcell.calibration.frames import (
    floor_points,
    has_own_place,
    hold_covariance,
    slide_covariance,
    world_covariance,
)
from hilcell.calibration.grid import grid_errors_mm, grid_of, vertex_ids
from hilcell.calibration.measurement_budget import expanded_mm, measurement_budget
from hilcell.calibration.position_errors import Errors, places, validation, visits_mm
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.errors import HilcellError
from hilcell.geometry.frames import RigidFit, cross_matrix, point_uncertainty
from hilcell.geometry.statistics import (
    CONFIDENCE,
    Figures,
    lengths_mm,
    pooled_std_mm,
    variance_of_mean,
)
from hilcell.identity import different_assets
from hilcell.journal.log import Log
from hilcell.journal.previous_reference import FLOOR_NESTS
from hilcell.model.frame import TouchedBase
from hilcell.model.point import Sent
from hilcell.model.verdicts import OTHERS
from hilcell.ports import Array
from hilcell.present.table import Column

# -- changes between two runs of one cell, each figure with the uncertainty of its change ----------

# {W} is built from floor nests, so frames in {W} and errors in {B} can be compared between two
# set-ups of the tracker. The place of a frame depends on {W}'s own noise, which a lever of metres
# multiplies; without it every station seems to have turned.


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
    def verdict(self) -> Literal["within", "beyond", ""]:
        """Return whether the change keeps its limit; empty where it has none."""
        if self.limit is None:
            return ""
        return "within" if abs(self.change) <= self.limit else "beyond"

    @property
    def where(self) -> str:
        """Return what changed: *S300 targets*, *S300 frame*, *grid point 1-2-0*."""
        match self.group:
            case "validation":
                return "other stations" if self.place == OTHERS else f"{self.place} targets"
            case "frames":
                station = self.place.removeprefix("station ")
                return f"{station} frame" if station != self.place else f"robot {self.place}"
            case "grid":  # a vertex by its key, or all of them
                place = self.place.replace("vertices", "grid points")
                return place.replace("grid/", "grid point ")
        return "air at tracker"

    @property
    def figure(self) -> str:
        """Return the figure that changed: *corrected: mean*, which is of |e|."""
        if self.group != "validation":
            return self.what
        how, _, figure = self.what.partition(" ")
        return f"{Sent(how).short}: {'95 %' if figure == 'p95' else figure}"

    def shown(self, name: str) -> str | None:
        """Return one of the figures with its decimals; a change of what was known has a sign."""
        value: float | None = getattr(self, name)
        sign = "+" if name == "change" and self.first is not None else ""  # a length has none
        digits = {"mm": 4, "deg": 5}
        return None if value is None else f"{value:{sign}.{digits.get(self.unit, 2)}f}"


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
    runs = _Runs(first, second)
    moved_mm, vertices = runs.grid() if runs.same_grid() else ({}, [])
    changes = [*runs.validation(), *runs.frames(), *vertices]
    if not changes:
        has = [
            f"a {log.inputs.procedure} ({log.state}, {len(log.points)} points)"
            for log in (first, second)
        ]
        raise HilcellError(
            f"nothing to compare: {' and '.join(has)} have no frame, grid or validation in common; "
            "compare two calibrations"
        )
    unfinished = [*runs.unfinished(live)]
    notes = [*unfinished, *runs.notes(grids=bool(moved_mm))]
    return Comparison(
        runs.settings(), [*changes, *runs.air()], moved_mm, notes, unfinished=bool(unfinished)
    )


@dataclass(frozen=True, eq=False)
class _Side:
    """One run, and u of one coordinate of a position that it measured, where its budget knows."""

    log: Log

    @cached_property
    def u_mm(self) -> float | None:
        budget = measurement_budget(self.log)
        return None if budget is None else budget.u_mm

    def frame_covariance(self, key: str) -> Array | None:
        """Return that (6, 6) of a frame in {W}: its own, {W}'s, the budget's, the strip's."""
        log, u_mm = self.log, self.u_mm
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

    def vertex_variance_mm2(self) -> float | None:
        """Return the measurement's and the robot's share, where places were visited again."""
        visited_mm = visits_mm(self.log)
        if self.u_mm is None or not visited_mm:
            return None
        return self.u_mm**2 + pooled_std_mm(visited_mm) ** 2

    def base_variance_mm2(self) -> float | None:
        """Return the variance of one coordinate of the grid's centre, as {B} carries it."""
        frame = self.log.frames.get("base")
        if frame is None or not frame.covariance:
            return None
        base = RigidFit(self.log.matrix("base"), frame.C, np.empty((0, 3)), 0.0)
        return point_uncertainty(base, self.log.cell.grid.centre.matrix()[:3, 3]) ** 2 / 3


class _Runs:
    def __init__(self, first: Log, second: Log) -> None:
        self._logs = first, second
        self._sides = _Side(first), _Side(second)

    def validation(self) -> Iterator[Change]:
        """Yield the figures of |e| per place, before and after; the mean alone has a limit."""
        here, there = (places(log.cell) for log in self._logs)
        for place, stations in here.items():
            if there.get(place) != stations:
                continue
            one, other = (validation(log, stations) for log in self._logs)
            for how in (how for how in one if how in other):
                errors = one[how], other[how]
                figures = zip(Figures._fields, *(each.figures for each in errors), strict=True)
                for what, one_mm, two_mm in figures:
                    limit_mm = self._mean_limit_mm(how, errors) if what == "mean" else None
                    yield Change(
                        "validation", place, f"{how} {what}", "mm",
                        one_mm, two_mm, two_mm - one_mm, limit_mm,
                    )  # fmt: skip

    def _mean_limit_mm(self, how: Sent, both: tuple[Errors, Errors]) -> float | None:
        """Return U of a change of the mean: which targets were drawn, the measurement's u, {B}'s.

        {B} counts before only: a correction learnt in a run's {B} makes up for where that {B} is.
        """
        variance_mm2 = 0.0
        for side, errors in zip(self._sides, both, strict=True):
            base_mm2 = side.base_variance_mm2()
            if side.u_mm is None or base_mm2 is None or len(errors) < 2:
                return None
            variance_mm2 += variance_of_mean(errors.norms_mm)
            variance_mm2 += side.u_mm**2 + (base_mm2 if how == Sent.BEFORE else 0.0)
        return expanded_mm(math.sqrt(variance_mm2))

    def frames(self) -> Iterator[Change]:
        """Yield how far the base and the station frames, as both runs have them, moved in {W}."""
        first, second = self._logs
        for key, frame in first.frames.items():
            if isinstance(frame, TouchedBase):  # two stops are never the same
                continue
            if not all(has_own_place(log.cell, key) for log in self._logs):
                continue
            other = second.frames.get(key)
            if frame.covariance and other is not None and other.covariance:
                place, (limit_mm, limit_deg) = key.replace(".", " "), self._frame_limits(key)
                T_1, T_2 = first.matrix(key), second.matrix(key)
                R = T_1[:3, :3].T @ T_2[:3, :3]
                turn = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
                sine = float(np.linalg.norm(turn) / 2)
                deg = math.degrees(math.atan2(sine, (float(np.trace(R)) - 1) / 2))
                mm = float(np.linalg.norm(T_2[:3, 3] - T_1[:3, 3]))
                yield Change("frames", place, "moved", "mm", None, None, mm, limit_mm)
                yield Change("frames", place, "turned", "deg", None, None, deg, limit_deg)

    def _frame_limits(self, key: str) -> tuple[float | None, float | None]:
        first, second = (side.frame_covariance(key) for side in self._sides)
        if first is None or second is None:
            return None, None
        covariance, factor = first + second, length_factor(1)
        moved_mm, turned_rad = (
            factor * math.sqrt(float(np.trace(part)) / 3)
            for part in (covariance[:3, :3], covariance[3:, 3:])
        )
        return moved_mm, math.degrees(turned_rad)

    def same_grid(self) -> bool:
        first, second = self._logs
        one, other = grid_of(first.cell), grid_of(second.cell)
        alike = one.shape == other.shape and one.pitch_mm == other.pitch_mm
        known = {"world", "base"} <= first.frames.keys() & second.frames.keys()
        measured = all(log.select("grid") for log in self._logs)  # a re-calibration predicts it
        return alike and known and measured and bool(np.array_equal(one.origin_mm, other.origin_mm))

    def grid(self) -> tuple[dict[str, float], list[Change]]:
        """Return how far the error at each vertex moved (mm, in {B}), by its key, and in figures.

        An error of {B} moves all vertices together; the rest, which no small rigid motion
        explains, is the arm's.
        """
        grid = grid_of(self._logs[0].cell)
        order = tuple(grid.serpentine().T)
        before_mm, after_mm = (grid_errors_mm(log)[order] for log in self._logs)
        both = np.isfinite(before_mm + after_mm).all(axis=1)
        if not both.any():
            return {}, []
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
        worst, where = int(np.argmax(moved_mm)), f"{len(keys)} vertices"
        moves = (
            (where, "mean move", float(moved_mm.mean()), 1, True),
            (keys[worst], "largest move", float(moved_mm[worst]), len(keys), True),
            (where, "mean move, rigid part removed", float(own_mm.mean()), 1, False),
        )
        return dict(zip(keys, moved_mm.tolist(), strict=True)), [
            Change("grid", where, "mean error", "mm", one_mm, other_mm, other_mm - one_mm),
            *(
                Change("grid", at, what, "mm", None, None, mm, self._move_limit_mm(count, based))
                for at, what, mm, count, based in moves
            ),
        ]

    def _move_limit_mm(self, count: int, based: bool) -> float | None:
        """Return what the largest of ``count`` differences of two errors keeps, in {B}.

        {W} cancels: base and vertices were measured in the same set-up. ``based`` adds {B}'s own.
        """
        variances_mm2 = [side.vertex_variance_mm2() for side in self._sides]
        if based:
            variances_mm2 += [side.base_variance_mm2() for side in self._sides]
        known = [each for each in variances_mm2 if each is not None]
        if len(known) < len(variances_mm2):
            return None
        return length_factor(count) * math.sqrt(sum(known))

    def air(self) -> Iterator[Change]:
        """Yield the mean temperature of both runs; the limit is that of a calibration's use."""
        celsius = [log.temperatures_c() for log in self._logs]
        if all(celsius):
            one, other = (float(np.mean(each)) for each in celsius)
            yield Change(
                "air", "at the tracker", "mean temperature", "°C", one, other, other - one,
                TEMPERATURE_MARGIN_K,
            )  # fmt: skip

    def unfinished(self, live: tuple[bool, bool]) -> Iterator[str]:
        for which, log, lives in zip(("first", "second"), self._logs, live, strict=True):
            if (state := log.state) != "finished":
                has_engine = lives or log.over
                how = f"is {state}" if has_engine else f"was {state} when its engine was lost"
                yield f"the {which} run {how}: its measured points are compared"

    def notes(self, *, grids: bool) -> Iterator[str]:
        yield "the tracker's place in {W} is of its set-up and is not compared"
        for which, log in zip(("first", "second"), self._logs, strict=True):
            if log.points and not log.temperatures_c():
                yield f"the {which} run's tracker had no weather station: the air is not compared"
        for one, other in different_assets(*(log.assets for log in self._logs)):
            yield f"the {one.kind} differs: {one.text} in the first run, {other.text} in the second"
        seeds = [log.inputs.machine_seed for log in self._logs]
        if None not in seeds and seeds[0] != seeds[1]:
            yield "the machines' seeds differ: these are two simulated cells, not one that drifted"
        measured = [bool(log.select("grid")) for log in self._logs]
        if any(measured) and not all(measured):
            yield "only one of the runs measured the grid: it is not compared"
        elif not grids and all(measured):
            yield "the grids differ: their vertices are not compared"
        methods = [log.method for log in self._logs]
        if all(methods) and methods[0] != methods[1]:
            yield f"'chosen' is {methods[0]} in the first run, {methods[1]} in the second"

    def settings(self) -> list[Setting]:
        """Return how the frozen inputs differ by key, without the simulation's addresses."""
        one, other = map(self._inputs, self._logs)
        keys = [*one, *(key for key in other if key not in one)]
        pairs = ((key, one.get(key, ""), other.get(key, "")) for key in keys)
        return [Setting(*each) for each in pairs if each[1] != each[2]]

    @staticmethod
    def _inputs(log: Log) -> dict[str, str]:
        inputs = log.inputs
        cell = {key: value for key, value in inputs.cell.items() if key != "simulation"}
        run = {"procedure": inputs.procedure, "seed": inputs.seed, "unattended": inputs.unattended}
        machine = {} if inputs.machine_seed is None else {"machine_seed": inputs.machine_seed}
        versions = {"versions": {"hilcell": inputs.versions.get("hilcell", "")}}
        return dict(_leaves(run | machine | versions | cell, ""))


def length_factor(count: int) -> float:
    """Return k so that with 95 % the largest of ``count`` 3D lengths is at most k u.

    u is the standard uncertainty of one coordinate, all coordinates normal and independent.
    """
    from scipy.special import chdtri

    return math.sqrt(float(chdtri(3, 1.0 - CONFIDENCE ** (1.0 / count))))


# -- words ----------------------------------------------------------------------------------------


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


# The place comes first: rows differ even where a column is narrow.

CHANGES: tuple[Column[Change], ...] = (
    Column("where", attrgetter("where")),
    Column("what", attrgetter("figure")),
    *(
        Column[Change](name, methodcaller("shown", name), form="s")
        for name in ("first", "second", "change", "limit")
    ),
    Column("unit", attrgetter("unit")),
    Column("verdict", attrgetter("verdict")),
)
