"""Where the rail and the nests stand, and whether reflectors are carried by hand.

Frames: {W} world (three floor nests), {B} robot base, {S} slide (its nests are given in nominal
{B}: the slide carries the robot).
"""

from __future__ import annotations

from itertools import combinations
from typing import Literal

import numpy as np
from msgspec import field

from hilcell.cell.tables import Count, Frozen, Length, Name, Point, Pose, Rate, Size
from hilcell.geometry.kinematics import Array

MOST_NESTS = 100
CERTIFIED_C = 20.0  # of lengths: ISO 1
APART_MM = 20.0  # nests closer than this are one nest, or their reflectors touch


class Nest(Frozen, frozen=True, kw_only=True):
    """A magnet nest that carries a reflector: on the floor in {W}, on the slide in nominal {B}."""

    name: Name
    x_mm: Length
    y_mm: Length
    z_mm: Length

    @property
    def xyz_mm(self) -> Array:
        """Return the position (3,)."""
        return np.array([self.x_mm, self.y_mm, self.z_mm])


class KnownLength(Frozen, frozen=True, kw_only=True):
    """A certified distance of two nests at 20 C; ``u_mm`` is 1 sigma, half the certificate's U."""

    nests: tuple[Name, Name]
    length_mm: Size
    u_mm: Size
    certificate: str = ""
    expansion_um_m_k: Rate = 0.0


class Layout(Frozen, frozen=True, kw_only=True):
    """Where the rail stands: nominal {B} in {W} at rail 0, the rail's direction in {W}."""

    base: Pose
    rail_direction: Point
    floor: list[Nest]
    slide: list[Nest]
    bar: list[Nest] = field(default_factory=list)
    length: list[KnownLength] = field(default_factory=list)
    nest_tolerance_mm: Size = 5.0
    nest_samples: Count = 10
    max_tool_std_mm: Size = 0.1
    reflectors: Literal["mounted", "by_hand"] = "mounted"

    def __post_init__(self) -> None:
        if not abs(np.linalg.norm(self.rail_direction) - 1) < 1e-6:
            raise ValueError("rail_direction must have length 1")
        for nests in (self.floor, self.slide):
            if not 3 <= len(nests) <= MOST_NESTS:
                raise ValueError(f"3 .. {MOST_NESTS} nests are needed, found {len(nests)}")
        names = [nest.name for nest in (*self.standing, *self.slide)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"nest names must differ, found {name} twice")
        for nests in (self.floor, self.slide):
            _refuse_collinear(nests[:3])  # they make the frame's axes
            _refuse_collinear(nests)
            _refuse_close(nests)
        _refuse_close(self.bar)
        self._refuse_lengths()

    def _refuse_lengths(self) -> None:
        """Refuse lengths that are not those of nests on floor and bars, and bars without one."""
        at_mm = {nest.name: nest.xyz_mm for nest in self.standing}
        for each in self.length:
            for name in each.nests:
                if name not in at_mm:
                    raise ValueError(f"length: nest {name} is unknown; known: {', '.join(at_mm)}")
            nominal_mm = float(np.linalg.norm(at_mm[each.nests[0]] - at_mm[each.nests[1]]))
            if not abs(nominal_mm - each.length_mm) <= 2 * self.nest_tolerance_mm:
                raise ValueError(
                    f"length of {' to '.join(each.nests)}: {each.length_mm} mm, by their places "
                    f"{nominal_mm:.3f} mm"
                )
        ends = {name for each in self.length for name in each.nests}
        if unused := [nest.name for nest in self.bar if nest.name not in ends]:
            raise ValueError(f"bar: no length has nest {', '.join(unused)}")

    @property
    def standing(self) -> list[Nest]:
        """Return the nests in {W}, which do not ride on the slide."""
        return [*self.floor, *self.bar]

    @property
    def by_hand(self) -> bool:
        """Whether one reflector is carried from nest to nest by hand."""
        return self.reflectors == "by_hand"

    def nominal_base(self, rail_mm: float) -> Array:
        """Return nominal {B} in {W} (4, 4) with the slide at ``rail_mm``."""
        T = self.base.matrix()
        T[:3, 3] += rail_mm * np.array(self.rail_direction)
        return T


def _refuse_close(nests: list[Nest]) -> None:
    for one, other in combinations(nests, 2):
        apart_mm = float(np.linalg.norm(one.xyz_mm - other.xyz_mm))
        if not apart_mm >= APART_MM:
            raise ValueError(
                f"nests {one.name} and {other.name} are {apart_mm:.1f} mm apart, "
                f"wanted at least {APART_MM} mm"
            )


def _refuse_collinear(nests: list[Nest]) -> None:
    points = np.array([nest.xyz_mm for nest in nests])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[1] > 0.02 * spread[0]:
        names = ", ".join(nest.name for nest in nests)
        raise ValueError(
            f"nests {names} lie on one line (spread {spread[0]:.1f} mm along it, "
            f"{spread[1]:.3f} mm across): a frame needs a triangle; move one nest aside"
        )
