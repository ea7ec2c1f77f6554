"""Frames as (4, 4) matrices, their rotations, and rigid fits with their uncertainty.

``T_W_B`` carries coordinates of {B} into {W}. A small error of a frame: shift of its origin (mm)
and rotation vector (rad) about it, axes of the frame it is given in. Three points fit a frame and
its mirror image equally well, so left-handed data show only in four or more points not in one
plane. (scipy's rotations take longer to import than all else that starts an engine.)

The base frame follows from circles of a reflector about robot axes (Fig 6). The sense of a circle's
axis follows from the order of its points, so `fit_circle` must know whether they were taken in the
positive or the negative sense.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hilcell.errors import HilcellError
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import lengths_mm, rms

ONE_PLACE_MM = 0.1  # of points that spread by no more, all are at one place


class FrameError(HilcellError):
    """Points that define no frame, or not the frame that they should."""

    code = "HC-C20"


@dataclass(frozen=True, slots=True)
class RigidFit:
    """``b = T a``: fitted frame of a in b, its covariance and residuals.

    ``covariance`` (6, 6): shift of a's origin (mm), rotation vector (rad) about it, axes of b;
    ``residuals_mm`` (N, 3): ``b - T a``.
    """

    T: Array
    covariance: Array
    residuals_mm: Array
    rms_mm: float


def inverse(T: Array) -> Array:
    """Return the inverse of rigid motions (..., 4, 4)."""
    R = np.swapaxes(T[..., :3, :3], -1, -2)
    back = np.zeros(T.shape)
    back[..., :3, :3] = R
    back[..., :3, 3] = -(R @ T[..., :3, 3, None])[..., 0]
    back[..., 3, 3] = 1.0
    return back


def apply(T: Array, points: ArrayLike) -> Array:
    """Carry points (N, 3) by one rigid motion (4, 4)."""
    return np.asarray(points, dtype=float) @ T[:3, :3].T + T[:3, 3]


def apply_each(T: Array, points: Array) -> Array:
    """Carry points (..., 3), each by its own rigid motion (..., 4, 4)."""
    return np.asarray(np.einsum("...ij,...j->...i", T[..., :3, :3], points) + T[..., :3, 3])


def matrix(R: Array, t: Array) -> Array:
    """Matrices (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3), broadcast."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def rigid_fit(
    a_mm: ArrayLike,
    b_mm: ArrayLike,
    weights: ArrayLike | None = None,
    names: tuple[str, str] = ("rigid fit: points to move", "rigid fit: points to meet"),
) -> RigidFit:
    """Fit ``b = T a`` to N >= 3 pairs of points (N, 3) by least squares.

    ``weights`` (N,) are relative: the covariance is scaled by the residuals. Covariances (N, 3, 3)
    of each pair's difference, mm^2 with axes of b, are absolute, but the result's is widened where
    the residuals exceed them. ``names``: of a and b in messages. Raises `FrameError` on too few,
    non-finite, collinear or mirrored points.
    """
    a, b = np.asarray(a_mm, dtype=float), np.asarray(b_mm, dtype=float)
    if a.shape != b.shape:
        raise FrameError(f"rigid fit: {a.shape} points against {b.shape}; pair them one to one")
    for points, name in zip((a, b), names, strict=True):
        checked_points(points, name)
    W, believed = _information(weights, len(a))
    T = _procrustes(a, b, np.trace(W, axis1=1, axis2=2))
    if believed:
        T = _refined(T, a, b, W)
    residuals = b - apply(T, a)
    excess = np.einsum("ni,nij,nj->", residuals, W, residuals) / max(3 * len(a) - 6, 1)
    if believed:
        excess = max(1.0, excess)
    moved = apply(T, a)
    centroid = moved.mean(axis=0)
    at_centroid = np.linalg.inv(_normal_matrix(moved - centroid, W)) * excess
    shift = np.eye(6)
    shift[:3, 3:] = -cross_matrix(T[:3, 3] - centroid)
    covariance = shift @ at_centroid @ shift.T
    return RigidFit(T, covariance, residuals, rms(lengths_mm(residuals)))


