"""The characteristics of ISO 9283:1998 from attained poses: AP and RP (7.2), AD and RD (7.3).

Positions (n, 3) in mm, axes of the base; each attained n times. u are standard uncertainties that
the scatter of n attainments alone gives (GUM 4.2.3); systematic ones are the caller's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import from_mean_mm, repeatability_mm

SHARE_OF_DIAGONAL = 0.1  # that test poses keep off the cube's corners: (10 +- 2) % (6.8.5)
# Corners by the signs of x, y, z: C1 to C4 around the cube's top, C5 to C8 below them.
CORNERS = {
    "C1": (-1, -1, 1), "C2": (-1, 1, 1), "C3": (1, 1, 1), "C4": (1, -1, 1),
    "C5": (-1, -1, -1), "C6": (-1, 1, -1), "C7": (1, 1, -1), "C8": (1, -1, -1),
}  # fmt: skip
PLANE = ("C1", "C2", "C7", "C8")  # its diagonals C1-C7 and C2-C8 are the cube's
CYCLE = ("P5", "P4", "P3", "P2", "P1")  # from P1 (table 7)
ENDS = ("P2", "P4")  # of the distance: on one diagonal


def cube_side_mm(size_mm: tuple[float, float, float]) -> float:
    """Return the side of the largest cube in a volume, edges parallel to the base (6.8.2)."""
    return min(size_mm)


def cube_poses_mm(centre_mm: Array, side_mm: float) -> dict[str, Array]:
    """Return P1, the cube's centre, and P2 to P5 (3,) on the diagonals of the plane (6.8.5)."""
    reach_mm = (1.0 - 2.0 * SHARE_OF_DIAGONAL) * side_mm / 2.0
    corners = {f"P{n}": np.array(CORNERS[name]) for n, name in enumerate(PLANE, start=2)}
    return {"P1": centre_mm} | {
        name: centre_mm + reach_mm * corner for name, corner in corners.items()
    }


@dataclass(frozen=True, slots=True)
class PoseFigures:
    """One pose: ``ap_mm`` (3,) is the barycentre less the commanded position."""

    ap_mm: Array
    scatter_mm2: Array  # covariance (3, 3) of one attainment
    l_mean_mm: float
    s_l_mm: float
    rp_mm: float
    count: int

    @property
    def ap_p_mm(self) -> float:
        """Return the positioning accuracy AP_p."""
        return float(np.linalg.norm(self.ap_mm))

    @property
    def rp_u_mm(self) -> float:
        """Return u of RP_l = mean + 3 S from the scatter of both, taken as independent."""
        n = self.count
        return self.s_l_mm * math.sqrt(1.0 / n + 9.0 / (2.0 * (n - 1)))

    def rp_without_mm(self, noise_mm2: float) -> float:
        """Return RP_l less the measurement's noise, the trace of its covariance; 0 where that
        explains all. Mean squares subtract; distances keep the shape of their distribution.
        """
        whole_mm2 = float(np.trace(self.scatter_mm2))
        share = 1.0 - noise_mm2 / whole_mm2 if whole_mm2 > noise_mm2 else 0.0
        return self.rp_mm * math.sqrt(share)

    def along(self, covariance_mm2: Array) -> float:
        """Return the standard deviation that a covariance (3, 3) has along AP."""
        e = self.ap_mm / self.ap_p_mm if self.ap_p_mm > 0.0 else np.eye(3)[0]
        return math.sqrt(float(e @ covariance_mm2 @ e))


def pose_figures(attained_mm: Array, commanded_mm: Array) -> PoseFigures:
    """Return AP and RP of attained positions (n, 3) and the commanded one (3,) (7.2.1, 7.2.2)."""
    l_mm = from_mean_mm(attained_mm)
    return PoseFigures(
        attained_mm.mean(axis=0) - commanded_mm,
        np.cov(attained_mm.T),
        float(l_mm.mean()),
        float(l_mm.std(ddof=1)),
        repeatability_mm(l_mm),
        len(attained_mm),
    )


@dataclass(frozen=True, slots=True)
class TurnFigures:
    """Angles a, b, c of one pose, each (3,) in rad: rotations about x, y, z of the base, from the
    commanded orientation to the attained ones.
    """

    ap_rad: Array  # the mean less the commanded angle
    s_rad: Array  # standard deviation of one attainment
    count: int

    @property
    def rp_rad(self) -> Array:
        """Return the repeatabilities RP_a, RP_b, RP_c = +-3 S (7.2.2)."""
        return 3.0 * self.s_rad

    @property
    def rp_u_rad(self) -> Array:
        """Return u of RP from the scatter."""
        return self.rp_rad / math.sqrt(2.0 * (self.count - 1))


def turn_figures(turns_rad: Array) -> TurnFigures:
    """Return AP_a, AP_b, AP_c (7.2.1) and RP (7.2.2) of rotation vectors (n, 3), axes of the base.

    Of errors as small as a robot's the three angles are the vector's coordinates.
    """
    return TurnFigures(turns_rad.mean(axis=0), turns_rad.std(axis=0, ddof=1), len(turns_rad))


@dataclass(frozen=True, slots=True)
class DistanceFigures:
    """One distance; ``ad_xyz_mm`` (3,) are those of the distances along each axis."""

    commanded_mm: float
    ad_mm: float
    ad_xyz_mm: Array
    s_d_mm: float
    count: int

    @property
    def rd_mm(self) -> float:
        """Return the distance repeatability RD = +-3 S_D."""
        return 3.0 * self.s_d_mm

    @property
    def ad_u_mm(self) -> float:
        """Return u of AD from the scatter."""
        return self.s_d_mm / math.sqrt(self.count)

    @property
    def rd_u_mm(self) -> float:
        """Return u of RD from the scatter."""
        return self.rd_mm / math.sqrt(2.0 * (self.count - 1))


def distance_figures(ends_mm: tuple[Array, Array], commanded_mm: Array) -> DistanceFigures:
    """Return AD and RD of two ends (n, 3) attained in turn; commanded (2, 3) (7.3.2, 7.3.3)."""
    ways_mm = ends_mm[0] - ends_mm[1]
    wanted_mm = commanded_mm[0] - commanded_mm[1]
    found_mm = np.linalg.norm(ways_mm, axis=1)
    length_mm = float(np.linalg.norm(wanted_mm))
    return DistanceFigures(
        length_mm,
        float(found_mm.mean()) - length_mm,
        np.abs(ways_mm).mean(axis=0) - np.abs(wanted_mm),
        float(found_mm.std(ddof=1)),
        len(ways_mm),
    )
