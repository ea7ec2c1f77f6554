"""Places that an instrument sees in nearly the same direction as another reflector.

A target recognition finds reflectors by direction. Where a nest stands behind or before the flange
in its line of sight, the instrument chooses neither, or the wrong one.
"""

from __future__ import annotations

import numpy as np

from hilcell.cell.devices import sights_apart_rad
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.inverse import Bools
from hilcell.ports import Array


def beside_nest(cell: Cell, station: Station, points_mm: Array) -> Bools:
    """Return which points (N, 3) in nominal {B} the tracker cannot tell from a nest, (N,)."""
    apart_rad = sights_apart_rad(cell)
    if not apart_rad or cell.layout.by_hand:
        return np.zeros(len(points_mm), dtype=bool)
    T_W_B = cell.layout.nominal_base(station.rail_mm)
    slide_mm = np.array([nest.xyz_mm for nest in cell.layout.slide]).reshape(-1, 3)
    floor_mm = np.array([nest.xyz_mm for nest in cell.layout.standing])
    nests_mm = np.vstack([floor_mm, apply(T_W_B, slide_mm)])
    places, nests = (_directions(cell, each) for each in (apply(T_W_B, points_mm), nests_mm))
    chords = np.linalg.norm(places[:, None] - nests[None], axis=-1)
    found: Bools = ~(chords.min(axis=1) > 2.0 * np.sin(apart_rad / 2.0))
    return found


def _directions(cell: Cell, world_mm: Array) -> Array:
    seen_mm = apply(inverse(cell.tracker.pose.matrix()), world_mm)
    directions: Array = seen_mm / np.linalg.norm(seen_mm, axis=1, keepdims=True)
    return directions
