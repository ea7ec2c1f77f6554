"""Uncertainty: bounds of corrected targets at each station, and the budget of one coordinate.

Everything is computed from the journal, as the calibration file was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np

from hilcell.calibration.budget import Coverage, ValidatedTargets, coverages, cube_bounds
from hilcell.calibration.from_run import calibration_so_far
from hilcell.calibration.influence import ASSUMED, MEASURED, Bounds, NoBound, Part
from hilcell.calibration.lookup import calibration_in
from hilcell.calibration.measurement_budget import NOISE, Budget, Contribution
from hilcell.calibration.position_errors import Errors, places
from hilcell.cell.uncertainty import COVERAGE_FACTOR
from hilcell.journal.log import Log
from hilcell.model.verdicts import OTHERS
from hilcell.ports import Array
from hilcell.present.table import Column, Table, listed


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
        return max(self.in_use, key=lambda name: float(self.in_use[name].radii_mm.mean()))

    def rows(self) -> Iterator[Bounded]:
        for name in dict.fromkeys([*self.in_use, *self.coverage]):
            used, kept = self.in_use.get(name), self.coverage.get(name)
            radii = [None, None] if used is None else [used.radii_mm.mean(), used.radii_mm.max()]
            figures = list[float]()
            if kept is not None:
                figures += [len(kept), kept.inside, 100 * kept.share]
                figures += [float(kept.bounds_mm.mean()), float(kept.bounds_mm.max())]
            yield Bounded(place_label(name), *radii, *figures)

    def table(self) -> Table:
        note = (
            "95 % of 3-D errors should be inside. In use: any target of the cube, at any "
            "temperature that the check of validity allows. In validation: without what stays the "
            "same from grid to validation, at the temperatures of the run, with the tracker's "
            "reading."
        )
        columns = listed(
            "station",
            ("bound in use, mean", "mm", ".3f"),
            ("bound in use, max", "mm", ".3f"),
            ("targets", "", ".0f"),
            ("inside", "", ".0f"),
            ("share inside", "%", ".1f"),
            ("validation bound, mean", "mm", ".3f"),
            ("validation bound, max", "mm", ".3f"),
        )
        return Table(columns, self.rows(), "95 % bounds of corrected targets", note)


def target_budget(log: Log, run: str) -> TargetBudget:
    calibration = calibration_so_far(log, run)
    if calibration is None:
        return TargetBudget(_why_none(log))
    names, points_mm = [station.name for station in log.cell.station], dict[str, float]()
    try:
        in_use = {name: cube_bounds(calibration, name) for name in names}
        coverage = coverages(calibration, log, places(log.cell))
        for name in names:
            validated = ValidatedTargets(calibration, log, name)
            if validated.points:
                keys = [point.key for point in validated.points]
                points_mm |= dict(zip(keys, validated.bounds.radii_mm.tolist(), strict=True))
    except NoBound as reason:
        return TargetBudget(reason.reason)
    return TargetBudget("", in_use, coverage, points_mm)


def _why_none(log: Log) -> str:
    used = calibration_in(log)
    no_fit = "this run has fitted no correction"
    if used is not None:
        return f"{no_fit}; the report of run {used.provenance.run} states those of its calibration"
    if "fit" not in log.verdicts:
        return no_fit
    stations = [each.name for each in log.cell.station if f"station.{each.name}" not in log.frames]
    return f"the run ended before it framed {' and '.join(stations)}"


class Bounded(NamedTuple):
    """Bounds in use at a place, and those of its validation with the targets that kept theirs."""

    name: str
    use_mean_mm: float | None
    use_max_mm: float | None
    targets: float | None = None
    inside: float | None = None
    inside_percent: float | None = None
    mean_mm: float | None = None
    max_mm: float | None = None


def place_label(place: str) -> str:
    """Return the name of a place in a table: a station, or those that are judged together."""
    return "others together" if place == OTHERS else place


# -- the uncertainty budget of one coordinate as one table: a measured error, a corrected target ---

# They are two measurands: each has its own lines and its own sum, and a share is one of its sum.

K_3D = 2.80  # times u of one coordinate: 95 % of three equal normal ones (chi^2, 3 degrees)
ERROR_SUM, TARGET_SUM = "A measured error", "A corrected target"


@dataclass(frozen=True, slots=True)
class Row:
    """A line: ``estimate`` in mm is a standard deviation (normal) or ± a half-width (rectangular).

    ``u_mm`` is of one coordinate: along one direction it is the estimate's u by √3.
    """

    source: str
    how: str
    kind: str
    u_mm: float
    percent: float = 100.0
    estimate: str = ""
    divisor: str = ""
    along: str = ""
    is_sum: bool = False


ROWS: tuple[Column[Row], ...] = (
    Column("source", attrgetter("source")),
    Column("how it is known", attrgetter("how")),
    Column("type, distribution", attrgetter("kind")),
    Column("estimate", attrgetter("estimate"), "mm", "s"),
    Column("divisor", attrgetter("divisor"), form="s"),
    Column("along", attrgetter("along"), form="s"),
    Column("u", attrgetter("u_mm"), "mm", ".4f"),
    Column("share of u²,", attrgetter("percent"), "%", ".1f"),
)


def budget_table(budget: Budget | None, targets: TargetBudget, hidden: Sequence[str] = ()) -> Table:
    """Return the table, nothing where the run allows neither budget; ``hidden`` are errors that no
    line has in it, in words.
    """
    rows = []
    if budget is not None:
        words = (
            f"U = {COVERAGE_FACTOR:.2f} u = {budget.U_mm:.3f} mm along the error; 3-D position: "
            f"{K_3D:.2f} u = {K_3D * budget.u_mm:.3f} mm (95 %)"
        )
        rows = [*error_rows(budget), Row(ERROR_SUM, words, "", budget.u_mm, is_sum=True)]
    note = (
        "Type A: from measured scatter, of this run unless the line says otherwise; B: from the "
        "certificate that is named, else an assumption that the cell file states. Sensitivity 1: "
        "every source is a length at the tool point. Sources are taken as independent."
    )
    notes = [note]
    if not targets.missing:
        bounds = targets.in_use[targets.worst]
        radii_mm = bounds.radii_mm
        words = f"3-D 95 % bound: mean {radii_mm.mean():.3f} mm, largest {radii_mm.max():.3f} mm"
        freedoms = (f"{p.name} {p.freedom:.0f}" for p in bounds.parts if p.freedom < math.inf)
        estimated = ", ".join(freedoms)  # what is not taken as known
        freedom = f"Degrees of freedom: {estimated}; others known." if estimated else ""
        rows += target_rows(bounds)
        rows.append(Row(TARGET_SUM, words, "", _whole_mm(bounds), is_sum=True))
        notes.append(
            f"Corrected target: at {targets.worst}, where bounds are largest; root mean square "
            "over the volume, at any temperature that “Valid for” allows; an estimate of several "
            f"limits is the half-width that gives the same u. {freedom}"
        )
    notes += [f"In no line, because no run shows it: {each}." for each in hidden]
    title = "Uncertainty budget for one coordinate (GUM, JCGM 100:2008)"
    return Table(ROWS, rows, title, " ".join(notes), lambda row: "sum" if row.is_sum else "")


def mean_table(budget: Budget | None, errors: Mapping[str, Errors]) -> Table:
    """Return how to make U of the mean smaller at the place where it is largest, nothing where none
    was measured. ``errors``: of the corrected targets, by place.
    """
    if budget is None or not errors:
        return Table((), ())
    means = {name: budget.of_mean(each.error_mm) for name, each in errors.items()}
    place = max(means, key=lambda name: means[name])
    error_mm, U_mm = errors[place].error_mm, means[place]
    count, tenfold = len(error_mm), np.tile(error_mm, (10, 1))
    stays_mm = budget.of_mean(tenfold)
    note = (
        f"U of the mean of {count} targets ({place_label(place)}) is {U_mm:.4f} mm (k = 2). Only "
        f"the readings' noise averages: {len(tenfold) - count} more targets would bring U to "
        f"{stays_mm:.4f} mm. Everything else moves all targets together, and their mean by the "
        "directions of their errors: one of parallel errors by all of it, one of errors in all "
        "directions by less. Each line: U where that source alone were half as large."
    )
    rows = [
        (each, U_mm - halved_mm, halved_mm)
        for each in budget.lines
        for halved_mm in [budget.with_half(each.name).of_mean(error_mm)]
        if each.u_mm
    ]
    rows.sort(key=itemgetter(1), reverse=True)
    return Table(MEAN, rows, "Uncertainty of the mean, and how to make it smaller", note)


MEAN: tuple[Column[tuple[Contribution, float, float]], ...] = (
    Column("source", lambda row: row[0].name),
    Column("averages", lambda row: "1/√n" if row[0].name == NOISE else "no"),
    Column("halved by", lambda row: row[0].halved_by),
    Column("U less by", lambda row: row[1], "mm", ".4f"),
    Column("U then", lambda row: row[2], "mm", ".4f"),
)


def error_rows(budget: Budget) -> list[Row]:
    return [
        _row(each, budget.u_mm, each.estimate_mm, each.distribution == "rectangular", "x, y, z")
        for each in budget.lines
    ]


def target_rows(bounds: Bounds) -> list[Row]:
    rows, whole_mm = [], _whole_mm(bounds)
    for each in bounds.parts:
        rectangular = each.clause == "4.3.7"  # of the GUM, that evaluates a half-width
        along = "one" if _one_direction(each.covariance_mm2) else "x, y, z"
        divisors = math.sqrt(3) if rectangular else 1.0, math.sqrt(3) if along == "one" else 1.0
        estimate_mm = each.u_mm * divisors[0] * divisors[1]
        rows.append(_row(each, whole_mm, estimate_mm, rectangular, along))
    return rows


def _row(
    each: Contribution | Part, whole_mm: float, estimate_mm: float, rectangular: bool, along: str
) -> Row:
    """Return a line; its type says whether it was measured or is stated.

    Clause 4.2 of the GUM is type A, 4.3 type B.
    """
    measured = MEASURED in each.source
    how = each.how if measured or each.source == ASSUMED else f"{each.how}; {each.source}"
    stated = each.source != MEASURED or each.clause.startswith("4.3")
    letters = [*("A" * (measured and not each.clause.startswith("4.3"))), *("B" * stated)]
    shape, sign, divisor = ("rectangular", "±", "√3") if rectangular else ("normal", "", "1")
    return Row(
        each.name,
        how,
        f"{', '.join(letters)}, {shape}",
        each.u_mm,
        100 * each.u_mm**2 / whole_mm**2,
        f"{sign}{estimate_mm:.4f}",
        divisor,
        along,
    )


def _whole_mm(bounds: Bounds) -> float:
    return math.sqrt(sum(part.u_mm**2 for part in bounds.parts))


def _one_direction(covariances_mm2: Array) -> bool:
    """Whether covariances (N, 3, 3) act along one direction at each target."""
    small, middle, large = np.linalg.eigvalsh(covariances_mm2).sum(axis=0)
    negligible = 1e-9  # share of the largest variance
    return bool(large > 0.0 and small + middle <= negligible * large)