def point_uncertainty(fit: RigidFit, point_mm: Array) -> float:
    return float(np.sqrt(point_variance_mm2(fit.T, fit.covariance, point_mm)))


def point_variance_mm2(T: Array, covariance: Array, point_mm: Array) -> float:
    """Return the variance (trace) of a point (3,) that a frame with this covariance carries."""
    J = np.hstack([np.eye(3), -cross_matrix(T[:3, :3] @ point_mm)])
    return float(np.trace(J @ covariance @ J.T))


def orientations(places_mm: Array, seen_mm: Array) -> Array:
    """Rotations (N, 3, 3) of a body whose points (K, 3) are measured at (N, K, 3). Least squares
    (Arun, Huang, Blostein 1987); K >= 3 points not on one line.
    """
    places = places_mm - places_mm.mean(axis=0)
    seen = seen_mm - seen_mm.mean(axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(np.einsum("ki,nkj->nij", places, seen))
    mirrored = np.broadcast_to(np.eye(3), U.shape).copy()
    mirrored[:, 2, 2] = np.sign(np.linalg.det(U @ Vt))
    return np.asarray(np.swapaxes(Vt, 1, 2) @ mirrored @ np.swapaxes(U, 1, 2))


def rotation_levers(places_mm: Array, rotations: Array) -> Array:
    """Rotation of the body by a displacement of each point, (N, K, 3, 3) in rad / mm.

    The body's points (K, 3) are rotated by ``rotations`` (N, 3, 3): the derivative of
    `orientations`, as a rotation vector in the frame in which they are measured.
    """
    places = places_mm - places_mm.mean(axis=0)
    levers = cross_matrix(np.einsum("nij,kj->nki", rotations, places))
    inertia = -np.sum(levers @ levers, axis=1)
    return np.asarray(np.linalg.inv(inertia)[:, None] @ levers)


def three_point_frame(p1_mm: ArrayLike, p2_mm: ArrayLike, p3_mm: ArrayLike) -> Array:
    """Return the station frame (4, 4) of three points, eqs 14-16, with its origin in P1."""
    points = checked_points(np.array([p1_mm, p2_mm, p3_mm], dtype=float), "the frame's points")
    return three_point_frames(points)


def three_point_frames(points_mm: Array) -> Array:
    """Return the frames (..., 4, 4) of three points each (..., 3, 3), which span a plane."""
    origin, along = points_mm[..., 0, :], points_mm[..., 1, :] - points_mm[..., 0, :]
    x, z = unit(along), unit(np.cross(along, points_mm[..., 2, :] - origin))
    return matrix(np.stack([x, np.cross(z, x), z], axis=-1), origin)


def pose_from_zyx(
    x_mm: float, y_mm: float, z_mm: float, a_deg: float, b_deg: float, c_deg: float
) -> Array:
    """Return the frame (4, 4) of X, Y, Z, A, B, C: Rz(A) Ry(B) Rx(C)."""
    return matrix(from_zyx((a_deg, b_deg, c_deg)), np.array([x_mm, y_mm, z_mm]))


def poses_from_zyx(values: ArrayLike) -> Array:
    """Return the frames (N, 4, 4) of rows (N, 6) of X, Y, Z (mm), A, B, C (deg)."""
    rows = np.asarray(values, dtype=float)
    return matrix(from_zyx(rows[:, 3:]), rows[:, :3])


def zyx_from_pose(T: Array) -> Array:
    """Return X, Y, Z (mm), A, B, C (deg) of frames (..., 4, 4) as (..., 6); A = 0 at B = +-90."""
    R = T[..., :3, :3]
    a = np.arctan2(R[..., 1, 0], R[..., 0, 0])
    sin_a, cos_a = np.sin(a), np.cos(a)
    b = np.arctan2(-R[..., 2, 0], cos_a * R[..., 0, 0] + sin_a * R[..., 1, 0])
    # Of Rz(-A) R = Ry(B) Rx(C), the middle row: well defined at B = +-90 too.
    c = np.arctan2(
        sin_a * R[..., 0, 2] - cos_a * R[..., 1, 2], cos_a * R[..., 1, 1] - sin_a * R[..., 0, 1]
    )
    angles = np.degrees(np.stack([a, b, c], axis=-1))
    return np.concatenate([T[..., :3, 3], angles], axis=-1)


def cross_matrix(v: Array) -> Array:
    """Return [v]x (..., 3, 3) of vectors (..., 3), so that ``[v]x w = v x w``."""
    K = np.zeros((*v.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return K - np.swapaxes(K, -1, -2)


def motion_levers(places_mm: Array) -> Array:
    """d(place) / d(shift, rotation vector, growth), (N, 3, 7), of a motion about the origin.
    ``places_mm`` (N, 3) in the moving frame: shift in mm, rotation in rad, growth a ratio.
    """
    shifts = np.broadcast_to(np.eye(3), (len(places_mm), 3, 3))
    return np.concatenate([shifts, -cross_matrix(places_mm), places_mm[:, :, None]], axis=-1)


def unit(v: Array) -> Array:
    """Return vectors (..., 3) scaled to length 1."""
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def checked_points(points: Array, what: str) -> Array:
    """Return points (N, 3) if they are finite and span a plane; raises `FrameError`."""
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3:
        raise FrameError(f"{what}: shape {points.shape}, expected (N, 3) with N >= 3")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise FrameError(f"{what}: point {bad[0] + 1} is not finite: {points[bad[0]]} mm")
    along, across, _ = _spread(points)
    least_spread = 0.02  # across over along: below this the points count as one line
    if not across > least_spread * along:
        where = "on one line" if along > ONE_PLACE_MM else "at one place"
        raise FrameError(
            f"{what}: {len(points)} points {where} (spread {along:.3f} mm along, {across:.3f} mm "
            f"across, expected over {least_spread:.0%} of it); take points that span a plane"
        )
    return points


def _spread(points: Array) -> tuple[float, float, float]:
    centred = points - points.mean(axis=0)
    along, across, depth = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred), 0.0))[::-1]
    return float(along), float(across), float(depth)


