"""The part as a solid, and whether a program's ways between its holes keep clear of it.

Nothing but the holes and the cell's boxes is known of a part. So it is taken to lie behind the
plane of each hole, as far as that hole is the nearest one and not farther than `REACH_MM`; and a
box of ``[[keep_out]]`` on which a hole lies is the part, or the jig that carries it, unless the box
sticks out in front of that hole. The tool's tip is in front of all else of the tool, so it is
judged against both, and so is the arm as far as its wrist; the wrist, and the line from the flange
to the tip, are judged against the other boxes, as in a run. Close to a hole, on the straight way,
the tip may be near to such a box, but not in it. Lengths mm, angles rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from msgspec.structs import replace
from scipy.spatial import cKDTree

from hilcell.cell.file import Cell, KeepOut, Station
from hilcell.cell.surroundings import LEAST_MM, LINKS, CapsuleTable, Surroundings, posture
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.kinematics import Arm, forward
from hilcell.ports import Array

REACH_MM = 300.0  # from a hole: farther away nothing is known of the part


@dataclass(frozen=True, eq=False)
class Part:
    """The holes ``points_mm`` (N, 3) of a whole part in {W}, and its outward normals (N, 3)."""

    points_mm: Array
    outward: Array

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points_mm)

    def free_mm(self, places_mm: Array) -> Array:
        """Return how far places (K, 3) in {W} are in front of the part, negative inside it.

        Infinite beyond `REACH_MM` of every hole.
        """
        off_mm, nearest = self._tree.query(places_mm)
        from_hole = places_mm - self.points_mm[nearest]
        front_mm = np.einsum("ki,ki->k", from_hole, self.outward[nearest])
        return np.where(off_mm <= REACH_MM, front_mm, np.inf)


class Clearance:
    """Clearance of an arm at a station; ``arm`` has the tool's tip as its tool point."""

    TO_WRIST = 4  # links; those after them work close to the part
    AT_HOLE_MM = 1.0  # of a hole: there the tip may touch what it drills
    LOOK_MM = 5.0  # between looks along a way
    LOOKS = 9  # by which a way's length is estimated

    def __init__(
        self, cell: Cell, station: Station, arm: Arm, T_W_B: Array, part: Part, least_mm: float
    ) -> None:
        """Between holes the tip keeps ``least_mm`` in front of the part."""
        self._arm, self._T_W_B, self._part, self._least_mm = arm, T_W_B, part, least_mm
        self._rail_mm = station.rail_mm
        boxes = [_Box(cell, station, each) for each in cell.keep_out]
        self._carriers = [box for box in boxes if box.carries(part, least_mm)]
        self._others = [box for box in boxes if box not in self._carriers]
        self._around = self._around_tool = self._to_wrist = None
        if (envelope := cell.robot.envelope) is not None:
            shape, layout = cell.robot.arm(), cell.layout
            longer = replace(envelope, capsule=[*envelope.capsule, _tool_line(arm)])
            if others := [box.table for box in self._others]:
                self._around = Surroundings(shape, envelope, layout, others)
                self._around_tool = Surroundings(shape, longer, layout, others)
            if carriers := [box.table for box in self._carriers]:
                self._to_wrist = Surroundings(shape, envelope, layout, carriers, self.TO_WRIST)

    def refusal(self, start_rad: Array, end_rad: Array) -> str:
        """Return why a motion of all joints in step between (6,) and (6,) is not clear, or ""."""
        tip_mm = self._looks_mm(start_rad, end_rad)
        free_mm = float(self._part.free_mm(tip_mm).min())
        if not free_mm >= self._least_mm:
            where = "inside" if free_mm < 0.0 else "in front of"
            return (
                f"the tip is {abs(free_mm):.1f} mm {where} the part, expected at least "
                f"{self._least_mm:.0f} mm in front of it"
            )
        return self._passes_through(tip_mm) or self._collides(
            self._around_tool, start_rad[None], end_rad[None]
        )

    def straight_refusal(self, joints_rad: Array) -> str:
        """Return why a straight way by joints (K, 6) to a hole is not clear, or ""."""
        tip_mm = self._tip_mm(joints_rad)
        before = np.linalg.norm(tip_mm - tip_mm[-1], axis=1) > self.AT_HOLE_MM
        *_, end_mm = free_mm = self._part.free_mm(tip_mm)  # commands lie beside their holes
        deepest_mm = float(free_mm.min())
        if not deepest_mm >= min(float(end_mm), 0.0) - self.AT_HOLE_MM:
            return (
                f"the tip is {-deepest_mm:.1f} mm inside the part on its straight way in: behind "
                "the plane of another hole"
            )
        return (
            self._passes_through(tip_mm[before])
            or self._tool_passes_through(joints_rad)
            or self._collides(self._around, joints_rad[:-1], joints_rad[1:])
        )

    def _tool_passes_through(self, joints_rad: Array) -> str:
        """Return which box the line from flange to tip is in, of those that carry no hole."""
        x_mm = self._arm.tool[:3, 3]
        shares = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(x_mm) / self.LOOK_MM))
        flanges = forward(self._arm, joints_rad) @ inverse(self._arm.tool)
        line_mm = np.concatenate([np.outer(shares, x_mm).T, np.ones((1, len(shares)))])
        places_mm = np.swapaxes((flanges @ line_mm)[:, :3], 1, 2).reshape(-1, 3)
        return next(
            (
                f"the tool passes through keep-out {box.table.name}"
                for box in self._others
                if box.contains(apply(self._T_W_B, places_mm))
            ),
            "",
        )

    def _passes_through(self, tip_mm: Array) -> str:
        for box in self._carriers:
            if box.contains(tip_mm):
                return f"the tip passes through keep-out {box.table.name}, on which holes lie"
        for box in self._others:
            if box.contains(tip_mm):
                return f"the tip passes through keep-out {box.table.name}"
        return ""

    def _collides(self, around: Surroundings | None, starts_rad: Array, ends_rad: Array) -> str:
        start, end = (posture(self._rail_mm, each) for each in (starts_rad, ends_rad))
        for known in (around, self._to_wrist):
            if known is None:
                continue
            proof = known.prove(start, end)
            for n in np.flatnonzero(~proof.clear).tolist():
                nearest = known.nearest(start[n], end[n], float(proof.share[n]))
                return (
                    f"link {nearest.link} comes within {nearest.clearance_mm:.1f} mm of keep-out "
                    f"{nearest.volume}, expected at least {known.wanted_mm:.0f} mm"
                )
        return ""

    def _looks_mm(self, start_rad: Array, end_rad: Array) -> Array:
        """Return places (K, 3) of the tip in {W} along a motion."""
        way_rad = end_rad - start_rad
        rough_mm = self._tip_mm(start_rad + np.linspace(0.0, 1.0, self.LOOKS)[:, None] * way_rad)
        length_mm = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(rough_mm))
        shares = np.linspace(0.0, 1.0, 2 + int(np.ceil(length_mm / self.LOOK_MM)))
        return self._tip_mm(start_rad + shares[:, None] * way_rad)

    def _tip_mm(self, joints_rad: Array) -> Array:
        return apply(self._T_W_B, forward(self._arm, joints_rad)[:, :3, 3])


