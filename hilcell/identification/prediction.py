"""Positions and orientations that identified kinematics predict, with their covariance."""

from __future__ import annotations

import numpy as np

from hilcell.geometry.kinematics import Array, forward
from hilcell.geometry.orientation import turn_levers
from hilcell.identification.kinematics import Kinematics, State
from hilcell.identification.noise import Noise

AT_ONCE = 4096  # poses, so that their derivatives stay in the processor's cache


def predict(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Return positions (M, K, 3) at commanded joints (M, 6) and their covariances (M, K, 3, 3).

    Covered are the parameters' ``covariance`` (P, P), and one visit's scatter as the identification
    met it: repeatability, and what no parameter describes. The reading is not.
    """
    count = len(joints_rad)
    positions = np.empty((count, kinematics.reflectors, 3))
    covariances = np.empty((count, kinematics.reflectors, 3, 3))
    size = len(covariance)
    for first in range(0, count, AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found = kinematics.linearised(state, joints_rad[part])
        J = found.by_parameter
        carried = (J.reshape(-1, size) @ covariance).reshape(J.shape)
        positions[part] = found.positions_mm
        covariances[part] = carried @ np.swapaxes(J, -1, -2) + noise.scatter(found.by_joint)
    return positions, covariances


def predict_orientations(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Return orientations (M, 3, 3) of the flange at commanded joints (M, 6), and the covariances
    (M, 3, 3) of their rotation vectors.

    The reflectors define the orientation. A turn of them on the flange that a turn of the last link
    takes back moves none: no reading tells it, and it counts for nothing.
    """
    true_rad = kinematics.joints_of(state, joints_rad)
    R = (state.T @ forward(kinematics.arm_of(state), true_rad))[:, :3, :3]
    covariances = np.empty((len(joints_rad), 3, 3))
    for first in range(0, len(joints_rad), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found = kinematics.linearised(state, joints_rad[part])
        levers = turn_levers(state.smr_mm, R[part])
        J = np.sum(levers @ found.by_parameter, axis=1)
        by_joint = np.sum(levers @ found.by_joint, axis=1) * noise.joint_rad
        own = np.sum(levers @ np.swapaxes(levers, -1, -2), axis=1) * noise.reading_mm**2
        scatter = by_joint @ np.swapaxes(by_joint, 1, 2) + own
        covariances[part] = J @ covariance @ np.swapaxes(J, 1, 2) + scatter
    return R, covariances
