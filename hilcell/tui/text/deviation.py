"""Deviations of points from their nominal targets, e = actual - nominal in {W}, mm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from hilcell.calibration.errors import counting, errors_of
from hilcell.calibration.measurement_budget import budget_of
from hilcell.geometry.statistics import rms
from hilcell.journal.log import Log
from hilcell.model.outcome import Outcome, outcome_of
from hilcell.model.point import Point, Sent
from hilcell.ports import Array, HilcellError

BAD_STATES = ("out", "undecided", "noisy")
STATES: dict[Outcome, str] = {Outcome.REJECTED: "out", Outcome.UNDECIDED: "undecided"}


@dataclass(frozen=True, slots=True)
class Deviation:
    """One point's deviation; ``limit_mm`` is None where no tolerance applies.

    ``U_mm`` is the expanded uncertainty of |e|.
    """

    key: str
    error_mm: tuple[float, float, float]
    actual_mm: tuple[float, float, float]
    limit_mm: float | None
    U_mm: float = 0.0

    @property
    def norm_mm(self) -> float:
        """Return |e|, the 3D error of eq 18."""
        return math.hypot(*self.error_mm)

    @property
    def outcome(self) -> Outcome:
        """Return the decision on |e|, by the rule that judges all results."""
        if self.limit_mm is None:
            return Outcome.ACCEPTED
        return outcome_of(self.norm_mm, self.limit_mm, self.U_mm)


def expanded_of(log: Log) -> float:
    """Return U (mm) of a single error; NaN, which accepts nothing, where it cannot be stated."""
    with suppress(HilcellError):
        budget = budget_of(log)
        return math.nan if budget is None else budget.U_mm
    return math.nan


def is_judged(point: Point) -> bool:
    """Whether the error of a point is judged: of a target sent with the chosen correction."""
    return point.id.kind == "validate" and point.id.how == Sent.CHOSEN


def deviation_of(log: Log, point: Point) -> Deviation | None:
    """Return a point's deviation, as `deviations_of`, with U as the log has it now."""
    U_mm = expanded_of(log) if is_judged(point) else 0.0
    return deviations_of(log, [point], U_mm)[0]


def deviations_of(log: Log, points: Sequence[Point], U_mm: float) -> list[Deviation | None]:
    """Return the deviation of each point, None without a nominal target or where {W} is not known.

    Of a target that was measured more than once, the measurement that counts: the larger error.
    ``U_mm`` is that of a single error.
    """
    found: list[Deviation | None] = [None] * len(points)
    known = [n for n, point in enumerate(points) if point.nominal_mm is not None]
    if not known or "world" not in log.frames:
        return found
    errors = errors_of(log, [counting(log, points[n]) for n in known])
    actual_mm = errors.nominal_mm + errors.error_mm
    limit_mm = log.cell.validation.max_tolerance_mm
    for n, error, actual in zip(known, errors.error_mm, actual_mm, strict=True):
        judged = (limit_mm, U_mm) if is_judged(points[n]) else (None, 0.0)
        found[n] = Deviation(points[n].key, _xyz(error), _xyz(actual), *judged)
    return found


def _xyz(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def state_of(log: Log, point: Point, deviation: Deviation | None) -> str:
    """Return a point's state in one word: ok, out, undecided, noisy, again (re-measured)."""
    if not rms(point.std_mm) <= log.cell.tracker.max_std_mm:
        return "noisy"
    if deviation is not None and deviation.outcome in STATES:
        return STATES[deviation.outcome]
    return "again" if point.retaken else "ok"


@dataclass(frozen=True, slots=True)
class PointRow:
    """One row of the points table."""

    point: Point
    deviation: Deviation | None
    state: str

    @property
    def norm_mm(self) -> float:
        """Return |e|, or -1 where there is none, so that it sorts last."""
        return -1.0 if self.deviation is None else self.deviation.norm_mm


def row_of(log: Log, point: Point) -> PointRow:
    """Return one point's row."""
    deviation = deviation_of(log, point)
    return PointRow(point, deviation, state_of(log, point, deviation))


def rows_of(log: Log, points: Sequence[Point], U_mm: float) -> list[PointRow]:
    """Return the rows of points; ``U_mm`` as in `deviations_of`."""
    found = zip(points, deviations_of(log, points, U_mm), strict=True)
    return [PointRow(point, each, state_of(log, point, each)) for point, each in found]


def judged_by(log: Log, row: PointRow, U_mm: float) -> PointRow:
    """Return a row whose error is judged with another U, mm."""
    known = row.deviation
    if known is None or known.limit_mm is None or known.U_mm == U_mm:
        return row
    deviation = replace(known, U_mm=U_mm)
    return PointRow(row.point, deviation, state_of(log, row.point, deviation))
