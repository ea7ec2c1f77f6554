"""The paper's figures beside ours, row by row, each with the criterion by which it holds.

`Row.holds` is one of four: *at most* a limit, *at least* a limit, *between* two values, or
*within* a share of the paper's figure. A row without a figure of the paper states a fact of its
mathematics and its own limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hilcell.calibration import Frames, grid_of, grid_pairs
from hilcell.compensation.interpolation import idw_weights
from hilcell.geometry.frames import apply
from hilcell.geometry.jacobian import PARAMETERS, moved, parameter_jacobian
from hilcell.geometry.kinematics import forward
from hilcell.planning.holes import Holes
from hilcell.planning.plan import plan
from hilcell.ports import Array
from hilcell.run.log import Log, Point

INFINITE = float("inf")


@dataclass(frozen=True, slots=True)
class Row:
    """One figure: its name, the paper's value, its unit, where ours is found, when it holds."""

    name: str
    paper: float | None
    unit: str
    here: Callable[[Log, dict[str, Any]], float]
    low: float
    high: float

    def judged(self, log: Log, result: dict[str, Any]) -> dict[str, Any]:
        """Return the row as it is reported."""
        here = self.here(log, result)
        return {
            "row": self.name,
            "paper": self.paper,
            "here": here,
            "unit": self.unit,
            "holds": bool(self.low <= here <= self.high),
            "criterion": self.criterion,
        }

    @property
    def criterion(self) -> str:
        """Return the criterion in words."""
        if np.isinf(self.high):
            return f">= {self.low:g}"
        if np.isinf(self.low):
            return f"<= {self.high:g}"
        return f"{self.low:g} .. {self.high:g}"


def at_most(name: str, paper: float | None, unit: str, here: Any, limit: float) -> Row:
    """Return a row that holds up to ``limit``."""
    return Row(name, paper, unit, here, -INFINITE, limit)


def at_least(name: str, paper: float | None, unit: str, here: Any, limit: float) -> Row:
    """Return a row that holds from ``limit`` on."""
    return Row(name, paper, unit, here, limit, INFINITE)


def between(name: str, paper: float | None, unit: str, here: Any, low: float, high: float) -> Row:
    """Return a row that holds from ``low`` to ``high``."""
    return Row(name, paper, unit, here, low, high)


def stations_needed(log: Log, result: dict[str, Any]) -> float:
    """Return the fewest stations for holes all over the work of all stations (section 2)."""
    cell = log.cell
    vertices_mm = grid_of(cell).serpentine_mm()
    bases = [cell.layout.nominal_base(station.rail_mm) for station in cell.station]
    points_mm = np.concatenate([apply(base, vertices_mm) for base in bases])
    tool = bases[0][:3, :3] @ cell.grid.centre.matrix()[:3, :3]
    tools = np.broadcast_to(tool, (len(points_mm), 1, 3, 3))
    names = [f"H{number}" for number in range(len(points_mm))]
    return float(len(plan(cell, Holes(names, points_mm, tools)).stations))


def jacobian_error(log: Log, result: dict[str, Any]) -> float:
    """Return how far eqs 1-7 are from central differences at the grid's vertices, relative."""
    arm = log.cell.robot.arm()
    joints_rad = commanded_rad(log.group("grid"))
    analytic = parameter_jacobian(arm, joints_rad)[:, :3, :]
    worst = 0.0
    for column, parameter in enumerate(PARAMETERS):
        step = 1e-2 if "_mm" in parameter else 1e-5
        ends = [
            forward(moved(arm, column, sign * step), joints_rad)[:, :3, 3] for sign in (1.0, -1.0)
        ]
        numeric = (ends[0] - ends[1]) / (2 * step)
        scale = max(float(np.abs(numeric).max()), 1.0)
        worst = max(worst, float(np.abs(analytic[:, :, column] - numeric).max()) / scale)
    return worst


def commanded_rad(points: list[Point]) -> Array:
    """Return the commanded joints (N, 6)."""
    joints_deg: Array = np.array([point.commanded_deg for point in points], dtype=float)
    return np.radians(joints_deg)


def similarity_rank(log: Log, result: dict[str, Any]) -> float:
    """Return the rank correlation of joint distance and error difference over the vertices."""
    from scipy import stats

    pairs = grid_pairs(log)
    return float(stats.spearmanr(pairs.joint_rad, pairs.difference_mm).statistic)


def weights_off_one(log: Log, result: dict[str, Any]) -> float:
    """Return how far eq 9's weights are from a sum of 1, and from 1/8 at a cell's centre."""
    places = np.random.default_rng(9).uniform(size=(1000, 3))
    off = np.abs(idw_weights(places, log.cell.grid.pitch_mm).sum(axis=1) - 1.0).max()
    centre = np.abs(idw_weights(np.full((1, 3), 0.5), 1.0) - 0.125).max()
    return float(max(off, centre))


def transfer_difference(log: Log, result: dict[str, Any]) -> float:
    """Return how far eq 13 by base frames is from eq 17 by station frames, at the cube (mm)."""
    frames, centre = Frames(log.cell, log), log.cell.grid.centre.matrix()[None, :3, 3]
    others = [s for s in log.cell.station if s.name != log.cell.grid.station]
    off = [
        apply(log.matrix(f"base.{each.name}"), centre) - apply(frames.base_in_world(each), centre)
        for each in others
    ]
    return float(np.linalg.norm(off, axis=-1).max())


