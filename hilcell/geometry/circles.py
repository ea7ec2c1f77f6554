"""Circles of a reflector about one robot axis, and the base frame they define (Fig 6).

The sense of a circle's axis follows from the order of its points, so `fit_circle` must know whether
they were taken in the positive or the negative sense.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.frames import FrameError, checked_points, matrix, unit
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import lengths_mm, rms


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle in space: centre (3,), unit axis (3,), radius, and residuals.

    ``residuals_mm`` (N, 2): axial, radial. ``covariance`` (6, 6) of centre (mm) and axis, scaled by
    the residuals; NaN with three points.
    """

    centre_mm: Array
    axis: Array
    radius_mm: float
    residuals_mm: Array
    covariance: Array

    @property
    def rms_mm(self) -> float:
        return rms(lengths_mm(self.residuals_mm))

    def linearised(self, points: Array) -> tuple[Array, Array, Array]:
        lever = points - self.centre_mm
        along = lever @ self.axis
        inside = lever - along[:, None] * self.axis
        radius = np.linalg.norm(inside, axis=1)
        outward = inside / radius[:, None]
        tangents = np.linalg.svd(self.axis[None])[2][1:].T
        zeros, ones = np.zeros((len(points), 1)), np.ones((len(points), 1))
        of_along = np.hstack([np.tile(-self.axis, (len(points), 1)), lever @ tangents, zeros])
        of_radius = np.hstack([-outward, -along[:, None] * (outward @ tangents), -ones])
        return (
            np.concatenate([along, radius - self.radius_mm]),
            np.vstack([of_along, of_radius]),
            tangents,
        )

    def directed(self, points: Array, turn: float) -> Circle:
        lever = points - self.centre_mm
        swept = np.cross(lever[:-1], lever[1:]).sum(axis=0) @ self.axis
        if not abs(turn * swept) > 0:
            raise FrameError(
                f"circle fit: no sense of rotation (turn {turn}, points' order {swept})"
            )
        return self if swept * turn > 0 else replace(self, axis=-self.axis)

    def with_covariance(self, points: Array) -> Circle:
        r, J, tangents = self.linearised(points)
        left = 2 * len(points) - 6
        variance = r @ r / left if left else np.nan
        parameters = _parameters(tangents)[:6, :5]
        covariance = parameters @ np.linalg.inv(J.T @ J)[:5, :5] @ parameters.T * variance
        residuals = r.reshape(2, -1).T
        return replace(self, residuals_mm=residuals, covariance=covariance)


def fit_circle(points_mm: ArrayLike, turn: float = 1.0) -> Circle:
    """Fit a circle to N >= 3 points (N, 3) by least squares of their distances from it.

    ``turn`` > 0: the points run counter-clockwise about the axis, viewed from its tip (steps below
    half a turn); < 0 clockwise. Raises `FrameError` on non-finite or collinear points and where the
    fit does not converge.
    """
    points = checked_points(np.asarray(points_mm, dtype=float), "the circle's points")
    # plane and algebraic circle of the points
    middle = points.mean(axis=0)
    e1, e2, axis = np.linalg.svd(points - middle)[2]
    u, v = (points - middle) @ e1, (points - middle) @ e2
    rows = np.column_stack([2 * u, 2 * v, np.ones(len(points))])
    cu, cv, c = np.linalg.lstsq(rows, u**2 + v**2, rcond=None)[0]
    radius = float(np.sqrt(c + cu**2 + cv**2))
    nothing = np.empty((0, 0))
    circle = Circle(middle + cu * e1 + cv * e2, axis, radius, nothing, nothing)
    converged = 1e-12
    for _ in range(50):
        r, J, tangents = circle.linearised(points)
        step = np.linalg.lstsq(J, -r, rcond=None)[0]
        circle = replace(
            circle,
            centre_mm=circle.centre_mm + step[:3],
            axis=unit(circle.axis + tangents @ step[3:5]),
            radius_mm=circle.radius_mm + float(step[5]),
        )
        if np.linalg.norm(step / circle.radius_mm) <= converged:
            break
    else:
        raise FrameError(
            f"circle fit of {len(points)} points does not settle (radius {circle.radius_mm:.3f} "
            "mm): sweep a longer arc"
        )
    return circle.directed(points, turn).with_covariance(points)


