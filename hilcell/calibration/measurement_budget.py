"""Uncertainty budget of a measured position error (GUM, JCGM 100:2008).

Every figure is for **one coordinate** of a position, in mm. Where all three have the same u, 95 %
of 3D errors are below 2.80 u = 1.40 U: the root of chi^2 of three degrees of freedom. The budget of
a corrected target depends on its position: `hilcell.calibration.budget`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from hilcell.calibration.frames import nest_noise, world_as_framed
from hilcell.calibration.influence import ASSUMED, MEASURED
from hilcell.cell.uncertainty import COVERAGE_FACTOR, UncertaintyTable
from hilcell.geometry.frames import apply, motion_levers
from hilcell.geometry.statistics import coverage_factor, lengths_mm, rectangular_variance, rms
from hilcell.journal.log import Log, of_measured, positions_mm, variances_mm2
from hilcell.model.point import Point
from hilcell.ports import Array

Distribution = Literal["normal", "rectangular"]


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a budget.

    ``estimate_mm`` is a standard deviation (normal) or a half-width (rectangular, GUM 4.3.7).
    ``halved_by`` names the change that halves ``estimate_mm``.
    """

    name: str
    estimate_mm: float
    distribution: Distribution
    source: str
    how: str
    clause: str
    halved_by: str

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


NOISE, WORLD, CENTRED = "Tracker, reading noise", "World frame", "World frame, centring"
FINER_REFLECTOR = "uncertainty.smr_centring_limit_mm of a finer reflector"
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

    def of_mean(self, errors_mm: Array) -> float:
        """U of the mean length of measured errors (N, 3).

        The readings' noise averages. All else moves all targets together.
        """
        averaged = [each for each in self.lines if each.name == NOISE]
        common = [each for each in self.lines if each.name != NOISE]
        noise_mm = expanded_mm(combined_mm(averaged) / math.sqrt(len(errors_mm)))
        return math.hypot(noise_mm, common_motion_mm(errors_mm, combined_mm(common)))

    def with_half(self, name: str) -> Budget:
        """The budget with one contribution half as large."""
        return Budget([
            replace(each, estimate_mm=each.estimate_mm / 2) if each.name == name else each
            for each in self.lines
        ])  # fmt: skip


def common_motion_mm(errors_mm: Array, u_mm: float) -> float:
    """U of the mean length of errors (N, 3) that an unknown motion d moves together.

    ``u_mm``: of one coordinate of d. The mean changes by that of |e + d| - |e|: along d where all
    errors are parallel, hardly where they have all directions, and upwards where they are shorter
    than d. That is no linear model, so distributions are propagated (JCGM 101, 5.9); U is the
    larger of both sides, each with the risk of k = 2.
    """
    draws_mm = u_mm * np.random.default_rng(101).standard_normal((10_000, 3))
    squares_mm2 = np.add.outer(np.square(draws_mm).sum(axis=1), np.square(errors_mm).sum(axis=1))
    moved_mm = np.sqrt(np.maximum(squares_mm2 + 2.0 * draws_mm @ errors_mm.T, 0.0)).mean(axis=1)
    beyond = 0.02275  # of a normal distribution, beyond 2 sigma on one side
    low_mm, high_mm = np.quantile(moved_mm - lengths_mm(errors_mm).mean(), [beyond, 1.0 - beyond])
    return float(np.maximum(-low_mm, high_mm))  # NaN where an error is


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
                     stated.tracker_source or ASSUMED, "limit of error", "4.3.7",
                     "uncertainty.tracker_limit_mm by a certificate"),
        Contribution("SMR centring", stated.smr_centring_limit_mm, "rectangular",
                     stated.smr_source or ASSUMED, "centre of the optics against the sphere",
                     "4.3.7", FINER_REFLECTOR),
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
        whole, noise = world_as_framed(self.log), world_as_framed(self.log, centred=True)
        if whole is None or noise is None:
            return []
        nests = nest_noise(self.log)
        widened = coverage_factor(COVERAGE_FACTOR, nests.freedom) / COVERAGE_FACTOR  # GUM G.3
        return [
            Contribution(WORLD, widened * self._at_points_mm(noise), "normal", MEASURED,
                         f"{nests.how}, carried to the points", "5.1.2",
                         "4 times the readings of each floor nest (layout.nest_samples)"),
            Contribution(CENTRED, self._at_points_mm(whole - noise), "normal", ASSUMED,
                         "the reflector's centring in the three floor nests, carried to the points",
                         "5.1.2", FINER_REFLECTOR),
        ]  # fmt: skip

    def _at_points_mm(self, covariance: Array) -> float:
        """u of one coordinate at the points, by a covariance (6, 6) of {W}."""
        at_mm = apply(self.log.matrix("world"), positions_mm(self._flange_points()))
        J = motion_levers(at_mm)[:, :, :6]
        variances_mm2 = np.einsum("nij,jk,nik->n", J, covariance, J) / 3
        return math.sqrt(max(0.0, float(variances_mm2.mean())))

    def reading_noise(self) -> Contribution:
        points = self._flange_points()
        noise_mm = math.sqrt(variances_mm2(points).mean())
        how = f"scatter of the readings of {len(points)} points"
        halved_by = "4 times the readings (tracker.samples); in a mean, 4 times the targets"
        return Contribution(NOISE, noise_mm, "normal", MEASURED, how, "4.2.3", halved_by)

    def drift(self) -> Contribution:
        moves = control_moves(self.log)
        if not moves:
            how, limit_mm = (
                "floor nests were measured once only",
                self.log.cell.uncertainty.drift_limit_mm,
            )
            halved_by = "floor nests that are measured again"
            return Contribution("Drift", limit_mm, "rectangular", ASSUMED, how, "4.3.7", halved_by)
        noise_mm2 = sum(
            float(variances_mm2(points).mean())
            for points in ([each.now for each in moves], [each.first for each in moves])
        )
        drift_mm2 = rms([each.moved_mm for each in moves]) ** 2 - noise_mm2
        how = f"{len(moves)} measurements of the floor nests against the first, less the readings'"
        return Contribution(
            "Drift", math.sqrt(max(0.0, drift_mm2)), "normal", MEASURED, how, "4.2.2",
            "a tracker that has warmed up and stands still",
        )  # fmt: skip

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
        return Contribution(
            "Thermal expansion", limit_mm, "rectangular", source, how, "4.3.7",
            "half the range of temperature",
        )  # fmt: skip


class ControlMove(NamedTuple):
    """A floor nest measured again, its first measurement of the set-up, and the motion (3,)."""

    now: Point
    first: Point
    moved_mm: Array


def control_moves(log: Log) -> list[ControlMove]:
    """Motions of the floor nests, without those by which a moved tracker was detected."""
    firsts = {(point.set_up, point.id.nest): point for point in log.select("world")}
    again = [
        point
        for key, point in log.points.items()
        if point.id.kind == "control" and key not in log.set_ups.refuted
    ]
    pairs = [(point, firsts.get((point.set_up, point.id.nest))) for point in again]
    return [
        ControlMove(now, first, np.subtract(now.xyz_mm, first.xyz_mm))
        for now, first in pairs
        if first is not None
    ]
