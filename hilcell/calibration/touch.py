"""The robot's base on this visit of a station, measured by touch poses after the stop.

The strip repeats only within its tolerance, and the station frame has the noise of its nests. So
the robot carries its reflector to a few corrected poses; their offsets from the station frame's
prediction give the present base. Only commands use it (`Frames.base_on_visit`): if targets did, an
error of the base would cancel in every figure that judges it.

Frame and points are weighted by their covariances (GUM 3.4.8, JCGM 101 5.1). Nothing is inverted
that may be singular.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hilcell.calibration.causes import Differences
from hilcell.calibration.frames import Frames, base_covariance, hold_covariance, world_covariance
from hilcell.calibration.influence import SIZE
from hilcell.calibration.known_arm import carried_calibration
from hilcell.calibration.lookup import calibration_in
from hilcell.calibration.position_errors import block_diagonal, visits_mm
from hilcell.cell.devices import least_separation_rad
from hilcell.cell.file import Cell, Station
from hilcell.geometry.frames import (
    FrameError,
    apply,
    cross_matrix,
    from_rotvec,
    inverse,
    matrix,
    motion_levers,
)
from hilcell.geometry.kinematics import Array, Bools
from hilcell.geometry.statistics import pooled_std_mm, rectangular_variance
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm
from hilcell.model.point import Point, PointId
from hilcell.model.verdicts import Suspicion

# Target recognition locates reflectors by direction. Where a nest is behind or before the flange in
# its line of sight, the instrument chooses neither, or the wrong one.


def beside_nest(cell: Cell, station: Station, points_mm: Array) -> Bools:
    """Which points (N, 3) in nominal {B} the tracker cannot distinguish from a nest, (N,)."""
    apart_rad = least_separation_rad(cell)
    if not apart_rad or cell.layout.by_hand:
        return np.zeros(len(points_mm), dtype=bool)
    T_W_B = cell.layout.nominal_base(station.rail_mm)
    slide_mm = np.array([nest.xyz_mm for nest in cell.layout.slide]).reshape(-1, 3)
    floor_mm = np.array([nest.xyz_mm for nest in cell.layout.fixed_nests])
    nests_mm = np.vstack([floor_mm, apply(T_W_B, slide_mm)])

    def directions(world_mm: Array) -> Array:
        seen_mm = apply(inverse(cell.tracker.pose.matrix()), world_mm)
        return np.asarray(seen_mm / np.linalg.norm(seen_mm, axis=1, keepdims=True))

    places, nests = directions(apply(T_W_B, points_mm)), directions(nests_mm)
    chords = np.linalg.norm(places[:, None] - nests[None], axis=-1)
    return np.asarray(~(chords.min(axis=1) > 2.0 * np.sin(apart_rad / 2.0)))


def touch_targets_mm(cell: Cell, station: Station) -> Array:
    """Touch targets (N, 3) in {B} through the cube, if possible not beside a nest."""
    count = cell.touch.poses
    spare = 4  # places for each touch pose, for those that are passed over
    number = np.arange(spare * count)[:, None]
    # Roots of x^4 = x + 1: steps by them fill a cube evenly, however many are taken.
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    share = (0.5 + number * steps) % 1.0
    size_mm = np.array(cell.grid.size_mm)
    margin_share = 0.05  # of the cube's edges, off each face
    targets: Array = cell.grid.centre.matrix()[:3, 3] + size_mm * (
        (1.0 - 2.0 * margin_share) * (share - 0.5)
    )
    order = np.argsort(beside_nest(cell, station, targets), kind="stable")
    return targets[order[:count]]


def touch_ids(cell: Cell, station: Station, visit: int) -> list[PointId]:
    return [
        PointId("touch", station=station.name, visit=visit, number=n)
        for n in range(cell.touch.poses)
    ]


@dataclass(frozen=True, eq=False)
class TouchPoses:
    """The touch poses of a visit of a station.

    Covariances ``model_mm2`` (N, 3, 3) in {B} are of the model's predictions there; the robot's
    repeatability and the tracker's noise are added from the log.
    """

    log: Log
    station: Station
    points: list[Point]

    def base(self, model_mm2: Array) -> FrameUpdate:
        """T_W_B on this visit."""
        T_W_B, R = self._T_W_B, self._T_W_B[:3, :3]
        noise_mm2 = np.einsum("ij,njk,lk->nil", R, model_mm2, R) + self._noise_mm2
        return updated_frame(
            T_W_B,
            self.prior,
            apply(inverse(T_W_B), self._nominal_mm),
            apply(self.log.matrix("world"), positions_mm(self.points)),
            noise_mm2,
            self._centre_mm,
        )

    def suspicion(self, model_mm2: Array) -> Suspicion:
        """Why the points contradict the station frame."""
        log, T_B_W, R = self.log, inverse(self._T_W_B), self._T_W_B[:3, :3]
        nominal_mm = apply(T_B_W, self._nominal_mm)
        at_mm = apply(T_B_W @ log.matrix("world"), positions_mm(self.points))
        J = motion_levers(nominal_mm)
        J[:, :, 6] -= self._centre_mm
        J = np.concatenate([J[:, :, :3] @ R.T, J[:, :, 3:6] @ R.T, J[:, :, 6:]], axis=-1)  # of {W}
        flat = J.reshape(-1, J.shape[-1])
        differences = Differences(
            at_mm - nominal_mm,
            flat @ self.prior @ flat.T + block_diagonal(model_mm2 + R.T @ self._noise_mm2 @ R),
            commanded_rad(self.points),
            3.0 * len(self.points),
            R.T @ np.array(log.cell.layout.rail_direction),
            [len(self.points)],
        )
        return differences.likeliest(log.cell.robot.arm(), f"touch poses at {self.station.name}")

    @property
    def _T_W_B(self) -> Array:  # noqa: N802 - the frame's symbol
        return Frames(self.log.cell, self.log).base_in_world(self.station)

    @property
    def _nominal_mm(self) -> Array:
        return np.array([point.nominal_mm for point in self.points])

    @property
    def _centre_mm(self) -> Array:
        return self.log.cell.grid.centre.matrix()[:3, 3]

    @property
    def prior(self) -> Array:
        """Covariance (7, 7) of T_W_B on the visit, before it is touched.

        Of the station frame, the strip's slip, and the arm's growth since the grid at the
        temperature of the points: shift of {B}'s origin (mm), rotation vector (rad) about it, axes
        of {W}; growth of the cube from its centre (ratio). The arm's growth shifts the cube's
        centre as a shift of the base does, and widens the cube. With an earlier calibration the
        error of {W} counts twice.
        """
        log, used, T_W_B = self.log, calibration_in(self.log), self._T_W_B
        now_c = [p.temperature_c for p in self.points if p.temperature_c is not None]
        then_c = [p.temperature_c for p in log.select("grid") if p.temperature_c is not None]
        if used is not None and used.validity.temperature_c is not None:
            then_c = list(used.validity.temperature_c)
        warmer_k = float(np.mean(now_c) - np.mean(then_c)) if now_c and then_c else 0.0
        growth = log.cell.uncertainty.arm_growth_um_m_k * 1e-6 * warmer_k
        outwards = np.append(T_W_B[:3, :3] @ self._centre_mm, [0.0, 0.0, 0.0, 1.0])
        known = rectangular_variance(growth) * np.outer(outwards, outwards)
        known[:6, :6] += base_covariance(log, self.station)
        holds = 2  # the strip's slip is that of the visit less that of the stop when it was framed
        known[:3, :3] += holds * hold_covariance(log.cell)
        if used is None:
            return known
        centring_mm2 = rectangular_variance(log.cell.uncertainty.smr_centring_limit_mm)
        set_ups = 2  # of the tracker: the calibration's and this run's
        known[:6, :6] += set_ups * world_covariance(log, T_W_B[:3, 3], centring_mm2)
        return known

    @property
    def _noise_mm2(self) -> Array:
        """Covariances (N, 3, 3) in {W} of single visits, with the readings' noise.

        From the visits of the repeatability's places; else from the readings, and from the robot's
        repeatability where an earlier calibration states it.
        """
        clouds_mm = visits_mm(self.log)
        if clouds_mm:
            return np.tile(pooled_std_mm(clouds_mm) ** 2 * np.eye(3), (len(self.points), 1, 1))
        R = self.log.matrix("world")[:3, :3]
        noise_mm2 = covariances_mm2(self.points, R)
        used = calibration_in(self.log) or carried_calibration(self.log)
        if used is not None and used.uncertainty is not None:
            for line in used.uncertainty.lines:
                if line.per_visit and line.frame == "base":
                    noise_mm2 = noise_mm2 + line.at(self.log.matrix("base"), self._nominal_mm)
        return noise_mm2


@dataclass(frozen=True, slots=True)
class FrameUpdate:
    """The corrected frame of a in b, its covariance (6, 6) as in `RigidFit`, the residuals (N, 3).

    ``growth``: ratio by which a has grown from the centre; ``left_out``: numbers of points that no
    small motion explains; ``pull``: the correction in sigmas of the given covariance (its square is
    chi2 of up to 7); ``misfit``: root mean square of the residuals in sigmas as stated. Large ones
    mean that frame and points contradict.
    """

    T: Array
    covariance: Array
    residuals_mm: Array
    left_out: tuple[int, ...]
    pull: float
    misfit: float
    growth: float


def updated_frame(
    T: Array,
    covariance: Array,
    a_mm: Array,
    b_mm: Array,
    covariances_mm2: Array,
    centre_mm: Array | None = None,
) -> FrameUpdate:
    """The frame ``T`` (4, 4) of a in b, corrected by pairs of points (N, 3), N >= 1.

    ``covariance`` of ``T``, possibly singular: (6, 6), shift of a's origin and rotation vector
    about it, axes of b; or (7, 7) with the growth of a from ``centre_mm`` (3,). ``covariances_mm2``
    (N, 3, 3) of each ``b - T a``, axes of b; their size is corrected by the residuals. Raises
    `FrameError` on what is not finite.
    """
    if not all(np.isfinite(each).all() for each in (T, covariance, a_mm, b_mm, covariances_mm2)):
        raise FrameError("frame update: a frame, a covariance or a point is not finite")
    prior = np.zeros((SIZE, SIZE))
    prior[: len(covariance), : len(covariance)] = covariance
    outwards_mm = a_mm if centre_mm is None else a_mm - centre_mm
    least_mm = 1e-4  # no reading is better
    R = covariances_mm2 + least_mm**2 * np.eye(3)
    off_mm = b_mm - apply(T, a_mm)
    J = np.concatenate(
        [
            np.broadcast_to(np.eye(3), R.shape),
            -cross_matrix(a_mm @ T[:3, :3].T),
            (outwards_mm @ T[:3, :3].T)[:, :, None],
        ],
        axis=-1,
    )
    kept = list(range(len(off_mm)))
    outlying = 25.0  # squared, in sigmas of the typical point
    leave_at_most = 4  # one of so many points may be left out
    while True:
        x, _, before, spent = _solved(prior, J[kept], off_mm[kept], R[kept])
        left_mm = off_mm[kept] - J[kept] @ x
        squares = np.einsum("ni,nij,nj->n", left_mm, np.linalg.inv(R[kept]), left_mm)  # in sigmas
        worst = int(np.argmax(squares))
        median = 2.366  # of chi2 of three coordinates
        typical = max(1.0, float(np.median(squares)) / median)
        enough = len(off_mm) - len(kept) >= len(off_mm) // leave_at_most
        if enough or squares[worst] <= outlying * typical:
            break
        kept.pop(worst)
    pull = math.sqrt(max(0.0, before - float(squares.sum())))  # of the covariances as stated
    freedom, chi2 = 3 * len(kept) - spent, float(squares.sum())
    belief = 6.0  # coordinates: so much counts the stated size of the covariances
    size = (belief + chi2) / (belief + freedom)
    x, after, _, _ = _solved(prior, J[kept], off_mm[kept], size * R[kept])
    return FrameUpdate(
        matrix(from_rotvec(x[3:6]) @ T[:3, :3], T[:3, 3] + x[:3]),
        after[:6, :6],
        off_mm - J @ x,
        tuple(n for n in range(len(off_mm)) if n not in kept),
        pull,
        math.sqrt(chi2 / freedom),
        float(x[6]),
    )


def _solved(P: Array, J: Array, off_mm: Array, R: Array) -> tuple[Array, Array, float, float]:
    """Correction (7,), its covariance, chi2 of (measured - predicted), and the coordinates it
    spent. All points' rows are stacked.
    """
    rows, off = J.reshape(-1, SIZE), off_mm.reshape(-1)
    S = rows @ P @ rows.T
    for n, each in enumerate(R):
        S[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += each
    gain = np.linalg.solve(S, rows @ P).T
    after = P - gain @ rows @ P
    chi2, spent = float(off @ np.linalg.solve(S, off)), float(np.trace(gain @ rows))
    return gain @ off, (after + after.T) / 2, chi2, spent
