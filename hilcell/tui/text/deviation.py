"""Deviations of points from their nominal targets, e = actual - nominal in {W}, mm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hilcell.journal.log import Log, Point

JUDGED = "validate_chosen"  # the paper's method is measured beside it, to be compared
BAD_STATES = ("out", "noisy")


@dataclass(frozen=True, slots=True)
class Deviation:
    """One point's deviation; ``limit_mm`` is None where no tolerance stands for it."""

    key: str
    error_mm: tuple[float, float, float]
    actual_mm: tuple[float, float, float]
    limit_mm: float | None

    @property
    def norm_mm(self) -> float:
        """Return |e|, the 3D error of eq 18."""
        return math.hypot(*self.error_mm)

    @property
    def within(self) -> bool:
        """Whether |e| keeps its limit; NaN does not."""
        return self.limit_mm is None or self.norm_mm <= self.limit_mm


def deviation_of(log: Log, point: Point) -> Deviation | None:
    """Return a point's deviation, or None where it has no nominal target or {W} is not known."""
    if point.nominal_mm is None or "world" not in log.frames:
        return None
    rows = log.frames["world"]["matrix"]
    x, y, z = point.xyz_mm
    actual = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows[:3]]
    error = [a - n for a, n in zip(actual, point.nominal_mm, strict=True)]
    limit = log.cell.validation.max_tolerance_mm if point.group == JUDGED else None
    return Deviation(
        point.key, (error[0], error[1], error[2]), (actual[0], actual[1], actual[2]), limit
    )


def rms_mm(point: Point) -> float:
    """Return the root of the mean square of a point's standard deviations."""
    return math.sqrt(sum(each * each for each in point.std_mm) / 3)


def state_of(log: Log, point: Point, deviation: Deviation | None) -> str:
    """Return a point's state in one word: ok, out, noisy, again (re-measured)."""
    if not rms_mm(point) <= log.cell.tracker.max_std_mm:
        return "noisy"
    if deviation is not None and not deviation.within:
        return "out"
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
