"""The uncertainty budget of a run: which contributions its journal proves, and which are assumed.

Two measurands. *Measurement*: the position error that the tracker states. *Target*: the place of
a corrected target at any station, for which robot, strip, station frame and model count too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hilcell.calibration.errors import validation, visits_mm
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import lengths_mm, pooled_std_mm, reading_variances_mm2, rms
from hilcell.journal.log import Log, positions_mm
from hilcell.ports import Array
from hilcell.report.uncertainty import (
    ASSUMED,
    MEASURED,
    Contribution,
    combined_mm,
    expanded_mm,
    remainder_mm,
    thermal_limit_mm,
)

# Stated assumptions: a laboratory replaces them by its certificates.
TRACKER_LIMIT_MM = 0.015  # the paper's tracker within 10 m (section 5.1)
SMR_CENTRING_LIMIT_MM = 0.0127  # half a thousandth of an inch, a common grade of 1.5-inch SMRs
DRIFT_LIMIT_MM = 0.02  # where the floor nests were not measured again
STEEL_EXPANSION_PER_K = 11.5e-6
AIR_RANGE_K = 4.0  # of the air during a run, where the tracker has no weather station


@dataclass(frozen=True, slots=True)
class Check:
    """The error that the budget predicts at the other stations, and the one measured there."""

    predicted_mm: float
    found_mm: float
    targets: int


@dataclass(frozen=True, slots=True)
class Budget:
    """Contributions of the measurement, and those that a corrected target has besides."""

    measurement: list[Contribution]
    target: list[Contribution]
    check: Check | None

    @property
    def measurement_u_mm(self) -> float:
        """Return u of one coordinate of a measured position error."""
        return combined_mm(self.measurement)

    @property
    def target_u_mm(self) -> float:
        """Return u of one coordinate of a corrected target's place."""
        return combined_mm([*self.measurement, *self.target])

    @property
    def measurement_U_mm(self) -> float:  # noqa: N802 - GUM's symbols: u and U differ
        """Return the expanded uncertainty of a measured position error."""
        return expanded_mm(self.measurement_u_mm)

    @property
    def target_U_mm(self) -> float:  # noqa: N802 - GUM's symbols: u and U differ
        """Return the expanded uncertainty of a corrected target's place."""
        return expanded_mm(self.target_u_mm)


def budget_of(log: Log) -> Budget | None:
    """Return the budget, or nothing where the run has framed no world and measured no points."""
    if "world" not in log.frames or not log.points:
        return None
    measurement = [
        _reading_noise(log),
        Contribution("Tracker, systematic", TRACKER_LIMIT_MM, "rectangular", ASSUMED,
                     "limit of error within 10 m", "4.3.7"),
        Contribution("SMR centring", SMR_CENTRING_LIMIT_MM, "rectangular", ASSUMED,
                     "centre of the optics against the sphere", "4.3.7"),
        _drift(log),
        _thermal(log),
    ]  # fmt: skip
    target = _target(log, measurement[0].u_mm)
    seen = [measurement[0], measurement[3], *target]
    return Budget(measurement, target, _check(log, seen) if target else None)


def _reading_noise(log: Log) -> Contribution:
    points = [p for p in log.points.values() if p.smr_mm is not None] or list(log.points.values())
    variances_mm2 = reading_variances_mm2([p.std_mm for p in points], [p.samples for p in points])
    noise_mm = math.sqrt(variances_mm2.mean())
    how = f"scatter of the readings of {len(points)} points"
    return Contribution("Tracker, reading noise", noise_mm, "normal", MEASURED, how, "4.2.3")


def _drift(log: Log) -> Contribution:
    moved_mm = _moves_mm(log)
    if not len(moved_mm):
        how = "floor nests were measured once only"
        return Contribution("Drift", DRIFT_LIMIT_MM, "rectangular", ASSUMED, how, "4.3.7")
    how = f"{len(moved_mm)} measurements of the floor nests against the first"
    return Contribution("Drift", rms(moved_mm), "normal", MEASURED, how, "4.2.2")


