"""The limits by which the paper's rows hold, worked out from the run's own figures.

A limit that a correct run of another machine may cross by chance, or that no mistake crosses, is
no limit: so each is the paper's own figure, or follows from stated uncertainties or counts.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hilcell.calibration.errors import errors_of, targets
from hilcell.calibration.frames import grid_pairs
from hilcell.cell.file import Cell
from hilcell.compensation.interpolation import Idw
from hilcell.geometry.frames import apply, inverse, matrix, rigid_fit, three_point_frame
from hilcell.geometry.inverse import reachable
from hilcell.geometry.statistics import chi2_quantile, f_quantile, ranks, rms, variance_of_mean
from hilcell.journal.log import Log
from hilcell.model.point import Sent
from hilcell.ports import Array
from procedures.paper_figures import Experiments, Where, mean, place, transfer
from procedures.plan import other_stations
from procedures.rail_survey import BACK, FORTH
from procedures.repeatability import VISITS, distances_mm, floor, places_mm
from procedures.station_frames import (
    slide_in_world_mm,
    slide_noise_mm2,
    station_fit,
    tool_uncertainty_mm,
)

if TYPE_CHECKING:
    from hilcell.programs.holes import Holes

HOLE_PITCH_MM = 100.0


def stations_planned(cell: Cell) -> float:
    """Return how many stations the planner takes for the longest work piece."""
    from hilcell.programs.plan import plan  # loads long, and few runs judge the paper

    return float(len(plan(cell, longest_work_piece(cell)).stations))


def stations_needed(cell: Cell) -> float:
    """Return the fewest stations for the longest work piece, by trying every set of them."""
    ok = _reached(cell, longest_work_piece(cell).points_mm)
    for count in range(1, len(cell.station) + 1):
        for chosen in combinations(range(len(cell.station)), count):
            if ok[:, chosen].any(axis=1).all():
                return float(count)
    return np.nan


def longest_work_piece(cell: Cell) -> Holes:
    """Return three rows of holes along the rail, as far as the stations together reach.

    On the far face of the grid's cube, with the grid's orientation.
    """
    from hilcell.programs.holes import Holes

    arm, rails_mm = cell.robot.arm(), [station.rail_mm for station in cell.station]
    span_mm = float(np.abs(arm.a_mm).sum() + np.abs(arm.d_mm).sum())
    middle_mm, half_mm = cell.grid.centre.matrix()[:3, 3], np.array(cell.grid.size_mm) / 2
    rows_mm = middle_mm + half_mm * [[1.0, 0.0, -1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]]
    along_mm = np.arange(min(rails_mm) - span_mm, max(rails_mm) + span_mm, HOLE_PITCH_MM)
    steps_mm = along_mm[:, None] * np.array(cell.layout.rail_direction)
    points_mm = (apply(cell.layout.nominal_base(0.0), rows_mm)[:, None] + steps_mm).reshape(-1, 3)
    points_mm = points_mm[_reached(cell, points_mm).any(axis=1)]
    tools = np.broadcast_to(_tool(cell), (len(points_mm), 1, 3, 3))
    return Holes([f"H{number}" for number in range(len(points_mm))], points_mm, tools)


def _tool(cell: Cell) -> Array:
    return cell.layout.nominal_base(0.0)[:3, :3] @ cell.grid.centre.matrix()[:3, :3]


def _reached(cell: Cell, points_mm: Array) -> NDArray[np.bool_]:
    """Return which points (N, 3) in {W} which station serves, (N, S): robot and tracker."""
    poses = matrix(_tool(cell), points_mm)
    robot, tracker = cell.robot, cell.tracker
    home_rad, limits_rad = np.radians(robot.home_deg), robot.margin_limits_rad
    bases = [cell.layout.nominal_base(station.rail_mm) for station in cell.station]
    ok = np.column_stack(
        [
            reachable(robot.arm(), inverse(base) @ poses, robot.status, limits_rad, home_rad)
            for base in bases
        ]
    )
    range_mm = np.linalg.norm(points_mm - tracker.pose.matrix()[:3, 3], axis=1)
    seen = (range_mm >= tracker.min_range_mm + tracker.find_radius_mm) & (
        range_mm <= tracker.max_range_mm - tracker.find_radius_mm
    )
    served: NDArray[np.bool_] = ok & seen[:, None]
    return served


Limits = tuple[float, float]
Limit = Callable[[Log, Experiments], Limits]
INFINITE = float("inf")
K = 2.0  # coverage factor, about 95 % (GUM 6.3.3)
SURE = 0.999  # a correct run crosses a statistical limit once in a thousand
PERMUTATIONS = 999
PAPER_REFERENCE_MM, PAPER_OTHERS_MM = 0.1168, 0.16  # mean errors after, section 5
PAPER_LARGEST_MM = 0.3
FLOOR_SHARE = 0.8  # the floor is a mean of 30 distances and scatters by 8 %


def at_most(limit: float) -> Limit:
    """Return the limits of a row that holds up to ``limit``."""
    return lambda log, result: (-INFINITE, limit)


def between(low: float, high: float) -> Limit:
    """Return the limits of a row that holds from ``low`` to ``high``."""
    return lambda log, result: (low, high)


def by_every_set(log: Log, result: Experiments) -> Limits:
    """Return the fewest stations, found by trying every set of them."""
    fewest = stations_needed(log.cell)
    return fewest, fewest


def beyond_chance(log: Log, result: Experiments) -> Limits:
    """Return the rank correlation of which errors dealt to other vertices stay below.

    Mantel's test: pairs of vertices are not independent, so whole vertices are exchanged.
    """
    pairs, count = grid_pairs(log), len(log.select("grid"))
    one, other = np.triu_indices(count, 1)
    of_joints, of_errors = np.zeros((2, count, count))
    for square, each in ((of_joints, pairs.joint_rad), (of_errors, pairs.difference_mm)):
        square[one, other] = square[other, one] = ranks(each) - (len(each) + 1) / 2
    scale = np.linalg.norm(of_joints) * np.linalg.norm(of_errors)
    rng = np.random.default_rng(8)
    dealt = (rng.permutation(len(of_errors)) for _ in range(PERMUTATIONS))
    by_chance = [float(np.sum(of_joints * of_errors[np.ix_(p, p)])) / scale for p in dealt]
    return float(np.quantile(by_chance, SURE)), INFINITE


def plain_range(log: Log, result: Experiments) -> Limits:
    """Return the range of approaches from both sides: the survey's backlash and two landings.

    The backlash at the station may differ from the survey's mean as that does from stop to stop.
    """
    backlash, curve = result.rail_survey.backlash_mm, result.rail_survey.curve
    lost_mm = np.array(curve[BACK])[1:-1, 1] - np.array(curve[FORTH])[1:-1, 1]
    varies_mm = 3 * float(lost_mm.std(ddof=1))
    landing_mm = result.station_repeatability.one_side.plain.range_mm
    return backlash.value - varies_mm, backlash.value + varies_mm + 2 * landing_mm


def sign_residual(log: Log, result: Experiments) -> Limits:
    """Return the worst error after a right correction, over the error before.

    The largest residual of cross-validation, and the robot's repeatability (95 %).
    """
    left_mm = result.fit.loocv[result.method]["max"]
    visit_mm = floor(log).p95
    return -INFINITE, (left_mm + visit_mm) / result.sign.before_mm


def transfer_expanded(log: Log, result: Experiments) -> Limits:
    """Return the expanded uncertainty of the difference of eqs 13 and 17."""
    return -INFINITE, K * transfer(log, result)[1]


def circle_residual(log: Log, result: Experiments) -> Limits:
    """Return the rms residual of a circle that the robot's repeatability explains.

    Repeatability is that of the visits to the cube; a circle's residual has two coordinates.
    """
    variance_mm2 = rms(distances_mm(log)) ** 2 / 3
    visits_freedom = 3 * len(places_mm(log.cell)) * (VISITS - 1)
    circle_freedom = 2 * log.cell.base_frame.points - 6
    spread = f_quantile(SURE, circle_freedom, visits_freedom)
    return -INFINITE, float(np.sqrt(2 * variance_mm2 * spread))


def rigid_slide(log: Log, result: Experiments) -> Limits:
    """Return the tool point's uncertainty if the slide is rigid and its nests stay in place.

    That of the readings' noise alone, widened by the effect of chance on the fit's residuals.
    """
    cell, reference = log.cell, log.cell.station_named(log.cell.grid.station)
    at_reference_mm = slide_in_world_mm(log, reference)
    slide_mm = apply(inverse(three_point_frame(*at_reference_mm[:3])), at_reference_mm)
    freedom = 3 * len(slide_mm) - 6
    widened = float(np.sqrt(chi2_quantile(SURE, freedom) / freedom))
    by_noise_mm = []
    for station in (reference, *other_stations(cell)):
        T = station_fit(log, station, reference).T
        noise_mm2 = slide_noise_mm2(log, station) + slide_noise_mm2(log, reference)
        exact = rigid_fit(slide_mm, apply(T, slide_mm), weights=noise_mm2)
        by_noise_mm.append(tool_uncertainty_mm(cell, exact))
    return -INFINITE, widened * max(by_noise_mm)


def better_at_all(log: Log, result: Experiments) -> Limits:
    """Return the ratio from which its 95 % interval lies above 1.

    The paper's 4 is one draw of the same wide distribution: it compares few frames.
    """
    found = result.frame_repeatability
    return found.ratio / found.ratio_interval[0], INFINITE


def as_cross_validated(log: Log, result: Experiments) -> Limits:
    """Return the mean that cross-validation says, with three standard errors of both means.

    It is taken at twice the pitch, so the grid itself leaves less.
    """
    norms_mm = errors_of(log, targets(log, log.cell.grid.station, Sent.IDW)).norms_mm
    share = 3 * np.sqrt(2 * variance_of_mean(norms_mm)) / norms_mm.mean()
    return -INFINITE, (1 + share) * result.fit.loocv[Idw.name]["mean"]


def transferred(log: Log, result: Experiments) -> Limits:
    """Return the mean at the grid's station and, in squares, the paper's cost of the transfer."""
    here_mm = mean("reference", Sent.IDW)(log, result)
    return -INFINITE, float(np.sqrt(here_mm**2 + PAPER_OTHERS_MM**2 - PAPER_REFERENCE_MM**2))


def same_robot(log: Log, result: Experiments) -> Limits:
    """Return the mean at the grid's station +- three standard errors of the difference.

    It is the same robot: nominal targets carried by the stations' frames see the same errors.
    """
    reference = log.cell.grid.station
    others = [station.name for station in other_stations(log.cell)]
    tools_mm = [result.stations[name].tool_uncertainty_mm for name in others]
    variance_mm2 = max(tools_mm) ** 2
    for names in ([reference], others):
        points = [p for name in names for p in targets(log, name, Sent.BEFORE)]
        variance_mm2 += variance_of_mean(errors_of(log, points).norms_mm)
    mean_mm = mean("reference", Sent.BEFORE)(log, result)
    return mean_mm - 3 * np.sqrt(variance_mm2), mean_mm + 3 * np.sqrt(variance_mm2)


def largest_of_many(log: Log, result: Experiments) -> Limits:
    """Return the paper's 0.3, or the size that the largest of so many errors has by chance.

    For normal errors in 3-D their norms follow Maxwell's law: the largest of 135 stays below 3.3
    times their mean in all runs but one in a thousand, and below 2.2 times in every second run.
    """
    count = place(log, result, "reference").points
    mean_mm = mean("reference", Sent.IDW)(log, result)
    of_all = np.sqrt(8.0 / np.pi)  # mean of Maxwell's law with unit standard deviation
    largest = float(np.sqrt(chi2_quantile(SURE ** (1 / count), 3)) / of_all)
    return -INFINITE, max(PAPER_LARGEST_MM, largest * mean_mm)


def reduced(where: Where) -> Limit:
    """Return the paper's "about 85 %", up to the share that the robot's repeatability allows."""

    def limits(log: Log, result: Experiments) -> Limits:
        before_mm = mean(where, Sent.BEFORE)(log, result)
        return 0.85, 1.0 - FLOOR_SHARE * floor(log).mean / before_mm

    return limits
