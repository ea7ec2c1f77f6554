"""The robot as its controller takes it to be: nominal arm, posture and limits."""

from __future__ import annotations

from dataclasses import dataclass

from hilcell.geometry.inverse import Bools, posture, reachable
from hilcell.geometry.kinematics import Arm, Array


@dataclass(frozen=True, eq=False)
class NominalRobot:
    """A nominal arm, the status bits of its posture, limits (2, 6) and home joints (6,) in rad."""

    arm: Arm
    status: int
    limits_rad: Array
    reference_rad: Array

    def joints_for(self, poses: Array) -> Array:
        """Return joints (N, 6) in rad for {T} in {B} (N, 4, 4); raises `ReachError`."""
        return posture(self.arm, poses, self.status, self.limits_rad, self.reference_rad)

    def reachable(self, poses: Array) -> Bools:
        """Return which poses (N, 4, 4) `joints_for` accepts, (N,)."""
        return reachable(self.arm, poses, self.status, self.limits_rad, self.reference_rad)
