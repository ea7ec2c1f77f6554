"""Checks of the instrument: its scale, its axes, and its reflectors.

A wrong scale (weather station), reflector or unit falsifies every point consistently.

Readings in both faces differ by twice the axes' errors. At range r and height z above the tracker,
half of it is ``c r + i z`` sideways and ``v r`` downwards: collimation c, the transit axis' tilt i,
the index v of the vertical circle. A tilt of 50 urad moves a point a metre lower by 0.05 mm.

In one nest all centres coincide, within roundness and centring: a reflector of another radius, or a
longer prism, is off mostly along the beam.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from hilcell.calibration.measurement_budget import systematic_mm2
from hilcell.cell.file import Cell
from hilcell.cell.layout import CERTIFIED_C, KnownLength
from hilcell.cell.uncertainty import COVERAGE_FACTOR
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import coverage_factor, lengths_mm, rectangular_variance
from hilcell.journal.log import (
    VERIFICATION_KINDS,
    Log,
    covariances_mm2,
    noise_at,
    positions_mm,
    run_noise,
    world_key,
)
from hilcell.model.events import URAD
from hilcell.model.point import BACK, LENGTH, REFLECTOR, Point, PointId
from hilcell.model.verdicts import (
    Cause,
    Faces,
    FacesCompared,
    LengthsChecked,
    MeasuredLength,
    MeasuredReflector,
    Suspicion,
)
from hilcell.ports import Array

SIGMAS = 4.0  # of the readings' noise, beyond the stated limits of tracker and centring

# -- scale: certified lengths ----------------------------------------------------------------------


def known_lengths(cell: Cell, log: Log) -> list[MeasuredLength]:
    return [_found(cell, log, each) for each in cell.layout.length]


def _found(cell: Cell, log: Log, known: KnownLength) -> MeasuredLength:
    of_floor = {each.name for each in cell.layout.floor}
    ends = [  # on the floor or on a bar, of the first framing of {W}
        log.point(PointId("world" if nest in of_floor else LENGTH, nest=nest))
        for nest in known.nests
    ]
    at_mm = positions_mm(ends)
    way_mm = at_mm[1] - at_mm[0]
    found_mm = float(np.linalg.norm(way_mm))
    along = way_mm / found_mm
    stated = cell.uncertainty
    variance_mm2 = (
        known.u_mm**2
        + float(along @ covariances_mm2(ends, np.eye(3)).sum(axis=0) @ along)
        + float(systematic_mm2(stated, at_mm).sum())
        + 2 * rectangular_variance(stated.smr_centring_limit_mm)
    )
    celsius = [point.temperature_c for point in ends if point.temperature_c is not None]
    warm_k = float(np.mean(celsius)) - CERTIFIED_C if celsius else 0.0
    expected_mm = known.length_mm * (1.0 + known.expansion_um_m_k * 1e-6 * warm_k)
    coverage = 2.0  # k: about 95 %
    return MeasuredLength(known.nests, expected_mm, found_mm, coverage * math.sqrt(variance_mm2))


def scale(log: Log) -> Suspicion | None:
    checked = log.verdict(LengthsChecked)
    wrong = [] if checked is None else [each for each in checked.lengths if not each.holds]
    if not wrong:
        return None
    worst = max(wrong, key=lambda each: each.share)
    return Suspicion(Cause.SCALE, worst.off_ppm, "ppm", f"known length {' to '.join(worst.nests)}")


# -- axes: nests measured in both faces ------------------------------------------------------------

TWO_FACES = FacesCompared.keys  # at the start, and at the end
AXES = ("urad of collimation", "urad of the transit axis' tilt", "urad of the vertical index")


class BothFaces(msgspec.Struct, frozen=True):
    """Both faces at each nest, and the axis error that explains them best, urad."""

    nests: list[Faces]
    size_urad: float
    unit: str

    BOTH_FACES = "nests seen in both faces"

    @property
    def holds(self) -> bool:
        return all(each.holds for each in self.nests)

    @property
    def suspicion(self) -> Suspicion | None:
        if self.holds:
            return None
        return Suspicion(Cause.INSTRUMENT, self.size_urad, self.unit, self.BOTH_FACES)

    @property
    def text(self) -> str:
        worst = max(self.nests, key=lambda each: each.off_mm)
        return (
            f"half the difference of both faces is {worst.off_mm:.3f} mm at most, at {worst.nest}, "
            f"limit {worst.limit_mm:.3f} mm; as of {self.size_urad:+.0f} {self.unit}"
        )


def two_faces(log: Log, number: int) -> BothFaces | None:
    """Two-face check at the start (0) or the end (1); None without readings."""
    backs = [point for point in log.measured(BACK) if point.id.number == number]
    both = [(front, back) for back in backs if (front := _front(log, back)) is not None]
    if not both:
        return None
    fronts, backs = [front for front, _ in both], [back for _, back in both]
    noise = run_noise(log)
    noise_mm2 = (noise_at(noise, fronts) + noise_at(noise, backs)) / 4.0
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    stated = log.cell.uncertainty
    range_mm: Array = np.linalg.norm(positions_mm(fronts), axis=1)
    limits_mm = (
        stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * range_mm
    ) + sigmas * np.sqrt(np.trace(noise_mm2, axis1=1, axis2=2))
    return judged_faces(
        [point.id.nest for point in fronts],
        positions_at_set_up(log, fronts),
        positions_at_set_up(log, backs),
        limits_mm,
    )


def judged_faces(
    names: Sequence[str], front_mm: Array, back_mm: Array, limits_mm: Array
) -> BothFaces:
    """Judge readings (N, 3) in both faces, in the tracker's own frame."""
    seen, range_mm = half_differences_mm(front_mm, back_mm), lengths_mm(front_mm)
    rows = axis_levers(front_mm).reshape(-1, 3)  # angles: noise across grows with the range
    off = (seen / range_mm[:, None]).reshape(-1)
    sizes = rows.T @ off / np.maximum(np.square(rows).sum(axis=0), 1e-12)
    left = np.square(off[:, None] - rows * sizes).sum(axis=0)
    axis = int(np.argmin(left))
    rows_found = zip(names, seen.tolist(), limits_mm.tolist(), strict=True)
    nests = [Faces(name, across, below, limit) for name, (across, below), limit in rows_found]
    return BothFaces(nests, URAD * float(sizes[axis]), AXES[axis])


