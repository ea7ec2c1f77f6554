"""Positions of rail and nests, and whether reflectors are carried by hand.

Frames: {W} world, of the floor's first three nests; {B} robot base; {S} slide, whose nests are
given in nominal {B}, because the slide carries the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import combinations
from typing import Literal

import numpy as np
from msgspec import field

from hilcell.cell.settings import refuse
from hilcell.cell.tables import UNPLACED_MM, Count, Frozen, Length, Name, Point, Pose, Rate, Size
from hilcell.geometry.kinematics import Array

CERTIFIED_C = 20.0  # of lengths: ISO 1


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
    """Nominal {B} in {W} at rail position 0, the rail's direction in {W}, the nests.

    Without a rail the direction is zero and there are no nests on a slide.
    """

    base: Pose
    rail_direction: Point
    floor: list[Nest]
    slide: list[Nest]
    bar: list[Nest] = field(default_factory=list)
    length: list[KnownLength] = field(default_factory=list)
    nest_tolerance_mm: Size = 5.0
    base_tolerance_mm: Size = 10.0
    nest_samples: Count = 10
    max_tool_std_mm: Size = 0.1
    reflectors: Literal["mounted", "by_hand"] = "mounted"

    def __post_init__(self) -> None:
        refuse(problem for check in self.checks() for problem in check())

    def checks(self) -> Sequence[Callable[[], Iterable[str]]]:
        return (
            self._bad_direction,
            self._bad_names,
            lambda: _bad_frame("floor", self.floor),
            lambda: _bad_frame("slide", self.slide) if self.slide else (),
            lambda: _too_close("bar", self.bar),
            self._bad_lengths,
            self._unused_bars,
        )

    def _bad_direction(self) -> Iterator[str]:
        fixed = not self.slide and not any(self.rail_direction)
        if not (fixed or abs(np.linalg.norm(self.rail_direction) - 1) < 1e-6):
            yield "rail_direction must have length 1"

    def _bad_names(self) -> Iterator[str]:
        seen = set[str]()
        for table, nests in (("floor", self.floor), ("bar", self.bar), ("slide", self.slide)):
            for n, nest in enumerate(nests):
                if nest.name in seen:
                    yield f"{table}[{n}].name: nest names must differ, found {nest.name} twice"
                seen.add(nest.name)

    def _bad_lengths(self) -> Iterator[str]:
        """Yield known lengths that do not match nests on floor and bars."""
        at_mm = {nest.name: nest.xyz_mm for nest in self.fixed_nests}
        for n, each in enumerate(self.length):
            unknown = [name for name in each.nests if name not in at_mm]
            for name in unknown:
                yield f"length[{n}].nests: nest {name} is unknown; known: {', '.join(at_mm)}"
            if unknown:
                continue
            nominal_mm = float(np.linalg.norm(at_mm[each.nests[0]] - at_mm[each.nests[1]]))
            if not abs(nominal_mm - each.length_mm) <= 2 * self.nest_tolerance_mm:
                nests = " to ".join(each.nests)
                yield f"length[{n}].length_mm: {each.length_mm}, by {nests} {nominal_mm:.3f} mm"

    def _unused_bars(self) -> Iterator[str]:
        ends = {name for each in self.length for name in each.nests}
        if unused := [nest.name for nest in self.bar if nest.name not in ends]:
            yield f"bar: no length has nest {', '.join(unused)}"

    @property
    def fixed_nests(self) -> list[Nest]:
        """Return the nests in {W}, not on the slide."""
        return [*self.floor, *self.bar]

    @property
    def is_unplaced(self) -> bool:
        """Whether the floor nests are a draft's, which the tracker places where they stand."""
        return all(nest.z_mm == UNPLACED_MM for nest in self.floor)

    @property
    def by_hand(self) -> bool:
        return self.reflectors == "by_hand"

    def nominal_base(self, rail_mm: float) -> Array:
        """Return nominal {B} in {W} (4, 4) with the slide at ``rail_mm``."""
        T = self.base.matrix()
        T[:3, 3] += rail_mm * np.array(self.rail_direction)
        return T


def _bad_frame(table: str, nests: list[Nest]) -> Iterator[str]:
    """Yield reasons why nests define no frame; the first three define its axes."""
    most_nests = 100
    if not 3 <= len(nests) <= most_nests:
        yield f"{table}: expected 3 .. {most_nests} nests, got {len(nests)}"
        return
    yield from _too_close(table, nests)
    yield from list(_collinear(table, nests[:3])) or _collinear(table, nests)


def _too_close(table: str, nests: list[Nest]) -> Iterator[str]:
    least_mm = 20.0  # closer: the same nest twice, or reflectors touch
    for (_, one), (n, other) in combinations(enumerate(nests), 2):
        apart_mm = float(np.linalg.norm(one.xyz_mm - other.xyz_mm))
        if not apart_mm >= least_mm:
            both = f"nests {one.name} and {other.name}"
            yield f"{table}[{n}]: {both} are {apart_mm:.1f} mm apart, expected >= {least_mm:g} mm"


def _collinear(table: str, nests: list[Nest]) -> Iterator[str]:
    points = np.array([nest.xyz_mm for nest in nests])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[1] > 0.02 * spread[0]:
        names = ", ".join(nest.name for nest in nests)
        yield (
            f"{table}: nests {names} lie on one line (spread {spread[0]:.1f} mm along it, "
            f"{spread[1]:.3f} mm across); move one nest aside"
        )
