"""The calibrated volume in numbers: where the grid begins and ends at each station, in {W}."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from operator import attrgetter

import numpy as np

from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply
from hilcell.ports import Array
from hilcell.report.columns import Column, Sheet, sheet

MOST_STATIONS = 4  # one by one
SAME_MM = 0.5


@dataclass(frozen=True, slots=True)
class Range:
    """From where to where the volume reaches along one axis."""

    name: str
    low_mm: float
    high_mm: float


RANGES: tuple[Column[Range], ...] = (
    Column("in {W}, mm", attrgetter("name")),
    Column("from", attrgetter("low_mm"), form=".0f"),
    Column("to", attrgetter("high_mm"), form=".0f"),
)


def corners_mm(cell: Cell, station: Station) -> Array:
    """Return the corners (8, 3) of a station's volume in {W}, of the nominal layout."""
    centre, half = cell.grid.centre.matrix()[:3, 3], np.array(cell.grid.size_mm) / 2
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    found: Array = apply(cell.layout.nominal_base(station.rail_mm), centre + signs * half)
    return found


def volume_sheet(cell: Cell, tracker_mm: Array) -> Sheet | None:
    """Return the table; ``tracker_mm`` (3,) is where the tracker stands in {W}."""
    places = {station.name: corners_mm(cell, station) for station in cell.station}
    every = np.concatenate(list(places.values()))
    far_m = np.linalg.norm(every - tracker_mm, axis=1) / 1000
    note = f"Tracker to corners: {far_m.min():.1f} to {far_m.max():.1f} m."
    return sheet("Calibrated volume", RANGES, _ranges(places), note)


def _ranges(places: dict[str, Array]) -> list[Range]:
    lows = np.array([corners.min(axis=0) for corners in places.values()])
    highs = np.array([corners.max(axis=0) for corners in places.values()])
    found = []
    for n, axis in enumerate("xyz"):
        low, high = lows[:, n], highs[:, n]
        if max(np.ptp(low), np.ptp(high)) <= SAME_MM:
            found.append(Range(axis, float(low.min()), float(high.max())))
        elif len(places) > MOST_STATIONS:
            words = f"{axis}, {len(places)} stations"
            found.append(Range(words, float(low.min()), float(high.max())))
        else:
            rows = zip(places, low.tolist(), high.tolist(), strict=True)
            found += [Range(f"{axis}, {name}", *ends) for name, *ends in rows]
    return found
