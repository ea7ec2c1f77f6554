"""How many stations a work piece needs that one station cannot reach (section 2, Fig 2)."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse, matrix
from hilcell.geometry.inverse import reachable
from hilcell.planning.holes import Holes
from hilcell.planning.plan import plan
from hilcell.ports import Array

HOLE_PITCH_MM = 100.0


def stations_planned(cell: Cell) -> float:
    """Return how many stations the planner takes for the longest work piece."""
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
    tool: Array = cell.layout.nominal_base(0.0)[:3, :3] @ cell.grid.centre.matrix()[:3, :3]
    return tool


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
