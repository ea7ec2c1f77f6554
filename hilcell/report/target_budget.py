"""The uncertainty of corrected targets: bounds in use at each station, and what validation found.

Everything is computed from the journal, as the calibration file was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from operator import attrgetter

import numpy as np

from hilcell.calibration.bounds import (
    Coverage,
    coverages,
    cube_bounds,
    validated,
    validation_points,
)
from hilcell.calibration.errors import OTHERS, places
from hilcell.calibration.file import calibration_so_far
from hilcell.calibration.form import Calibration
from hilcell.calibration.in_use import calibration_in
from hilcell.calibration.influence import Bounds, NoBound
from hilcell.journal.log import Log
from hilcell.present.table import Column, Table

NO_FIT = "this run has fitted no correction"


@dataclass(frozen=True, eq=False)
class TargetBudget:
    """Bounds in use through the cube by station, coverage of the validation by place.

    ``missing`` says in words why there are none.
    """

    missing: str = ""
    in_use: dict[str, Bounds] = field(default_factory=dict)
    coverage: dict[str, Coverage] = field(default_factory=dict)
    points_mm: dict[str, float] = field(default_factory=dict)  # by the key of a validation point

    @property
    def worst(self) -> str:
        """Return the station with the largest mean bound."""
        return max(self.in_use, key=lambda name: float(self.in_use[name].radii_mm.mean()))


def target_budget(log: Log, run: str) -> TargetBudget:
    """Return the bounds that a run's journal allows."""
    calibration = calibration_so_far(log, run)
    if calibration is None:
        return TargetBudget(_why_none(log))
    names = [station.name for station in log.cell.station]
    try:
        return TargetBudget(
            "",
            {name: cube_bounds(calibration, name) for name in names},
            coverages(calibration, log, places(log.cell)),
            _points_mm(calibration, log, names),
        )
    except NoBound as reason:
        return TargetBudget(reason.reason)


def _why_none(log: Log) -> str:
    """Return why a run's journal makes no calibration."""
    used = calibration_in(log)
    if used is not None:
        return f"{NO_FIT}; the report of run {used.provenance.run} states those of its calibration"
    if "fit" not in log.verdicts:
        return NO_FIT
    stations = [each.name for each in log.cell.station if f"station.{each.name}" not in log.frames]
    return f"the run ended before it framed {' and '.join(stations)}"


def _points_mm(calibration: Calibration, log: Log, names: list[str]) -> dict[str, float]:
    found: dict[str, float] = {}
    for name in names:
        judged = validated(calibration, log, name)
        if judged is not None:
            keys = [point.key for point in validation_points(log, name)]
            found |= dict(zip(keys, judged.bounds_mm.tolist(), strict=True))
    return found


@dataclass(frozen=True, slots=True)
class Placed:
    """One place of the table of bounds."""

    name: str
    in_use: Bounds | None
    coverage: Coverage | None

    def use(self, of: Callable[[np.ndarray], float]) -> float | None:
        """Return a figure of the bounds in use."""
        return None if self.in_use is None else float(of(self.in_use.radii_mm))

    def validated(self, of: Callable[[Coverage], float]) -> float | None:
        """Return a figure of the validation."""
        return None if self.coverage is None else of(self.coverage)


PLACES: tuple[Column[Placed], ...] = (
    Column("station", attrgetter("name")),
    Column("bound in use, mean", lambda row: row.use(np.mean), "mm", ".3f"),
    Column("bound in use, max", lambda row: row.use(np.max), "mm", ".3f"),
    Column("targets", partial(Placed.validated, of=len), form=".0f"),
    Column("inside", partial(Placed.validated, of=attrgetter("inside")), form=".0f"),
    Column("share inside", lambda row: row.validated(lambda each: 100 * each.share), "%", ".1f"),
    Column("validation bound, mean", lambda row: row.validated(_mean_mm), "mm", ".3f"),
    Column("validation bound, max", lambda row: row.validated(_most_mm), "mm", ".3f"),
)


def _mean_mm(found: Coverage) -> float:
    return float(found.bounds_mm.mean())


def _most_mm(found: Coverage) -> float:
    return float(found.bounds_mm.max())


def placed(budget: TargetBudget) -> list[Placed]:
    """Return the bounds and what validation found of them, place by place."""
    names = [*budget.in_use, *(name for name in budget.coverage if name not in budget.in_use)]
    return [
        Placed(
            "others together" if name == OTHERS else name,
            budget.in_use.get(name),
            budget.coverage.get(name),
        )
        for name in names
    ]


def bounds_sheet(budget: TargetBudget) -> Table:
    """Return the bounds by place."""
    note = (
        "95 % of 3-D errors should be inside. In use: any target of the cube, at any temperature "
        "that the check of validity allows. In validation: without what stays the same from grid "
        "to validation, at the temperatures of the run, with the tracker's reading."
    )
    return Table(PLACES, placed(budget), "95 % bounds of corrected targets", note)
