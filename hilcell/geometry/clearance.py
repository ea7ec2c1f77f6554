"""Clearance of an arm from boxes, in a posture and on a whole motion. Lengths mm, angles rad.

A capsule is all within a radius of a segment fixed to one link. The distance of a segment from a
box is the minimum of a convex function of one number, computed exactly.

Clearance on a motion is proven, not only sampled. A posture is (7,): the slide's position in mm,
and six joints in rad; on a motion all seven are synchronous. Between two postures no point of the
arm travels farther than its levers allow (`levers_mm`), so the excess of a posture's clearance over
the required one proves the motion around it; the rest is halved and checked again. A motion is
clear only when the proven parts cover it; a posture of NaN proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from hilcell.geometry.frames import inverse
from hilcell.geometry.kinematics import Arm, Array, Bools, Ints, link_transforms, rotation_y


@dataclass(frozen=True, slots=True)
class Capsules:
    """``link`` (C,) 1 .. 6, ``ends_mm`` (C, 2, 3) in that link's frame {i}, ``radius_mm`` (C,)."""

    link: Ints
    ends_mm: Array
    radius_mm: Array


@dataclass(frozen=True)
class Boxes:
    """``frames`` (V, 4, 4) of their centres, ``half_mm`` (V, 3): half of their edges."""

    frames: Array
    half_mm: Array

    @cached_property
    def into(self) -> Array:
        """Return the motions (V, 4, 4) into the boxes' frames."""
        return inverse(self.frames)

    @cached_property
    def axes(self) -> Array:
        return self.into[:, :3, :3].reshape(-1, 3)


def joint_lines(arm: Arm, link: int) -> Array:
    """Segments (S, 2, 3) along link 1 .. 6, from its joint to the next, in its frame.

    Axis 1 rotates its own column in place: the column is left out. Link 6 includes the tool point.
    A link whose joints coincide has a segment of length 0.
    """
    row = link - 1
    a_mm, d_mm, alpha_rad = arm.a_mm[row], arm.d_mm[row], arm.alpha_rad[row]
    foot = np.array([-a_mm, 0.0, 0.0])
    joint = foot - d_mm * np.array([0.0, np.sin(alpha_rad), np.cos(alpha_rad)])
    corners = [corner @ rotation_y(arm.beta_rad[row]) for corner in (joint, foot, np.zeros(3))]
    corners = corners[1:] if link == 1 else corners
    corners += [arm.tool[:3, 3]] if link == 6 else []
    pairs = list(pairwise(corners))
    long = [pair for pair in pairs if np.linalg.norm(pair[1] - pair[0]) > 0.0]
    return np.array(long or pairs[:1])


def placed_mm(arm: Arm, capsules: Capsules, joints_rad: Array) -> Array:
    """Return the ends (N, C, 2, 3) in {B} at joints (N, 6)."""
    frames = link_transforms(arm, joints_rad)
    for row in range(1, 6):
        frames[:, row] = frames[:, row - 1] @ frames[:, row]
    carried = frames[:, capsules.link - 1]
    turned = capsules.ends_mm @ carried[..., :3, :3].swapaxes(-1, -2)
    return turned + carried[:, :, None, :3, 3]


def levers_mm(arm: Arm, capsules: Capsules) -> Array:
    """Largest distance (C, 6) of any point of a capsule's segment from each axis, in any posture.

    0 for axes behind the capsule's link. A point travels at most sum_j |turn_j| lever_j on any
    motion.
    """
    lengths = np.hypot(arm.a_mm, arm.d_mm)
    levers = np.zeros((len(capsules.link), 6))
    for number, (link, ends) in enumerate(zip(capsules.link, capsules.ends_mm, strict=True)):
        # A point of the link's joint axis, and its direction, in the link's frame.
        row = link - 1
        axis = np.array([0.0, np.sin(arm.alpha_rad[row]), np.cos(arm.alpha_rad[row])])
        turned = rotation_y(arm.beta_rad[row])  # Hayati's term ends the link's transform
        joint = (np.array([-arm.a_mm[row], 0.0, 0.0]) - arm.d_mm[row] * axis) @ turned
        arms = ends - joint
        levers[number, row] = np.linalg.norm(np.cross(arms, axis @ turned), axis=1).max()
        beyond = np.linalg.norm(arms, axis=1).max()
        for row in range(link - 2, -1, -1):
            levers[number, row] = abs(arm.a_mm[row]) + beyond
            beyond += lengths[row]
    return levers


