"""A change between two runs in words: every row says which station it is about.

The station stands first, so that rows differ where a column is narrow, too.
"""

from __future__ import annotations

from hilcell.calibration.errors import OTHERS
from hilcell.journal.ways_sent import SHORT_WAYS
from hilcell.report.drift import Change

_GRID, _STATION = "grid/", "station "  # begin the places of a vertex and of a station's frame


def where_words(change: Change) -> str:
    """Return what changed: *S300 targets*, *S300 frame*, *grid point 1-2-0*."""
    match change.group:
        case "validation":
            return "other stations" if change.place == OTHERS else f"{change.place} targets"
        case "frames":
            station = change.place.removeprefix(_STATION)
            return f"{station} frame" if station != change.place else f"robot {change.place}"
        case "grid" if change.place.startswith(_GRID):
            return f"grid point {change.place.removeprefix(_GRID)}"
        case "grid":
            return change.place.replace("vertices", "grid points")
    return "air at tracker"


def figure_words(change: Change) -> str:
    """Return the figure that changed: *corrected: mean*, which is of |e|."""
    if change.group != "validation":
        return change.what
    how, _, figure = change.what.partition(" ")
    return f"{SHORT_WAYS.get(how, how)}: {'95 %' if figure == 'p95' else figure}"
