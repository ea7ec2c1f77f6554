"""Positions that identified kinematics predict, with their covariance."""

from __future__ import annotations

import numpy as np

from hilcell.geometry.kinematics import Array
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
