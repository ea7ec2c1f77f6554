"""The calibration as a chain of frames, read from a run's log.

{L} tracker, {W} world, {B} robot base, {S} slide: ``T_W_L`` comes from the floor nests, ``T_W_B``
at the grid's station from circles of axes 1 and 6, ``T_W_S`` at every station from slide nests; eq
17 gives every station's base, which is bolted to the slide. Covariances (6, 6): shift of the
frame's origin (mm), rotation vector about it (rad), axes of {W}, as in `hilcell.geometry.frames`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hilcell.cell.file import Cell, Six, Station
from hilcell.geometry.frames import (
    Circle,
    apply,
    apply_each,
    base_frame,
    cross_matrix,
    fit_circle,
    inverse,
    rigid_fit,
    three_point_frame,
    three_point_frames,
)
from hilcell.geometry.kinematics import forward
from hilcell.geometry.statistics import f_quantile, rectangular_variance, trace_freedom
from hilcell.journal.log import Log, noise_at, positions_mm, run_noise, variances_mm2, world_key
from hilcell.journal.previous_reference import FLOOR_NESTS
from hilcell.model.frame import TouchedBase
from hilcell.model.point import Point, PointId
from hilcell.ports import Array

RESTLESS_RISK = 0.001  # that chance alone makes a nest restless, in a run


def base_at(T_W_S1: Array, T_W_Si: Array, T_W_B1: Array) -> Array:
    """{B} in {W} (4, 4) at station i from {B} at station 1: the slide is rigid.

    Eqs 11-13 and 17, corrected; {B} in {S} cancels. Nominal targets move along as measured data do:
    otherwise the rail's offset would count as an error of the robot.
    """
    return T_W_Si @ inverse(T_W_S1) @ T_W_B1


class Frames:
    """Frames of a cell: measured where the log has them, otherwise nominal."""

    def __init__(self, cell: Cell, log: Log) -> None:
        self.cell, self._log = cell, log

    def tracker_in_world(self, set_up: int | None = None) -> Array:
        """T_W_L (4, 4) at a set-up, or at the present one."""
        number = self._log.set_ups.number if set_up is None else set_up
        for key in (world_key(number), "world"):
            if key in self._log.frames:
                return self._log.matrix(key)
        return self.cell.tracker.pose.matrix()

    def based(self) -> bool:
        return "base" in self._log.frames

    def base_in_world(self, station: Station) -> Array:
        """T_W_B (4, 4) at ``station``, by eq 17 where the stations are framed."""
        reference = self.cell.reference
        if not self.based():
            return self.cell.layout.nominal_base(station.rail_mm)
        base = self._log.matrix("base")
        if station.name == reference.name:
            return base
        if f"station.{station.name}" not in self._log.frames:
            shift = np.eye(4)
            travel_mm = station.strip_mm - reference.strip_mm
            shift[:3, 3] = travel_mm * np.array(self.cell.layout.rail_direction)
            return shift @ base
        return self.carried("station", station)

    def is_touched(self, station: Station) -> bool:
        """Whether the base was touched at ``station`` since the slide last moved."""
        frame = self._log.frames.get(f"touch.{station.name}")
        return isinstance(frame, TouchedBase) and frame.visit == self._log.visit

    def stays(self, station: Station) -> bool:
        """Whether the slide has not moved since the base was framed there."""
        return station == self.cell.reference and self._log.visit == self._log.based_visit

    def base_on_visit(self, station: Station) -> Array:
        """T_W_B (4, 4) as touched on this visit, else `base_in_world`: for commands only."""
        if self.is_touched(station):
            return self._log.matrix(f"touch.{station.name}")
        return self.base_in_world(station)

    def on_visit_mm(self, station: Station, targets_mm: Array) -> Array:
        """Command in {B} for targets (N, 3) of `base_in_world`'s {B}. In the base of this visit, by
        an arm that has grown since the grid was measured.
        """
        at_mm = apply(
            inverse(self.base_on_visit(station)) @ self.base_in_world(station), targets_mm
        )
        if not self.is_touched(station):
            return at_mm
        growth = self._log.frame(TouchedBase, f"touch.{station.name}").growth
        centre_mm = self.cell.grid.centre.matrix()[:3, 3]
        return centre_mm + (at_mm - centre_mm) / (1.0 + growth)

    def carried(self, kind: str, station: Station) -> Array:
        """T_W_B (4, 4) by {S} of a ``kind``: ``station``, or ``three_points``."""
        T_W_S1 = self._log.matrix(f"{kind}.{self.cell.grid.station}")
        T_W_Si = self._log.matrix(f"{kind}.{station.name}")
        return base_at(T_W_S1, T_W_Si, self._log.matrix("base"))

    def world_from_tracker(self, xyz_mm: Array) -> Array:
        """Carry raw positions (N, 3) into {W}."""
        return apply(self.tracker_in_world(), np.atleast_2d(xyz_mm))

    def tracker_from_world(self, xyz_mm: Array) -> Array:
        """Carry positions (N, 3) in {W} into the tracker's frame."""
        T_W_L = self.tracker_in_world()
        return (np.atleast_2d(xyz_mm) - T_W_L[:3, 3]) @ T_W_L[:3, :3]


