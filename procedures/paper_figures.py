"""Our figures of the paper's rows, each found from the journal of the run alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from hilcell.calibration.errors import reduction as share_removed
from hilcell.calibration.frames import (
    Frames,
    axis_6_height_mm,
    circle_of,
    grid_errors_mm,
    grid_of,
    grid_pairs,
)
from hilcell.compensation.grid import Grid
from hilcell.geometry.circles import base_frame_covariance
from hilcell.geometry.frames import apply, cross_matrix, inverse
from hilcell.geometry.jacobian import PARAMETERS, moved, parameter_jacobian
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import lengths_mm, ranks, rms
from hilcell.journal.log import Log, positions_mm
from hilcell.model.point import Point, PointId, Sent
from hilcell.model.results import (
    Calibrated,
    FramesRepeated,
    Place,
    SurveyedRail,
)
from hilcell.ports import Array
from procedures.base_frame import FramedBase
from procedures.fit import Choice
from procedures.plan import other_stations
from procedures.sign_check import SignErrors
from procedures.station import StationRepeated


class Experiments(Calibrated, frozen=True, kw_only=True):
    """The results of all experiments."""

    base: FramedBase
    rail_survey: SurveyedRail
    station_repeatability: StationRepeated
    frame_repeatability: FramesRepeated
    fit: Choice
    sign: SignErrors


Figure = Callable[[Log, Experiments], float]
Where = Literal["reference", "others"]


def place(log: Log, result: Experiments, where: Where) -> Place:
    """Return the validation at the grid's station, or that of all others together."""
    return result.validation[log.cell.grid.station if where == "reference" else where]


def mean(where: Where, how: Sent) -> Figure:
    """Return the mean error of targets that were sent in one way."""
    return lambda log, result: place(log, result, where).sent[how].mean


def reduction(where: Where, how: Sent = Sent.IDW) -> Figure:
    """Return by which share a correction, the paper's or another, lowers the mean error."""
    before, after = mean(where, Sent.BEFORE), mean(where, how)
    return lambda log, result: share_removed(before(log, result), after(log, result))


def cells(log: Log, result: Experiments) -> float:
    """Return how many cells the grid has."""
    return float(np.prod(np.array(grid_of(log.cell).shape) - 1))


def lowest_temperature(log: Log, result: Experiments) -> float:
    """Return the lowest temperature of all points."""
    return min(log.temperatures_c())


def highest_temperature(log: Log, result: Experiments) -> float:
    """Return the highest temperature of all points."""
    return max(log.temperatures_c())


def jacobian_error(log: Log, result: Experiments) -> float:
    """Return how far eqs 1-7 are from central differences at the grid's vertices, relative."""
    arm = log.cell.robot.arm()
    joints_rad = commanded_rad(log.select("grid"))
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


def similarity_rank(log: Log, result: Experiments) -> float:
    """Return the rank correlation of joint distance and error difference over the vertices."""
    pairs = grid_pairs(log)
    return float(np.corrcoef(ranks(pairs.joint_rad), ranks(pairs.difference_mm))[0, 1])


def interpolation_off_mm(log: Log, result: Experiments) -> float:
    """Return how far the commands sent are from eqs 9-10 as they stand in the paper (mm).

    P_cmd = P - e(P_cmd) in two steps, where e is worked out here from the 8 vertices within a
    pitch. Two steps, not the limit: at a face between cells e jumps (0.1 mm is common), so that a
    target near a face may have no P_cmd of which the equation is exactly true.
    """
    points = log.select("validate", log.cell.grid.station, how=Sent.IDW)
    nominal_mm = np.array([point.nominal_mm for point in points])
    wanted_mm = apply(inverse(log.matrix("base")), nominal_mm)
    sent_mm = forward(log.cell.robot.arm(), commanded_rad(points))[:, :3, 3]
    grid, errors_mm = grid_of(log.cell), grid_errors_mm(log)
    once_mm = wanted_mm - by_eqs_9_10(grid, errors_mm, wanted_mm)
    twice_mm = wanted_mm - by_eqs_9_10(grid, errors_mm, grid.clamped(once_mm))
    return float(lengths_mm(sent_mm - twice_mm).max())


def by_eqs_9_10(grid: Grid, errors_mm: Array, points_mm: Array) -> Array:
    """Return e (N, 3) at points (N, 3) that are no vertices, by eqs 9-10 word for word."""
    vertices_mm, vertex_errors_mm = grid.vertices_mm().reshape(-1, 3), errors_mm.reshape(-1, 3)
    found = []
    for point in points_mm:
        corners = (np.abs(vertices_mm - point) <= grid.pitch_mm).all(axis=1)
        nearness = 1.0 / np.linalg.norm(vertices_mm[corners] - point, axis=1)
        found.append(nearness / nearness.sum() @ vertex_errors_mm[corners])
    return np.array(found)


def transfer(log: Log, result: Experiments) -> tuple[float, float]:
    """Return eq 13 by base frames against eq 17 by station frames, and its u, at the cube (mm).

    At the station where the 3-D difference is the largest for its u (1 sigma, root of the trace).
    """
    frames, centre_mm = Frames(log.cell, log), log.cell.grid.centre.matrix()[:3, 3]
    reference_mm2 = _point_variance_mm2(log.matrix("base"), log.frames["base"].C, centre_mm)
    found = []
    for station in other_stations(log.cell):
        by_bases, by_slide = log.matrix(f"base.{station.name}"), frames.base_in_world(station)
        off_mm = apply(by_bases, centre_mm[None]) - apply(by_slide, centre_mm[None])
        axis_1, axis_6 = (
            circle_of(log.cell, log, axis, log.select("frames", station.name, axis=axis))
            for axis in (1, 6)
        )
        covariance = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(log.cell))
        u_mm = np.sqrt(
            reference_mm2
            + _point_variance_mm2(by_bases, covariance, centre_mm)
            + result.stations[station.name].tool_uncertainty_mm ** 2
        )
        found.append((float(np.linalg.norm(off_mm)), float(u_mm)))
    return max(found, key=lambda each: each[0] / each[1])


def _point_variance_mm2(T: Array, covariance: Array, point_mm: Array) -> float:
    """Return the variance (trace) of a point (3,) that a frame with this covariance carries."""
    J = np.hstack([np.eye(3), -cross_matrix(T[:3, :3] @ point_mm)])
    return float(np.trace(J @ covariance @ J.T))


def nests_moved_mm(log: Log, result: Experiments) -> float:
    """Return how far fixed floor nests were found from their first places: 3-D, rms."""
    again = log.select("control")
    first = [log.point(PointId("world", nest=point.id.nest)) for point in again]
    return rms(lengths_mm(positions_mm(again) - positions_mm(first)))