def reading_covariance(circle: Circle, points_mm: Array, covariances_mm2: Array) -> Array:
    """Covariance (7, 7) of centre, axis and radius from its points' (N, 3, 3). Unlike that of the
    residuals it includes a direction of larger scatter.
    """
    _, J, tangents = circle.linearised(points_mm)
    lever = points_mm - circle.centre_mm
    inside = lever - (lever @ circle.axis)[:, None] * circle.axis
    outward = inside / lengths_mm(inside)[:, None]
    by_residual = np.linalg.pinv(J).reshape(6, 2, len(points_mm))
    by_point = by_residual[:, 0, :, None] * circle.axis + by_residual[:, 1, :, None] * outward
    covariance = np.einsum("pni,nij,qnj->pq", by_point, covariances_mm2, by_point)
    parameters = _parameters(tangents)
    return np.asarray(parameters @ covariance @ parameters.T)


def base_frame(axis_1: Circle, axis_6: Circle, height_mm: float) -> Array:
    """{B} (4, 4) in the frame of the circles, from sweeps about axes 1 and 6.

    z is axis 1; x is axis 6, swept at A1 = 0, made orthogonal to z, from axis 1 to the circle of
    axis 6. The origin lies on axis 1, ``height_mm`` below the centre of axis 6's circle. Raises
    `FrameError` where the axes are too nearly parallel.
    """
    z = axis_1.axis
    across = axis_6.axis - (axis_6.axis @ z) * z
    least_angle = 0.1  # sine between axes 1 and 6 below which x is not defined
    if not np.linalg.norm(across) > least_angle:
        raise FrameError(
            f"base frame: axes 1 and 6 are {np.degrees(np.arcsin(np.linalg.norm(across))):.1f} deg "
            "apart, expected near 90: sweep axis 6 with its axis level"
        )
    outward = axis_6.centre_mm - axis_1.centre_mm
    x = unit(across) * (1.0 if across @ outward >= 0 else -1.0)
    origin = axis_1.centre_mm + z * (outward @ z - height_mm)
    return matrix(np.column_stack([x, np.cross(z, x), z]), origin)


def base_frame_covariance(axis_1: Circle, axis_6: Circle, height_mm: float) -> Array:
    """Covariance (6, 6) of `base_frame`: shift of its origin (mm), rotation vector. Both with the
    axes of the circles' frame, as in `frames.RigidFit`.
    """
    T = base_frame(axis_1, axis_6, height_mm)
    covariance = np.zeros((6, 6))
    centre_step_mm, axis_step = 1e-3, 1e-6  # of the numeric propagation of uncertainty
    for which, circle in enumerate((axis_1, axis_6)):
        columns = []
        for step in np.diag([centre_step_mm] * 3 + [axis_step] * 3):
            pair = [axis_1, axis_6]
            pair[which] = replace(
                circle, centre_mm=circle.centre_mm + step[:3], axis=unit(circle.axis + step[3:])
            )
            moved = base_frame(pair[0], pair[1], height_mm)
            turn = (moved[:3, :3] @ T[:3, :3].T)[[2, 0, 1], [1, 2, 0]]
            columns.append(np.concatenate([moved[:3, 3] - T[:3, 3], turn]) / step.sum())
        J = np.column_stack(columns)
        covariance += J @ circle.covariance @ J.T
    return covariance


def _parameters(tangents: Array) -> Array:
    """Return d(centre, axis, radius) / d(centre, the axis's two tangents, radius), (7, 6)."""
    found = np.zeros((7, 6))
    found[:3, :3], found[3:6, 3:5], found[6, 5] = np.eye(3), tangents, 1.0
    return found