def world_from_tracker(cell: Cell, measured_mm: Array) -> Array:
    """T_W_L (4, 4): the first three floor nests (N, 3) span {W} by eqs 14-16."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    return three_point_frame(*nominal_mm[:3]) @ inverse(three_point_frame(*measured_mm[:3]))


def frame_of_sweeps(
    cell: Cell, log: Log, swept_1: list[Point], swept_6: list[Point]
) -> tuple[Array, Circle, Circle]:
    """T_W_B (4, 4) and the circles of axes 1 and 6 from the points of both sweeps."""
    axis_1, axis_6 = axis_circle(cell, log, 1, swept_1), axis_circle(cell, log, 6, swept_6)
    return base_frame(axis_1, axis_6, axis_6_height_mm(cell)), axis_1, axis_6


def axis_circle(cell: Cell, log: Log, axis: int, points: list[Point]) -> Circle:
    """Circle in {W} through the points of one sweep, or of a part of it."""
    begin_deg, end_deg = sweep_of(cell, axis)[1]
    turn = cell.robot.joint[axis - 1].sign * (end_deg - begin_deg)
    return fit_circle(apply(log.matrix("world"), positions_mm(points)), turn=turn)


def sweep_of(cell: Cell, axis: int) -> tuple[Six, tuple[float, float]]:
    """Fixed joints and ends of axis 1's or 6's sweep, deg."""
    table = cell.base_frame
    return {
        1: (table.axis_1_deg, table.axis_1_sweep_deg),
        6: (table.axis_6_deg, table.axis_6_sweep_deg),
    }[axis]


def axis_6_height_mm(cell: Cell) -> float:
    """Nominal height in {B} of the centre of axis 6's circle: a point on the axis."""
    arm = cell.robot.arm()
    on_axis = arm.tool.copy()
    on_axis[:2, 3] = 0.0
    pose = forward(replace(arm, tool=on_axis), np.radians(cell.base_frame.axis_6_deg))
    return float(pose[2, 3])


def floor_points(log: Log) -> list[Point]:
    """Measured points of the three floor nests that define {W}."""
    nests = [
        log.find(PointId("world", nest=nest.name)) for nest in log.cell.layout.floor[:FLOOR_NESTS]
    ]
    return [nest for nest in nests if nest is not None]


class NestNoise(NamedTuple):
    """Covariances (N, 3, 3) of N nests' averaged readings, tracker's frame; degrees of freedom.

    ``restless``: names of the nests that scatter more than chance makes of the run's noise.
    """

    covariances_mm2: Array
    freedom: float
    restless: tuple[str, ...]

    @property
    def how(self) -> str:
        by_own = f"; {', '.join(self.restless)} scatters more, and counts by its own readings"
        return f"noise of the three floor nests by all readings{by_own if self.restless else ''}"


def nest_noise(log: Log) -> NestNoise:
    """Noise of the floor nests that define {W}, by all readings of the run.

    A nest's own few readings say little: the spread of 2 is half the noise or less in 38 % of all
    places. They count where they scatter more than that, as on a stand that trembles.
    """
    noise, points = run_noise(log), floor_points(log)
    covariances_mm2, own_mm2 = noise_at(noise, points), variances_mm2(points)
    stated = all(point.samples == 1 for point in points)  # by the instrument, so no estimate
    freedom, restless = math.inf if stated else noise.freedom, []
    most_freedom = 1e6  # as good as infinite, which a noise of 0 has
    for row, point in enumerate(points):
        own_freedom = trace_freedom(covariances_mm2[row], max(point.samples - 1, 1))
        own_freedom = min(own_freedom, most_freedom)
        most = f_quantile(1.0 - RESTLESS_RISK / len(points), own_freedom, noise.freedom)
        if not own_mm2[row].sum() <= most * np.trace(covariances_mm2[row]):
            covariances_mm2[row] = np.diag(own_mm2[row])
            freedom = min(freedom, own_freedom)
            restless.append(point.id.nest)
    return NestNoise(covariances_mm2, freedom, tuple(restless))


