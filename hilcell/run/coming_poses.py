"""Poses that the robot goes to in turn: their ways are proven at once, before the first of them.

The proof knows where each way begins if nothing comes between, and keeps a reserve. Where the slide
and the robot then are read elsewhere, no point of the arm is farther from its proven way than the
levers allow (`Body.travel_mm`): joints go in step, so along two ways to the same pose they differ
nowhere by more than at their ends. Within the reserve the way is clear. Any other way is none of
these, and is proven by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.cell.file import Cell
from hilcell.cell.surroundings import posture
from hilcell.ports import Array
from hilcell.run.clear_ways import below, leaves_cube

RESERVE_MM = 5.0  # beyond the wanted clearance; a plan's legs have 10


@dataclass(frozen=True, slots=True)
class Coming:
    """A pose: from which posture (7,) its ways are proven, if they are; `leaves_cube`."""

    start: Array | None
    leaves_cube: bool


class ComingPoses:
    """Knows the poses by their joints, to the last bit."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self._coming: dict[bytes, Coming] = {}

    def expect(self, rail_mm: float, joints_rad: Array) -> None:
        """Prove the ways from the safe pose to joints (N, 6) in turn, each from below."""
        cell = self._cell
        if cell.surroundings is None:
            return
        before_rad = np.vstack([np.radians(cell.robot.safe_deg), joints_rad])[:-1]
        stops = posture(rail_mm, np.array([before_rad, below(cell, joints_rad), joints_rad]))
        ways = stops[:-1].reshape(-1, 7), stops[1:].reshape(-1, 7)
        proof = cell.surroundings.prove(*ways, RESERVE_MM)
        to_below, from_there = proof.clear.reshape(2, -1)
        clear = to_below & from_there
        self._coming = {
            joints.tobytes(): Coming(stops[0, n] if clear[n] else None, bool(leaves))
            for n, (joints, leaves) in enumerate(
                zip(joints_rad, leaves_cube(cell, joints_rad), strict=True)
            )
        }

    def clear(self, rail_mm: float, from_rad: Array, to_rad: Array) -> bool:
        """Whether the ways from joints (6,) to others, from below, are within the reserve."""
        coming, around = self._coming.get(to_rad.tobytes()), self._cell.surroundings
        if coming is None or coming.start is None or around is None:
            return False
        return around.apart_mm(coming.start, posture(rail_mm, from_rad)) <= RESERVE_MM

    def leaves_cube(self, joints_rad: Array) -> bool:
        """Return `leaves_cube` of joints (6,)."""
        coming = self._coming.get(joints_rad.tobytes())
        if coming is None:
            return bool(leaves_cube(self._cell, joints_rad[None])[0])
        return coming.leaves_cube
