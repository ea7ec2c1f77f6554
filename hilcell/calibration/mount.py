"""A reflector that is not mounted where the cell file says: axis 6's circle, the grid's errors.

Both are compared with what links, zeros and a mount measured by hand explain, and with what the
instrument itself does: a turn of {B} about z, that axis 6's small circle leaves open, looks like a
reflector that sits sideways.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilcell.calibration.base_circles import axis_6_height_mm, circle_of
from hilcell.calibration.contribution import systematic_mm2
from hilcell.calibration.errors import errors_of
from hilcell.calibration.suspicions import Suspicion
from hilcell.geometry.circles import base_frame_covariance, reading_covariance
from hilcell.geometry.frames import apply, matrix, motion_levers
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.rotations import from_rotvec
from hilcell.journal.log import Log, Point, commanded_rad, covariances_mm2, positions_mm
from hilcell.ports import Array

CIRCLE, CONSTANT = "circle of axis 6", "constant error in the tool's frame"
SIGMAS = 3.0
MOST_RADIUS_MM = 2.0  # 3 sigma: a mount to +-1 mm as measured by hand, an arm's links to 0.4 mm
MOST_CONSTANT_MM = 3.0  # 3 sigma of the uncorrected error, that links and zeros explain


def mount_offset(log: Log) -> Suspicion | None:
    """Return a reflector that is not where the cell file says, if it is clearly not."""
    frame, arm = log.frames.get("base", {}), log.cell.robot.arm()
    of_base, radius_mm2 = np.zeros((6, 6)), 0.0
    if "radius_mm" in frame:
        of_base, radius_mm2 = _by_circles(log)
        off_mm = abs(frame["radius_mm"][1] - axis_6_radius_mm(arm))
        if not off_mm <= np.hypot(MOST_RADIUS_MM, SIGMAS * np.sqrt(radius_mm2)):
            return Suspicion("mount offset", off_mm, "mm", CIRCLE)
    points = log.select("grid")
    if not points:
        return None
    R = log.matrix("base")[:3, :3] @ forward(arm, commanded_rad(points))[:, :3, :3]
    errors = errors_of(log, points)
    off = np.einsum("nji,nj->ni", R, errors.error_mm).mean(axis=0)
    levers = motion_levers(errors.nominal_mm - log.matrix("base")[:3, 3])[:, :, :6]
    J = (np.swapaxes(R, 1, 2) @ levers).mean(axis=0)
    systematic = systematic_mm2(log.cell.uncertainty, positions_mm(points)).mean()
    mount_mm2 = (MOST_CONSTANT_MM / SIGMAS) ** 2
    covariance = (mount_mm2 + systematic) * np.eye(3) + J @ of_base @ J.T
    if off @ np.linalg.solve(covariance, off) <= SIGMAS**2:
        return None
    return Suspicion("mount offset", float(np.linalg.norm(off)), "mm", CONSTANT)


def _by_circles(log: Log) -> tuple[Array, float]:
    """Return the covariance (6, 6) that the readings on both circles give {B}, and the variance
    that they give the radius of axis 6's.
    """
    circles, covariances = [], []
    for axis in (1, 6):
        points = log.select("base", axis=axis)
        circle = circle_of(log.cell, log, axis, points)
        at_mm = apply(log.matrix("world"), positions_mm(points))
        covariances.append(reading_covariance(circle, at_mm, _covariances_mm2(log, points)))
        circles.append(replace(circle, covariance=covariances[-1][:6, :6]))
    axis_1, axis_6 = circles
    of_base = base_frame_covariance(axis_1, axis_6, axis_6_height_mm(log.cell))
    return of_base, float(covariances[-1][6, 6])


def _covariances_mm2(log: Log, points: list[Point]) -> Array:
    """Return the covariances (N, 3, 3) in {W} of readings, with the tracker's stated limits."""
    limits = systematic_mm2(log.cell.uncertainty, positions_mm(points))
    noise = covariances_mm2(points, log.matrix("world")[:3, :3])
    found: Array = noise + limits[:, None, None] * np.eye(3)
    return found


def axis_6_radius_mm(arm: Arm) -> float:
    """Return the nominal distance of the tool point from axis 6."""
    turn = from_rotvec(np.array([arm.alpha_rad[5], 0.0, 0.0]))
    last = matrix(turn, np.array([arm.a_mm[5], 0.0, 0.0])) @ arm.tool
    return float(np.hypot(last[0, 3], last[1, 3]))
