"""Points measured more than once: both values, why, and which counts.

Of a target the larger error counts, of position (`hilcell.calibration.errors.counting`) and of
orientation (`hilcell.calibration.orientation.largest_turned`) alike: to re-measure only large
errors would make the figures smaller than the robot is. Of every other point the later does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from hilcell.calibration.errors import counting, errors_of
from hilcell.calibration.orientation import seats_of, turned_each_time
from hilcell.journal.log import Log, Point
from hilcell.journal.point_words import point_words
from hilcell.ports import Array
from hilcell.present.table import Column, Table
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

    Errors |e| in mm are None where the point has no nominal place, the tool's turns in deg where
    its orientation was not measured.
    """

    first: Point
    again: Point
    why: str
    first_mm: float | None
    again_mm: float | None
    counts: str
    first_deg: float | None = None
    again_deg: float | None = None

    @property
    def apart_mm(self) -> float:
        """Return how far the two were from each other."""
        return float(np.linalg.norm(np.subtract(self.again.xyz_mm, self.first.xyz_mm)))


REPEATS: tuple[Column[Repeat], ...] = (
    Column("point", lambda row: point_words(row.again.id, row.again.station)),
    Column("why", attrgetter("why")),
    Column("counts", attrgetter("counts")),
    Column("error first", attrgetter("first_mm"), "mm", ".4f"),
    Column("error again", attrgetter("again_mm"), "mm", ".4f"),
    Column("apart", attrgetter("apart_mm"), "mm", ".4f"),
)
TURNS: tuple[Column[Repeat], ...] = (
    Column("turned first", attrgetter("first_deg"), "°", ".4f"),
    Column("turned again", attrgetter("again_deg"), "°", ".4f"),
)
KEYS = Column[Repeat]("key", attrgetter("again.key"), small=True)


def remeasured(facts: Facts) -> Table:
    """Return the points that were measured more than once, with both values."""
    found = repeats(facts)
    turned = any(each.again_deg is not None for each in found)
    what = "error of position and that of orientation count" if turned else "error counts"
    note = f"Every value stays in the journal. Of a target the larger {what}, whatever the reason; "
    note += "of other points the later value."
    note += " Once more: hilcell resume RUN --retake KEY; hilcell export RUN --csv lists every key."
    columns = (*REPEATS, *TURNS, KEYS) if turned else (*REPEATS, KEYS)
    return Table(columns, found, "Points measured more than once", note)


def repeats(facts: Facts) -> list[Repeat]:
    """Return each pair of successive measurements of one point, in the order of the later ones."""
    pairs = list(_pairs(facts))
    counted = {key: _counted(facts.log, key) for key in {again.key for _, again, _ in pairs}}
    seats, times = seats_of(facts.log), Counter[str]()
    found = []
    for first, again, why in pairs:
        turns = _turns_deg(facts.log, again.key, seats)[times[again.key] :][:2]
        times[again.key] += 1
        found.append(
            Repeat(
                first,
                again,
                why,
                _error_mm(facts.log, first),
                _error_mm(facts.log, again),
                _which(counted[again.key], first, again),
                *(turns if len(turns) == 2 else ()),
            )
        )
    return found


def _turns_deg(log: Log, key: str, seats: Array | None) -> list[float]:
    """Return by how much a target's tool was turned, each time that it was measured."""
    point = log.points.get(key)
    if seats is None or point is None or point.id.kind != "validate":
        return []
    tool = log.find(point.id.at_seat(1))
    return turned_each_time(log, tool, seats).angles_deg.tolist() if tool else []


def _counted(log: Log, key: str) -> Point | None:
    """Return the measurement of a point that counts, nothing where none does any more."""
    point = log.points.get(key)
    target = point is not None and point.id.kind == "validate" and point.nominal_mm is not None
    return counting(log, point) if point is not None and target and "world" in log.frames else point


def _which(counted: Point | None, first: Point, again: Point) -> str:
    places_mm = {"again": again.xyz_mm, "first": first.xyz_mm}
    found = (name for name, at_mm in places_mm.items() if counted and at_mm == counted.xyz_mm)
    return next(found, "neither")


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
