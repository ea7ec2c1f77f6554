"""Floor nests as the tracker sees them: limits of their motions, checks of their distances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from hilcell.cell.file import Cell
from hilcell.geometry.beam_noise import BeamNoise
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import coverage_factor, lengths_mm
from hilcell.journal.log import noise_at, positions_mm
from hilcell.model.point import Point
from hilcell.ports import Array, DeviceError

SIGMAS = 4.0  # of the readings' noise, were it known, beyond the stated drift
ALIKE = 0.5  # of the farthest motion: less moves no nest of a tracker that was bumped


class WrongDistance(NamedTuple):
    """Two nests whose distance is not the expected one."""

    nests: list[str]
    distance_mm: float
    wanted_mm: float
    limit_mm: float

    @property
    def names(self) -> str:
        return " to ".join(self.nests)


def limits_of(cell: Cell, noise: BeamNoise, before: Sequence[Point], now: Sequence[Point]) -> Array:
    """Return by how much each nest (N,) may seem to move: stated drift, and the readings' noise.

    The noise is what all readings of the run so far have shown, at the nest.
    """
    mm2 = noise_at(noise, before) + noise_at(noise, now)
    return _limits(cell, noise, np.trace(mm2, axis1=-2, axis2=-1))


def _limits(cell: Cell, noise: BeamNoise, variances_mm2: Array) -> Array:
    """Return the limits (N,) of lengths by the variances of their noise (N,)."""
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    limits: Array = np.sqrt(3.0) * cell.uncertainty.drift_limit_mm + sigmas * np.sqrt(variances_mm2)
    return limits


def distance_limits(
    cell: Cell, noise: BeamNoise, before: Sequence[Point], now: Sequence[Point]
) -> Array:
    """Return by how much distances between nests (N, N) may seem to change, as `limits_of`.

    Of the readings' noise counts what lies along the line between the two.
    """
    mm2 = noise_at(noise, before) + noise_at(noise, now)
    at_mm = positions_mm(before)
    lines_mm = at_mm[:, None] - at_mm[None]
    along = lines_mm / np.maximum(np.linalg.norm(lines_mm, axis=-1), 1.0)[..., None]
    both_mm2 = np.einsum("ijk,ijkl,ijl->ij", along, mm2[:, None] + mm2[None], along)
    return _limits(cell, noise, both_mm2)


def limit_since(
    cell: Cell, noise: BeamNoise, nests: Sequence[Point], then_c: float | None
) -> float:
    """Return by how much distances of the floor nests may differ from those of an earlier run.

    Besides noise and stated drift both runs have the tracker's limits, and the floor has grown.
    """
    now_c = [point.temperature_c for point in nests if point.temperature_c is not None]
    warmer_k = 10.0  # air that nobody measured
    if now_c and then_c is not None:
        warmer_k = abs(float(np.mean(now_c)) - then_c)
    at_mm = positions_mm(nests)
    longest_mm = float(np.linalg.norm(at_mm[:, None] - at_mm[None], axis=-1).max())
    far_mm = float(np.linalg.norm(at_mm, axis=1).max())
    stated = cell.uncertainty
    tracker_mm = 2.0 * (stated.tracker_limit_mm + 1e-6 * stated.tracker_limit_um_m * far_mm)
    floor_um_m_k = 12.0  # growth of concrete and steel
    grown_mm = 1e-6 * floor_um_m_k * warmer_k * longest_mm
    return float(limits_of(cell, noise, nests, nests).max()) + tracker_mm + grown_mm


def motions_mm(before: Sequence[Point], now: Sequence[Point]) -> Array:
    """Return by how much each nest (N,) seems to have moved."""
    return lengths_mm(positions_mm(now) - positions_mm(before))


def some_stand(before: Sequence[Point], now: Sequence[Point]) -> bool:
    """Whether some nests are hardly moved beside the others: no motion of a tracker does that."""
    off_mm = motions_mm(before, now)
    return bool(np.any(off_mm <= ALIKE * off_mm.max()))


def check_places(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests that were seen outside the tracker's search for them.

    Distances do not tell that two nests changed places in a symmetric triangle; places do.
    """
    nests, limit_mm = cell.layout.floor, cell.tracker.find_radius_mm
    nominal_mm = np.array([nest.xyz_mm for nest in nests])
    expected_mm = apply(inverse(cell.tracker.pose.matrix()), nominal_mm)
    off_mm = np.linalg.norm(measured_mm[:, None] - expected_mm[None], axis=-1)
    for nest, row_mm, found_mm in zip(nests, off_mm, np.diag(off_mm), strict=True):
        if found_mm <= limit_mm:
            continue
        near = zip(nests, row_mm, strict=True)
        at = [other.name for other, each_mm in near if each_mm <= limit_mm]
        where = f", where {at[0]} is expected" if at else ""
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{nest.name} was seen {found_mm:.1f} mm from its expected place{where}",
            wanted=f"<= {limit_mm:.1f} mm (tracker.find_radius_mm)",
            act="nests swapped, or the tracker does not stand as tracker.pose says; check, then "
            "resume",
            fields={
                "nest": nest.name,
                "off_mm": float(found_mm),
                "limit_mm": limit_mm,
                "seen_at": at[:1],
            },
        )


def check_distances(cell: Cell, measured_mm: Array) -> None:
    """Refuse nests whose distances are not those of the cell file: swapped, lifted, wrong unit."""
    nominal_mm = np.array([nest.xyz_mm for nest in cell.layout.floor])
    limit_mm = 2 * cell.layout.nest_tolerance_mm
    for wrong in wrong_distances(cell, nominal_mm, measured_mm, limit_mm):
        raise DeviceError(
            "HC-T32",
            "Tracker",
            "world frame",
            f"{wrong.names} is {wrong.distance_mm:.2f} mm",
            wanted=f"{wrong.wanted_mm:.2f} +-{limit_mm:.1f} mm",
            act="nests swapped, a reflector not seated, or wrong units; check, then resume",
            fields=wrong._asdict(),
        )


def wrong_distances(
    cell: Cell, wanted_mm: Array, found_mm: Array, limits_mm: Array | float
) -> Iterator[WrongDistance]:
    """Yield the pairs of floor nests whose distance is not that of ``wanted_mm`` (N, 3).

    ``limits_mm`` is one for all, or (N, N).
    """
    names = [nest.name for nest in cell.layout.floor]
    each_mm = np.broadcast_to(limits_mm, (len(names), len(names)))
    for pair in combinations(range(len(names)), 2):
        then, now = (
            float(np.linalg.norm(at_mm[pair[0]] - at_mm[pair[1]]))
            for at_mm in (wanted_mm, found_mm)
        )
        limit_mm = float(each_mm[pair])
        if not abs(now - then) <= limit_mm:
            yield WrongDistance([names[n] for n in pair], now, then, limit_mm)