def _moves_mm(log: Log) -> Array:
    """Return how far each control point (N, 3) was from the first measurement of its nest."""
    firsts = {point.id.nest: point for point in log.select("world")}
    again = [point for point in log.points.values() if point.id.kind == "control"]
    pairs = [(point, firsts[point.id.nest]) for point in again if point.id.nest in firsts]
    return positions_mm(now for now, _ in pairs) - positions_mm(first for _, first in pairs)


def _thermal(log: Log) -> Contribution:
    celsius = log.temperatures_c()
    range_k = max(celsius) - min(celsius) if celsius else AIR_RANGE_K
    known = "measured" if celsius else "assumed: no weather station"
    world_mm = apply(log.matrix("world"), positions_mm(log.points.values()))
    length_mm = float(lengths_mm(world_mm).max())
    how = (
        f"steel, {STEEL_EXPANSION_PER_K * 1e6:.1f} µm/(m·K) assumed, {length_mm / 1000:.2f} m "
        f"from {{W}}, range {range_k:.2f} K {known}"
    )
    limit_mm = thermal_limit_mm(length_mm, STEEL_EXPANSION_PER_K, range_k)
    source = f"{MEASURED}, and {ASSUMED}" if celsius else ASSUMED
    return Contribution("Thermal expansion", limit_mm, "rectangular", source, how, "4.3.7")


def _target(log: Log, noise_mm: float) -> list[Contribution]:
    """Return a corrected target's other contributions; none where robot and model are not known."""
    clouds_mm = visits_mm(log)
    reference = validation(log, [log.cell.grid.station]).get("chosen")
    if not clouds_mm or reference is None:
        return []
    visits = sum(len(cloud) for cloud in clouds_mm)
    scatter_mm = pooled_std_mm(clouds_mm)
    left_mm = rms(reference.error_mm)
    return [
        _strip(log),
        *_station_frame(log),
        Contribution("Model residual", remainder_mm(left_mm, scatter_mm), "normal", MEASURED,
                     f"{len(reference)} validated targets less repeatability", "4.2.2"),
        Contribution("Robot repeatability", remainder_mm(scatter_mm, noise_mm), "normal", MEASURED,
                     f"{visits} visits of {len(clouds_mm)} places less reading noise", "4.2.4"),
    ]  # fmt: skip


def _strip(log: Log) -> Contribution:
    again = log.select("repeat", how="strip", way="random")
    if len(again) > 1:
        along_mm = apply(log.matrix("world"), positions_mm(again)) @ log.cell.layout.rail_direction
        how = f"{len(again)} approaches of a station by the strip, along the rail"
        std_mm = float(along_mm.std(ddof=1))
        return Contribution("Strip", std_mm, "normal", MEASURED, how, "4.2.2", 1)
    tolerance_mm = log.cell.rail.strip_tolerance_mm
    how = f"the strip proved each hold within ±{tolerance_mm:g} mm, along the rail"
    return Contribution("Strip", tolerance_mm, "rectangular", MEASURED, how, "4.3.7", 1)


def _station_frame(log: Log) -> list[Contribution]:
    found_mm = [
        float(frame["tool_uncertainty_mm"])
        for frame in log.frames.values()
        if "tool_uncertainty_mm" in frame
    ]
    if not found_mm:
        return []
    how = "slide nests' scatter carried to the grid's centre, worst station"
    worst_mm = max(found_mm) / math.sqrt(3)  # the journal states the 3D length
    return [Contribution("Station frame", worst_mm, "normal", MEASURED, how, "5.2.2")]


def _check(log: Log, seen: Sequence[Contribution]) -> Check | None:
    """Compare with the other stations, whose errors no contribution was estimated from.

    Contributions that stay the same from calibration to validation (SMR, scale of the tracker)
    cannot show.
    """
    reference = log.cell.grid.station
    others = [station.name for station in log.cell.station if station.name != reference]
    found = validation(log, others).get("chosen")
    if found is None:
        return None
    return Check(combined_mm(seen), rms(found.error_mm), len(found))
