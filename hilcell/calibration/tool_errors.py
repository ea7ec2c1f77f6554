"""Errors of a tool point as its controller would correct them.

The controller knows the nominal arm; its base stands where the fit found it, and its tool is a
reflector where the fit found that. Both were found together with the errors: with another base or
tool the errors are others.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.fit import Method
from hilcell.calibration.robot_file import Measurements, Robot
from hilcell.compensation.model import Prediction
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward


def tool_errors(robot: Robot, method: Method, target: str, joints_rad: Array) -> Prediction:
    """Return e = actual - nominal of a reflector in the robot's root frame at joints (N, 6)."""
    count = len(joints_rad)
    rows = Measurements(
        list(map(str, range(count))), [target] * count, joints_rad, np.full((count, 3), np.nan)
    )
    seen_mm, covariance_mm2 = method.predict(rows)
    flange = forward(robot.arm(), joints_rad)
    nominal_mm = flange[:, :3, 3] + flange[:, :3, :3] @ method.smr_mm[target]
    R = (robot.base @ inverse(method.base))[:3, :3]
    error_mm = (seen_mm - apply(method.base, nominal_mm)) @ R.T
    return Prediction(error_mm, R @ covariance_mm2 @ R.T)


def tool_point_mm(robot: Robot, method: Method, target: str) -> Array:
    """Return a reflector (3,) in the robot's tool frame."""
    point: Array = apply(inverse(robot.tool), method.smr_mm[target][None])[0]
    return np.asarray(point)
