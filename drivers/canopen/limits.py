"""Bounds of one slide, in counts and seconds, and its scale to mm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.standstill import Windows


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds that a healthy slide never exceeds, in counts and seconds, and the scale to mm."""

    counts_per_mm: float
    strip_counts_per_mm: float
    strip_at_sync: bool  # it is on the drive's bus
    lowest: int
    highest: int
    speed: float
    acceleration: float
    homing_s: float  # planned, from the far end of the travel
    window: int  # arrived, or progress
    windows: Windows  # at rest

    def mm(self, counts: float) -> str:
        """Return a position, or a speed a second, in words."""
        return f"{counts / self.counts_per_mm:.3f} mm"

    def travel_s(self, distance: float) -> float:
        """Return how long a motion over ``distance`` is planned to take, from rest to rest."""
        peak = min(self.speed, math.sqrt(abs(distance) * self.acceleration))
        return abs(distance) / peak + peak / self.acceleration if peak else 0.0

    @property
    def ramp_s(self) -> float:
        """Return how long the slide takes from full speed to rest."""
        return self.speed / self.acceleration
