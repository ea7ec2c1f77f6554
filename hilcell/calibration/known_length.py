"""Certified lengths, as the tracker measured them when {W} was framed: its scale.

A tracker whose scale is wrong (a weather station that lies), a reflector of another size or a wrong
unit makes every point wrong, and all that is measured agrees with itself.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from hilcell.calibration.causes import Cause, Suspicion
from hilcell.calibration.contribution import systematic_mm2
from hilcell.cell.file import Cell
from hilcell.cell.layout import CERTIFIED_C, KnownLength
from hilcell.geometry.statistics import rectangular_variance
from hilcell.journal.log import Log, Point, covariances_mm2, positions_mm
from hilcell.journal.point_id import LENGTH, PointId
from hilcell.typed import typed

VERDICT = "known-length"  # its key
COVERAGE = 2.0  # k: about 95 %


class LengthFound(msgspec.Struct, frozen=True):
    """A certified length at the air's temperature, as measured, and U (k = 2) of the difference."""

    nests: tuple[str, str]
    wanted_mm: float
    found_mm: float
    U_mm: float

    @property
    def off_ppm(self) -> float:
        """Return how much longer it was measured."""
        return 1e6 * (self.found_mm / self.wanted_mm - 1.0)

    @property
    def share(self) -> float:
        """Return the difference as a share of U."""
        return abs(self.found_mm - self.wanted_mm) / self.U_mm

    @property
    def holds(self) -> bool:
        """Whether certificate and tracker explain the difference."""
        return self.share <= 1.0

    @property
    def text(self) -> str:
        """Return it in words."""
        return (
            f"{' to '.join(self.nests)} was measured {self.found_mm:.3f} mm, certified "
            f"{self.wanted_mm:.3f} mm, U = {self.U_mm:.3f} mm (k = 2): {self.off_ppm:+z.0f} ppm"
        )


def known_lengths(cell: Cell, log: Log) -> list[LengthFound]:
    """Return the cell's certified lengths as a run has measured them."""
    return [_found(cell, log, each) for each in cell.layout.length]


def _end(cell: Cell, log: Log, nest: str) -> Point:
    """Return the point of a nest, on the floor or on a bar, of the first framing of {W}."""
    of_floor = {each.name for each in cell.layout.floor}
    return log.point(PointId("world" if nest in of_floor else LENGTH, nest=nest))


def _found(cell: Cell, log: Log, known: KnownLength) -> LengthFound:
    """Return a length with the uncertainty that certificate, tracker and centring leave."""
    ends = [_end(cell, log, nest) for nest in known.nests]
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
    wanted_mm = known.length_mm * (1.0 + known.expansion_um_m_k * 1e-6 * warm_k)
    return LengthFound(known.nests, wanted_mm, found_mm, COVERAGE * math.sqrt(variance_mm2))


def scale(log: Log) -> Suspicion | None:
    """Return a tracker's scale that a certified length has shown to be wrong."""
    rows = log.verdicts.get(VERDICT, {}).get("lengths", [])
    found = [typed(row, LengthFound) for row in rows]
    wrong = [each for each in found if not each.holds]
    if not wrong:
        return None
    worst = max(wrong, key=lambda each: each.share)
    return Suspicion(Cause.SCALE, worst.off_ppm, "ppm", f"known length {' to '.join(worst.nests)}")
