"""A frame that is known already, corrected by points measured through it (GUM 3.4.8, JCGM 101 5.1).

The frame as known and the points are weighted by their covariances, so few or noisy points
change the frame little, and can make it worse by little only. Nothing is inverted that may be
singular: a frame may be known to move along one direction only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hilcell.geometry.frames import FrameError, apply, cross_matrix, from_rotvec, matrix
from hilcell.geometry.kinematics import Array

SIZE = 7  # shift, rotation, growth
TYPICAL = 2.366  # median of chi2 of three coordinates


@dataclass(frozen=True, slots=True)
class FrameUpdate:
    """The corrected frame of a in b, its covariance (6, 6) as in `RigidFit`, the residuals (N, 3).

    ``growth`` is the ratio by which a has grown from the centre, besides.

    ``left_out`` are the numbers of points that no small motion explains. ``pull`` is the correction
    in sigmas of the given covariance (its square is chi2 of up to 7), ``misfit`` the root mean
    square of the residuals in sigmas as stated: large ones mean that frame and points contradict.
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
    """Return the frame ``T`` (4, 4) of a in b, corrected by pairs of points (N, 3), N >= 1.

    ``covariance`` (6, 6) of ``T``, which may be singular: shift of a's origin and rotation
    vector about it, axes of b; or (7, 7) with the growth of a from ``centre_mm`` (3,).
    ``covariances_mm2`` (N, 3, 3) of each ``b - T a``, axes of b; their size is corrected by the
    residuals. Raises `FrameError` on what is not finite.
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
        solved = _solved(prior, J[kept], off_mm[kept], R[kept])
        left_mm = off_mm[kept] - J[kept] @ solved.x
        squares = np.einsum("ni,nij,nj->n", left_mm, np.linalg.inv(R[kept]), left_mm)  # in sigmas
        worst = int(np.argmax(squares))
        typical = max(1.0, float(np.median(squares)) / TYPICAL)
        enough = len(off_mm) - len(kept) >= len(off_mm) // leave_at_most
        if enough or squares[worst] <= outlying * typical:
            break
        kept.pop(worst)
    pull = math.sqrt(max(0.0, solved.chi2 - float(squares.sum())))  # of the covariances as stated
    freedom, chi2 = 3 * len(kept) - solved.spent, float(squares.sum())
    belief = 6.0  # coordinates: so much counts the stated size of the covariances
    size = (belief + chi2) / (belief + freedom)
    solved = _solved(prior, J[kept], off_mm[kept], size * R[kept])
    return FrameUpdate(
        matrix(from_rotvec(solved.x[3:6]) @ T[:3, :3], T[:3, 3] + solved.x[:3]),
        solved.covariance[:6, :6],
        off_mm - J @ solved.x,
        tuple(n for n in range(len(off_mm)) if n not in kept),
        pull,
        math.sqrt(chi2 / freedom),
        float(solved.x[6]),
    )


@dataclass(frozen=True, slots=True)
class _Solved:
    x: Array
    covariance: Array
    chi2: float  # of (measured - expected beforehand)
    spent: float  # coordinates, of the points, on the correction


def _solved(P: Array, J: Array, off_mm: Array, R: Array) -> _Solved:
    """Return the correction (7,) with its covariance; all points' rows are stacked."""
    rows, off = J.reshape(-1, SIZE), off_mm.reshape(-1)
    S = rows @ P @ rows.T
    for n, each in enumerate(R):
        S[3 * n : 3 * n + 3, 3 * n : 3 * n + 3] += each
    gain = np.linalg.solve(S, rows @ P).T
    after = P - gain @ rows @ P
    chi2, spent = float(off @ np.linalg.solve(S, off)), float(np.trace(gain @ rows))
    return _Solved(gain @ off, (after + after.T) / 2, chi2, spent)
