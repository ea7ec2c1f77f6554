"""Points measured more than once: both values, why, and what would be without the later ones.

The later value counts, in the correction and in the verdict. To re-measure only large errors
makes the figures smaller than the robot is, so the report states them with the larger values too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from hilcell.calibration.decision import guard_of, judged, limits_of
from hilcell.calibration.errors import errors_of
from hilcell.geometry.statistics import figures_of
from hilcell.journal.log import Log, Point
from hilcell.ports import Array
from hilcell.report.columns import Column, Sheet, sheet
from hilcell.report.facts import Facts

REASONS = {
    "retake asked": "the operator asked for it",
    "outlier measured again": "its error stood out from the others",
    "visited once more": "visited once more",
}
INVALIDATED = "measured before the tracker was found moved"


@dataclass(frozen=True, eq=False)
class Repeat:
    """Two measurements of one point, one after the other, and why there are two.

    Errors |e| in mm are None where the point has no nominal place.
    """

    first: Point
    again: Point
    why: str
    first_mm: float | None
    again_mm: float | None
    counts: str

    @property
    def apart_mm(self) -> float:
        """Return how far the two were from each other."""
        return float(np.linalg.norm(np.subtract(self.again.xyz_mm, self.first.xyz_mm)))


REPEATS: tuple[Column[Repeat], ...] = (
    Column("point", attrgetter("again.key")),
    Column("at", attrgetter("again.station")),
    Column("why", attrgetter("why")),
    Column("counts", attrgetter("counts")),
    Column("error first", attrgetter("first_mm"), "mm", ".4f"),
    Column("error again", attrgetter("again_mm"), "mm", ".4f"),
    Column("apart", attrgetter("apart_mm"), "mm", ".4f"),
)


def remeasured(facts: Facts) -> Sheet | None:
    """Return the points that were measured more than once, with both values."""
    found = repeats(facts)
    note = "Every value stays in the journal. " + " ".join(_without_choice(facts.log, found))
    return sheet("Points measured more than once", REPEATS, found, note.strip())


def repeats(facts: Facts) -> list[Repeat]:
    """Return each pair of successive measurements of one point, in the order of the later ones."""
    pairs = list(_pairs(facts))
    last = {again.key: number for number, (_, again, _) in enumerate(pairs)}
    return [
        Repeat(
            first,
            again,
            why,
            _error_mm(facts.log, first),
            _error_mm(facts.log, again),
            "the later" if last[again.key] == number else "neither",
        )
        for number, (first, again, why) in enumerate(pairs)
    ]


def _pairs(facts: Facts) -> Iterator[tuple[Point, Point, str]]:
    before: dict[str, Point] = {}
    reasons: dict[str, str] = {}
    for record in facts.records:
        if record.kind == "event":
            if record.body["what"] in REASONS and "key" in record.body:
                reasons[record.body["key"]] = REASONS[record.body["what"]]
            for key in record.body.get("invalid", ()):
                reasons[key] = INVALIDATED
        elif record.kind == "point":
            point = facts.log.read(record)
            if point.key in before:
                why = reasons.pop(point.key, "the run was resumed")
                yield before[point.key], point, why
            before[point.key] = point


def _error_mm(log: Log, point: Point) -> float | None:
    if point.nominal_mm is None or "world" not in log.frames:
        return None
    return float(errors_of(log, [point]).norms_mm[0])


def _without_choice(log: Log, found: list[Repeat]) -> Iterator[str]:
    """Yield for each station what its figures are with the larger value of each target."""
    chosen = [
        each
        for each in found
        if each.again.id.kind == "validate" and each.again.id.how == "chosen"
        and each.first_mm is not None
    ]  # fmt: skip
    for station in dict.fromkeys(each.again.station for each in chosen):
        points = log.select("validate", station, how="chosen")
        norms_mm = errors_of(log, points).norms_mm
        number = {point.key: n for n, point in enumerate(points)}
        larger_mm = norms_mm.copy()
        for each in chosen:
            n = number.get(each.again.key)
            if n is not None and each.first_mm is not None:
                larger_mm[n] = max(larger_mm[n], each.first_mm)
        yield _words(log, station, norms_mm, larger_mm)


def _words(log: Log, station: str, norms_mm: Array, larger_mm: Array) -> str:
    counted, larger = figures_of(norms_mm), figures_of(larger_mm)
    guard = guard_of(log, len(norms_mm))
    holds = judged(larger.mean, larger.max, limits_of(log.cell), guard).holds
    return (
        f"{station}, after: mean {counted.mean:.4f} and largest {counted.max:.4f} mm count the "
        f"later values; with the larger of each target {larger.mean:.4f} and {larger.max:.4f} mm, "
        f"which {'keeps' if holds else 'would NOT keep'} the limits."
    )
