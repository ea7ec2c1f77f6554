"""The truth under a robot that stands on the floor: it stands where a slide would be at 0."""

from __future__ import annotations

from fakes.truth.transforms import Array, frame
from hilcell.cell.file import Cell


class FloorTruth:
    """The place of one simulated robot; it answers what `RailTruth` answers the plant."""

    still = True

    def __init__(self, cell: Cell) -> None:
        self._pose = frame(cell.layout.base)

    def slide_mm(self) -> float:
        """Return where a slide would be."""
        return 0.0

    def slide_pose(self) -> Array:
        """Return in {W}, (4, 4), what the cell file states as nominal {B}."""
        return self._pose.copy()
