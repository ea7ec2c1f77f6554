"""From corrected targets to the program of their station: base, approach and posture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilcell.calibration.form import Calibration
from hilcell.cell.file import Cell
from hilcell.compensation.station_program import Places, StationProgram
from hilcell.compensation.targets import as_listed
from hilcell.geometry.closed_form import status_of
from hilcell.geometry.frames import inverse, poses_from_zyx, zyx_from_pose
from hilcell.geometry.inverse import posture
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array


def station_program(
    calibration: Calibration,
    cell: Cell,
    station: str,
    names: Sequence[str],
    command: Array,
    remarks: Sequence[str],
) -> StationProgram:
    """Return the program for commands (N, 6) in {W}, as a list states them.

    Each is approached from below on every axis, by ``robot.approach_deg``, as every pose of the
    calibration was: from elsewhere the lost motion of the axes comes on top. Raises `ReachError`
    where the arm leaves its limits.
    """
    T_W_B = np.array(calibration.stations[station].T_W_B)
    robot, arm = cell.robot, cell.robot.arm()
    joints_rad = posture(
        arm, inverse(T_W_B) @ poses_from_zyx(command), robot.status, robot.margin_limits_rad,
        np.radians(robot.home_deg),
    )  # fmt: skip
    below_rad = joints_rad - np.radians(robot.approach_deg)
    below = as_listed(zyx_from_pose(T_W_B @ forward(arm, below_rad)))
    return StationProgram(
        station=station,
        names=names,
        command=Places(command, joints_rad, status_of(arm, joints_rad)),
        approach=Places(below, below_rad, status_of(arm, below_rad)),
        base=zyx_from_pose(inverse(T_W_B)[None])[0],
        safe_deg=robot.safe_deg,
        speed_percent=robot.speed_percent,
        options=robot.options,
        remarks=remarks,
    )