def _information(weights: ArrayLike | None, count: int) -> tuple[Array, bool]:
    """Return every pair's inverse covariance (N, 3, 3), and whether its scale is known."""
    given = np.ones(count) if weights is None else np.asarray(weights, dtype=float)
    if given.shape not in ((count,), (count, 3, 3)):
        raise FrameError(f"weights: shape {given.shape}, expected ({count},) or ({count}, 3, 3)")
    if given.ndim == 1:
        if not (np.isfinite(given) & (given > 0)).all():
            raise FrameError(f"weights: all must be finite and above 0, found {given}")
        return given[:, None, None] * np.eye(3), False
    if not (np.isfinite(given).all() and (np.linalg.eigvalsh(given) > 0).all()):
        raise FrameError("covariances: all must be finite and positive definite")
    return np.asarray(np.linalg.inv(given), dtype=float), True


def _procrustes(a: Array, b: Array, weights: Array) -> Array:
    """Return the best T for scalar weights by SVD; raises `FrameError` on mirrored data."""
    share = weights / weights.sum()
    ca, cb = share @ a, share @ b
    U, _, Vt = np.linalg.svd((a - ca).T @ ((b - cb) * share[:, None]))
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    least_depth = 1e-3  # out of plane over along: below this handedness is undefined
    deep = all(depth > least_depth * along for along, _, depth in (_spread(a), _spread(b)))
    if sign < 0 and deep:
        raise FrameError(
            "rigid fit: only a mirror image fits: one set is left-handed or its points are "
            "swapped; check the axes of the coordinate system and the points' order"
        )
    R = Vt.T @ np.diag([1.0, 1.0, sign]) @ U.T
    return matrix(R, cb - R @ ca)