def world_covariance(log: Log, at_mm: Array, centring_mm2: float = 0.0) -> Array:
    """Covariance of a frame at ``at_mm`` (3,) by the noise of the floor nests.

    Three nests span {W} (eqs 14-16), so each moves along each principal axis of its noise, by the
    standard deviation there. ``centring_mm2``: additional variance of each.
    """
    values, axes = np.linalg.eigh(nest_noise(log).covariances_mm2 + centring_mm2 * np.eye(3))
    steps_mm = np.zeros((FLOOR_NESTS, 3, FLOOR_NESTS, 3))
    for nest in range(FLOOR_NESTS):
        steps_mm[nest, :, nest] = np.sqrt(np.maximum(values[nest], 0.0))[:, None] * axes[nest].T
    moved = _world_motions(log, at_mm, steps_mm.reshape(-1, FLOOR_NESTS, 3))
    return np.asarray(moved.T @ moved)


def world_as_framed(log: Log, *, centred: bool = False) -> Array | None:
    """Covariance (6, 6) of {W} at its origin by its floor nests, None without all. ``centred``: by
    their readings alone, as if the reflector's optics were in the centre of its sphere.
    """
    if len(floor_points(log)) != FLOOR_NESTS:
        return None
    limit_mm = 0.0 if centred else log.cell.uncertainty.smr_centring_limit_mm
    return world_covariance(log, np.zeros(3), rectangular_variance(limit_mm))


def nest_leverage(nests_mm: Array, at_mm: Array) -> float:
    """Variance of a coordinate at ``at_mm`` (3,) in {W}, mean of three, by an independent one of 1
    of each coordinate of the three nests (3, 3) that span {W}.
    """
    step_mm = 1e-3
    moved = nests_mm + step_mm * np.eye(nests_mm.size).reshape(-1, *nests_mm.shape)
    T = three_point_frame(*nests_mm) @ inverse(three_point_frames(moved))
    return float(np.square((apply_each(T, at_mm) - at_mm) / step_mm).sum() / 3.0)


def world_motion(log: Log, at_mm: Array, nest: int, step_mm: Array) -> Array:
    """Motion (6,) in {W} at ``at_mm`` by a nest's ``step_mm`` (3,), tracker's frame."""
    steps_mm = np.zeros((1, FLOOR_NESTS, 3))
    steps_mm[0, nest] = step_mm
    return np.asarray(_world_motions(log, at_mm, steps_mm)[0])


def _world_motions(log: Log, at_mm: Array, steps_mm: Array) -> Array:
    """Motions (N, 6) as `world_motion`, for steps (N, 3, 3) of all nests."""
    measured_mm, T_W_L = positions_mm(floor_points(log)), log.matrix("world")
    before, seen_mm = T_W_L @ three_point_frame(*measured_mm), apply(inverse(T_W_L), at_mm[None])
    T = before @ inverse(three_point_frames(measured_mm + steps_mm))
    turn = (T[:, :3, :3] @ T_W_L[:3, :3].T)[:, [2, 0, 1], [1, 2, 0]]
    return np.concatenate([apply_each(T, seen_mm) - at_mm, turn], axis=1)


def base_covariance(log: Log, station: Station) -> Array:
    """Covariance of {B} at ``station``, carried there from the grid's station. 0 at the grid's own:
    an error of the {B} measured there moves grid and targets alike.
    """
    if station.name == log.cell.grid.station:
        return np.zeros((6, 6))
    key = f"station.{station.name}"
    lever_mm = Frames(log.cell, log).base_in_world(station)[:3, 3] - log.matrix(key)[:3, 3]
    shift = np.eye(6)
    shift[:3, 3:] = -cross_matrix(lever_mm)
    return np.asarray(shift @ log.frames[key].C @ shift.T)


def hold_covariance(cell: Cell) -> Array:
    """Covariance (3, 3) in {W} of a held slide: along the rail, by the interlock."""
    along = np.array(cell.layout.rail_direction)
    return rectangular_variance(cell.rail.hold_limit_mm) * np.outer(along, along)


def has_own_place(cell: Cell, key: str) -> bool:
    """Whether a frame is measured separately; without a rail a station's is a copy of the base."""
    return key == "base" or cell.has_rail


def slide_covariance(cell: Cell, T_W_S: Array, variance_mm2: float, nests: int = 100) -> Array:
    """Covariance in {W} of {S} by a variance of each of the first slide nests."""
    nests_mm = np.array([nest.xyz_mm for nest in cell.layout.slide])
    in_slide_mm = apply(inverse(three_point_frame(*nests_mm[:3])), nests_mm[:nests])
    variances_mm2 = np.tile(variance_mm2 * np.eye(3), (len(in_slide_mm), 1, 1))
    return rigid_fit(in_slide_mm, apply(T_W_S, in_slide_mm), weights=variances_mm2).covariance
