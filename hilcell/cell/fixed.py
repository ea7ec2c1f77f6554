"""A cell without a rail: its robot stands on the floor, at one station, for good.

The cell file leaves out ``[rail]`` and all that belongs to one. Here alone it is completed: by a
rail whose driver is `NO_RAIL`, a slide that never moves and has no nests, and one station at 0. So
base, journal, plans and calibration files have one form, with a rail or without.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

NO_RAIL = "none"  # the driver of a rail that is not there
STATION = "BASE"
AT_0 = {"rail_mm": 0.0, "strip_mm": 0.0}
RAIL = {
    "driver": NO_RAIL,
    "travel_min_mm": 0.0,
    "travel_max_mm": 0.0,
    "speed_mm_s": 1.0,
    "acceleration_mm_s2": 1.0,
}


def completed(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a cell file's tables, with those of a robot that stands where there is no rail."""
    if "rail" in values:
        return values
    stations = values.get("station", [{"name": STATION}])
    if isinstance(stations, list):
        stations = [_with(AT_0, station) for station in stations]
    name = stations[0].get("name", STATION) if _tables(stations) else STATION
    return {
        **values,
        "rail": RAIL,
        "station": stations,
        "grid": _with({"station": name}, values.get("grid", {})),
        "layout": _with({"rail_direction": [0.0, 0.0, 0.0], "slide": []}, values.get("layout", {})),
        "touch": _with({"poses": 0}, values.get("touch", {})),
    }


def _with(defaults: Mapping[str, object], table: Any) -> Any:
    """Return a table with defaults; a value that is no table stays, and the checks refuse it."""
    return {**defaults, **table} if isinstance(table, Mapping) else table


def _tables(found: object) -> bool:
    return isinstance(found, list) and bool(found) and isinstance(found[0], Mapping)
