"""The points of SpatialAnalyzer's job: those of the cell's own CSV file, or a fan of directions.

A person would import a list into the job, and name it in the cell file. In a simulated cell whose
file names none, a fan towards all that the arm and the nests can reach is both.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from fakes.truth.transforms import Array, frame, inverse
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError

PITCH_RAD = 0.01
RANGE_MM = 4000.0
SAMPLE_MM = 400.0
WIDER_RAD = 0.1
STOPS = 6


def imported(path: Path) -> dict[str, Array]:
    """Return the points (3,) of a CSV file by name; raises `SettingsError`."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [row for row in csv.reader(file) if row and row[0] != "name"]
        return {row[0]: np.array([float(each) for each in row[1:4]]) for row in rows}
    except (OSError, ValueError) as error:
        raise SettingsError(
            str(path), [f"SpatialAnalyzer imports no such list: {error}"]
        ) from error


def fan(cell: Cell) -> dict[str, Array]:
    """Return points (3,) in the tracker's frame in all directions of the cell's reflectors."""
    ways = _ways_mm(cell)
    directions = _directions()
    tree = KDTree(ways / np.linalg.norm(ways, axis=1)[:, None])
    beside, _ = tree.query(directions, distance_upper_bound=WIDER_RAD)
    kept = RANGE_MM * directions[np.isfinite(beside)]
    return {f"H{n:06d}": at_mm.round(3) for n, at_mm in enumerate(kept, start=1)}


def write(path: Path, points: dict[str, Array]) -> None:
    """Write the list as a person would name it in the cell file."""
    with path.open("w", encoding="ascii", newline="") as file:
        csv.writer(file).writerows([name, *map(str, at_mm)] for name, at_mm in points.items())


def _ways_mm(cell: Cell) -> Array:
    """Return places (N, 3), tracker's frame, throughout the arm's reach, and the nests."""
    rail, layout = cell.rail, cell.layout
    nests_mm = np.array([nest.xyz_mm for nest in layout.standing])
    reach_mm = sum(math.hypot(joint.a_mm, joint.d_mm) for joint in cell.robot.joint)
    reach_mm += float(np.linalg.norm(cell.robot.smr_mm))
    axis_mm = np.arange(-reach_mm, reach_mm, SAMPLE_MM)
    ball_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm), -1).reshape(-1, 3)
    ball_mm = ball_mm[np.linalg.norm(ball_mm, axis=1) <= reach_mm]
    ball_mm += [layout.base.x_mm, layout.base.y_mm, layout.base.z_mm]
    stops_mm = np.linspace(rail.travel_min_mm, rail.travel_max_mm, STOPS)
    shifts_mm = np.multiply.outer(stops_mm, np.array(layout.rail_direction))
    world_mm = np.vstack([ball_mm + shift_mm for shift_mm in shifts_mm] + [nests_mm])
    world_mm = world_mm[world_mm[:, 2] >= nests_mm[:, 2].min()]
    T = inverse(frame(cell.tracker.pose))
    at_mm = world_mm @ T[:3, :3].T + T[:3, 3]
    found: Array = at_mm[np.linalg.norm(at_mm, axis=1) >= cell.tracker.min_range_mm]
    return found


def _directions() -> Array:
    """Return unit vectors (N, 3), evenly spread by the golden angle."""
    count = math.ceil(4.0 * math.pi / PITCH_RAD**2)
    n = np.arange(count)
    z = 1.0 - (2.0 * n + 1.0) / count
    turn = n * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - z**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
