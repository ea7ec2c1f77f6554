"""A floor nest that rose straight out of the plane of the three since the current calibration.

Distances of three nests hardly change then, but {W} tilts about the other two, and the robot's base
lies elsewhere in it. So {B} as this run measured it is compared with that of the calibration's run:
each nest moves it along one direction of six. A nest is suspected where its height explains the
difference better than chance does, and chance what is left: a base that was moved, or a robot with
other zeros, is no risen nest.
"""

from __future__ import annotations

import numpy as np

from hilcell.calibration.change import RISK
from hilcell.calibration.frame_covariance import (
    FLOOR_NESTS,
    floor_points,
    hold_covariance,
    world_covariance,
    world_motion,
)
from hilcell.calibration.suspicions import Suspicion
from hilcell.geometry.rotations import to_rotvec
from hilcell.geometry.statistics import f_quantile, lengths_mm, rectangular_variance
from hilcell.journal.log import Log, positions_mm
from hilcell.ports import Array

FITTED = 12  # parameters of the two circles: centre, axis and radius of each


def risen_nest(log: Log) -> Suspicion | None:
    """Return the nest that rose or sank, if one clearly has; None where no base can tell."""
    before = log.inputs.floor_before
    if before is None or before.base is None or "circle_rms_mm" not in log.frames.get("base", {}):
        return None
    now = log.matrix("base")
    covariance = _covariance(log) + np.array(before.base.covariance)
    d = _moved(np.array(before.base.matrix), now)
    up = log.matrix("world")[:3, :3].T[:, 2]  # of {W}, in the tracker's frame
    columns = [world_motion(log, now[:3, 3], nest, up) for nest in range(FLOOR_NESTS)]
    heights_mm, sigmas_mm = np.array([_fitted(d, covariance, each) for each in columns]).T
    nest = int(np.argmax(np.abs(heights_mm / sigmas_mm)))
    explained = (heights_mm[nest] / sigmas_mm[nest]) ** 2
    left = float(d @ np.linalg.solve(covariance, d)) - explained
    freedom = 2.0 * len(log.select("base")) - FITTED
    if not explained > f_quantile(1.0 - RISK / FLOOR_NESTS, 1, freedom):
        return None
    if not left <= 5.0 * f_quantile(1.0 - RISK, 5, freedom):
        return None
    name = log.cell.layout.floor[nest].name
    noticed_by = f"base frame of run {before.run}"
    return Suspicion("nest moved", float(heights_mm[nest]), f"mm of {name}", noticed_by)


def _fitted(d: Array, covariance: Array, column: Array) -> tuple[float, float]:
    """Return the height by generalised least squares, and its standard uncertainty."""
    weighted = np.linalg.solve(covariance, column)
    information = float(weighted @ column)
    return float(weighted @ d) / information, 1.0 / np.sqrt(information)


def _moved(then: Array, now: Array) -> Array:
    """Return the shift of a frame's origin (mm) and its rotation vector (rad), axes of {W}."""
    turn = to_rotvec(now[:3, :3] @ then[:3, :3].T)
    return np.concatenate([now[:3, 3] - then[:3, 3], turn.reshape(3)])


def _covariance(log: Log) -> Array:
    """Return the covariance (6, 6) of the change of {B} in {W} but for the circles of then.

    Both runs have the noise, drift and limits of the tracker in {W}, and the hold of the slide.
    """
    stated = log.cell.uncertainty
    far_mm = float(lengths_mm(positions_mm(floor_points(log))).max())
    limit_mm = stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * far_mm
    centring_mm2 = sum(map(rectangular_variance, (stated.drift_limit_mm, limit_mm)))
    both = 2.0 * world_covariance(log, log.matrix("base")[:3, 3], centring_mm2)
    both[:3, :3] += 2.0 * hold_covariance(log.cell)
    circles: Array = np.array(log.frames["base"]["covariance"])
    return both + circles
