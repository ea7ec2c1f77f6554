"""Runs of the paper with a mistake in them: one right run's log, changed; and its rows."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec
import numpy as np

from hilcell.calibration.grid import measured_grid
from hilcell.calibration.position_errors import position_errors
from hilcell.compensation.interpolation import Idw
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log
from hilcell.model.point import Point
from hilcell.model.results import PaperRow
from hilcell.ports import Array
from procedures.paper import ROWS, Experiments, Row, experiments
from procedures.plan import poses_at
from tests.whole.conftest import PaperRun

BY_NAME: Mapping[str, Row] = {row.name: row for row in ROWS}
REFERENCE, OTHERS = "S1100", ("S300", "S1900")


def rows_of(log: Log) -> dict[str, PaperRow]:
    """Return all rows, judged on this log alone."""
    found = experiments(log)
    return {row.name: row.judged(log, found) for row in ROWS}


def failing(log: Log) -> set[str]:
    return {name for name, row in rows_of(log).items() if not row.holds}


def fails(name: str, log: Log) -> bool:
    """Whether one row fails, judged on this log alone."""
    return not BY_NAME[name].judged(log, experiments(log)).holds


def changed(log: Log, points: Iterable[Point]) -> Log:
    """Return the log with these points in the places of those with their keys."""
    other = copy.copy(log)
    new = {point.key: point for point in points}
    other.points = {**log.points} | new
    air = {key: each.temperature_c for key, each in new.items() if each.temperature_c is not None}
    other.celsius = {**log.celsius} | air
    return other


def framed(log: Log, frames: Mapping[str, dict[str, Any]]) -> Log:
    """Return the log with these facts of frames changed."""
    other = copy.copy(log)
    other.frames = log.frames | {
        name: msgspec.structs.replace(log.frames[name], **new) for name, new in frames.items()
    }
    return other


def placed(point: Point, xyz_mm: Array, **others: Any) -> Point:
    return msgspec.structs.replace(point, xyz_mm=tuple(xyz_mm.tolist()), **others)


def as_if_sent(log: Log, correct: Callable[[Array], Array], stations: Iterable[str]) -> Log:
    """Return the log as if P - correct(P) had been sent in the place of the paper's method.

    ``correct`` maps targets (N, 3) to what is taken off, (N, 3), both in {B} of the grid's station.
    """
    points = []
    T_L_W, T_B_W = inverse(log.matrix("world")), inverse(log.matrix("base"))
    for station in stations:
        targets = log.select("validate", station, how="idw")
        nominal_mm = np.array([point.nominal_mm for point in targets])
        in_base_mm = apply(T_B_W @ moved_to_reference(log, station), nominal_mm)
        off_mm = correct(in_base_mm) @ inverse(T_B_W)[:3, :3].T
        before_mm = position_errors(log, log.select("validate", station, how="before")).error_mm
        reached_mm = apply(T_L_W, nominal_mm + before_mm - off_mm)
        points += [placed(point, at_mm) for point, at_mm in zip(targets, reached_mm, strict=True)]
    return changed(log, points)


def moved_to_reference(log: Log, station: str) -> Array:
    """Return the motion (4, 4) in {W} that takes the slide back to the grid's station."""
    T_W_Si = log.matrix(f"station.{station}")
    back: Array = log.matrix(f"station.{REFERENCE}") @ inverse(T_W_Si)
    return back


def by_idw(log: Log) -> Callable[[Array], Array]:
    model = Idw.of_grid(measured_grid(log))
    return lambda at_mm: model.predict(poses_at(log.cell, at_mm)).error_mm


def judged(name: str, paper: PaperRun) -> PaperRow:
    """Return one row, judged as if the run's result were unchanged."""
    return BY_NAME[name].judged(paper.log, typed(paper.result, Experiments))
