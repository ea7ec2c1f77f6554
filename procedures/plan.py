"""Checks that the plans of several procedures share."""

from __future__ import annotations

import numpy as np

from hilcell.cell.file import Cell, Station
from hilcell.geometry.closed_form import ReachError
from hilcell.geometry.frames import apply, inverse, matrix, zyx_from_pose
from hilcell.geometry.kinematics import Bools
from hilcell.geometry.rotations import from_rotvec, from_zyx
from hilcell.ports import Array, HilcellError
from hilcell.run.collision import check_poses, clear_poses


def other_stations(cell: Cell) -> list[Station]:
    """Return the stations but the grid's, in the order in which they are visited."""
    return [station for station in cell.station if station.name != cell.grid.station]


def poses_at(cell: Cell, points_mm: Array) -> Array:
    """Return poses (N, 4, 4) in {B} at ``points_mm`` (N, 3) with the grid's orientation."""
    return matrix(cell.grid.centre.matrix()[:3, :3], points_mm)


def more_orientations(cell: Cell) -> Array:
    """Return the orientations (N, 3, 3) in {B} of the tool on the grid besides the grid's own."""
    return from_zyx(np.array(cell.plan.grid_orientations, dtype=float).reshape(-1, 3))


def angles_deg(T_W_B: Array, poses: Array) -> Array:
    """Return A, B, C (N, 3) in {W} of poses (N, 4, 4) in {B}."""
    return zyx_from_pose(T_W_B @ poses)[:, 3:]


def turned(poses: Array, turns_rad: Array) -> Array:
    """Return poses (N, 4, 4) turned on the spot by rotation vectors (N, 3) in {B}."""
    return matrix(from_rotvec(turns_rad) @ poses[:, :3, :3], poses[:, :3, 3])


def drivable(cell: Cell, station: Station, poses: Array) -> Bools:
    """Return which poses (N, 4, 4) in {B} the robot reaches and may be driven to, (N,)."""
    robot = cell.robot.nominal()
    found: Bools = robot.reachable(poses)
    found[found] = clear_poses(cell, station, robot.joints_for(poses[found]))
    return found


def joints_for(cell: Cell, points_mm: Array) -> Array:
    """Return joints (N, 6) in rad that nominally reach ``points_mm`` (N, 3) in {B}, in limits.

    Raises `ReachError` naming the targets that the robot cannot reach.
    """
    return cell.robot.nominal().joints_for(poses_at(cell, points_mm))


def check_reach(cell: Cell, poses: Array, what: str) -> Array:
    """Return the joints (N, 6) for poses (N, 4, 4) in {B}, or name those out of reach."""
    try:
        return cell.robot.nominal().joints_for(poses)
    except ReachError as error:
        raise HilcellError(
            f"{what}: {error}",
            code="HC-C10",
        ) from error


def check_targets(cell: Cell, station: Station, poses: Array, what: str) -> Array:
    """Return the joints (N, 6), or name the poses that cannot be reached or driven to."""
    joints_rad = check_reach(cell, poses, what)
    check_poses(cell, station, joints_rad, what)
    return joints_rad


def check_range(cell: Cell, points_mm: Array, what: str) -> None:
    """Refuse points (N, 3) in {W} that are nearer or farther than the tracker can measure."""
    range_mm = np.linalg.norm(apply(inverse(cell.tracker.pose.matrix()), points_mm), axis=1)
    low, high = cell.tracker.min_range_mm, cell.tracker.max_range_mm
    seen = (range_mm >= low) & (range_mm <= high)
    if not bool(np.all(seen)):
        worst = int(np.argmin(seen))
        raise HilcellError(
            f"{what}: {int(np.sum(~seen))} of {len(seen)} out of the tracker's range; the first at "
            f"{range_mm[worst]:.0f} mm, wanted {low:.0f} .. {high:.0f} mm; move the tracker",
            code="HC-C10",
        )
