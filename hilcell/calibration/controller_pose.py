"""Whether the controller computes poses as the cell file does: with its links, tool and base.

A controller with other links puts the tool beside each Cartesian target, and no measurement of
joint motions shows it. So each pose stated at rest is compared with forward kinematics of its
joints. A controller that solves with links measured in its factory (Universal Robots) says so in
its readings: its poses may differ by millimetres, and programs use joints.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.cell.robot import RobotTable
from hilcell.geometry.frames import to_rotvec
from hilcell.geometry.jacobian import KINDS, moved, parameter_jacobian
from hilcell.geometry.kinematics import Arm, forward
from hilcell.ports import Array, DeviceError, HilcellError, RobotReading

ROUNDING_MM, ROUNDING_RAD = 0.005, np.radians(0.001)  # of the numbers that a controller states
AXIS_RAD = np.radians(0.0005)  # joints and pose are some ms apart, and a robot at rest flickers


class Deviation:
    """Deviation of a pose (4, 4) from that of joints (6,) by the cell file's arm, and its limits.

    Each point has one, and few need its limits, so these are computed when they are read.
    """

    limit_rad = float(ROUNDING_RAD + 6.0 * AXIS_RAD)

    def __init__(self, arm: Arm, joints_rad: Array, pose: Array) -> None:
        self._arm, self._joints_rad, self._pose = arm, joints_rad, pose
        self._nominal = forward(arm, joints_rad)
        self.shift_mm: Array = pose[:3, 3] - self._nominal[:3, 3]

    @property
    def off_mm(self) -> float:
        return math.sqrt(float(self.shift_mm @ self.shift_mm))

    @cached_property
    def turn_rad(self) -> Array:
        """Return the rotation vector (3,)."""
        return to_rotvec(self._pose[:3, :3] @ self._nominal[:3, :3].T).reshape(3)

    @cached_property
    def limit_mm(self) -> float:
        """Return what rounding of pose and joints explains."""
        zeros = slice(18, 24)
        by_zeros = parameter_jacobian(self._arm, self._joints_rad)[:3, zeros]
        return float(ROUNDING_MM + AXIS_RAD * np.linalg.norm(by_zeros, axis=0).sum())

    @property
    def holds(self) -> bool:
        return self.rounded or self.within(self.limit_mm, self.limit_rad)

    @property
    def rounded(self) -> bool:
        """Whether rounding of the pose alone explains it, which is less than the limits.

        The difference of two rotations has a norm of 1.4 times their angle.
        """
        turned = self._pose[:3, :3] - self._nominal[:3, :3]
        return bool(self.off_mm <= ROUNDING_MM and np.vdot(turned, turned) <= ROUNDING_RAD**2)

    def within(self, limit_mm: float, limit_rad: float) -> bool:
        """Whether it is within limits; NaN is not."""
        return bool(self.off_mm <= limit_mm and np.linalg.norm(self.turn_rad) <= limit_rad)


def check_pose(robot: RobotTable, reading: RobotReading, operation: str) -> Deviation:
    """The deviation; raises `DeviceError` beyond rounding and factory calibration."""
    factory_mm, factory_rad = 15.0, np.radians(1.0)  # what links measured in a factory may explain
    arm = robot.arm()
    found = Deviation(arm, reading.joints_rad, reading.pose)
    if found.rounded:
        return found
    limit_mm, limit_rad = found.limit_mm, found.limit_rad
    if reading.by_factory_links:
        limit_mm, limit_rad = factory_mm, factory_rad
    if found.within(limit_mm, limit_rad):
        return found
    off_deg, off_mm = float(np.degrees(np.linalg.norm(found.turn_rad))), found.off_mm
    fits = fitting(arm, reading.joints_rad, reading.pose)
    where = " or ".join(f"{name} by {by:+.3f}" for name, by in fits.items())
    first = f"this fits: {where} on the controller; " if fits else ""
    raise DeviceError(
        "HC-B36",
        "Robot",
        operation,
        f"the controller's pose is {off_mm:.3f} mm and {off_deg:.4f} deg from that of its joints "
        "by the cell file",
        expected=f"<= {limit_mm:.3f} mm and {np.degrees(limit_rad):.4f} deg",
        act=(
            f"{first}compare [[robot.joint]] and robot.smr_mm with the controller: its variant, a "
            "typed length, a tool, base or root that is not null, an absolute-accuracy model"
        ),
        fields={
            "off_mm": _finite(off_mm),
            "off_deg": _finite(off_deg),
            "limit_mm": limit_mm,
            "limit_deg": float(np.degrees(limit_rad)),
            "fits": fits,
        },
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None  # a journal keeps no other number


def fitting(arm: Arm, joints_rad: Array, pose: Array) -> dict[str, float]:
    """Single links and tool coordinates that explain a controller's pose (4, 4), the best first.
    Their names in the cell file, with differences (mm, deg).
    """
    fits = []
    fitted = (*range(24), *range(30, 33))  # of `parameters` those that a cell file has
    for column in fitted:
        other, step = _best_fit(arm, joints_rad, pose, column)
        left = Deviation(other, joints_rad, pose)
        if left.holds:
            fits.append((left.off_mm, *_named(column, step)))
    listed = 3
    return {name: by for _, name, by in sorted(fits)[:listed]}


def _best_fit(arm: Arm, joints_rad: Array, pose: Array, column: int) -> tuple[Arm, float]:
    """The arm with one parameter changed so that its pose fits best, and the change."""
    scale = np.array([1.0] * 3 + [1000.0] * 3)  # an angle acts over a metre
    other, step = arm, 0.0
    tries = 4
    for _ in range(tries):
        left = Deviation(other, joints_rad, pose)
        J = scale * parameter_jacobian(other, joints_rad)[:, column]
        d = scale * np.concatenate([left.shift_mm, left.turn_rad])
        weight = float(J @ J)
        step += float(J @ d) / weight if weight > 0.0 else 0.0
        other = moved(arm, column, step)
    return other, step


def _named(column: int, step: float) -> tuple[str, float]:
    if column >= 30:
        return f"smr_mm {'xyz'[column - 30]}", step
    kind, row = divmod(column, 6)
    name = KINDS[kind].replace("_rad", "_deg")
    return f"{name} of joint {row + 1}", float(np.degrees(step)) if "deg" in name else step


def check_links(calibration: Calibration, name: str) -> None:
    """Raise `HilcellError` for points that the controller solves with factory links."""
    if calibration.provenance.links == "factory":
        raise HilcellError(
            f"{name}: its points are Cartesian, and this robot's controller solves them with links "
            "that its factory has measured; the calibration was learnt with those of the cell "
            "file, so each point would be millimetres off; `hilcell prepare HOLES.csv` writes a "
            "program of joints",
            code="HC-C10",
        )
