"""Whether an arm on a slide keeps a clearance on a whole motion: proven, and not only sampled.

A posture is (7,): where the slide stands in mm, and six joints in rad; on a motion all seven go in
step. Between two postures no point of the arm travels farther than its levers allow
(`clearance.levers_mm`). So a posture that has more clearance than wanted, by half of that, proves
the motion around it; where it has less, the motion is halved and both halves are looked at. A
motion counts as clear only when the parts that are proven make up the whole: a posture that is no
number proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hilcell.geometry.clearance import Boxes, Capsules, clearance_mm, levers_mm, placed_mm
from hilcell.geometry.frames import inverse
from hilcell.geometry.kinematics import Arm, Array, Bools

RESOLUTION_MM = 1.0  # a motion that is nearer than this to the wanted clearance is not proven
FARTHEST_MM = 1e6  # no arm's motion is longer: halving one of 1e300 mm would never end


@dataclass(frozen=True, slots=True)
class Proof:
    """Which motions (N,) are proven clear, and at which share of the way the others are not."""

    clear: Bools
    share: Array


@dataclass(frozen=True, slots=True)
class Tightest:
    """The least clearance that was found on a motion: by which capsule from which box, and where.

    ``box`` counts those that stand, then those that ride.
    """

    clearance_mm: float
    capsule: int
    box: int
    share: float


@dataclass(frozen=True)
class Body:
    """An arm with its shape, among boxes that stand in {W} and boxes that ride on its slide.

    ``base`` is {B} in {W} (4, 4) with the slide at 0, ``direction`` (3,) that of the slide in {W};
    riding boxes are given in {B}.
    """

    arm: Arm
    capsules: Capsules
    base: Array
    direction: Array
    standing: Boxes
    riding: Boxes

    def prove(self, start: Array, end: Array, wanted_mm: float) -> Proof:
        """Judge motions between postures (N, 7)."""
        travel = self.travel_mm(start, end)
        count = len(travel)
        proven, share = np.zeros(count), np.full(count, 0.5)
        refused: Bools = ~np.all(travel <= FARTHEST_MM, axis=1)
        motion, half, way = np.flatnonzero(~refused), 0.5, end - start
        middle = np.full(len(motion), half)
        while len(motion):
            postures = start[motion] + middle[:, None] * way[motion]
            needed = half * travel[motion]
            spare = self._least_mm(postures, needed + wanted_mm) - wanted_mm
            done = (spare >= needed).all(axis=1)
            np.add.at(proven, motion[done], 2.0 * half)
            if done.all():
                break
            near = ~(needed.max(axis=1) > RESOLUTION_MM)
            hopeless = ~done & (near | ~(spare >= 0.0).all(axis=1))
            refused[motion[hopeless]] = True
            share[motion[hopeless]] = middle[hopeless]
            left = ~done & ~refused[motion]
            half /= 2.0
            middle = (middle[left, None] + [-half, half]).ravel()
            motion = np.repeat(motion[left], 2)
        return Proof(proven == 1.0, share)  # halves add without rounding

    def tightest(self, start: Array, end: Array, also: float) -> Tightest:
        """Return where a motion between postures (7,) is tightest, by many looks at it.

        ``also`` is a share of the way to look at beside those in even steps.
        """
        looks = 257  # along a motion that is not clear, for the message
        shares = np.append(np.linspace(0.0, 1.0, looks), also)
        postures = start + shares[:, None] * (end - start)
        found = self.clearances_mm(postures, np.full((len(postures), 1), np.inf))
        at = np.unravel_index(np.argmin(found), found.shape)  # of several NaN, the first
        return Tightest(float(found[at]), int(at[1]), int(at[2]), float(shares[at[0]]))

    def clearances_mm(self, postures: Array, enough_mm: Array) -> Array:
        """Return `clearance.clearance_mm` (N, C, V) at postures (N, 7)."""
        ends_mm = placed_mm(self.arm, self.capsules, postures[:, 1:])
        boxes, along = self._boxes
        shift_mm = postures[:, :1, None] * along
        return clearance_mm(ends_mm, self.capsules.radius_mm, boxes, enough_mm, shift_mm)

    def travel_mm(self, start: Array, end: Array) -> Array:
        """Return how far (N, C) any point of a capsule's segment can travel in {W} at most."""
        way = np.abs(end - start)
        return way[:, :1] + way[:, 1:] @ self._levers_mm.T

    @cached_property
    def _boxes(self) -> tuple[Boxes, Array]:
        """Return all boxes (V,) in {B} with the slide at 0, and its direction (V, 3), the axes of
        each box; 0 for those that ride.
        """
        standing, riding, T_B_W = self.standing, self.riding, inverse(self.base)
        boxes = Boxes(
            np.concatenate([T_B_W @ standing.frames, riding.frames]),
            np.concatenate([standing.half_mm, riding.half_mm]),
        )
        along = (boxes.axes @ T_B_W[:3, :3] @ self.direction).reshape(-1, 3)
        along[len(standing.half_mm) :] = 0.0
        return boxes, along

    @cached_property
    def _levers_mm(self) -> Array:
        return levers_mm(self.arm, self.capsules)

    def _least_mm(self, postures: Array, enough_mm: Array) -> Array:
        """Return the clearance (N, C) from the nearest box."""
        at_once = 2048  # postures: bounds the memory
        if len(postures) <= at_once:
            return np.array(self.clearances_mm(postures, enough_mm).min(axis=-1))
        parts = [
            self.clearances_mm(postures[n : n + at_once], enough_mm[n : n + at_once]).min(axis=-1)
            for n in range(0, len(postures), at_once)
        ]
        return np.concatenate(parts)