def _refined(T: Array, a: Array, b: Array, W: Array) -> Array:
    """Return T after Gauss-Newton with full covariances."""
    converged = 1e-13
    for _ in range(20):
        moved = apply(T, a)
        centroid = moved.mean(axis=0)
        J = _jacobian(moved - centroid)
        gradient = np.einsum("nij,nik,nk->j", J, W, b - moved)
        step = np.linalg.solve(_normal_matrix(moved - centroid, W), gradient)
        R = from_rotvec(step[3:])
        T = matrix(R, centroid + step[:3] - R @ centroid) @ T
        if np.linalg.norm(step) <= converged * (1.0 + np.linalg.norm(centroid)):
            break
    return T


def _jacobian(levers: Array) -> Array:
    """Return d(point)/d(shift, rotation vector), (N, 3, 6), at levers (N, 3)."""
    return np.concatenate(
        [np.broadcast_to(np.eye(3), (len(levers), 3, 3)), -cross_matrix(levers)], -1
    )


def _normal_matrix(levers: Array, W: Array) -> Array:
    J = _jacobian(levers)
    return np.asarray(np.einsum("nij,nik,nkl->jl", J, W, J))


def from_zyx(angles_deg: ArrayLike) -> Array:
    """Return Rz(A) Ry(B) Rx(C) (..., 3, 3) of angles A, B, C (..., 3)."""
    angles_rad = np.radians(np.asarray(angles_deg, dtype=float))
    sines, cosines = np.sin(angles_rad), np.cos(angles_rad)
    sa, sb, sc = sines[..., 0], sines[..., 1], sines[..., 2]
    ca, cb, cc = cosines[..., 0], cosines[..., 1], cosines[..., 2]
    rows = [
        (ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc),
        (sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc),
        (-sb, cb * sc, cb * cc),
    ]
    R = np.empty((*angles_rad.shape, 3))
    for n, row in enumerate(rows):
        R[..., n, 0], R[..., n, 1], R[..., n, 2] = row
    return R


def from_rotvec(vectors_rad: ArrayLike) -> Array:
    """Return the rotations (..., 3, 3) about vectors (..., 3) by their lengths, by Rodrigues."""
    v = np.asarray(vectors_rad, dtype=float)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    K = cross_matrix(v)
    small_rad = 1e-4  # below, series in the angle: their next term is beyond a double
    safe = np.where(angle < small_rad, 1.0, angle)
    first = np.where(angle < small_rad, 1.0 - angle**2 / 6.0, np.sin(angle) / safe)
    half = np.where(angle < small_rad, 0.5 - angle**2 / 48.0, np.sin(0.5 * angle) / safe)
    return np.asarray(np.eye(3) + first * K + 2.0 * half**2 * (K @ K))


def to_rotvec(rotations: Array) -> Array:
    """Return the rotation vectors (..., 3), of at most pi, of rotations (..., 3, 3).

    By the quaternion of its largest component, so that it is exact near 0 and near pi.
    """
    R = np.asarray(rotations, dtype=float)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(R, (-2, -1), (0, 1))
    rows = [  # 4 q q^T, q = (x, y, z, w)
        [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
        [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
    ]
    Q = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(Q, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(Q, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True) * np.where(q[..., 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    scale = np.divide(angle, sine, out=np.full_like(angle, 2.0), where=sine > 0.0)
    return np.asarray(q[..., :3] * scale)


def is_rotation(R: Array) -> bool:
    """Whether a matrix (3, 3) is one, to 1e-6: it neither stretches nor shears nor mirrors."""
    within = 1e-6
    if not np.abs(R).max() <= 1.0 + within:  # so that no product is beyond all numbers
        return False
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= within and np.linalg.det(R) > 0)


def turned_deg(orientation: Array, poses: Array) -> Array:
    """Return by how much poses (N, 4, 4) are turned from an orientation (3, 3), deg (N,)."""
    cosine = (np.einsum("nij,ij->n", poses[:, :3, :3], orientation) - 1.0) / 2.0
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


# -- circles of a reflector about one robot axis, and the base frame they define (Fig 6) ----------


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
