"""The robot's error is measured on the vertices of a grid at one station (section 5.2, Fig 11)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hilcell.calibration import grid_of
from hilcell.cell import Cell
from hilcell.geometry.frames import apply
from hilcell.run.bench import Bench
from hilcell.run.log import Log
from hilcell.run.procedure import Step
from procedures.plan import check_range, check_reach, joints_for, robot_point_s


class RobotGrid:
    """Visits the vertices in serpentine order, every axis from below, and records the joints."""

    name = "robot-grid"
    needs = "world and base frame, the grid's station held"
    moves = "the robot"
    measures = "the flange reflector at every vertex"
    yields = "the position error on the grid"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse vertices out of reach, out of limits or out of sight, at any station."""
        vertices_mm = grid_of(cell).serpentine_mm()
        check_reach(cell, vertices_mm, "grid vertex")
        for station in cell.station:
            world_mm = apply(cell.layout.nominal_base(station.rail_mm), vertices_mm)
            check_range(cell, world_mm, f"grid at {station.name}")
        return Step(self.name, len(vertices_mm), len(vertices_mm) * robot_point_s(cell))

    def perform(self, bench: Bench) -> None:
        """Measure every vertex."""
        cell = bench.cell
        station = cell.station_named(cell.grid.station)
        grid = grid_of(cell)
        vertices_mm = grid.serpentine_mm()
        world_mm = apply(bench.frames.base_in_world(station), vertices_mm)
        for joints, vertex_mm, nominal_mm in zip(
            joints_for(cell, vertices_mm), vertices_mm, world_mm, strict=True
        ):
            i, j, k = np.round((vertex_mm - grid.origin_mm) / grid.pitch_mm).astype(int)
            key = f"grid/{i}-{j}-{k}"
            bench.flange_point(key, "grid", station, joints, nominal_mm=nominal_mm)
        bench.reach("measure_grid")

    def result(self, log: Log) -> dict[str, Any]:
        """Return nothing of its own: the errors are judged by fit and validation."""
        return {}
