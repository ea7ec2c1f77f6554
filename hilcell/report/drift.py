"""Changes between two runs of one cell, each figure with the uncertainty of its change.

{W} is built from floor nests, so frames in {W} and errors in {B} can be compared between two
set-ups of the tracker. The place of a frame depends on {W}'s own noise, which a lever of metres
multiplies; without it every station seems to have turned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hilcell.calibration.errors import visits_mm
from hilcell.calibration.frame_covariance import (
    FLOOR_NESTS,
    floor_points,
    has_own_place,
    hold_covariance,
    slide_covariance,
    world_covariance,
)
from hilcell.calibration.frames import grid_errors_mm, grid_of, vertex_ids
from hilcell.calibration.measurement_budget import budget_of
from hilcell.geometry.frames import (
    RigidFit,
    cross_matrix,
    point_uncertainty,
)
from hilcell.geometry.statistics import CONFIDENCE, lengths_mm, pooled_std_mm
from hilcell.journal.log import Log
from hilcell.ports import Array

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
        if "visit" in frame:  # two stops are never the same
            continue
        if not all(has_own_place(side.log.cell, key) for side in (first, second)):
            continue
        if "covariance" in frame and "covariance" in second.log.frames.get(key, {}):
            place = key.replace(".", " ")
            limits = _frame_limits(first, second, key)
            T_1, T_2 = first.log.matrix(key), second.log.matrix(key)
            moved = (float(np.linalg.norm(T_2[:3, 3] - T_1[:3, 3])), _angle_deg(T_1, T_2))
            for what, unit, change, limit in zip(
                ("moved", "turned"), ("mm", "deg"), moved, limits, strict=True
            ):
                found.append(Change("frames", place, what, unit, None, None, change, limit))
    return found


def _angle_deg(T_1: Array, T_2: Array) -> float:
    """Return the angle between two frames; from the sine, which small angles keep exactly."""
    R = T_1[:3, :3].T @ T_2[:3, :3]
    sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return math.degrees(math.atan2(float(sine), (float(np.trace(R)) - 1) / 2))


def _frame_limits(first: Side, second: Side, key: str) -> tuple[float | None, float | None]:
    """Return the limits of a frame's move in mm and of its turn in deg."""
    both = [_frame_covariance(side, key) for side in (first, second)]
    covariance = sum((each for each in both if each is not None), np.zeros((6, 6)))
    if any(each is None for each in both):
        return None, None
    factor = length_factor(1)
    moved_mm, turned_rad = (
        factor * math.sqrt(float(np.trace(part)) / 3)
        for part in (covariance[:3, :3], covariance[3:, 3:])
    )
    return moved_mm, math.degrees(turned_rad)


def _frame_covariance(side: Side, key: str) -> Array | None:
    """Return the covariance (6, 6) of a frame in {W}: its own, {W}'s, the budget's, the strip's."""
    log, u_mm = side.log, side.u_mm
    if u_mm is None or len(floor_points(log)) < FLOOR_NESTS:
        return None
    covariance: Array = np.array(log.frames[key]["covariance"], dtype=float)
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
    if not _same_grid(first.log, second.log):
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
    own_mm = lengths_mm(_less_rigid(places_mm, after_mm - before_mm))
    one_mm, other_mm = (float(lengths_mm(each).mean()) for each in (before_mm, after_mm))
    keys = [id.key for id, known in zip(vertex_ids(grid), both, strict=True) if known]
    worst = int(np.argmax(moved_mm))
    whole, own = _vertex_u_mm(first, second, based=True), _vertex_u_mm(first, second, based=False)
    where = f"{len(keys)} vertices"
    changes = [
        Change("grid", where, "mean error", "mm", one_mm, other_mm, other_mm - one_mm),
        _move(where, "mean move", float(moved_mm.mean()), 1, whole),
        _move(keys[worst], "largest move", float(moved_mm[worst]), len(keys), whole),
        _move(where, "mean move, rigid part removed", float(own_mm.mean()), 1, own),
    ]
    return GridDrift(dict(zip(keys, moved_mm.tolist(), strict=True)), changes)


def _same_grid(first: Log, second: Log) -> bool:
    """Whether both have measured errors on the same lattice."""
    one, other = grid_of(first.cell), grid_of(second.cell)
    alike = one.shape == other.shape and one.pitch_mm == other.pitch_mm
    known = {"world", "base"} <= first.frames.keys() & second.frames.keys()
    return alike and known and bool(np.array_equal(one.origin_mm, other.origin_mm))


def _move(where: str, what: str, change_mm: float, count: int, u_mm: float | None) -> Change:
    limit_mm = None if u_mm is None else length_factor(count) * u_mm
    return Change("grid", where, what, "mm", None, None, change_mm, limit_mm)


def _less_rigid(places_mm: Array, moved_mm: Array) -> Array:
    """Return moves (N, 3) at places (N, 3) less the small rigid motion that explains most."""
    levers = cross_matrix(places_mm - places_mm.mean(axis=0))
    shifts = np.broadcast_to(np.eye(3), levers.shape)
    A = np.concatenate([shifts, -levers], axis=2).reshape(-1, 6)
    values = moved_mm.reshape(-1)
    rest: Array = values - A @ np.linalg.lstsq(A, values, rcond=None)[0]
    return rest.reshape(-1, 3)


def _vertex_u_mm(first: Side, second: Side, *, based: bool) -> float | None:
    """Return u of one coordinate of the difference of two errors at a vertex, in {B}.

    {W} cancels: base and vertices were measured in the same set-up. ``based`` adds {B}'s own.
    """
    variances_mm2 = [_vertex_variance_mm2(side) for side in (first, second)]
    if based:
        variances_mm2 += [base_variance_mm2(side.log) for side in (first, second)]
    known = [each for each in variances_mm2 if each is not None]
    return math.sqrt(sum(known)) if len(known) == len(variances_mm2) else None


def _vertex_variance_mm2(side: Side) -> float | None:
    """Return the measurement's and the robot's share, where places were visited again."""
    log = side.log
    visited_mm = visits_mm(log)
    if side.u_mm is None or not visited_mm:
        return None
    return side.u_mm**2 + pooled_std_mm(visited_mm) ** 2


def base_variance_mm2(log: Log) -> float | None:
    """Return the variance of one coordinate of the grid's centre, as {B} carries it."""
    frame = log.frames.get("base", {})
    if "covariance" not in frame:
        return None
    base = RigidFit(log.matrix("base"), np.array(frame["covariance"]), np.empty((0, 3)), 0.0)
    centre_mm = log.cell.grid.centre.matrix()[:3, 3]
    return point_uncertainty(base, centre_mm) ** 2 / 3


def length_factor(count: int) -> float:
    """Return k so that with 95 % the largest of ``count`` 3D lengths is at most k u.

    u is the standard uncertainty of one coordinate, all coordinates normal and independent.
    """
    from scipy.special import chdtri

    return math.sqrt(float(chdtri(3, 1.0 - CONFIDENCE ** (1.0 / count))))
