"""Measured orientations as readings of points, which a robot's identification takes as reflectors.

An orientation is read as two points on the measured body's x and y, far from its origin, so that
they say nothing of its position. Their covariance is that of the orientation. The body's own frame
on the flange is unknown, as reflectors are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from hilcell.fit.measurements import Measurements, rotations
from hilcell.fit.placement import FitError, Placement
from hilcell.geometry.frames import apply_each, from_rotvec, inverse
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
    places_mm, missed_mm = _on_the_flange(placement, points)
    return points_of(rows, scatter_rad(missed_mm)), places_mm


def _on_the_flange(placement: Placement, points: Measurements) -> tuple[dict[str, Array], Array]:
    """Where points are on the nominal flange (3,), and how far each is from there (N, 3)."""
    flange = placement.T_L_B @ forward(placement.arm, points.joints_rad)
    at_mm = apply_each(inverse(flange), points.xyz_mm)
    places_mm = {each: np.median(at_mm[points.of(each)], axis=0) for each in set(points.target)}
    return places_mm, at_mm - np.array([places_mm[each] for each in points.target])


def refuse_misread(placement: Placement, rows: Measurements) -> None:
    """Refuse orientations that fit nominal ones clearly better if they are read otherwise, and
    those that are not the flange's at all.
    """
    least, clearly, most_rad = 8, 3.0, np.radians(2.0)  # no arm errs so
    count = len(points_of(rows, 1.0)) // 2
    if rows.R is None or count < least:
        return

    def scatter(R: Array) -> float:
        points = points_of(replace(rows, R=R, u_rad=None), 1.0)
        return scatter_rad(_on_the_flange(placement, points)[1])

    read_rad = scatter(rows.R)
    others = {says: scatter(R) for says, R in _readings(rows.R, rows.turns)}
    best = min(others, key=lambda says: others[says])
    found = f"{rows.source}: orientations differ by {np.degrees(read_rad):.3g} deg from the robot's"
    if clearly * others[best] < read_rad:
        raise FitError(f"{found}; they fit if they are {best}: correct the columns")
    if not read_rad <= most_rad:
        raise FitError(
            f"{found}, expected <= {np.degrees(most_rad):.3g} deg; correct their columns or ignore "
            "them (no unit, order of angles, or inverse fits)"
        )


def _readings(R: Array, turns: Array | None) -> Iterator[tuple[str, Array]]:
    """Other rotations (N, 3, 3) that columns (N, 3 or 4), read in rad, may mean."""
    inverted = ", of the tracker in the body's frame"
    yield f"as read{inverted}", np.swapaxes(R, 1, 2)
    quaternion = 4
    readings = list[tuple[str, Array]]()
    if turns is not None and turns.shape[1] == quaternion:
        others = rotations("quaternion", turns[:, [3, 0, 1, 2]])
        readings = [("in the order qx, qy, qz, qw", others)]
    elif turns is not None:
        for unit, factor in (("", 1.0), (" in deg", np.radians(1.0)), (" in rad", np.degrees(1.0))):
            v = factor * turns
            back = v[:, ::-1]
            readings += [
                (f"rotation vectors{unit}", from_rotvec(v)),
                (f"Rz(a) Ry(b) Rx(c), columns a, b, c{unit}", _turned("zyx", v)),
                (
                    f"Rz(yaw) Ry(pitch) Rx(roll), columns roll, pitch, yaw{unit}",
                    _turned("zyx", back),
                ),
            ]
            for axes in product("xyz", repeat=3):
                if axes[0] != axes[1] != axes[2] and axes != ("z", "y", "x"):
                    says = " ".join(f"R{axis}" for axis in axes)
                    readings += [
                        (f"{says} of the columns in order{unit}", _turned(axes, v)),
                        (f"{says} of the columns in reverse order{unit}", _turned(axes, back)),
                    ]
    for says, other in readings:
        yield says, other
        yield f"{says}{inverted}", np.swapaxes(other, 1, 2)


def _turned(axes: Iterable[str], angles_rad: Array) -> Array:
    """Products (N, 3, 3) of turns about axes by angles (N, 3)."""
    first, second, third = (
        from_rotvec(angles_rad[:, [n]] * np.eye(3)["xyz".index(axis)])
        for n, axis in enumerate(axes)
    )
    return np.asarray(first @ second @ third)


def scatter_rad(missed_mm: Array) -> float:
    """Standard deviation of orientations about an axis, by their points' misses (N, 3)."""
    middle = 2.0 * np.log(2.0)  # of the squared length of a vector of two normal coordinates
    squares = np.sum(missed_mm**2, axis=1)  # a point does not move along its own axis
    return float(np.sqrt(np.nanmedian(squares) / middle)) / _LEVER_MM
