"""Errors of a tool point as its controller would correct them.

The controller knows the nominal arm. Its tool is a reflector as it was identified; its base stands
where nominal kinematics with that tool fit the training poses best. An identified base would do as
well, but where the poses do not determine it, it lies millimetres aside, and all corrections would
make up for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.compensation.model import Prediction
from hilcell.fit.methods import Method
from hilcell.fit.robot_file import Measurements, Robot
from hilcell.geometry.frames import FrameError, apply, apply_each, inverse, rigid_fit
from hilcell.geometry.kinematics import Array, forward


@dataclass(frozen=True, eq=False)
class Controller:
    """A robot's nominal arm, its ``base`` (4, 4) in the tracker's frame, and a reflector ``target``
    at ``smr_mm`` (3,) on the flange.
    """

    robot: Robot
    base: Array
    target: str
    smr_mm: Array

    @property
    def root(self) -> Array:
        """Return the robot's root frame in the tracker's (4, 4)."""
        return self.base @ inverse(self.robot.base)

    @property
    def tool_mm(self) -> Array:
        """Return the reflector (3,) in the robot's tool frame."""
        point: Array = apply(inverse(self.robot.tool), self.smr_mm[None])[0]
        return point

    def errors(self, method: Method, joints_rad: Array) -> Prediction:
        """Return e = actual - nominal of the reflector in the root frame at joints (N, 6)."""
        count = len(joints_rad)
        labels, nowhere = list(map(str, range(count))), np.full((count, 3), np.nan)
        rows = Measurements(labels, [self.target] * count, joints_rad, nowhere)
        seen_mm, covariance_mm2 = method.predict(rows)
        nominal_mm = apply_each(forward(self.robot.arm(), joints_rad), self.smr_mm)
        R = inverse(self.root)[:3, :3]
        error_mm = (seen_mm - apply(self.base, nominal_mm)) @ R.T
        return Prediction(error_mm, R @ covariance_mm2 @ R.T)


def controller_of(robot: Robot, method: Method, train: Measurements, target: str) -> Controller:
    """Return the controller that a method's predictions at the training rows fit best."""
    smr_mm = np.array([method.smr_mm[each] for each in train.target])
    nominal_mm = apply_each(forward(robot.arm(), train.joints_rad), smr_mm)
    try:
        base = rigid_fit(nominal_mm, method.predict(train)[0]).T
    except FrameError:  # on one line: its turn about the line is the method's
        base = method.base
    return Controller(robot, base, target, method.smr_mm[target])
