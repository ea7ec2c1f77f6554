"""Uncertainty budget of a measured position error (GUM, JCGM 100:2008).

Every figure is for **one coordinate** of a position, in mm. Where all three have the same u, 95 %
of 3D errors are below 2.80 u = 1.40 U: the root of chi^2 of three degrees of freedom. The budget of
a corrected target depends on its position: `hilcell.calibration.budget`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hilcell.calibration.frames import world_as_framed
from hilcell.calibration.influence import ASSUMED, MEASURED
from hilcell.cell.uncertainty import COVERAGE_FACTOR, UncertaintyTable
from hilcell.geometry.frames import apply, motion_levers
from hilcell.geometry.statistics import lengths_mm, rectangular_variance, rms
from hilcell.journal.log import Log, of_measured, positions_mm, variances_mm2
from hilcell.model.point import Point
from hilcell.ports import Array

Distribution = Literal["normal", "rectangular"]


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a budget.

    ``estimate_mm`` is a standard deviation (normal) or a half-width (rectangular, GUM 4.3.7).
    """

    name: str
    estimate_mm: float
    distribution: Distribution
    source: str
    how: str
    clause: str

    @property
    def u_mm(self) -> float:
        """Standard uncertainty of one coordinate (GUM 4.2, 4.3)."""
        return self.estimate_mm / (math.sqrt(3.0) if self.distribution == "rectangular" else 1.0)


def combined_mm(contributions: Iterable[Contribution]) -> float:
    """Combined standard uncertainty (GUM 5.1.2, eq 10): all sensitivities are 1."""
    return math.sqrt(sum(each.u_mm**2 for each in contributions))


def expanded_mm(u_mm: float) -> float:
    """Expanded uncertainty U = k u (GUM 6.2.1)."""
    return COVERAGE_FACTOR * u_mm


def thermal_limit_mm(length_mm: float, expansion_per_k: float, range_k: float) -> float:
    """Elongation of ``length_mm`` by half a temperature range (GUM 4.3.7)."""
    return length_mm * expansion_per_k * range_k / 2


def systematic_mm2(stated: UncertaintyTable, at_mm: Array) -> Array:
    """Variances (N,) of one coordinate at (N, 3), tracker's frame, by stated limits."""
    range_mm2 = np.square(at_mm).sum(axis=-1)
    return np.asarray(
        rectangular_variance(stated.tracker_limit_mm)
        + range_mm2 * (rectangular_variance(stated.tracker_limit_um_m * 1e-6))
    )


NOISE, WORLD = "Tracker, reading noise", "World frame"
STEEL_EXPANSION_PER_K = 11.5e-6  # of the structure between {W} and the points


@dataclass(frozen=True, slots=True)
class Budget:
    """The contributions to a measured position error."""

    lines: list[Contribution]

    @property
    def u_mm(self) -> float:
        return combined_mm(self.lines)

    @property
    def U_mm(self) -> float:  # noqa: N802 - GUM's symbols: u and U differ
        return expanded_mm(self.u_mm)

    def of_mean_of(self, count: int) -> float:
        """U of the mean of ``count`` positions: only the readings' noise averages."""
        lines = [
            replace(each, estimate_mm=each.estimate_mm / math.sqrt(count))
            if each.name == NOISE
            else each
            for each in self.lines
        ]
        return expanded_mm(combined_mm(lines))


@of_measured
def measurement_budget(log: Log) -> Budget | None:
    """The budget; None where the run has framed no world and measured no points."""
    if "world" not in log.frames or not log.points:
        return None
    stated = log.cell.uncertainty
    contributions = _Contributions(log)
    return Budget([
        contributions.reading_noise(),
        Contribution("Tracker, systematic", stated.tracker_limit_mm, "rectangular",
                     stated.tracker_source or ASSUMED, "limit of error", "4.3.7"),
        Contribution("SMR centring", stated.smr_centring_limit_mm, "rectangular",
                     stated.smr_source or ASSUMED, "centre of the optics against the sphere",
                     "4.3.7"),
        *contributions.world(),
        contributions.drift(),
        contributions.thermal(),
    ])  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Contributions:
    log: Log

    def _flange_points(self) -> list[Point]:
        return [p for p in self.log.points.values() if p.smr_mm is not None] or list(
            self.log.points.values()
        )

    def world(self) -> list[Contribution]:
        """Uncertainty of {W} at the points, where the run measured its three nests."""
        covariance = world_as_framed(self.log)
        if covariance is None:
            return []
        at_mm = apply(self.log.matrix("world"), positions_mm(self._flange_points()))
        J = motion_levers(at_mm)[:, :, :6]
        variances_mm2 = np.einsum("nij,jk,nik->n", J, covariance, J) / 3
        u_mm = math.sqrt(float(variances_mm2.mean()))
        how = "noise and centring of the three floor nests, carried to the points"
        return [Contribution(WORLD, u_mm, "normal", f"{MEASURED}, and {ASSUMED}", how, "5.1.2")]

    def reading_noise(self) -> Contribution:
        points = self._flange_points()
        noise_mm = math.sqrt(variances_mm2(points).mean())
        how = f"scatter of the readings of {len(points)} points"
        return Contribution(NOISE, noise_mm, "normal", MEASURED, how, "4.2.3")

    def drift(self) -> Contribution:
        moved_mm = np.array([move for _, move in control_moves(self.log)])
        if not len(moved_mm):
            how, limit_mm = (
                "floor nests were measured once only",
                self.log.cell.uncertainty.drift_limit_mm,
            )
            return Contribution("Drift", limit_mm, "rectangular", ASSUMED, how, "4.3.7")
        how = f"{len(moved_mm)} measurements of the floor nests against the first"
        return Contribution("Drift", rms(moved_mm), "normal", MEASURED, how, "4.2.2")

    def thermal(self) -> Contribution:
        celsius = self.log.temperatures_c()
        range_k = max(celsius) - min(celsius) if celsius else self.log.cell.uncertainty.air_range_k
        known = "measured" if celsius else "assumed: no weather station"
        world_mm = apply(self.log.matrix("world"), positions_mm(self.log.points.values()))
        length_mm = float(lengths_mm(world_mm).max())
        how = (
            f"steel, {STEEL_EXPANSION_PER_K * 1e6:.1f} µm/(m·K) assumed, {length_mm / 1000:.2f} m "
            f"from {{W}}, range {range_k:.2f} K {known}"
        )
        limit_mm = thermal_limit_mm(length_mm, STEEL_EXPANSION_PER_K, range_k)
        source = f"{MEASURED}, and {ASSUMED}" if celsius else ASSUMED
        return Contribution("Thermal expansion", limit_mm, "rectangular", source, how, "4.3.7")


def control_moves(log: Log) -> list[tuple[Point, Array]]:
    """Each control point and its motion (3,) since the first of nest and set-up, mm. Without those
    that detected a moved tracker, which is no drift.
    """
    firsts = {(point.set_up, point.id.nest): point for point in log.select("world")}
    again = [
        point
        for key, point in log.points.items()
        if point.id.kind == "control" and key not in log.set_ups.refuted
    ]
    pairs = [(point, firsts.get((point.set_up, point.id.nest))) for point in again]
    return [
        (now, np.subtract(now.xyz_mm, first.xyz_mm)) for now, first in pairs if first is not None
    ]
