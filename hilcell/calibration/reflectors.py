"""Reflectors against one another, each seated once in the same nest.

In one nest all centres are at one place, as far as balls are round and centred: a reflector whose
ball has another radius, or whose prism is longer, is seen elsewhere, along the beam mostly. In its
own nest nothing shows that: the nest's place is not known so well.
"""

from __future__ import annotations

import msgspec
import numpy as np

from hilcell.geometry.statistics import coverage_factor
from hilcell.journal.log import Log, positions_mm
from hilcell.journal.point_id import REFLECTOR
from hilcell.journal.reading_noise import noise_at, run_noise
from hilcell.ports import Array

SIGMAS = 4.0  # of the readings' noise, beyond the stated limits of centring
LEAST = 3  # reflectors: of two nobody can say which is off


class Compared(msgspec.Struct, frozen=True):
    """The reflector of a place: how far from the median of the others, along the beam and across
    it, and its limit.
    """

    place: str
    along_mm: float
    across_mm: float
    limit_mm: float

    @property
    def holds(self) -> bool:
        """Whether centring and noise explain it."""
        return bool(np.hypot(self.along_mm, self.across_mm) <= self.limit_mm)

    @property
    def text(self) -> str:
        """Return it in words."""
        return (
            f"the reflector of {self.place} is seen {self.along_mm:+.3f} mm along the beam and "
            f"{self.across_mm:.3f} mm across it from the others, limit {self.limit_mm:.3f} mm"
        )


def compared(log: Log) -> list[Compared]:
    """Return each reflector against the others; nothing where too few were measured."""
    points = list(log.measured(REFLECTOR))
    if len(points) < LEAST:
        return []
    noise = run_noise(log)
    noise_mm2 = noise_at(noise, points)
    sigmas = coverage_factor(SIGMAS, noise.freedom)
    limits_mm = 2.0 * log.cell.uncertainty.smr_centring_limit_mm + sigmas * np.sqrt(
        np.trace(noise_mm2, axis1=1, axis2=2) * (1.0 + 1.0 / len(points))
    )
    return compared_places([point.id.nest for point in points], positions_mm(points), limits_mm)


def compared_places(names: list[str], at_mm: Array, limits_mm: Array) -> list[Compared]:
    """Return places (N, 3), tracker's frame, each against the median of all others."""
    found = []
    for row, (name, limit_mm) in enumerate(zip(names, limits_mm.tolist(), strict=True)):
        others_mm = np.median(np.delete(at_mm, row, axis=0), axis=0)
        beam = others_mm / np.linalg.norm(others_mm)
        off_mm = at_mm[row] - others_mm
        along_mm = float(off_mm @ beam)
        across_mm = float(np.linalg.norm(off_mm - along_mm * beam))
        found.append(Compared(name, along_mm, across_mm, limit_mm))
    return found
