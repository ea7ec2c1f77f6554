"""Robots with known errors, measured without wires: truth for the identification's tests."""

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.kinematics import Arm, Array
from hilcell.identification.kinematics import Kinematics, State, TransmissionCurve
from hilcell.identification.measured_poses import Readings

ARM = Arm(
    a_mm=np.array([350.0, 1250.0, -55.0, 0.0, 0.0, 0.0]),
    alpha_rad=np.radians([-90.0, 0.0, -90.0, 90.0, -90.0, 0.0]),
    d_mm=np.array([675.0, 0.0, 0.0, 1500.0, 0.0, 215.0]),
    offset_rad=np.radians([0.0, 0.0, -90.0, 0.0, 0.0, 180.0]),
    sign=np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0]),
    tool=np.eye(4),
)
T_L_B = pose_from_zyx(2200, -150, -600, 170, 2, -1)
SMR_MM = np.array([[0.2, -0.8, 120.5], [75.2, 90.6, 213.4], [150.7, -1.3, 121.7]])
MIDDLE_RAD = np.radians([0.0, -70.0, 90.0, 20.0, 40.0, 10.0])


def curve(
    axis: int, cycles: tuple[float, ...], seed: int = 0, rad: float = 40e-6
) -> TransmissionCurve:
    """Return a curve with drawn amplitudes, known to 3 urad."""
    amplitude = np.random.default_rng(seed).normal(0.0, 40e-6, (len(cycles), 2))
    covariance = 9e-12 * np.eye(2 * len(cycles))
    return TransmissionCurve(
        axis, np.array(cycles), amplitude, covariance, 0.0, 1e-3, -np.pi, np.pi, 1e-6
    )


@dataclass(frozen=True, eq=False)
class Robot:
    """A kind of robot and one with errors."""

    kinematics: Kinematics
    state: State

    @classmethod
    def drawn(cls, kinematics: Kinematics, seed: int) -> "Robot":
        rng = np.random.default_rng(seed)
        mean, covariance = kinematics.prior
        placed = kinematics.placed
        values = (mean + rng.standard_normal(len(mean)) * np.sqrt(np.diag(covariance)))[placed:]
        return cls(
            kinematics, State(T_L_B, SMR_MM[: kinematics.reflectors], values, np.zeros(placed))
        )

    def joints_rad(self, seed: int, poses: int, spread_rad: float = 0.6) -> Array:
        rng = np.random.default_rng(seed)
        return MIDDLE_RAD + rng.uniform(-spread_rad, spread_rad, (poses, 6))

    def measured(
        self, seed: int, poses: int, noise_mm: float = 0.0, joint_rad: float = 0.0
    ) -> Readings:
        """Return readings with noise of the tracker and of the joints."""
        rng, joints = np.random.default_rng([seed, 1]), self.joints_rad(seed, poses)
        landed = joints + joint_rad * rng.standard_normal(joints.shape)
        xyz_mm = self.kinematics.positions_mm(self.state, landed)
        xyz_mm += noise_mm * rng.standard_normal(xyz_mm.shape)
        return Readings(joints, xyz_mm, np.zeros((*xyz_mm.shape, 3)))