def clearance_mm(
    ends_mm: Array, radius_mm: Array, boxes: Boxes, enough_mm: Array, shift_mm: Array
) -> Array:
    """Clearances (N, C, V) of capsules with ends (N, C, 2, 3) from boxes.

    ``shift_mm`` (N, V, 3) is the motion of the capsules against each box, its axes. Negative where
    they overlap, down to the radius. Where a sphere around the capsule has ``enough_mm`` (N, C),
    the sphere's clearance is returned.
    """
    origins = boxes.into[:, :3, 3] + shift_mm
    middle = (ends_mm[..., 0, :] + ends_mm[..., 1, :]) / 2
    within = (middle @ boxes.axes.T).reshape(*middle.shape[:2], -1, 3) + origins[:, None]
    half_length = _lengths(ends_mm[..., 1, :] - ends_mm[..., 0, :])[..., None] / 2
    from_box = _lengths(np.maximum(np.abs(within) - boxes.half_mm, 0.0))
    found: Array = from_box - half_length - radius_mm[:, None]
    near = ~(found >= enough_mm[..., None])
    if near.any():
        at, capsule, volume = np.nonzero(near)
        axes = boxes.into[volume, :3, :3].swapaxes(-1, -2)
        ends = ends_mm[at, capsule] @ axes + origins[at, volume, None]
        found[near] = segment_to_box_mm(ends, boxes.half_mm[volume]) - radius_mm[capsule]
    return found


def segment_to_box_mm(ends_mm: Array, half_mm: Array) -> Array:
    """Distances (K,) of segments (K, 2, 3) from boxes (K, 3) about the origin.

    The squared distance is convex along the segment, and its slope is linear between the crossings
    with the planes of the box's faces: the slope's zero is the minimum.
    """
    start, along = ends_mm[:, 0, None], (ends_mm[:, 1] - ends_mm[:, 0])[:, None]
    half = half_mm[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(-half - start) / along, (half - start) / along], axis=-1)[:, 0]
    knots = np.zeros((len(ends_mm), crossings.shape[1] + 2))
    knots[:, 1:-1] = np.where(np.isnan(crossings), 0.0, crossings).clip(0.0, 1.0)
    knots[:, -1] = 1.0
    knots.sort(axis=1)
    slope = np.sum(along * _outside(start + knots[..., None] * along, half), axis=-1)
    after = np.argmax(slope >= 0.0, axis=1)
    after = np.where(slope[:, -1] >= 0.0, after, knots.shape[1] - 1)
    rows, before = np.arange(len(knots)), np.maximum(after - 1, 0)
    low, high = slope[rows, before], slope[rows, after]
    share = np.where((low < 0.0) & (high > 0.0), -low / np.where(high > low, high - low, 1.0), 1.0)
    nearest = knots[rows, before] + share * (knots[rows, after] - knots[rows, before])
    outside = _outside(start[:, 0] + nearest[:, None] * along[:, 0], half_mm)
    return _lengths(outside)


def _outside(points: Array, half: Array) -> Array:
    return points - np.minimum(np.maximum(points, -half), half)


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


@dataclass(frozen=True, slots=True)
class Proof:
    """Which motions (N,) are proven clear, and at which share of the motion the others are not."""

    clear: Bools
    share: Array


@dataclass(frozen=True, slots=True)
class Tightest:
    """The least clearance on a motion: capsule, box, and position. ``box`` counts the fixed boxes,
    then the carried ones.
    """

    clearance_mm: float
    capsule: int
    box: int
    share: float


