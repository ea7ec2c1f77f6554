"""Why floor nests do not stand as the cell file says: one of them elsewhere, another reflector.

Distances between nests do not depend on the tracker's pose. A nest that stands elsewhere changes
the distances to it alone; a reflector of another radius shifts every reading along its beam.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse, rigid_fit, unit
from hilcell.identification.reflector_radius import SHIFTS_MM, reflectors_of
from hilcell.ports import Array


@dataclass(frozen=True, slots=True)
class MisplacedNest:
    """One nest, how far it is from its place in the cell file, and where it is (3,) in {W}."""

    name: str
    off_mm: float
    world_mm: Array

    @property
    def text(self) -> str:
        x, y, z = self.world_mm
        return (
            f"{self.name} alone is {self.off_mm:.0f} mm from its place in the cell file: put it "
            f"back, or write x_mm = {x:.1f}, y_mm = {y:.1f}, z_mm = {z:.1f} for {self.name} in "
            "[[layout.floor]]"
        )


def misplaced_nest(cell: Cell, measured_mm: Array, limit_mm: float) -> MisplacedNest | None:
    """Return the one floor nest without which all distances hold; None where it is not one alone.

    ``measured_mm`` (N, 3), tracker's frame. Of several the one counts whose others are where
    tracker.pose expects them.
    """
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    expected_mm = apply(inverse(cell.tracker.pose.matrix()), nominal_mm)
    off_mm = np.linalg.norm(measured_mm - expected_mm, axis=1)
    found = [
        n
        for n in range(len(nominal_mm))
        if bool(np.all(np.abs(_changes_mm(nominal_mm, measured_mm, n)) <= limit_mm))
    ]
    if len(found) > 1:
        at_place = off_mm <= cell.tracker.find_radius_mm
        found = [n for n in found if not at_place[n] and at_place.sum() == len(nominal_mm) - 1]
    if len(found) != 1:
        return None
    n = found[0]
    T = _tracker_in_world(cell, nominal_mm, measured_mm, n)
    world_mm = apply(T, measured_mm[n][None])[0]
    moved_mm = float(np.linalg.norm(world_mm - nominal_mm[n]))
    return MisplacedNest(cell.layout.floor[n].name, moved_mm, world_mm)


def other_reflector(cell: Cell, measured_mm: Array, limit_mm: float) -> str:
    """Return words for a reflector of another radius, with which all distances hold; "" for none.

    ``measured_mm`` (N, 3), tracker's frame, are of the reflector that the cell file names.
    """
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    if not float(np.abs(_changes_mm(nominal_mm, measured_mm)).max()) <= 2.0 * max(SHIFTS_MM):
        return ""  # no difference of radii changes a distance by more
    shift_mm, along = 0.0, unit(measured_mm)
    for _ in range(5):  # Gauss-Newton of one unknown: it converges in two
        at_mm = measured_mm + shift_mm * along
        pairs = np.array(list(combinations(range(len(at_mm)), 2)))
        lines = unit(at_mm[pairs[:, 0]] - at_mm[pairs[:, 1]])
        slope = np.vecdot(along[pairs[:, 0]] - along[pairs[:, 1]], lines)
        shift_mm -= float(slope @ _changes_mm(nominal_mm, at_mm) / max(slope @ slope, 1e-9))
    at_mm = measured_mm + shift_mm * along
    if not bool(np.all(np.abs(_changes_mm(nominal_mm, at_mm)) <= limit_mm)):
        return ""
    if not (fits := reflectors_of(shift_mm)):
        return ""
    return (
        f"all distances hold if every reading is {shift_mm:+.2f} mm along its beam: reflectors of "
        f"{fits}; seat {cell.tracker.reflector!r}, or correct tracker.reflector"
    )


def _changes_mm(nominal_mm: Array, measured_mm: Array, without: int | None = None) -> Array:
    """Return measured minus nominal distances (M,) of all pairs, or of those without one nest."""
    pairs = [pair for pair in combinations(range(len(nominal_mm)), 2) if without not in pair]
    ends = np.array(pairs, dtype=int).reshape(-1, 2)
    lengths = [
        np.linalg.norm(at_mm[ends[:, 0]] - at_mm[ends[:, 1]], axis=1)
        for at_mm in (measured_mm, nominal_mm)
    ]
    changes_mm: Array = lengths[0] - lengths[1]
    return changes_mm


def _tracker_in_world(cell: Cell, nominal_mm: Array, measured_mm: Array, without: int) -> Array:
    """Return T_W_L (4, 4) by all nests but one; with two of them only its shift is found."""
    kept = np.arange(len(nominal_mm)) != without
    if kept.sum() >= 3:
        return rigid_fit(measured_mm[kept], nominal_mm[kept]).T
    T = cell.tracker.pose.matrix()
    T[:3, 3] += (nominal_mm[kept] - apply(T, measured_mm[kept])).mean(axis=0)
    return T