def lowest_temperature(log: Log, result: dict[str, Any]) -> float:
    """Return the lowest temperature of all points."""
    return min(point.temperature_c for point in log.points.values())


def highest_temperature(log: Log, result: dict[str, Any]) -> float:
    """Return the highest temperature of all points."""
    return max(point.temperature_c for point in log.points.values())


def tracker_scatter(log: Log, result: dict[str, Any]) -> float:
    """Return the tracker's mean 1-sigma of one reading of a slide nest, root of the mean axis."""
    variance = [np.mean(np.square(point.std_mm)) for point in log.group("frames")]
    return float(np.sqrt(np.mean(variance)))


def validation(where: str, label: str, figure: str) -> Callable[[Log, dict[str, Any]], float]:
    """Return where a figure of the validation stands."""

    def here(log: Log, result: dict[str, Any]) -> float:
        place = log.cell.grid.station if where == "reference" else where
        return float(result["validation"][place][label][figure])

    return here


def reduction(where: str) -> Callable[[Log, dict[str, Any]], float]:
    """Return by which share the paper's method lowers the mean error (abstract)."""
    before, after = validation(where, "before", "mean"), validation(where, "idw", "mean")
    return lambda log, result: 1.0 - after(log, result) / before(log, result)


def count(group: str) -> Callable[[Log, dict[str, Any]], float]:
    """Return how many points a group has."""
    return lambda log, result: float(result["points"][group])


def cells(log: Log, result: dict[str, Any]) -> float:
    """Return how many cells the grid has."""
    return float(np.prod(np.array(grid_of(log.cell).shape) - 1))


def targets(where: str) -> Callable[[Log, dict[str, Any]], float]:
    """Return how many targets were validated."""
    return lambda log, result: float(
        result["validation"][log.cell.grid.station if where == "reference" else where]["points"]
    )


ROWS = (
    between("fig1.error.max", 0.5, "mm", lambda log, r: r["rail_survey"]["max_error_mm"], 0.3, 0.7),
    between(
        "fig1.backlash", 0.2, "mm", lambda log, r: r["rail_survey"]["backlash_mm"]["value"],
        0.18, 0.22,
    ),
    between("fig2.stations", 3, "", stations_needed, 1, 3),
    at_most("eq1-7.jacobian", None, "", jacobian_error, 1e-6),
    at_least("eq8.similarity", None, "", similarity_rank, 0.3),
    at_most("eq9.weights", None, "", weights_off_one, 1e-12),
    at_most("sec3.3.sign", None, "", lambda log, r: r["sign"]["ratio"], 0.5),
    at_most("eq13-17.transfer", None, "mm", transfer_difference, 0.4),
    at_most("fig6.circle.rms", None, "mm", lambda log, r: max(r["base"]["circle_rms_mm"]), 0.08),
    at_most(
        "fig7.tool.u", None, "mm",
        lambda log, r: max(each["tool_uncertainty_mm"] for each in r["stations"].values()), 0.05,
    ),
    at_least("fig8.ratio", 4, "", lambda log, r: r["frame_repeatability"]["ratio"], 3),
    at_most(
        "fig10.strip.range", 0.035, "mm",
        lambda log, r: r["station_repeatability"]["strip"]["range_mm"], 0.035,
    ),
    between(
        "fig10.plain.range", 0.2, "mm",
        lambda log, r: r["station_repeatability"]["plain"]["range_mm"], 0.15, 0.3,
    ),
    between("fig10.repeats", 15, "", lambda log, r: r["station_repeatability"]["repeats"], 15, 15),
    between("sec5.1.temperature.min", 22, "C", lowest_temperature, 21.9, 24.1),
    between("sec5.1.temperature.max", 24, "C", highest_temperature, 21.9, 24.1),
    at_most("sec5.1.tracker", 0.015, "mm", tracker_scatter, 0.015),
    between("fig11.vertices", 64, "", count("grid"), 64, 64),
    between("fig11.cells", 27, "", cells, 27, 27),
    between("fig12.targets", 135, "", targets("reference"), 135, 135),
    between(
        "fig12.before.mean", 1.2092, "mm", validation("reference", "before", "mean"), 1.09, 1.33
    ),
    between("fig12.after.mean", 0.1168, "mm", validation("reference", "idw", "mean"), 0.09, 0.15),
    between("fig13.targets", 150, "", targets("others"), 150, 150),
    between("fig13.before.mean", 1.2511, "mm", validation("others", "before", "mean"), 1.0, 1.5),
    between("fig13.after.mean", 0.16, "mm", validation("others", "idw", "mean"), 0.11, 0.20),
    between("abstract.before.max", 2.0, "mm", validation("reference", "before", "max"), 1.2, 2.4),
    at_most("abstract.after.max", 0.3, "mm", validation("reference", "chosen", "max"), 0.35),
    at_least("abstract.reduction.reference", 0.90, "", reduction("reference"), 0.85),
    at_least("abstract.reduction.others", 0.87, "", reduction("others"), 0.85),
)  # fmt: skip
