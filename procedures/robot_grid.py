"""The robot's error is measured on the vertices of a grid at one station (section 5.2, Fig 11)."""

from __future__ import annotations

from typing import Any

from hilcell.calibration.frames import grid_of, outlying_vertices, vertex_ids
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Step
from procedures.durations import closing, flange_points, step
from procedures.plan import check_range, check_targets, joints_for, poses_at

Vertex = tuple[PointId, Array, Array]  # identity, joints (6,) in rad, nominal position (3,) in {W}


class RobotGrid:
    """Visits the vertices in serpentine order, every axis from below, and records the joints.

    An outlier among its neighbours is measured once more; the retake counts.
    """

    name = "robot-grid"
    needs = "world and base frame, the grid's station held"
    moves = "the robot"
    measures = "the flange reflector at every vertex"
    yields = "the position error on the grid"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse vertices out of reach, out of limits or out of sight, at any station."""
        vertices_mm = grid_of(cell).serpentine_mm()
        there = cell.station_named(cell.grid.station)
        joints_rad = check_targets(cell, there, poses_at(cell, vertices_mm), "grid vertex")
        for station in cell.station:
            world_mm = apply(cell.layout.nominal_base(station.rail_mm), vertices_mm)
            check_range(cell, world_mm, f"grid at {station.name}")
        return step(
            self.name,
            len(vertices_mm),
            [
                flange_points(cell, joints_rad),
                *closing(cell, carried=True, points=len(vertices_mm)),
            ],
        )

    def perform(self, session: CellSession) -> None:
        """Measure every vertex."""
        cell = session.cell
        station = cell.station_named(cell.grid.station)
        grid = grid_of(cell)
        vertices_mm = grid.serpentine_mm()
        world_mm = apply(session.frames.base_in_world(station), vertices_mm)
        joints_rad = joints_for(cell, vertices_mm)
        vertices = list(zip(vertex_ids(grid), joints_rad, world_mm, strict=True))
        for id, joints, nominal_mm in vertices:
            session.flange_point(id, station, joints, nominal_mm=nominal_mm)
        for id, joints, nominal_mm in self._doubtful(session, vertices):
            session.flange_point(id, station, joints, nominal_mm=nominal_mm, retake=True)
        session.close_step(carried=True)
        session.reach("measure_grid")

    def _doubtful(self, session: CellSession, vertices: list[Vertex]) -> list[Vertex]:
        """Return the vertices that stand out and were not measured a second time yet."""
        ids = set(outlying_vertices(session.log))
        doubtful = [v for v in vertices if v[0] in ids and not session.log.point(v[0]).retaken]
        for id, _, _ in doubtful:
            session.event("outlier measured again", key=id.key)
        return doubtful

    def result(self, log: Log) -> dict[str, Any]:
        """Return nothing of its own: the errors are judged by fit and validation."""
        return {}
