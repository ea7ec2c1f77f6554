"""The whole paper in one run: every system and experiment, its figure beside ours.

Our figures come from the run's journal alone. Each limit is the paper's own figure, or follows from
stated uncertainties or counts: one that a correct run may exceed by chance, or that no mistake
exceeds, is no limit. A row determined by cell file or simulated machine is "set": it cannot fail.
Every other row names a mistake that fails it (`Row.fails`), and a test makes that mistake.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from operator import attrgetter
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from hilcell.calibration.frames import Frames, axis_6_height_mm, axis_circle
from hilcell.calibration.grid import grid_errors_mm, grid_of, grid_pairs
from hilcell.calibration.position_errors import position_errors, targets
from hilcell.calibration.position_errors import reduction as share_removed
from hilcell.cell.file import Cell
from hilcell.compensation.grid import Grid
from hilcell.compensation.interpolation import Idw
from hilcell.decoding import typed
from hilcell.geometry.frames import (
    apply,
    base_frame_covariance,
    inverse,
    matrix,
    point_variance_mm2,
    rigid_fit,
    three_point_frame,
)
from hilcell.geometry.jacobian import moved, parameter_jacobian, parameters
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import (
    chi2_quantile,
    f_quantile,
    lengths_mm,
    ranks,
    rms,
    variance_of_mean,
)
from hilcell.journal.log import Log, positions_mm
from hilcell.model.plan import PlannedStep
from hilcell.model.point import Point, PointId, Sent
from hilcell.model.results import Calibrated, FramesRepeated, PaperRow, Place, SurveyedRail
from hilcell.ports import Array, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result, Step
from procedures.axis_sweeps import AxisSweeps
from procedures.base_frame import BaseFrame, FramedBase
from procedures.fit import Choice, Fit, SignCheck, SignErrors
from procedures.plan import other_stations, stations_in_order
from procedures.rail import (
    BACK,
    FORTH,
    HoldStation,
    RailSurvey,
    StationRepeatability,
    StationRepeated,
)
from procedures.repeatability import VISITS, Repeatability
from procedures.robot_grid import RobotGrid
from procedures.station_frames import (
    FrameRepeatability,
    StationFrames,
    pair_noise_mm2,
    slide_in_world_mm,
    station_fit,
    tool_uncertainty_mm,
)
from procedures.validate import Validate
from procedures.world_frame import Home, WorldFrame

if TYPE_CHECKING:
    from hilcell.programs.holes import Holes


# -- our figures ----------------------------------------------------------------------------------


class Experiments(Calibrated, frozen=True, kw_only=True):
    """The results of all experiments."""

    base: FramedBase
    rail_survey: SurveyedRail
    station_repeatability: StationRepeated
    frame_repeatability: FramesRepeated
    fit: Choice
    sign: SignErrors


Where = Literal["reference", "others"]
Limits = tuple[float, float]
SURE = 0.999  # a correct run crosses a statistical limit once in a thousand
PAPER_REFERENCE_MM, PAPER_OTHERS_MM = 0.1168, 0.16  # mean errors after, section 5


@dataclass(frozen=True, eq=False)
class Compared:
    """A run beside the paper: our figures, and the limits within which they hold."""

    log: Log
    result: Experiments

    def place(self, where: Where) -> Place:
        own = self.log.cell.grid.station
        return self.result.validation[own if where == "reference" else where]

    def mean(self, where: Where, how: Sent) -> float:
        return self.place(where).sent[how].mean

    def largest(self, how: Sent) -> float:
        return self.place("reference").sent[how].max

    def reduction(self, where: Where, how: Sent = Sent.IDW) -> float:
        return share_removed(self.mean(where, Sent.BEFORE), self.mean(where, how))

    def jacobian_error(self) -> float:
        """Return how far eqs 1-7 are from central differences at the grid's vertices, relative."""
        arm = self.log.cell.robot.arm()
        joints_rad = self.commanded_rad(self.log.select("grid"))
        analytic = parameter_jacobian(arm, joints_rad)[:, :3, :]
        worst = 0.0
        for column, parameter in enumerate(parameters(arm)):
            step = 1e-2 if "_mm" in parameter else 1e-5
            ends = [
                forward(moved(arm, column, sign * step), joints_rad)[:, :3, 3]
                for sign in (1.0, -1.0)
            ]
            numeric = (ends[0] - ends[1]) / (2 * step)
            scale = max(float(np.abs(numeric).max()), 1.0)
            worst = max(worst, float(np.abs(analytic[:, :, column] - numeric).max()) / scale)
        return worst

    def similarity_rank(self) -> float:
        """Return the rank correlation of joint distance and error difference over the vertices."""
        pairs = grid_pairs(self.log)
        return float(np.corrcoef(ranks(pairs.joint_rad), ranks(pairs.difference_mm))[0, 1])

    def beyond_chance(self) -> Limits:
        """Upper limit of the rank correlation of errors assigned to other vertices. Mantel's test:
        pairs of vertices are not independent, so whole vertices are exchanged.
        """
        pairs, count, permutations = grid_pairs(self.log), len(self.log.select("grid")), 999
        one, other = np.triu_indices(count, 1)
        of_joints, of_errors = np.zeros((2, count, count))
        for square, each in ((of_joints, pairs.joint_rad), (of_errors, pairs.difference_mm)):
            square[one, other] = square[other, one] = ranks(each) - (len(each) + 1) / 2
        scale = np.linalg.norm(of_joints) * np.linalg.norm(of_errors)
        rng = np.random.default_rng(8)
        dealt = (rng.permutation(len(of_errors)) for _ in range(permutations))
        by_chance = [float(np.sum(of_joints * of_errors[np.ix_(p, p)])) / scale for p in dealt]
        return float(np.quantile(by_chance, SURE)), math.inf

    def interpolation_off_mm(self) -> float:
        """Difference of the commands sent from eqs 9-10 as printed in the paper (mm).

        P_cmd = P - e(P_cmd) in two steps, where e is computed here from the 8 vertices within a
        pitch. Two steps, not the limit: at a face between cells e jumps (0.1 mm is common), so that
        a target near a face may have no exact P_cmd.
        """
        log = self.log
        points = log.select("validate", log.cell.grid.station, how=Sent.IDW)
        nominal_mm = np.array([point.nominal_mm for point in points])
        target_mm = apply(inverse(log.matrix("base")), nominal_mm)
        sent_mm = forward(log.cell.robot.arm(), self.commanded_rad(points))[:, :3, 3]
        grid, errors_mm = grid_of(log.cell), grid_errors_mm(log)
        once_mm = target_mm - self._by_eqs_9_10(grid, errors_mm, target_mm)
        twice_mm = target_mm - self._by_eqs_9_10(grid, errors_mm, grid.clamped(once_mm))
        return float(lengths_mm(sent_mm - twice_mm).max())

    def transfer(self) -> tuple[float, float]:
        """Eq 13 by base frames against eq 17 by station frames, and its u, at the cube (mm). At the
        station with the largest 3-D difference for its u (1 sigma, root of the trace).
        """
        log, cell = self.log, self.log.cell
        frames, centre_mm = Frames(cell, log), cell.grid.centre.matrix()[:3, 3]
        reference_mm2 = point_variance_mm2(log.matrix("base"), log.frames["base"].C, centre_mm)
        found = []
        for station in other_stations(cell):
            by_bases, by_slide = log.matrix(f"base.{station.name}"), frames.base_in_world(station)
            off_mm = apply(by_bases, centre_mm[None]) - apply(by_slide, centre_mm[None])
            axis_1, axis_6 = (
                axis_circle(cell, log, axis, log.select("frames", station.name, axis=axis))
                for axis in (1, 6)
            )
            covariance = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(cell))
            u_mm = np.sqrt(
                reference_mm2
                + point_variance_mm2(by_bases, covariance, centre_mm)
                + self.result.stations[station.name].tool_uncertainty_mm ** 2
            )
            found.append((float(np.linalg.norm(off_mm)), float(u_mm)))
        return max(found, key=lambda each: each[0] / each[1])

    def nests_moved_mm(self) -> float:
        """Return how far fixed floor nests were found from their first places: 3-D, rms."""
        again = self.log.select("control")
        first = [self.log.point(PointId("world", nest=point.id.nest)) for point in again]
        return rms(lengths_mm(positions_mm(again) - positions_mm(first)))

    def stations_planned(self) -> float:
        from hilcell.programs.plan import plan  # loads long, and few runs judge the paper

        return float(len(plan(self.log.cell, self._longest_work_piece(self.log.cell)).stations))

    def by_every_set(self) -> Limits:
        """Return the fewest stations for the longest work piece, by trying every set of them."""
        cell = self.log.cell
        ok = self._reached(cell, self._longest_work_piece(cell).points_mm)
        for count in range(1, len(cell.station) + 1):
            for chosen in combinations(range(len(cell.station)), count):
                if ok[:, chosen].any(axis=1).all():
                    return float(count), float(count)
        return np.nan, np.nan

    def plain_range(self) -> Limits:
        """Range of approaches from both sides: the survey's backlash and two landings. The backlash
        at the station may differ from the survey's mean as that does from stop to stop.
        """
        backlash, curve = self.result.rail_survey.backlash_mm, self.result.rail_survey.curve
        lost_mm = np.array(curve[BACK])[1:-1, 1] - np.array(curve[FORTH])[1:-1, 1]
        varies_mm = 3 * float(lost_mm.std(ddof=1))
        landing_mm = self.result.station_repeatability.one_side.plain.range_mm
        return backlash.value - varies_mm, backlash.value + varies_mm + 2 * landing_mm

    def sign_residual(self) -> Limits:
        """Return the worst error after a right correction, over the error before.

        The largest residual of cross-validation, and the robot's repeatability (95 %).
        """
        left_mm = self.result.fit.loocv[self.result.method]["max"]
        return -math.inf, (left_mm + Repeatability.floor(self.log).p95) / self.result.sign.before_mm

    def circle_residual(self) -> Limits:
        """Return the rms residual of a circle that the robot's repeatability explains.

        Repeatability is that of the visits to the cube; a circle's residual has two coordinates.
        """
        variance_mm2 = rms(Repeatability.distances_mm(self.log)) ** 2 / 3
        visits_freedom = 3 * len(Repeatability.places_mm(self.log.cell)) * (VISITS - 1)
        circle_freedom = 2 * self.log.cell.base_frame.points - 6
        spread = f_quantile(SURE, circle_freedom, visits_freedom)
        return -math.inf, float(np.sqrt(2 * variance_mm2 * spread))

    def rigid_slide(self) -> Limits:
        """Return the tool point's uncertainty if the slide is rigid and its nests stay in place.

        That of the readings' noise alone, widened by the effect of chance on the fit's residuals.
        """
        log, cell = self.log, self.log.cell
        at_reference_mm = slide_in_world_mm(log, cell.reference)
        slide_mm = apply(inverse(three_point_frame(*at_reference_mm[:3])), at_reference_mm)
        freedom = 3 * len(slide_mm) - 6
        widened = float(np.sqrt(chi2_quantile(SURE, freedom) / freedom))
        by_noise_mm = []
        for station in stations_in_order(cell):
            T, noise_mm2 = station_fit(log, station).T, pair_noise_mm2(log, station)
            exact = rigid_fit(slide_mm, apply(T, slide_mm), weights=noise_mm2)
            by_noise_mm.append(tool_uncertainty_mm(cell, exact))
        return -math.inf, widened * max(by_noise_mm)

    def better_at_all(self) -> Limits:
        """Return the ratio from which its 95 % interval lies above 1.

        The paper's 4 is one draw of the same wide distribution: it compares few frames.
        """
        found = self.result.frame_repeatability
        return found.ratio / found.ratio_interval[0], math.inf

    def as_cross_validated(self) -> Limits:
        """Return the mean that cross-validation says, with three standard errors of both means.

        It is taken at twice the pitch, so the grid itself leaves less.
        """
        station = self.log.cell.grid.station
        norms_mm = position_errors(self.log, targets(self.log, station, Sent.IDW)).norms_mm
        share = 3 * np.sqrt(2 * variance_of_mean(norms_mm)) / norms_mm.mean()
        return -math.inf, (1 + share) * self.result.fit.loocv[Idw.name]["mean"]

    def transferred(self) -> Limits:
        """The mean at the grid's station plus, in quadrature, the paper's transfer error."""
        here_mm = self.mean("reference", Sent.IDW)
        return -math.inf, float(np.sqrt(here_mm**2 + PAPER_OTHERS_MM**2 - PAPER_REFERENCE_MM**2))

    def same_robot(self) -> Limits:
        """Return the mean at the grid's station +- three standard errors of the difference.

        It is the same robot: nominal targets carried by the stations' frames see the same errors.
        """
        log, reference = self.log, self.log.cell.grid.station
        others = [station.name for station in other_stations(log.cell)]
        tools_mm = [self.result.stations[name].tool_uncertainty_mm for name in others]
        variance_mm2 = max(tools_mm) ** 2
        for names in ([reference], others):
            points = [p for name in names for p in targets(log, name, Sent.BEFORE)]
            variance_mm2 += variance_of_mean(position_errors(log, points).norms_mm)
        mean_mm = self.mean("reference", Sent.BEFORE)
        return mean_mm - 3 * np.sqrt(variance_mm2), mean_mm + 3 * np.sqrt(variance_mm2)

    def largest_of_many(self) -> Limits:
        """The paper's 0.3, or the size that the largest of so many errors has by chance.

        For normal errors in 3-D their norms follow Maxwell's law: the largest of 135 is below 3.3
        times their mean in all runs but one in a thousand, and below 2.2 times in every second run.
        """
        count, mean_mm = self.place("reference").points, self.mean("reference", Sent.IDW)
        of_all = np.sqrt(8.0 / np.pi)  # mean of Maxwell's law with unit standard deviation
        largest = float(np.sqrt(chi2_quantile(SURE ** (1 / count), 3)) / of_all)
        return -math.inf, max(0.3, largest * mean_mm)

    def reduced(self, where: Where) -> Limits:
        """Return the paper's "about 85 %", up to the share that repeatability allows."""
        share = 0.8  # the floor is a mean of 30 distances and scatters by 8 %
        floor_mm = Repeatability.floor(self.log).mean
        return 0.85, 1.0 - share * floor_mm / self.mean(where, Sent.BEFORE)

    @staticmethod
    def _by_eqs_9_10(grid: Grid, errors_mm: Array, points_mm: Array) -> Array:
        """Return e (N, 3) at points (N, 3) that are no vertices, by eqs 9-10 word for word."""
        vertices_mm, vertex_errors_mm = grid.vertices_mm().reshape(-1, 3), errors_mm.reshape(-1, 3)
        found = []
        for point in points_mm:
            corners = (np.abs(vertices_mm - point) <= grid.pitch_mm).all(axis=1)
            nearness = 1.0 / np.linalg.norm(vertices_mm[corners] - point, axis=1)
            found.append(nearness / nearness.sum() @ vertex_errors_mm[corners])
        return np.array(found)

    @staticmethod
    def _longest_work_piece(cell: Cell) -> Holes:
        """Return three rows of holes along the rail, as far as the stations together reach.

        On the far face of the grid's cube, with the grid's orientation.
        """
        from hilcell.programs.holes import Holes

        pitch_mm = 100.0
        arm, rails_mm = cell.robot.arm(), [station.rail_mm for station in cell.station]
        span_mm = float(np.abs(arm.a_mm).sum() + np.abs(arm.d_mm).sum())
        middle_mm, half_mm = cell.grid.centre.matrix()[:3, 3], np.array(cell.grid.size_mm) / 2
        rows_mm = middle_mm + half_mm * [[1.0, 0.0, -1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]]
        along_mm = np.arange(min(rails_mm) - span_mm, max(rails_mm) + span_mm, pitch_mm)
        steps_mm = along_mm[:, None] * np.array(cell.layout.rail_direction)
        points_mm = (apply(cell.layout.nominal_base(0.0), rows_mm)[:, None] + steps_mm).reshape(
            -1, 3
        )
        points_mm = points_mm[Compared._reached(cell, points_mm).any(axis=1)]
        tools = np.broadcast_to(Compared._tool(cell), (len(points_mm), 1, 3, 3))
        return Holes([f"H{number}" for number in range(len(points_mm))], points_mm, tools)

    @staticmethod
    def _reached(cell: Cell, points_mm: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) in {W} which station serves, (N, S): robot and tracker."""
        poses, robot = matrix(Compared._tool(cell), points_mm), cell.robot.nominal()
        tracker = cell.tracker
        bases = [cell.layout.nominal_base(station.rail_mm) for station in cell.station]
        ok = np.column_stack([robot.reachable(inverse(base) @ poses) for base in bases])
        range_mm = np.linalg.norm(points_mm - tracker.pose.matrix()[:3, 3], axis=1)
        visible = (range_mm >= tracker.min_range_mm + tracker.find_radius_mm) & (
            range_mm <= tracker.max_range_mm - tracker.find_radius_mm
        )
        served: NDArray[np.bool_] = ok & visible[:, None]
        return served

    @staticmethod
    def commanded_rad(points: list[Point]) -> Array:
        """Return the commanded joints (N, 6)."""
        joints_deg: Array = np.array([point.commanded_deg for point in points], dtype=float)
        return np.radians(joints_deg)

    @staticmethod
    def _tool(cell: Cell) -> Array:
        return cell.layout.nominal_base(0.0)[:3, :3] @ cell.grid.centre.matrix()[:3, :3]


# -- rows -----------------------------------------------------------------------------------------

Figure = Callable[[Compared], float]


@dataclass(frozen=True, slots=True)
class Row:
    """One figure: its name, the paper's value, its unit, source of ours, and criterion.

    ``set_by``: the cause of a set figure; a machine sets it only if simulated. ``chosen``: the same
    figure of the chosen correction; it is not judged.
    """

    name: str
    paper: float | None
    unit: str
    here: Figure
    limits: Limits | Callable[[Compared], Limits]
    fails: str = ""
    set_by: Literal["", "cell file", "simulation"] = ""
    chosen: Figure | None = None

    def judged(self, log: Log, result: Experiments) -> PaperRow:
        run = Compared(log, result)
        here = float(self.here(run))
        low, high = self.limits(run) if callable(self.limits) else self.limits
        is_set = self.set_by == "cell file" or (bool(self.set_by) and log.inputs.simulated)
        return PaperRow(
            row=self.name,
            paper=self.paper,
            here=here,
            chosen=None if self.chosen is None else self.chosen(run),
            unit=self.unit,
            holds=is_set or bool(low <= here <= high),
            set=is_set,
            criterion=self.set_by if is_set else self._criterion(low, high),
            fails="" if is_set else self.fails,
        )

    @staticmethod
    def _criterion(low: float, high: float) -> str:
        if low == high:
            return f"= {low:.4g}"
        if np.isinf(high):
            return f">= {low:.4g}"
        if np.isinf(low):
            return f"<= {high:.4g}"
        return f"{low:.4g} .. {high:.4g}"

    @staticmethod
    def by_cell(name: str, paper: float, here: Figure) -> Row:
        return Row(name, paper, "", here, (paper, paper), set_by="cell file")


ROWS = (
    Row(
        "fig1.error.max", 0.5, "mm", lambda run: run.result.rail_survey.max_error_mm,
        (0.3, 0.7),  # one of the two ways has the backlash of 0.2 more than the other
        "the way back is read in the order of the way there",
    ),
    Row(
        "fig1.backlash", 0.2, "mm", lambda run: run.result.rail_survey.backlash_mm.value,
        (0.15, 0.25),  # "about 0.2", to its digit
        "the way back is approached from the same side as the way there",
    ),
    Row(
        "fig2.stations", 3, "", Compared.stations_planned, Compared.by_every_set,
        "every hole takes its closest station, also where fewer stations reach all holes",
    ),
    Row(
        "eq1-7.jacobian", None, "", Compared.jacobian_error,
        (-math.inf, 1e-6),  # of central differences, relative
        "a link's error stays in its own frame, or R_T d^n is left out (eq 6)",
    ),
    Row(
        "eq8.similarity", None, "", Compared.similarity_rank, Compared.beyond_chance,
        "errors are paired with the joints of other vertices",
    ),
    Row(
        "eq9.weights", None, "mm", Compared.interpolation_off_mm,
        (-math.inf, 0.001),  # the tracker's resolution
        "the nearest 8 of the whole grid are taken instead of the cell's 8, or weights 1/d^2",
    ),
    Row(
        "sec3.3.sign", None, "", lambda run: run.result.sign.ratio, Compared.sign_residual,
        "the error is added instead of subtracted, or half of it is taken off",
    ),
    Row(
        "eq13-17.transfer", None, "mm", lambda run: run.transfer()[0],
        lambda run: (-math.inf, 2.0 * run.transfer()[1]),
        "the slide is shifted by the strip's travel alone, or eq 17's factors are exchanged",
    ),
    Row(
        "fig6.circle.rms", None, "mm",
        lambda run: max(run.result.base.circle_rms_mm), Compared.circle_residual,
        "another axis still moves when a point of a sweep is measured",
    ),
    Row(
        "fig7.tool.u", None, "mm",
        lambda run: max(each.tool_uncertainty_mm for each in run.result.stations.values()),
        Compared.rigid_slide,
        "a nest that was moved between two stations stays in the fit",
    ),
    Row(
        "fig8.ratio", 4, "", lambda run: run.result.frame_repeatability.ratio,
        Compared.better_at_all,
        "the station's frame is built from the robot's circles, or frames are exchanged",
    ),
    Row(
        "fig10.strip.range", 0.035, "mm",
        lambda run: run.result.station_repeatability.strip.range_mm, (-math.inf, 0.035),
        "the loop of the strip is off",
    ),
    Row(
        "fig10.plain.range", 0.2, "mm", lambda run: run.result.station_repeatability.plain.range_mm,
        Compared.plain_range,
        "all approaches come from one side, so that backlash is not seen",
    ),
    Row.by_cell("fig10.repeats", 15, lambda run: run.result.station_repeatability.repeats),
    Row(
        "sec5.1.temperature.min", 22, "C", lambda run: min(run.log.temperatures_c()),
        (21.9, 24.1), "the laboratory is not the paper's", "simulation",
    ),
    Row(
        "sec5.1.temperature.max", 24, "C", lambda run: max(run.log.temperatures_c()),
        (21.9, 24.1), "the laboratory is not the paper's", "simulation",
    ),
    Row(
        "sec5.1.tracker", 0.015, "mm", Compared.nests_moved_mm, (-math.inf, 0.015),
        "single readings are taken instead of means, or the tracker moved during the run",
    ),
    Row.by_cell("fig11.vertices", 64, lambda run: run.result.points["grid"]),
    Row.by_cell(
        "fig11.cells", 27,
        lambda run: math.prod(count - 1 for count in grid_of(run.log.cell).shape),
    ),
    Row.by_cell("fig12.targets", 135, lambda run: run.place("reference").points),
    Row(
        "fig12.before.mean", 1.2092, "mm", lambda run: run.mean("reference", Sent.BEFORE),
        (1.09, 1.33), "the robot is not the paper's", "simulation",
    ),
    Row(
        "fig12.after.mean", 0.1168, "mm", lambda run: run.mean("reference", Sent.IDW),
        Compared.as_cross_validated,
        "the correction is not sent, has the wrong sign or two axes exchanged",
        chosen=lambda run: run.mean("reference", Sent.CHOSEN),
    ),
    Row.by_cell("fig13.targets", 150, lambda run: run.place("others").points),
    Row(
        "fig13.before.mean", 1.2511, "mm", lambda run: run.mean("others", Sent.BEFORE),
        Compared.same_robot,
        "targets are placed by the cell file's base instead of the measured frames",
    ),
    Row(
        "fig13.after.mean", 0.16, "mm", lambda run: run.mean("others", Sent.IDW),
        Compared.transferred,
        "targets or measured data are carried by the strip's travel alone",
        chosen=lambda run: run.mean("others", Sent.CHOSEN),
    ),
    Row(
        "abstract.before.max", 2.0, "mm", lambda run: run.largest(Sent.BEFORE),
        (1.2, 2.4), "the robot is not the paper's", "simulation",
    ),
    Row(
        "abstract.after.max", 0.3, "mm", lambda run: run.largest(Sent.IDW),
        Compared.largest_of_many,
        "one target is sent without its correction, or one vertex is wrong by 2 mm",
        chosen=lambda run: run.largest(Sent.CHOSEN),
    ),
    Row(
        "abstract.reduction.reference", 0.90, "", lambda run: run.reduction("reference"),
        lambda run: run.reduced("reference"),
        "a part of the correction is lost; or squares are averaged, which beats the floor",
        chosen=lambda run: run.reduction("reference", Sent.CHOSEN),
    ),
    Row(
        "abstract.reduction.others", 0.87, "", lambda run: run.reduction("others"),
        lambda run: run.reduced("others"),
        "a part of the correction is lost on the way to another station",
        chosen=lambda run: run.reduction("others", Sent.CHOSEN),
    ),
)  # fmt: skip


# -- the procedure --------------------------------------------------------------------------------

EXPERIMENTS: tuple[Step, ...] = (
    Home(),
    WorldFrame(),
    RailSurvey(),
    StationRepeatability(),
    HoldStation(),
    BaseFrame(),
    RobotGrid(),
    AxisSweeps(),
    Repeatability(),
    StationFrames(),
    FrameRepeatability(),
    Fit(),
    SignCheck(),
    Validate(),
)


class PaperRows:
    """Compares the run's figures with the paper's."""

    name = "paper-rows"
    needs = "all experiments"
    moves = "nothing"
    measures = "nothing"
    yields = "the paper's figures beside ours"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a quick plan: the paper's figures are of the paper's own."""
        if cell.plan.quick:
            raise HilcellError(
                "plan.quick: the paper's rows need every target; leave it out, or run calibrate",
                code="HC-C10",
            )
        return PlannedStep(self.name, 0, 0.0)

    def perform(self, session: CellSession) -> None:
        """Do nothing: the rows are computed from the journal."""

    def result(self, log: Log) -> Result:
        found = self.experiments(log)
        return {"rows": [row.judged(log, found) for row in self.rows(log)]}

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("row", attrgetter("row")),
                Column("paper", attrgetter("paper"), form="g"),
                Column("here", attrgetter("shown"), form=".4g"),
                Column("chosen", attrgetter("chosen"), form=".4g"),
                Column("unit", attrgetter("unit")),
                Column("criterion", attrgetter("criterion")),
                Column("", attrgetter("verdict")),
            ],
            typed(result["rows"], list[PaperRow]),
        )

    @staticmethod
    def experiments(log: Log) -> Experiments:
        return typed(
            Procedure("experiments", "", EXPERIMENTS, PaperRows.table).result(log), Experiments
        )

    @staticmethod
    def rows(log: Log) -> list[Row]:
        """Return the rows that the run can answer: those of the air only where it was measured."""
        return [row for row in ROWS if row.unit != "C" or log.temperatures_c()]


PAPER = Procedure(
    "paper",
    "every system and experiment of the paper, its figures beside ours",
    (*EXPERIMENTS, PaperRows()),
    PaperRows.table,
    of_rail=True,
    figures="procedures.paper_figures:PaperFigures",
)
