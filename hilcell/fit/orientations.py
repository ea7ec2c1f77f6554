"""Measured orientations as readings of points, which a robot's identification takes as reflectors.

An orientation is read as two points on the measured body's x and y, far from its origin, so that
they say nothing of its position. Their covariance is that of the orientation. The body's own frame
on the flange is unknown, as reflectors are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import Placement
from hilcell.geometry.frames import apply_each, inverse
from hilcell.geometry.kinematics import Array, forward

_LEVER_MM = 10_000.0
# Variances of both points along the body's axes, in those of lever times rotation: a rotation about
# x moves y's point alone, one about y x's, one about z both. None moves a point along its own axis.
_VARIANCES = np.array([[4.0, 2.0, 1.0], [2.0, 4.0, 1.0]])


def points_of(rows: Measurements, assumed_rad: float) -> Measurements:
    """Two rows for each orientation, x's then y's; unknown uncertainties are as assumed.

    One that several reflectors of a pose repeat counts once.
    """
    if rows.R is None:
        return rows.at([])
    values = np.column_stack([rows.joints_rad, rows.R.reshape(-1, 9)])
    different = np.sort(np.unique(values, axis=0, return_index=True)[1])
    known = different[np.isfinite(rows.R[different]).all(axis=(1, 2))]
    own, R = rows.at(known), rows.R[known]
    u_rad = np.full(len(known), assumed_rad) if own.u_rad is None else own.u_rad
    scale_mm2 = np.tile((_LEVER_MM * u_rad) ** 2, 2)
    variances_mm2 = np.repeat(_VARIANCES, len(known), axis=0) * scale_mm2[:, None]
    both, axes = own.at([*range(len(known))] * 2), np.tile(R, (2, 1, 1))
    return replace(
        both,
        target=[f"{target} {axis}" for axis in "xy" for target in own.target],
        xyz_mm=both.xyz_mm + _LEVER_MM * np.concatenate([R[:, :, 0], R[:, :, 1]]),
        covariance_mm2=(axes * variances_mm2[:, None, :]) @ np.swapaxes(axes, 1, 2),
        R=None,
        u_rad=None,
    )


def mounted(placement: Placement, rows: Measurements) -> tuple[Measurements, dict[str, Array]]:
    """The points of rows, and where they are on the flange (3,), by nominal kinematics.

    Its misses are the uncertainty where none is known: too large, but no orientation contradicts.
    """
    points = points_of(rows, 1.0)
    if not len(points):
        return points, {}
    flange = placement.T_L_B @ forward(placement.arm, points.joints_rad)
    at_mm = apply_each(inverse(flange), points.xyz_mm)
    places_mm = {each: np.median(at_mm[points.of(each)], axis=0) for each in set(points.target)}
    missed_mm = at_mm - np.array([places_mm[each] for each in points.target])
    return points_of(rows, scatter_rad(missed_mm)), places_mm


def scatter_rad(missed_mm: Array) -> float:
    """Standard deviation of orientations about an axis, by their points' misses (N, 3)."""
    middle = 2.0 * np.log(2.0)  # of the squared length of a vector of two normal coordinates
    squares = np.sum(missed_mm**2, axis=1)  # a point does not move along its own axis
    return float(np.sqrt(np.nanmedian(squares) / middle)) / _LEVER_MM
