"""Places that nobody has measured: nests by their distances, the rail by a place that rides on it.

A reflector of another radius shifts every reading along its beam by the difference: it is known by
nests whose distances agree only with such a shift. {L} tracker, {W} world; mm, rad.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hilcell.geometry.frames import apply, cross_matrix, from_rotvec, matrix, rigid_fit, unit
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import coverage_factor, expanded
from hilcell.identification.reflector_radius import RADIUS_MM, SHIFTS_MM

PROOF = 3.0  # sigmas of a shift that proves another reflector
LIKELIER = 100.0  # times, by which another reflector must explain readings better than nests do
STATED = 5.0  # coordinates that the tolerance is worth
WITHIN = 3.76  # sigmas of a coordinate within which 99.7 % of normal places (3,) are
UPRIGHT = 0.0  # least cosine between the tracker's z and that of {W}


@dataclass(frozen=True, slots=True)
class Recognition:
    """Which nominal nest each seen one is (M,), -1 for none; ``T_W_L`` (4, 4); distances (M,) from
    the nominal places, NaN for none.

    ``U_mm`` and ``U_rad`` (k = 2) of the tracker's place and rotation, one coordinate in the worst
    direction. ``shift_mm``: of every reading along its beam, where that proves a reflector of
    another radius, else 0.
    """

    nests: tuple[int, ...]
    T_W_L: Array
    off_mm: Array
    U_mm: float
    U_rad: float
    shift_mm: float

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
    found: list[Recognition] = []
    for left_out in (-1, *range(M if M > 3 else 0)):
        kept = tuple(n for n in range(M) if n != left_out)
        for shift_mm in SHIFTS_MM:
            found += _matches(nominal_mm, seen_mm, kept, tolerance_mm, shift_mm)
        if found and left_out < 0:
            break
    return sorted(found, key=lambda each: each.worst_mm)


def may_be_nests(nominal_mm: Array, seen_mm: Array, tolerance_mm: float) -> bool:
    """Whether two seen nests (M, 3) or more may all be nominal ones, of any usual reflector."""
    distances, limit_mm = _distances(nominal_mm), 2.0 * tolerance_mm
    for shift_mm in SHIFTS_MM:
        at_mm = seen_mm + shift_mm * unit(seen_mm)
        for nests in _assignments(distances, _distances(at_mm), (), limit_mm):
            if len(at_mm) < 3 or _off_mm(nominal_mm[list(nests)], at_mm).max() <= tolerance_mm:
                return True
    return False


def proven_shift(nominal_mm: Array, seen_mm: Array, tolerance_mm: float) -> float:
    """Return by how much readings of nests (N, 3), {L}, are off along their beams as of another
    usual reflector; 0 where nothing proves one.

    Two hypotheses: nests beside their places, and readings off by a known difference of radii as
    well; the second must be `LIKELIER`. Nests' distances from their places are normal; their spread
    is that of the tolerance, which counts as `STATED` coordinates, and of the readings.
    """
    freedom = 3 * len(seen_mm) - 6
    known_mm2 = STATED * (tolerance_mm / WITHIN) ** 2
    squares_mm2 = np.array([
        known_mm2 + np.square(_off_mm(nominal_mm, seen_mm + shift_mm * unit(seen_mm))).sum()
        for shift_mm in SHIFTS_MM
    ])  # fmt: skip
    best = int(np.argmin(squares_mm2))
    likelier = (squares_mm2[0] / squares_mm2[best]) ** ((STATED + freedom) / 2.0)
    return SHIFTS_MM[best] if likelier >= LIKELIER else 0.0


def _matches(
    nominal_mm: Array, seen_mm: Array, kept: tuple[int, ...], tolerance_mm: float, shift_mm: float
) -> Iterator[Recognition]:
    at_mm = seen_mm[list(kept)]
    apart = _distances(at_mm + shift_mm * unit(at_mm))
    for nests in _assignments(_distances(nominal_mm), apart, (), 2.0 * tolerance_mm):
        fit = _fit(nominal_mm[list(nests)], at_mm, shift_mm)
        if fit is None or not fit.off_mm.max() <= tolerance_mm:
            continue
        names, off_mm = np.full(len(seen_mm), -1), np.full(len(seen_mm), np.nan)
        names[list(kept)], off_mm[list(kept)] = nests, fit.off_mm
        yield Recognition(
            tuple(int(n) for n in names), fit.T_W_L, off_mm, fit.U_mm, fit.U_rad, fit.shift_mm
        )


@dataclass(frozen=True, slots=True)
class _Fit:
    T_W_L: Array
    off_mm: Array
    U_mm: float
    U_rad: float
    shift_mm: float


def _off_mm(nominal_mm: Array, at_mm: Array) -> Array:
    T = rigid_fit(at_mm, nominal_mm).T
    return np.asarray(np.linalg.norm(apply(T, at_mm) - nominal_mm, axis=1))


def _fit(nominal_mm: Array, seen_mm: Array, shift_mm: float) -> _Fit | None:
    """Fit the tracker's pose, and near a ``shift_mm`` that is not 0 the shift of all readings.

    None where the readings do not prove such a shift.
    """
    along, unknowns = unit(seen_mm), 7 if shift_mm else 6
    freedom, near_mm = 3 * len(seen_mm) - unknowns, shift_mm
    T = rigid_fit(seen_mm + shift_mm * along, nominal_mm).T
    for _ in range(5):  # Gauss-Newton, from closely by
        turned = apply(T, seen_mm + shift_mm * along)
        left_mm = (nominal_mm - turned).reshape(-1)
        J = np.zeros((len(seen_mm), 3, 7))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -cross_matrix(turned - T[:3, 3])
        J[:, :, 6] = along @ T[:3, :3].T
        A = J.reshape(-1, 7)[:, :unknowns]
        step = np.linalg.lstsq(A, left_mm, rcond=None)[0]
        T = matrix(from_rotvec(step[3:6]) @ T[:3, :3], T[:3, 3] + step[:3])
        shift_mm += float(step[6:].sum())
    off_mm = np.linalg.norm(nominal_mm - apply(T, seen_mm + shift_mm * along), axis=1)
    normal = A.T @ A + 1e-12 * np.eye(unknowns)  # what is not determined becomes very uncertain
    covariance = np.linalg.inv(normal) * float(np.sum(off_mm**2)) / freedom
    if near_mm:
        least_mm = coverage_factor(PROOF, freedom) * float(np.sqrt(covariance[6, 6]))
        if not (least_mm < abs(shift_mm) and abs(shift_mm - near_mm) <= RADIUS_MM):
            return None
    U_mm, U_rad = (expanded(covariance[at, at], freedom) for at in (slice(3), slice(3, 6)))
    return _Fit(T, off_mm, U_mm, U_rad, shift_mm)


def _distances(at_mm: Array) -> Array:
    return np.asarray(np.linalg.norm(at_mm[:, None] - at_mm, axis=-1))


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
class RailLine:
    """The line along which a place rode: unit ``direction`` (3,), and ``scale``, its distance a mm
    of the slide's positions; U (k = 2) of both.
    """

    direction: Array
    scale: float
    U_rad: float
    U_scale: float


def rail_line(positions_mm: Sequence[float], places_mm: Array, swing_mm: float) -> RailLine:
    """Fit a line to places (N, 3) at positions of the slide.

    ``swing_mm``: 1 sigma by which the slide's tilt carries a place off its line, from one end to
    the other; the residuals do not show it.
    """
    s = np.asarray(positions_mm) - np.mean(positions_mm)
    moved_mm = places_mm - places_mm.mean(axis=0)
    slope = s @ moved_mm / (s @ s)
    scale = float(np.linalg.norm(slope))
    left_mm = moved_mm - np.outer(s, slope)
    freedom = 3 * len(s) - 6
    u_slope = np.sqrt(np.sum(left_mm**2) / freedom / (s @ s))
    U_swing = 2.0 * swing_mm / np.ptp(s)
    U_scale = float(np.hypot(coverage_factor(2.0, freedom) * u_slope, U_swing))
    return RailLine(slope / scale, scale, U_scale / scale, U_scale)
