"""The robot's error is measured on the vertices of a grid at one station (section 5.2, Fig 11)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hilcell.calibration.frames import ORIENTED, grid_of, outlying_vertices, vertex_ids
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import apply, matrix
from hilcell.geometry.rotations import to_rotvec
from hilcell.journal.log import Log
from hilcell.model.events import OutlierMeasuredAgain
from hilcell.model.plan import Step
from hilcell.model.point import PointId
from hilcell.ports import Array, HilcellError
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.durations import closing, flange_count, flange_points, step
from procedures.plan import (
    angles_deg,
    check_range,
    check_targets,
    more_orientations,
    poses_at,
)

SAME_RAD = 1e-4  # nearer orientations are one
# Identity, joints (6,) in rad, nominal position (3,) and angles (3,) in {W}.
Vertex = tuple[PointId, Array, Array, Array]


class RobotGrid:
    """Visits the vertices in serpentine order, every axis from below, and records the joints.

    An outlier among its neighbours is measured once more; the retake counts.
    """

    name = "robot-grid"
    needs = "world and base frame, the grid's station held"
    moves = "the robot"
    measures = "the reflectors on the flange at every vertex"
    yields = "the position error on the grid, the orientation's with several reflectors"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse vertices out of reach, out of limits or out of sight, at any station."""
        vertices_mm = grid_of(cell).serpentine_mm()
        there = cell.station_named(cell.grid.station)
        joints_rad = check_targets(cell, there, poses_at(cell, vertices_mm), "grid vertex")
        for station in cell.station:
            world_mm = apply(cell.layout.nominal_base(station.rail_mm), vertices_mm)
            check_range(cell, world_mm, f"grid at {station.name}")
        sent_rad = [joints_rad]
        _check_orientations(cell)
        for n, R in enumerate(more_orientations(cell)):
            what = f"grid vertex in orientation {_named(cell.plan.grid_orientations[n])}"
            sent_rad.append(check_targets(cell, there, matrix(R, vertices_mm), what))
        points = flange_count(cell, len(vertices_mm) * len(sent_rad))
        measured = flange_points(cell, np.concatenate(sent_rad), seats=True)
        return step(self.name, points, [measured, *closing(cell, carried=True, points=points)])

    def perform(self, session: CellSession) -> None:
        """Measure every vertex."""
        cell = session.cell
        station = cell.station_named(cell.grid.station)
        grid = grid_of(cell)
        vertices_mm = grid.serpentine_mm()
        T_W_B = session.frames.base_in_world(station)
        ids = vertex_ids(grid)
        vertices = _sent(cell, T_W_B, ids, poses_at(cell, vertices_mm))
        self._measure_all(session, station, vertices)
        for each in self._doubtful(session, vertices):
            self._measure(session, station, each, retake=True)
        for number, R in enumerate(more_orientations(cell), start=1):
            turned = [PointId(ORIENTED, vertex=id.vertex, place=number) for id in ids]
            self._measure_all(session, station, _sent(cell, T_W_B, turned, matrix(R, vertices_mm)))
        session.close_step(carried=True)
        session.reach("measure_grid")

    def _measure_all(self, session: CellSession, station: Station, vertices: list[Vertex]) -> None:
        session.expect(station, np.array([joints_rad for _, joints_rad, *_ in vertices]))
        for each in vertices:
            self._measure(session, station, each)

    def _measure(
        self, session: CellSession, station: Station, vertex: Vertex, *, retake: bool = False
    ) -> None:
        id, joints_rad, at_mm, at_deg = vertex
        session.flange_point(
            id, station, joints_rad, nominal_mm=at_mm, nominal_deg=at_deg, retake=retake, seats=True
        )

    def _doubtful(self, session: CellSession, vertices: list[Vertex]) -> list[Vertex]:
        """Return the vertices that stand out and were not measured a second time yet."""
        ids = set(outlying_vertices(session.log))
        doubtful = [v for v in vertices if v[0] in ids and not session.log.point(v[0]).retaken]
        for id, *_ in doubtful:
            for seat in range(1, len(session.cell.robot.seats_mm) + 1):
                session.add(OutlierMeasuredAgain(key=id.at_seat(seat).key))
        return doubtful

    def result(self, log: Log) -> Result:
        """Return nothing of its own: the errors are judged by fit and validation."""
        return {}


def _check_orientations(cell: Cell) -> None:
    """Raise `HilcellError` for orientations that are equal, or the grid's own: they add nothing."""
    of = cell.grid.centre.matrix()[None, :3, :3]
    found = np.concatenate([of, more_orientations(cell)])
    names = ["the grid's own", *map(_named, cell.plan.grid_orientations)]
    for n, m in combinations(range(len(found)), 2):
        apart_rad = float(np.linalg.norm(to_rotvec(found[n].T @ found[m])))
        if not apart_rad > SAME_RAD:
            raise HilcellError(
                f"plan.grid_orientations: {names[m]} is the same orientation as {names[n]}: the "
                "vertices would be measured twice in it; leave one out",
                code="HC-C10",
            )


def _named(angles_deg: Sequence[float]) -> str:
    a, b, c = angles_deg
    return f"A {a:g}°, B {b:g}°, C {c:g}°"


def _sent(cell: Cell, T_W_B: Array, ids: list[PointId], poses: Array) -> list[Vertex]:
    """Return what to measure at poses (N, 4, 4) in {B}."""
    joints_rad = cell.robot.nominal().joints_for(poses)
    world_mm, world_deg = apply(T_W_B, poses[:, :3, 3]), angles_deg(T_W_B, poses)
    return list(zip(ids, joints_rad, world_mm, world_deg, strict=True))
