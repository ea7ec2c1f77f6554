"""Errors of a tracker's own axes, by nests that it sees in both of its faces.

A reading in the first face and one in the second, the back sight, differ by twice what the axes are
off, whatever else is wrong. At a place of range r and height z above the tracker, half of the
difference is ``c r + i z`` sideways and ``v r`` downwards: collimation c, the transit axis' tilt i,
the index v of the vertical circle. All that a run measures is off by as much: a tilt of 50 urad
moves what lies a metre lower by 0.05 mm against what lies level.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from hilcell.calibration.causes import Cause, Suspicion
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import coverage_factor
from hilcell.journal.log import Log, Point, positions_mm
from hilcell.journal.point_id import BACK
from hilcell.journal.reading_noise import noise_at, run_noise
from hilcell.journal.set_ups import PROOFS, world_key
from hilcell.ports import Array

VERDICTS = ("two-face", "two-face.closing")  # at the start, and at the end
NOTICED_BY = "nests seen in both faces"
SIGMAS = 4.0  # of the readings' noise, beyond the tracker's stated limits
URAD = 1e6
AXES = ("urad of collimation", "urad of the transit axis' tilt", "urad of the vertical index")
FRONTS = (*PROOFS, "length")  # kinds of points


class Faces(msgspec.Struct, frozen=True):
    """Half the difference of both faces at a nest, sideways and downwards, and its limit."""

    nest: str
    across_mm: float
    down_mm: float
    limit_mm: float

    @property
    def holds(self) -> bool:
        """Whether tracker and noise explain the difference."""
        return bool(np.hypot(self.across_mm, self.down_mm) <= self.limit_mm)


class BothFaces(msgspec.Struct, frozen=True):
    """Both faces at each nest, and the axis that explains them best, in urad."""

    nests: list[Faces]
    size_urad: float
    unit: str

    @property
    def holds(self) -> bool:
        """Whether every nest keeps its limit."""
        return all(each.holds for each in self.nests)

    @property
    def suspicion(self) -> Suspicion | None:
        """Return the axis that is off, if a nest shows that one is."""
        if self.holds:
            return None
        return Suspicion(Cause.INSTRUMENT, self.size_urad, self.unit, NOTICED_BY)

    @property
    def text(self) -> str:
        """Return it in words."""
        worst = max(self.nests, key=lambda each: np.hypot(each.across_mm, each.down_mm))
        off_mm = float(np.hypot(worst.across_mm, worst.down_mm))
        return (
            f"half the difference of both faces is {off_mm:.3f} mm at most, at {worst.nest}, limit "
            f"{worst.limit_mm:.3f} mm; as of {self.size_urad:+.0f} {self.unit}"
        )


def two_faces(log: Log, number: int) -> BothFaces | None:
    """Return what both faces have shown at the start (0) or the end (1); None without readings."""
    backs = [point for point in log.measured(BACK) if point.id.number == number]
    both = [(front, back) for back in backs if (front := _front(log, back)) is not None]
    if not both:
        return None
    fronts, backs = [front for front, _ in both], [back for _, back in both]
    noise = run_noise(log)
    noise_mm2 = (noise_at(noise, fronts) + noise_at(noise, backs)) / 4.0
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    limits_mm = _limits_mm(log.cell, positions_mm(fronts)) + sigmas * np.sqrt(
        np.trace(noise_mm2, axis1=1, axis2=2)
    )
    return judged_faces(
        [point.id.nest for point in fronts], _own_mm(log, fronts), _own_mm(log, backs), limits_mm
    )


def judged_faces(
    names: Sequence[str], front_mm: Array, back_mm: Array, limits_mm: Array
) -> BothFaces:
    """Return what readings (N, 3) in both faces show, in the tracker's own frame."""
    x, y, z = front_mm.T
    flat_mm, range_mm = np.hypot(x, y), np.linalg.norm(front_mm, axis=1)
    nought = np.zeros(len(x))
    around = np.stack([-y, x, nought], axis=1) / flat_mm[:, None]
    down = np.stack([x * z, y * z, -(flat_mm**2)], axis=1) / (flat_mm * range_mm)[:, None]
    half_mm = (front_mm - back_mm) / 2.0
    seen = np.stack([(half_mm * each).sum(axis=1) for each in (around, down)], axis=1)
    columns = np.zeros((len(x), 2, 3))
    columns[:, 0, 0], columns[:, 0, 1], columns[:, 1, 2] = range_mm, z, range_mm
    weighted = columns / range_mm[:, None, None]  # noise across the beam grows with the range
    rows = weighted.reshape(-1, 3)
    off = (seen / range_mm[:, None]).reshape(-1)
    sizes = rows.T @ off / np.maximum(np.square(rows).sum(axis=0), 1e-12)
    left = np.square(off[:, None] - rows * sizes).sum(axis=0)
    axis = int(np.argmin(left))
    rows_found = zip(names, seen.tolist(), limits_mm.tolist(), strict=True)
    nests = [Faces(name, across, below, limit) for name, (across, below), limit in rows_found]
    return BothFaces(nests, URAD * float(sizes[axis]), AXES[axis])


def instrument(log: Log) -> Suspicion | None:
    """Return the first axis of the tracker that both faces showed to be off."""
    judged = (two_faces(log, n) for n, key in enumerate(VERDICTS) if key in log.verdicts)
    suspicions = (each.suspicion for each in judged if each is not None)
    return next((each for each in suspicions if each is not None), None)


def _limits_mm(cell: Cell, at_mm: Array) -> Array:
    """Return by how much (N,) the tracker's stated limits let places (N, 3) be off."""
    stated = cell.uncertainty
    range_mm: Array = np.linalg.norm(at_mm, axis=1)
    return stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * range_mm


def _front(log: Log, back: Point) -> Point | None:
    """Return the newest reading of a nest in the first face before the one in the second."""
    points = (p for kind in FRONTS for p in log.measured(kind) if p.id.nest == back.id.nest)
    seen = log.recorded(back)
    before = [p for p in points if p.set_up == back.set_up and log.recorded(p) < seen]
    return max(before, key=log.recorded, default=None)


def _own_mm(log: Log, points: Sequence[Point]) -> Array:
    """Return places (N, 3) as the tracker saw them from its own set-up."""
    first = log.matrix("world")
    own = [inverse(log.matrix(world_key(point.set_up))) @ first for point in points]
    rows = zip(own, positions_mm(points), strict=True)
    found: Array = np.array([apply(T, at_mm[None])[0] for T, at_mm in rows])
    return found
