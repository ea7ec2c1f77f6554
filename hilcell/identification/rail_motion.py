"""A rail by its jogs: scale and sign of drive against strip, unit of speed, stop; mm, s."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from hilcell.geometry.statistics import coverage_factor, slope, variance_of_mean

SIMPLE_FACTORS = (0.001, 0.01, 0.1, 0.5, 1.0, 2.0, 10.0, 100.0, 1000.0)
SLOW_MM = 2.0  # a shorter jog is over within a few polls, too few for a speed
GROSS = 1.4  # a scale beyond this factor is wrong, whatever the readings' noise


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
    """Displacements of drive and strip, and that of the drive by the speeds that it states."""

    driven_mm: float
    moved_mm: float
    by_speed_mm: float
    mean_mm_s: float  # until a tenth of the way is left: no stated speed tells it
    stopped_by: str

    @property
    def scale(self) -> float:
        """The strip's displacement a mm of the drive's; 0 for a drive that did not count."""
        return self.moved_mm / self.driven_mm if abs(self.driven_mm) > 1e-6 else 0.0

    @property
    def is_gross(self) -> bool:
        """Whether sign or scale is wrong beyond what a short jog leaves open; NaN is."""
        return not 1.0 / GROSS <= self.scale <= GROSS

    def simple_scale(self, share: float) -> float:
        """Return the scale, or the simple factor within a ``share`` of it."""
        size = abs(self.scale)
        near = min(SIMPLE_FACTORS, key=lambda each: abs(np.log(size / each)))
        return float(np.copysign(near if abs(size / near - 1.0) <= share else size, self.scale))

    @property
    def speed_share(self) -> float:
        """The distance a mm of that by the stated speeds; NaN for a drive that states none."""
        if not self.by_speed_mm > 1e-9:
            return float("nan")
        return abs(self.driven_mm) / self.by_speed_mm

    @property
    def words(self) -> str:
        """The scale in words."""
        if not abs(self.scale) > 0.02:
            return "drive and strip do not move together: coupling, or the strip's head"
        if self.scale < 0:
            return f"opposite directions, scale {-self.scale:.4f}"
        return f"scale {self.scale:.4f}"


def jog_figures(trace: Trace) -> JogFigures:
    """Return the figures of one jog."""
    t, stated = np.asarray(trace.taken_s), np.asarray(trace.velocity_mm_s)  # signed: noise cancels
    gone_mm = np.abs(np.asarray(trace.drive_mm) - trace.drive_mm[0])
    near = int(np.argmax(gone_mm >= 0.9 * gone_mm[-1]))
    return JogFigures(
        float(trace.drive_mm[-1] - trace.drive_mm[0]),
        float(trace.strip_mm[-1] - trace.strip_mm[0]),
        abs(float(np.trapezoid(stated, t))),
        float(gone_mm[near] / (t[near] - t[0])) if near else 0.0,
        trace.stopped_by,
    )


class RailFigures(NamedTuple):
    """Of a rail by several jogs: the strip's mm a mm of the drive, the distance that a reversal
    loses, the mm by positions a mm by the stated speeds; each with its U (k = 2).
    """

    scale: float
    U_scale: float
    lost_mm: float
    U_lost_mm: float
    speed_share: float
    U_speed_share: float


def rail_figures(jogs: Sequence[Trace], back: Trace) -> RailFigures:
    """Return the figures of three jogs or more in one direction, and of one after a reversal.

    The drive has taken up the backlash where the first jog ends: from there the ends of all jogs
    lie on a line, whose residuals are the scatter of drive and strip.
    """
    ends = np.array([[jog.drive_mm[-1], jog.strip_mm[-1]] for jog in jogs]).T
    scale, u_scale = slope(*ends)
    freedom = ends.shape[1] - 2
    scatter_mm = u_scale * float(np.std(ends[0])) * np.sqrt(ends.shape[1])
    factor = coverage_factor(2.0, freedom)
    reversal = jog_figures(back)
    lost_mm = scale * abs(reversal.driven_mm) - abs(reversal.moved_mm)
    longer = [figures for jog in jogs if abs((figures := jog_figures(jog)).driven_mm) > SLOW_MM]
    shares = [figures.speed_share for figures in longer]
    U_share = np.inf  # of a single jog
    if len(shares) > 1:
        U_share = coverage_factor(2.0, len(shares) - 1) * np.sqrt(variance_of_mean(shares))
    return RailFigures(
        scale,
        factor * u_scale,
        lost_mm,
        factor * np.sqrt(2.0) * scatter_mm,
        float(np.mean(shares)),
        float(U_share),
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