@dataclass(frozen=True)
class Body:
    """An arm with its shape, among boxes fixed in {W} and boxes carried by its slide.

    ``base`` is {B} in {W} (4, 4) with the slide at 0, ``direction`` (3,) that of the slide in {W};
    carried boxes are given in {B}.
    """

    RESOLUTION_MM = 1.0  # a motion that is nearer than this to the required clearance is not proven

    arm: Arm
    capsules: Capsules
    base: Array
    direction: Array
    fixed: Boxes
    carried: Boxes

    def prove(self, start: Array, end: Array, required_mm: float) -> Proof:
        """Judge motions between postures (N, 7)."""
        travel = self.travel_mm(start, end)
        count = len(travel)
        proven, share = np.zeros(count), np.full(count, 0.5)
        farthest_mm = 1e6  # no arm's motion is longer: halving one of 1e300 mm would never end
        refused: Bools = ~np.all(travel <= farthest_mm, axis=1)
        motion, half, way = np.flatnonzero(~refused), 0.5, end - start
        middle = np.full(len(motion), half)
        while len(motion):
            postures = start[motion] + middle[:, None] * way[motion]
            needed = half * travel[motion]
            spare = self._least_mm(postures, needed + required_mm) - required_mm
            done = (spare >= needed).all(axis=1)
            np.add.at(proven, motion[done], 2.0 * half)
            if done.all():
                break
            near = ~(needed.max(axis=1) > self.RESOLUTION_MM)
            hopeless = ~done & (near | ~(spare >= 0.0).all(axis=1))
            refused[motion[hopeless]] = True
            share[motion[hopeless]] = middle[hopeless]
            left = ~done & ~refused[motion]
            half /= 2.0
            middle = (middle[left, None] + [-half, half]).ravel()
            motion = np.repeat(motion[left], 2)
        return Proof(proven == 1.0, share)  # halves add without rounding

    def tightest(self, start: Array, end: Array, also: float) -> Tightest:
        """The tightest point of a motion between postures (7,), by samples in even steps. ``also``:
        an additional share of the path.
        """
        shares = np.append(np.linspace(0.0, 1.0, 257), also)
        postures = start + shares[:, None] * (end - start)
        found = self.clearances_mm(postures, np.full((len(postures), 1), np.inf))
        at = np.unravel_index(np.argmin(found), found.shape)  # of several NaN, the first
        return Tightest(float(found[at]), int(at[1]), int(at[2]), float(shares[at[0]]))

    def clearances_mm(self, postures: Array, enough_mm: Array) -> Array:
        """Return `clearance_mm` (N, C, V) at postures (N, 7)."""
        ends_mm = placed_mm(self.arm, self.capsules, postures[:, 1:])
        boxes, along = self._boxes
        shift_mm = postures[:, :1, None] * along
        return clearance_mm(ends_mm, self.capsules.radius_mm, boxes, enough_mm, shift_mm)

    def travel_mm(self, start: Array, end: Array) -> Array:
        """Largest travel (N, C) in {W} of any point of a capsule's segment."""
        way = end - start
        turns = np.abs(self.arm.angles(way[:, 1:]))
        return np.abs(way[:, :1]) + turns @ self._levers_mm.T

    @cached_property
    def _boxes(self) -> tuple[Boxes, Array]:
        """All boxes (V,) in {B} with the slide at 0, and its direction (V, 3), the axes of each
        box. 0 for carried boxes.
        """
        fixed, carried, T_B_W = self.fixed, self.carried, inverse(self.base)
        boxes = Boxes(
            np.concatenate([T_B_W @ fixed.frames, carried.frames]),
            np.concatenate([fixed.half_mm, carried.half_mm]),
        )
        along = (boxes.axes @ T_B_W[:3, :3] @ self.direction).reshape(-1, 3)
        along[len(fixed.half_mm) :] = 0.0
        return boxes, along

    @cached_property
    def _levers_mm(self) -> Array:
        return levers_mm(self.arm, self.capsules)

    def _least_mm(self, postures: Array, enough_mm: Array) -> Array:
        """Clearance (N, C) from the nearest box."""
        at_once = 2048  # postures: bounds the memory
        if len(postures) <= at_once:
            return np.array(self.clearances_mm(postures, enough_mm).min(axis=-1))
        parts = [
            self.clearances_mm(postures[n : n + at_once], enough_mm[n : n + at_once]).min(axis=-1)
            for n in range(0, len(postures), at_once)
        ]
        return np.concatenate(parts)
