"""The room's temperature against that at the grid's first point: rail, floor and arm follow it."""

from __future__ import annotations

from itertools import chain

from hilcell.calibration.suspicions import Suspicion
from hilcell.journal.log import Log
from hilcell.journal.point_id import CONTROL

NOTICED_BY = "weather station"


def reference_c(log: Log) -> float | None:
    """Return the temperature at the grid's first point, before there is one at the run's first."""
    points = chain(log.measured("grid"), log.points.values())
    return next((p.temperature_c for p in points if p.temperature_c is not None), None)


def warm(log: Log) -> Suspicion | None:
    """Return the room's change, where points that count were measured beyond its limit."""
    then_c = reference_c(log)
    if then_c is None:
        return None
    counted = (p for p in log.points.values() if p.id.group != CONTROL)
    off_k = [p.temperature_c - then_c for p in counted if p.temperature_c is not None]
    worst_k = max(off_k, key=abs, default=0.0)
    if abs(worst_k) <= log.cell.room.range_k:
        return None
    return Suspicion("temperature", worst_k, "K", NOTICED_BY)