def beam_axes(at_mm: Array) -> Array:
    """Return unit vectors (N, 3, 3) at places (N, 3), tracker's frame: along the beam, sideways as
    the horizontal angle grows, downwards.
    """
    x, y, z = at_mm.T
    flat_mm, range_mm = np.hypot(x, y), lengths_mm(at_mm)
    around = np.stack([-y, x, np.zeros(len(x))], axis=1) / flat_mm[:, None]
    down = np.stack([x * z, y * z, -(flat_mm**2)], axis=1) / (flat_mm * range_mm)[:, None]
    return np.stack([at_mm / range_mm[:, None], around, down], axis=1)


def half_differences_mm(front_mm: Array, back_mm: Array) -> Array:
    """Return half of first less second face (N, 2) at (N, 3) each: sideways and downwards."""
    half_mm: Array = np.einsum("nij,nj->ni", beam_axes(front_mm), (front_mm - back_mm) / 2.0)
    return half_mm[:, 1:]


def axis_levers(front_mm: Array) -> Array:
    """Return half the differences (N, 2, 3) of both faces, as angles at places (N, 3), by unit
    errors of collimation, transit tilt and index.
    """
    levers = np.zeros((len(front_mm), 2, 3))
    levers[:, 0, 0], levers[:, 0, 1] = 1.0, front_mm[:, 2] / lengths_mm(front_mm)
    levers[:, 1, 2] = 1.0
    return levers


def axis_off(log: Log) -> Suspicion | None:
    """The first axis of the tracker that both faces showed to be off."""
    judged = (two_faces(log, n) for n, key in enumerate(TWO_FACES) if key in log.verdicts)
    suspicions = (each.suspicion for each in judged if each is not None)
    return next((each for each in suspicions if each is not None), None)


def _front(log: Log, back: Point) -> Point | None:
    """The newest reading of a nest in the first face before the one in the second."""
    fronts = (*VERIFICATION_KINDS, "length")  # kinds of points
    points = (p for kind in fronts for p in log.measured(kind) if p.id.nest == back.id.nest)
    seen = log.recorded(back)
    before = [p for p in points if p.set_up == back.set_up and log.recorded(p) < seen]
    return max(before, key=log.recorded, default=None)


def positions_at_set_up(log: Log, points: Sequence[Point]) -> Array:
    """Positions (N, 3) as measured from the tracker's own set-up."""
    first = log.matrix("world")
    own = [inverse(log.matrix(world_key(point.set_up))) @ first for point in points]
    rows = zip(own, positions_mm(points), strict=True)
    return np.array([apply(T, at_mm[None])[0] for T, at_mm in rows])


# -- reflectors: each in the same nest -------------------------------------------------------------


def compared_reflectors(log: Log) -> list[MeasuredReflector]:
    """Each reflector against the others; empty where too few were measured."""
    points = list(log.measured(REFLECTOR))
    fewest_reflectors = 3  # of two, either may be off
    if len(points) < fewest_reflectors:
        return []
    noise = run_noise(log)
    u_mm = np.sqrt(np.trace(noise_at(noise, points), axis1=1, axis2=2) * (1.0 + 1.0 / len(points)))
    sigmas, k = (coverage_factor(each, noise.freedom) for each in (SIGMAS, COVERAGE_FACTOR))
    limits_mm = 2.0 * log.cell.uncertainty.smr_centring_limit_mm + sigmas * u_mm
    names = [point.id.nest for point in points]
    return compared_positions(names, positions_mm(points), limits_mm, k * u_mm)


def compared_positions(
    names: list[str], at_mm: Array, limits_mm: Array, U_mm: Array
) -> list[MeasuredReflector]:
    """Each position (N, 3), tracker's frame, against the median of all others."""
    found = []
    rows = zip(names, limits_mm.tolist(), U_mm.tolist(), strict=True)
    for row, (name, limit_mm, expanded_mm) in enumerate(rows):
        others_mm = np.median(np.delete(at_mm, row, axis=0), axis=0)
        beam = others_mm / np.linalg.norm(others_mm)
        off_mm = at_mm[row] - others_mm
        along_mm = float(off_mm @ beam)
        across_mm = float(np.linalg.norm(off_mm - along_mm * beam))
        found.append(MeasuredReflector(name, along_mm, across_mm, limit_mm, expanded_mm))
    return found
