"""How well a run knows its frames: covariances (6, 6) of {W} and of {B} at a station.

Each is that of the shift of the frame's origin (mm) and of a rotation vector about it (rad), with
the axes of {W}, as in `hilcell.geometry.frames`.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.frames import Frames
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import (
    apply,
    apply_each,
    cross_matrix,
    inverse,
    rigid_fit,
    three_point_frame,
    three_point_frames,
)
from hilcell.geometry.statistics import rectangular_variance
from hilcell.journal.log import Log, positions_mm, variances_mm2
from hilcell.model.point import Point, PointId
from hilcell.ports import Array

FLOOR_NESTS = 3  # that define {W}


def floor_points(log: Log) -> list[Point]:
    """Return the points of the three floor nests that define {W}, as far as they were measured."""
    nests = [
        log.find(PointId("world", nest=nest.name)) for nest in log.cell.layout.floor[:FLOOR_NESTS]
    ]
    return [nest for nest in nests if nest is not None]


def world_covariance(log: Log, at_mm: Array, centring_mm2: float = 0.0) -> Array:
    """Return the covariance that the noise of the floor nests gives a frame at ``at_mm`` (3,).

    {W} is spanned by three nests (eqs 14-16), so each coordinate of each is moved by its own
    standard deviation. ``centring_mm2`` is the variance of each besides its reading's.
    """
    std_mm = np.sqrt(variances_mm2(floor_points(log)) + centring_mm2)
    moved = _world_motions(log, at_mm, np.diag(std_mm.ravel()).reshape(-1, FLOOR_NESTS, 3))
    covariance: Array = moved.T @ moved
    return covariance


def world_motion(log: Log, at_mm: Array, nest: int, step_mm: Array) -> Array:
    """Return how a frame at ``at_mm`` (3,) moves (6,) in {W} where a nest is seen elsewhere, by
    ``step_mm`` (3,) in the tracker's frame.
    """
    steps_mm = np.zeros((1, FLOOR_NESTS, 3))
    steps_mm[0, nest] = step_mm
    moved: Array = _world_motions(log, at_mm, steps_mm)[0]
    return moved


def _world_motions(log: Log, at_mm: Array, steps_mm: Array) -> Array:
    """Return the motions (N, 6) of `world_motion` for steps (N, 3, 3) of all nests."""
    measured_mm, T_W_L = positions_mm(floor_points(log)), log.matrix("world")
    before, seen_mm = T_W_L @ three_point_frame(*measured_mm), apply(inverse(T_W_L), at_mm[None])
    T = before @ inverse(three_point_frames(measured_mm + steps_mm))
    turn = (T[:, :3, :3] @ T_W_L[:3, :3].T)[:, [2, 0, 1], [1, 2, 0]]
    return np.concatenate([apply_each(T, seen_mm) - at_mm, turn], axis=1)


def base_covariance(log: Log, station: Station) -> Array:
    """Return the covariance of {B} at ``station`` as it was carried there from the grid's station.

    Nothing is carried at the grid's own: the grid's errors stand in the {B} measured there, and
    an error of that {B} moves grid and targets alike.
    """
    if station.name == log.cell.grid.station:
        return np.zeros((6, 6))
    key = f"station.{station.name}"
    lever_mm = Frames(log.cell, log).base_in_world(station)[:3, 3] - log.matrix(key)[:3, 3]
    shift = np.eye(6)
    shift[:3, 3:] = -cross_matrix(lever_mm)
    covariance: Array = shift @ log.frames[key].C @ shift.T
    return covariance


def hold_covariance(cell: Cell) -> Array:
    """Return the covariance (3, 3) in {W} of the slide held at a station: along the rail, as far
    as the interlock lets it slip.
    """
    along = np.array(cell.layout.rail_direction)
    return rectangular_variance(cell.rail.held_within_mm) * np.outer(along, along)


def has_own_place(cell: Cell, key: str) -> bool:
    """Whether a frame is measured by itself; without a rail a station's is a copy of the base."""
    return key == "base" or cell.has_rail


def slide_covariance(cell: Cell, T_W_S: Array, variance_mm2: float, nests: int = 100) -> Array:
    """Return the covariance in {W} that a variance of every slide nest by itself gives {S}, where
    so many of them, the first ones, say where it is.
    """
    nests_mm = np.array([nest.xyz_mm for nest in cell.layout.slide])
    in_slide_mm = apply(inverse(three_point_frame(*nests_mm[:3])), nests_mm[:nests])
    variances_mm2 = np.tile(variance_mm2 * np.eye(3), (len(in_slide_mm), 1, 1))
    return rigid_fit(in_slide_mm, apply(T_W_S, in_slide_mm), weights=variances_mm2).covariance