def _tool_line(arm: Arm) -> CapsuleTable:
    """Return what is known of a tool's body: it reaches from the flange to its tip."""
    x_mm, y_mm, z_mm = arm.tool[:3, 3].tolist()
    return CapsuleTable(
        link=LINKS, from_mm=(0.0, 0.0, 0.0), to_mm=(x_mm, y_mm, z_mm), radius_mm=LEAST_MM
    )


@dataclass(frozen=True, eq=False)
class _Box:
    """A box of the cell, with the slide at a station."""

    cell: Cell
    station: Station
    table: KeepOut

    ON_BOX_MM = 5.0  # a hole this near to a box lies on it

    def carries(self, part: Part, front_mm: float) -> bool:
        """Whether holes lie on it, and it does not stick out beside them: ``front_mm`` in front of
        them it is at least half as far away.
        """
        on_it = self._outside_mm(part.points_mm) <= self.ON_BOX_MM
        in_front_mm = part.points_mm[on_it] + front_mm * part.outward[on_it]
        return bool(on_it.any() and (self._outside_mm(in_front_mm) >= front_mm / 2).all())

    def contains(self, places_mm: Array) -> bool:
        """Whether any of places (K, 3) in {W} is in it, or is no number."""
        return not bool((self._outside_mm(places_mm) > 0.0).all())

    def _outside_mm(self, places_mm: Array) -> Array:
        frame = self.table.centre.matrix()
        if self.table.frame == "slide":
            frame = self.cell.layout.nominal_base(self.station.rail_mm) @ frame
        beyond_mm = np.abs(apply(inverse(frame), places_mm)) - np.array(self.table.size_mm) / 2
        found: Array = np.linalg.norm(np.maximum(beyond_mm, 0.0), axis=-1)
        return found
