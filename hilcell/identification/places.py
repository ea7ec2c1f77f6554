"""Places that nobody has measured: nests by their distances, the base by poses of the arm.

{L} tracker, {W} world, {B} robot base; mm, rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilcell.geometry.frames import apply, cross_matrix, from_rotvec, matrix, rigid_fit
from hilcell.geometry.kinematics import Arm, Array, forward

UPRIGHT = 0.0  # least cosine between the tracker's z and that of {W}


@dataclass(frozen=True, slots=True)
class Recognition:
    """Which nominal nest each seen one is (M,), -1 for none; ``T_W_L`` (4, 4); distances (M,) from
    the nominal places, NaN for none.
    """

    nests: tuple[int, ...]
    T_W_L: Array
    off_mm: Array

    @property
    def upright(self) -> bool:
        """Whether the tracker stands on its foot, not upside down."""
        return bool(self.T_W_L[2, 2] > UPRIGHT)

    @property
    def worst_mm(self) -> float:
        return float(np.nanmax(self.off_mm))


def recognised(nominal_mm: Array, seen_mm: Array, tolerance_mm: float) -> list[Recognition]:
    """Return how nests seen (M, 3), {L}, may be nominal ones (N, 3), {W}, the best first.

    Pairs of nests have the nominal distances within ``2 tolerance_mm``, and all nests their places
    within the tolerance after the best rigid motion. With four or more seen, one of them may be
    none of the nominal ones. Symmetric layouts have several answers: a triangle with two equal
    sides exchanges two nests where the tracker is upside down.
    """
    M = len(seen_mm)
    found = list(_matches(nominal_mm, seen_mm, tuple(range(M)), tolerance_mm))
    if not found and M > 3:
        for left_out in range(M):
            rest = tuple(n for n in range(M) if n != left_out)
            found += _matches(nominal_mm, seen_mm, rest, tolerance_mm)
    return sorted(found, key=lambda each: each.worst_mm)


def _matches(
    nominal_mm: Array, seen_mm: Array, kept: tuple[int, ...], tolerance_mm: float
) -> Iterator[Recognition]:
    distances = np.linalg.norm(nominal_mm[:, None] - nominal_mm, axis=-1)
    apart = np.linalg.norm(seen_mm[:, None] - seen_mm, axis=-1)
    for nests in _assignments(distances, apart[np.ix_(kept, kept)], (), 2.0 * tolerance_mm):
        T = rigid_fit(seen_mm[list(kept)], nominal_mm[list(nests)]).T
        off_mm = np.full(len(seen_mm), np.nan)
        off_mm[list(kept)] = np.linalg.norm(
            apply(T, seen_mm[list(kept)]) - nominal_mm[list(nests)], axis=1
        )
        if np.nanmax(off_mm) <= tolerance_mm:
            names = np.full(len(seen_mm), -1)
            names[list(kept)] = nests
            yield Recognition(tuple(int(n) for n in names), T, off_mm)


def _assignments(
    distances: Array, apart: Array, begun: tuple[int, ...], limit_mm: float
) -> Iterator[tuple[int, ...]]:
    """Yield which nominal nest each seen one is, as far as all distances agree."""
    count = len(begun)
    if count == len(apart):
        yield begun
        return
    for nest in range(len(distances)):
        if nest in begun:
            continue
        off_mm = np.abs(distances[nest, list(begun)] - apart[count, :count])
        if bool(np.all(off_mm <= limit_mm)):
            yield from _assignments(distances, apart, (*begun, nest), limit_mm)


@dataclass(frozen=True, slots=True)
class BaseFit:
    """``T_L_B`` (4, 4) and the reflector ``smr_mm`` (3,) in the flange; ``covariance`` (9, 9) of
    shift and rotation of {B} in {L}, and of the reflector; residuals (N, 3), mm.
    """

    T_L_B: Array
    smr_mm: Array
    covariance: Array
    residuals_mm: Array

    @property
    def rms_mm(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.residuals_mm**2, axis=1))))

    @property
    def smr_u_mm(self) -> float:
        """1 sigma of the reflector's place, in its worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[6:, 6:])[-1]))

    def predict_mm(self, arm: Arm, joints_rad: Array) -> Array:
        """Return where the tracker sees the reflector (N, 3) at joints (N, 6)."""
        flange = _flange(arm, joints_rad)
        return apply(self.T_L_B, flange[:, :3, :3] @ self.smr_mm + flange[:, :3, 3])


def fit_base(
    arm: Arm, joints_rad: Array, seen_mm: Array, smr_mm: Array, u_smr_mm: float = 1e3
) -> BaseFit:
    """Fit {B} and the reflector's place to a reflector seen (N, 3), {L}, at joints (N, 6).

    ``smr_mm`` (3,) is where the reflector is supposed to be, ``u_smr_mm`` (1 sigma) how well that
    is known: it decides what few poses cannot. Gauss-Newton from the rigid fit of these places.
    """
    flange = _flange(arm, joints_rad)
    R_F, t_F = flange[:, :3, :3], flange[:, :3, 3]
    U = smr_mm.astype(float)
    T = rigid_fit(R_F @ U + t_F, seen_mm).T
    sigma = 1.0
    for _ in range(50):
        in_base = R_F @ U + t_F
        residuals = seen_mm - apply(T, in_base)
        freedom = max(3 * len(seen_mm) - 9, 1)
        sigma = max(float(np.sqrt(np.sum(residuals**2) / freedom)), 0.02)
        J = np.zeros((len(seen_mm), 3, 9))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -cross_matrix(apply(T, in_base) - T[:3, 3])
        J[:, :, 6:] = T[:3, :3] @ R_F
        A = J.reshape(-1, 9)
        prior = np.zeros((9, 9))
        prior[6:, 6:] = np.eye(3) * (sigma / u_smr_mm) ** 2
        normal = A.T @ A + prior
        pull = A.T @ residuals.reshape(-1) + prior @ np.r_[np.zeros(6), smr_mm - U]
        step = np.linalg.solve(normal + 1e-9 * np.eye(9), pull)
        T = matrix(from_rotvec(step[3:6]) @ T[:3, :3], T[:3, 3] + step[:3])
        U = U + step[6:]
        if np.linalg.norm(step[[0, 1, 2, 6, 7, 8]]) < 1e-7:
            break
    covariance = np.asarray(sigma**2 * np.linalg.inv(normal + 1e-9 * np.eye(9)), dtype=float)
    return BaseFit(T, U, covariance, seen_mm - apply(T, R_F @ U + t_F))


def _flange(arm: Arm, joints_rad: Array) -> Array:
    """Return the flange in {B} (N, 4, 4) at joints (N, 6)."""
    return forward(replace(arm, tool=np.eye(4)), np.atleast_2d(joints_rad))


def rail_direction(positions_mm: Sequence[float], places_mm: Array) -> Array:
    """Return the unit vector (3,) along which a nest moved: places (N, 3) at slide positions."""
    s = np.asarray(positions_mm) - np.mean(positions_mm)
    slope = s @ (places_mm - places_mm.mean(axis=0)) / (s @ s)
    return np.asarray(slope / np.linalg.norm(slope))


def rail_scale(positions_mm: Sequence[float], places_mm: Array) -> float:
    """Return the distance by the tracker a mm of the slide's positions."""
    s = np.asarray(positions_mm) - np.mean(positions_mm)
    return float(np.linalg.norm(s @ (places_mm - places_mm.mean(axis=0)) / (s @ s)))
