"""Which points may be re-measured, and which wait for it.

A point may be retaken as long as nothing was built on it that a retake would not rebuild. What
waits stands in the journal: asked for by an event, done by the point's next record.
"""

from __future__ import annotations

from hilcell.journal.log import Log
from hilcell.model.point import Point
from hilcell.run.states import CALIBRATION

UNTIL_FITTED = ("grid", "repeatability")
ALWAYS = ("validate",)


def retake_refusal(log: Log, key: str) -> str:
    """Return why a point may not be re-measured, or nothing where it may."""
    point = log.points.get(key)
    if point is None:
        return f"{key[:80]}: no such point was measured in this run"
    if key in log.retakes:
        return f"{key}: waits already to be re-measured"
    return _bound(log, point)


def still_refused(log: Log, key: str) -> str:
    """Return why a point that waits may no longer be re-measured, or nothing where it may."""
    return _bound(log, log.points[key])


def _bound(log: Log, point: Point) -> str:
    if point.id.kind in ALWAYS and _repeatable(point):
        return ""
    if not (point.id.kind in UNTIL_FITTED and _repeatable(point)):
        return f"{point.key}: only grid, repeatability, validation are retaken; start a new run"
    if log.calibration in CALIBRATION.states[CALIBRATION.states.index("fitted") :]:
        return f"{point.key}: the correction was built with it; start a new run"
    return ""


def _repeatable(point: Point) -> bool:
    return point.commanded_deg is not None and bool(point.station)
