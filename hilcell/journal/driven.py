"""Where the robot was driven: the ends of motions that a journal proves.

A motion has come to its end where a point or another motion follows it in the same session.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np

from hilcell.ports import Array

if TYPE_CHECKING:
    from hilcell.journal.journal import Record

SAME_DEG = 1.0  # of each axis: corrections and approaches turn less
SAME_MM = 5.0  # of the slide


class Driven:
    """Takes a run's records in their order."""

    def __init__(self) -> None:
        self._ends = array("d")  # of each seven: the strip's reading, six joints in deg
        self._under_way: list[float] | None = None

    def take(self, record: Record) -> None:
        """Add one record."""
        body = record.body
        if record.kind == "state" and body["to"] == "checking":
            self._under_way = None  # its session ended before it was seen to arrive
        if record.kind not in ("intent", "point"):
            return
        if self._under_way is not None:
            self._ends.extend(self._under_way)
        self._under_way = None
        if body.get("action") == "robot.move" and "strip_mm" in body:
            self._under_way = [body["strip_mm"], *body["joints_deg"]]

    def has(self, strip_mm: float, joints_rad: Array) -> bool:
        """Whether a motion ended at joints (6,) with the slide there."""
        if not self._ends:
            return False
        off = np.abs(np.reshape(self._ends, (-1, 7)) - [strip_mm, *np.degrees(joints_rad)])
        near = (off[:, 0] <= SAME_MM) & (off[:, 1:] <= SAME_DEG).all(axis=1)
        return bool(near.any())
