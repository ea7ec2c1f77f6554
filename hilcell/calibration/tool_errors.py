"""Errors of a tool point as its controller would correct them.

The controller knows the nominal arm; its base stands where the fit found it, and its tool is a
reflector where the fit found that. Both were found together with the errors: with another base or
tool the errors are others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from hilcell.calibration.robot_file import Robot
from hilcell.compensation.model import Prediction
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Array, forward


class Fitted(Protocol):
    """A fit that predicts where reflectors are."""

    @property
    def base(self) -> Array:
        """Return the base in the tracker's frame (4, 4)."""

    @property
    def smr_mm(self) -> Mapping[str, Array]:
        """Return the reflectors (3,) on the flange by name."""

    def positions(self, joints_rad: Array, target: str) -> tuple[Array, Array]:
        """Return a reflector's positions (N, 3) at joints (N, 6), and covariances (N, 3, 3).

        Both have the tracker's frame.
        """


def tool_errors(robot: Robot, fitted: Fitted, target: str, joints_rad: Array) -> Prediction:
    """Return e = actual - nominal of a reflector in the robot's root frame at joints (N, 6)."""
    seen_mm, covariance_mm2 = fitted.positions(joints_rad, target)
    flange = forward(robot.arm(), joints_rad)
    nominal_mm = flange[:, :3, 3] + flange[:, :3, :3] @ fitted.smr_mm[target]
    R = (robot.base @ inverse(fitted.base))[:3, :3]
    error_mm = (seen_mm - apply(fitted.base, nominal_mm)) @ R.T
    return Prediction(error_mm, R @ covariance_mm2 @ R.T)


def tool_point_mm(robot: Robot, fitted: Fitted, target: str) -> Array:
    """Return a reflector (3,) in the robot's tool frame."""
    point: Array = apply(inverse(robot.tool), fitted.smr_mm[target][None])[0]
    return np.asarray(point)
