"""A rail by its jogs: scale and sign of drive against strip, unit of speed, stop; mm, s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

SIMPLE_FACTORS = (0.001, 0.01, 0.1, 0.5, 1.0, 2.0, 10.0, 100.0, 1000.0)
SIMPLE_SHARE = 0.02  # a scale this near to a simple factor is that factor


class Trace(Protocol):
    """A jog as recorded, one entry a poll; see `hilcell.ports.RailTrace`."""

    @property
    def taken_s(self) -> Sequence[float]: ...
    @property
    def drive_mm(self) -> Sequence[float]: ...
    @property
    def strip_mm(self) -> Sequence[float]: ...
    @property
    def velocity_mm_s(self) -> Sequence[float]: ...
    @property
    def stopped_by(self) -> str: ...


class JogFigures(NamedTuple):
    """Displacements of drive and strip; the fastest speed by the drive's positions and as the drive
    itself states it.
    """

    driven_mm: float
    moved_mm: float
    speed_mm_s: float
    stated_mm_s: float
    stopped_by: str

    @property
    def scale(self) -> float:
        """The strip's displacement a mm of the drive's; 0 for a drive that did not count."""
        return self.moved_mm / self.driven_mm if abs(self.driven_mm) > 1e-6 else 0.0

    @property
    def simple_scale(self) -> float:
        """The scale, or the simple factor that it is near to."""
        sign = 1.0 if self.scale > 0 else -1.0
        near = min(SIMPLE_FACTORS, key=lambda each: abs(np.log(abs(self.scale) / each)))
        return sign * (
            near if abs(abs(self.scale) / near - 1.0) <= SIMPLE_SHARE else abs(self.scale)
        )

    @property
    def speed_share(self) -> float:
        """The speed by positions a mm/s that the drive states; NaN for a drive that states none."""
        return self.speed_mm_s / self.stated_mm_s if self.stated_mm_s > 0 else float("nan")

    def words(self, limit: float) -> str:
        """Return the scale in words."""
        if not abs(self.scale) > 0.02:
            return "drive and strip do not move together: coupling, or the strip's head"
        if self.scale < 0:
            return f"opposite directions, scale {-self.scale:.4f}"
        return f"scale {self.scale:.4f}" + ("" if abs(self.scale - 1) <= limit else ", wrong")


def jog_figures(trace: Trace) -> JogFigures:
    """Return the figures of one jog.

    Speeds are the medians of the fastest fifth of the polls, so that one late poll decides nothing.
    """
    t, x = np.asarray(trace.taken_s), np.asarray(trace.drive_mm)
    speed_mm_s = np.abs(np.gradient(x, t)) if len(t) > 2 else np.zeros(len(t))
    fastest = speed_mm_s >= 0.9 * np.quantile(speed_mm_s, 0.8)
    stated = np.abs(np.asarray(trace.velocity_mm_s))
    return JogFigures(
        float(x[-1] - x[0]),
        float(trace.strip_mm[-1] - trace.strip_mm[0]),
        float(np.median(speed_mm_s[fastest])),
        float(np.median(stated[fastest])),
        trace.stopped_by,
    )


class StopFigures(NamedTuple):
    """From the last poll at full speed to rest."""

    distance_mm: float
    duration_s: float
    speed_mm_s: float

    def expected_mm(self, ramp_mm_s2: float, late_s: float = 0.25) -> float:
        """Return the longest distance: polls and frames are late, then the ramp."""
        return self.speed_mm_s * late_s + self.speed_mm_s**2 / (2.0 * ramp_mm_s2) + 0.5


def stop_figures(trace: Trace) -> StopFigures:
    """Return the distance and the time of a quick stop, by the drive's positions."""
    t, x = np.asarray(trace.taken_s), np.asarray(trace.drive_mm)
    speed_mm_s = np.abs(np.gradient(x, t)) if len(t) > 2 else np.zeros(len(t))
    full_mm_s = float(np.quantile(speed_mm_s, 0.8))
    fast = np.flatnonzero(speed_mm_s >= 0.9 * full_mm_s)
    rests = np.flatnonzero(np.abs(x - x[-1]) > 0.02)
    last, rest = int(fast[-1]), int(rests[-1]) if len(rests) else len(x) - 1
    return StopFigures(float(abs(x[-1] - x[last])), float(max(0.0, t[rest] - t[last])), full_mm_s)
