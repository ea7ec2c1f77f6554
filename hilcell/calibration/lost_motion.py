"""Lost motion of the joints: as measured, and its effect on a straight path to a hole.

In a calibration every axis comes from below, so that lost motion cancels. Of N vertices approached
from above as well, the differences are the Jacobian's columns times the lost motion of each axis at
reversal. Axes 1 to 3, with levers of metres, are estimated; the others are noise. On a straight
path reversed axes err by their lost motion: as measured for the large axes, an uncertainty for the
rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from hilcell.calibration.causes import zero_columns
from hilcell.calibration.file import LostMotion
from hilcell.calibration.known_arm import carried_calibration
from hilcell.calibration.position_errors import block_diagonal, visit_noise
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.statistics import bounds95_mm, lengths_mm, rectangular_variance
from hilcell.journal.log import Log, commanded_rad, positions_mm
from hilcell.model.events import URAD
from hilcell.model.point import PointId
from hilcell.model.verdicts import Cause, LostMotionJudged, Suspicion
from hilcell.ports import Array

REVERSAL = "reversal"  # kind of the points that were approached from above
LARGE, AXES = 3, 6  # the first ones, and all
WRIST_RAD = 1e-4  # 1 sigma of what axes 4 to 6 may lose
COVERAGE = 2.0  # k


def lost_motion(log: Log) -> LostMotion:
    """Lost motion of the axes, as measured; else 0, within the data sheet's limit."""
    if (carried := carried_calibration(log)) is not None:
        return carried.lost_motion
    verdict = log.once_measured(reversal)
    wrist = [WRIST_RAD] * (AXES - LARGE)
    if verdict is None:
        limit_rad = log.cell.uncertainty.lost_motion_urad / URAD
        u_rad = [math.sqrt(rectangular_variance(limit_rad))] * LARGE
        return LostMotion([0.0] * AXES, [*u_rad, *wrist], measured=False)
    lost_rad = [each / URAD for each in verdict.lost_urad]
    u_rad = [each / URAD / COVERAGE for each in verdict.U_urad]
    return LostMotion([*lost_rad, *[0.0] * (AXES - LARGE)], [*u_rad, *wrist], measured=True)


def reversal(log: Log) -> LostMotionJudged | None:
    """Verdict on the points approached from above; None without any."""
    above = log.select(REVERSAL)
    if not above:
        return None
    T_B_L = inverse(log.matrix("base")) @ log.matrix("world")
    below = [log.point(PointId("revisit", vertex=point.id.vertex)) for point in above]
    off_mm = apply(T_B_L, positions_mm(above)) - apply(T_B_L, positions_mm(below))
    arm, joints_rad = log.cell.robot.arm(), commanded_rad(above)
    J = -zero_columns(arm, joints_rad).reshape(-1, 6)
    count, drift_mm2 = len(above), rectangular_variance(log.cell.uncertainty.drift_limit_mm)
    noise = visit_noise(log)
    visits_mm2 = [noise.covariances(points, T_B_L[:3, :3]) for points in (above, below)]
    wrist = J[:, LARGE:] * WRIST_RAD
    shared = np.ones((count, count)) * drift_mm2
    C = block_diagonal(np.sum(visits_mm2, axis=0)) + np.kron(shared, np.eye(3)) + wrist @ wrist.T
    weighted = np.linalg.solve(C, J[:, :LARGE])
    covariance = np.linalg.inv(J[:, :LARGE].T @ weighted)
    lost = URAD * covariance @ weighted.T @ off_mm.reshape(-1)
    U = URAD * COVERAGE * np.sqrt(np.diag(covariance))
    limit_urad = log.cell.uncertainty.lost_motion_urad
    return reversal_verdict(lengths_mm(off_mm).tolist(), lost.tolist(), U.tolist(), limit_urad)


def reversal_verdict(
    off_mm: list[float], lost_urad: list[float], U_urad: list[float], limit_urad: float
) -> LostMotionJudged:
    """Verdict on distances (N) between both directions and on the lost motion of axes 1 to 3."""
    verdict = LostMotionJudged(
        holds=False,
        mean_mm=float(np.mean(off_mm)),
        max_mm=max(off_mm),
        points=len(off_mm),
        lost_urad=lost_urad,
        U_urad=U_urad,
        limit_urad=limit_urad,
    )
    return msgspec.structs.replace(verdict, holds=all(each <= 0.0 for each in verdict.excess_urad))


def lost_too_much(log: Log) -> Suspicion | None:
    verdict = log.once_measured(reversal)
    if verdict is None or verdict.holds:
        return None
    axis = int(np.argmax(verdict.excess_urad))
    noticed_by = "vertices approached from above"
    return Suspicion(
        Cause.REVERSAL, verdict.lost_urad[axis], f"urad of axis {axis + 1}", noticed_by
    )


# -- the cost of a straight path to a hole ---------------------------------------------------------

TAKE_UP_RAD = 3e-4  # an axis that turns down by less has taken up a part of its play only


@dataclass(frozen=True, eq=False)
class StraightPath:
    """Offsets of N tips from their place approached from below: (N, 3) in {W}; covariances."""

    shift_mm: Array
    covariance_mm2: Array

    @property
    def text(self) -> str:
        most_mm = float(lengths_mm(self.shift_mm).max())
        left_mm = float(bounds95_mm(self.covariance_mm2).max())
        return (
            f"axes that reverse on the straight path in lose motion: corrected by up to "
            f"{most_mm:.3f} mm; up to {left_mm:.3f} mm (95 %) comes on top of the bounds"
        )


def straight_path(lost: LostMotion, arm: Arm, T_W_B: Array, straight_rad: Array) -> StraightPath:
    """Effect of straight paths by joints (N, K, 6) of an arm at ``T_W_B``, at their ends."""
    angles_rad = arm.angles(straight_rad)
    end_rad = angles_rad[:, -1]
    fall_rad = angles_rad.max(axis=1) - end_rad
    turns_down = end_rad < angles_rad[:, -2]
    share = np.where(turns_down, np.minimum(fall_rad / TAKE_UP_RAD, 1.0), 0.0)
    J = T_W_B[:3, :3] @ zero_columns(arm.by_angles, end_rad)
    lost_rad, u_rad = np.array(lost.lost_rad), np.array(lost.u_rad)
    shift_mm = -np.einsum("nij,nj->ni", J, share * lost_rad)
    partly = share * (1.0 - share) * np.abs(lost_rad)
    spread = J * np.hypot(share * u_rad, partly)[:, None]
    return StraightPath(shift_mm, spread @ np.swapaxes(spread, 1, 2))
