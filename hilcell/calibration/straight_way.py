"""The cost of a straight way in to a hole: axes that turn down on it lose their motion.

A calibration comes to its poses from below on every axis. On a straight way some axes turn down,
and stand elsewhere by their lost motion. The run has measured that of the large axes, by vertices
that were approached from above; the rest is an uncertainty. On three simulated machines the
straight way took the tool .05 to .07 mm away in the mean; corrected, .014 to .031 mm were left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.calibration.causes import ZEROS
from hilcell.calibration.form import LostMotion
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.statistics import bounds95_mm, lengths_mm
from hilcell.ports import Array

TAKE_UP_RAD = 3e-4  # an axis that turns down by less has taken up a part of its play only


@dataclass(frozen=True, eq=False)
class StraightWay:
    """By how far N tips stand elsewhere than if every axis had come from below: (N, 3) in {W}, and
    its covariance (N, 3, 3).
    """

    shift_mm: Array
    covariance_mm2: Array

    @property
    def words(self) -> str:
        """Return in words what was corrected and what is left."""
        most_mm = float(lengths_mm(self.shift_mm).max())
        left_mm = float(bounds95_mm(self.covariance_mm2).max())
        return (
            f"axes that turn down on the straight way in lose motion: corrected by up to "
            f"{most_mm:.3f} mm; up to {left_mm:.3f} mm (95 %) comes on top of the bounds"
        )


def straight_way(lost: LostMotion, arm: Arm, T_W_B: Array, straight_rad: Array) -> StraightWay:
    """Return what straight ways by joints (N, K, 6) cost at their ends.

    ``arm`` has the tip as its tool point and stands at ``T_W_B``.
    """
    end_rad = straight_rad[:, -1]
    fall_rad = straight_rad.max(axis=1) - end_rad
    turns_down = end_rad < straight_rad[:, -2]
    share = np.where(turns_down, np.minimum(fall_rad / TAKE_UP_RAD, 1.0), 0.0)
    J = T_W_B[:3, :3] @ (parameter_jacobian(arm, end_rad)[:, :3, ZEROS] * arm.sign)
    lost_rad, u_rad = np.array(lost.lost_rad), np.array(lost.u_rad)
    shift_mm = -np.einsum("nij,nj->ni", J, share * lost_rad)
    partly = share * (1.0 - share) * np.abs(lost_rad)
    spread = J * np.hypot(share * u_rad, partly)[:, None]
    return StraightWay(shift_mm, spread @ np.swapaxes(spread, 1, 2))
