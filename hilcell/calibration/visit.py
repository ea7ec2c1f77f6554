"""Points of a run that used a calibration, in its {B}, and the noise of that visit.

The noise is that of the calibration's budget: lines that differ from point to point, and frames,
which move all points of the run together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.calibration.budget import temperature
from hilcell.calibration.form import Calibration
from hilcell.calibration.in_use import NoCalibration, calibration_in
from hilcell.calibration.influence import NoBound
from hilcell.geometry.frames import apply, inverse
from hilcell.journal.log import Log, covariances_mm2, positions_mm
from hilcell.model.point import Point
from hilcell.ports import Array


@dataclass(frozen=True, eq=False)
class Visited:
    """Nominal and measured positions (N, 3) in {B}; covariances (N, 3, 3) of visit and reading,
    and (7, 7) of the frames: shift (mm), rotation vector (rad), growth about the origin of {B}.

    ``within_mm2`` (3, 3) is the part of a visit that the model's covariance has in it, too.
    """

    nominal_mm: Array
    actual_mm: Array
    own_mm2: Array
    common: Array
    within_mm2: Array


def used(log: Log) -> Calibration:
    """Return the calibration that the run uses; raises `NoCalibration` before it does."""
    calibration = calibration_in(log)
    if calibration is None:
        raise NoCalibration("the run has used no calibration yet")
    return calibration


def visited(log: Log, points: list[Point], station: str) -> Visited:
    """Return the points, all measured at ``station``; raises `NoBound` without a budget."""
    calibration = used(log)
    T_W_B = np.array(calibration.stations[station].T_W_B)
    T_B_L = inverse(T_W_B) @ log.matrix("world")
    nominal_mm = apply(inverse(T_W_B), np.array([p.nominal_mm for p in points], dtype=float))
    alone_mm2, within_mm2, common = _noise(log, calibration, station, T_W_B)
    own_mm2 = alone_mm2 + covariances_mm2(points, T_B_L[:3, :3])
    return Visited(nominal_mm, apply(T_B_L, positions_mm(points)), own_mm2, common, within_mm2)


def _noise(
    log: Log, calibration: Calibration, station: str, T_W_B: Array
) -> tuple[Array, Array, Array]:
    """Return the budget's covariances of one visit and of its part within the model, (3, 3), and of
    the frames, (7, 7), all in {B}.

    The tracker was set up for the calibration and again for this run, so that the lines of {W}
    count twice. The drill is no part of it.
    """
    stated = calibration.uncertainty
    if stated.missing:
        raise NoBound(stated.missing)
    air_c, then_c = log.temperatures_c(), calibration.validity.temperature_c
    now_c = float(np.mean(air_c)) if air_c and then_c is not None else None
    air = temperature(stated.growth_per_k, then_c, stated.air_range_k, now_c)
    set_up = [line for line in stated.lines if line.frame == "world" and not line.alone]
    frames = {"world": np.eye(4), "base": T_W_B}
    alone, within, common = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((7, 7))
    for line in (*stated.lines, *set_up, *stated.stations[station], air):
        if line.frame == "tool" or line.counts == "in validation":
            continue
        covariance = line.about(frames[line.frame], T_W_B)
        if line.alone:
            alone += covariance[:3, :3]
            within += covariance[:3, :3] * line.within_model
        else:
            common += covariance
    return alone, within, common
