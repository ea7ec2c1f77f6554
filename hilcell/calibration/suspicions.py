"""Changes of the robot that a re-check suspects, where no motion of the base explains its errors.

Each cause moves the poses in a way of its own: an axis that lost its zero by its column of the
Jacobian, a reflector that moved on the flange by its orientation, an arm that grew by its length.
A cause is suspected where errors are as predicted once it is taken off together with a motion of
the base. It is a hint where to look, no proof: seven poses cannot tell every cause from another,
and an axis 2 that lost its zero turns the arm in its plane as a tilted base does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.calibration.recheck import MOTION, Judgement, Rechecked, limit_of, motion_columns
from hilcell.geometry.kinematics import Arm, Array, forward

STEP_RAD = 1e-6
AXES = (2, 3, 4, 5)  # axis 1 turns the base; axis 6 hardly moves the reflector


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A cause in words, and its size: deg of an axis, mm of the reflector, um/m of the arm."""

    cause: str
    size: float
    unit: str

    @property
    def text(self) -> str:
        """Return it in words."""
        return f"{self.cause} ({self.size:.4g} {self.unit})"


def suspicions(found: Rechecked, judged: Judgement, arm: Arm, joints_rad: Array) -> list[Suspicion]:
    """Return the causes that explain the errors at joints (N, 6), the likeliest first.

    None where the errors need no cause besides a motion of the base.
    """
    if judged.rest.holds:
        return []
    likely: list[tuple[float, Suspicion]] = []
    for cause, columns, factor, unit in _causes(found, arm, joints_rad):
        chi2, size = _explained(found, columns)
        freedom = judged.rest.freedom - columns.shape[1]
        if chi2 <= limit_of(freedom):
            likely.append((chi2 / freedom, Suspicion(cause, factor * size, unit)))
    return [each for _, each in sorted(likely, key=lambda pair: pair[0])]


def _causes(found: Rechecked, arm: Arm, joints_rad: Array) -> list[tuple[str, Array, float, str]]:
    """Return causes: words, columns (3N, K) of errors per unit, factor and name of the unit."""
    poses = forward(arm, joints_rad)
    causes: list[tuple[str, Array, float, str]] = []
    for axis in AXES:
        step = STEP_RAD * np.eye(6)[axis - 1]
        ends = [forward(arm, joints_rad + sign * step)[:, :3, 3] for sign in (1.0, -1.0)]
        column = ((ends[0] - ends[1]) / (2 * STEP_RAD)).reshape(-1, 1)
        causes.append((f"axis {axis} lost its zero", column, np.degrees(1.0), "deg"))
    causes.append(("the reflector moved on the flange", poses[:, :3, :3].reshape(-1, 3), 1.0, "mm"))
    causes.append(("the arm grew", found.targets_mm.reshape(-1, 1), 1e6, "µm/m"))
    return causes


def _explained(found: Rechecked, columns: Array) -> tuple[float, float]:
    """Return the chi^2 that the columns and a motion of the base leave, and the columns' size."""
    J = np.hstack([motion_columns(found.targets_mm), columns])
    C, e = found.covariance_mm2, found.errors_mm.reshape(-1)
    weighted = np.linalg.solve(C, np.column_stack([J, e]))
    scale = 1.0 / np.sqrt(np.einsum("nj,nj->j", J, weighted[:, :-1]))
    information = scale[:, None] * (J.T @ weighted[:, :-1]) * scale
    pull = scale * (J.T @ weighted[:, -1])
    x = scale * (np.linalg.pinv(information, hermitian=True) @ pull)
    chi2 = float(e @ weighted[:, -1]) - float(x @ (J.T @ weighted[:, -1]))
    own = x[MOTION:]
    return chi2, float(own[0]) if len(own) == 1 else float(np.linalg.norm(own))
