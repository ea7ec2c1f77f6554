"""Mistakes in measured lists: each is supposed, and the one that explains the rows is named.

Rows explain themselves by the robot that they identify: the likelihood of what it leaves, with long
tails (Cauchy's in three dimensions), so that neither a few slips nor a few telling rows decide
alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, islice, permutations
from typing import NamedTuple

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import Placement, place_roughly
from hilcell.geometry.frames import apply, inverse, rigid_fit
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.ports import HilcellError

SURE = 10.0  # of a likelihood's logarithm: two explanations this close are equal
LEFT_MM = 5.0  # in the median: more, and the rows are not explained
TRIED = (
    "other units, joints that turn the other way, coupled joints, zeros off by 90 or 180 deg, a "
    "left-handed frame, exchanged reflectors, poses out of step"
)

Supposed = tuple[str, Measurements]
Misses = Callable[[Measurements], Array]


class Explained(NamedTuple):
    """A supposition, its log likelihood, and the median of what it leaves."""

    says: str
    likelihood: float
    left_mm: float


def explaining(
    rows: Measurements,
    miss_mm: Array,
    bad: Iterable[int],
    supposed: Iterable[Supposed],
    misses: Misses,
) -> str:
    """Which supposition explains the rows, ``bad`` among them, clearly better than they do as they
    are, missing by ``miss_mm`` (N,). Several that do it equally well are joined by "or"; "" for
    none.
    """
    most_tried, most_named = 100, 3
    every = range(0, len(rows), len(rows) // most_tried + 1)
    tried = sorted({*every, *islice(bad, most_tried)})
    as_they_are = max(
        _explained("", rows.at(tried), each).likelihood
        for each in (misses, lambda _: miss_mm[tried])
    )
    found = [_explained(says, changed.at(tried), misses) for says, changed in supposed]
    best = max((each.likelihood for each in found), default=-np.inf)
    if not best > as_they_are + 2.0 * SURE:
        return ""
    equal = [each for each in found if each.likelihood > best - SURE]
    if not all(each.left_mm <= LEFT_MM for each in equal):
        return ""
    return ", or ".join(each.says for each in equal[:most_named])


def _explained(says: str, rows: Measurements, misses: Misses) -> Explained:
    least_mm = 0.02  # no tracker tells less
    with suppress(HilcellError, np.linalg.LinAlgError):
        miss_mm = misses(rows)
        if np.isfinite(miss_mm).all():
            scale_mm = max(float(np.median(miss_mm)), least_mm)
            tails = np.log1p((miss_mm / scale_mm) ** 2).sum()
            likelihood = -3.0 * len(rows) * np.log(scale_mm) - 2.0 * tails
            return Explained(says, float(likelihood), scale_mm)
    return Explained(says, -np.inf, np.inf)


def of_training(arm: Arm, rows: Measurements) -> Iterator[Supposed]:
    """Yield training rows as they would be without a mistake, the likeliest first."""
    yield from _of_a_list(arm, rows)
    with suppress(HilcellError):
        yield from _exchanged(place_roughly(arm, rows), rows)


def of_test(arm: Arm, rows: Measurements, predicted_mm: Array) -> Iterator[Supposed]:
    """Yield test rows so, whose positions are predicted (N, 3) from training rows."""
    yield from _of_a_list(arm, rows)
    names = sorted(set(rows.target))
    most_reflectors = 4  # of which all permutations are tried
    for others in islice(permutations(names), 1, None) if len(names) <= most_reflectors else ():
        other = dict(zip(names, others, strict=True))
        changed = replace(rows, target=[other[target] for target in rows.target])
        swapped = ", ".join(f"{a} is {b}" for a, b in other.items() if a != b)
        yield f"the reflectors are swapped: {swapped}", changed
    if rows.distance_mm is not None:
        return
    with suppress(HilcellError):
        moved = rigid_fit(predicted_mm, rows.xyz_mm)
        back = replace(rows, xyz_mm=apply(inverse(moved.T), rows.xyz_mm))
        shift_mm = float(np.linalg.norm((rows.xyz_mm - predicted_mm).mean(axis=0)))
        yield f"tracker or robot moved between the files, by {shift_mm:.4g} mm there", back


def _of_a_list(arm: Arm, rows: Measurements) -> Iterator[Supposed]:
    yield from _units(arm, rows)
    yield from _joints(arm, rows)
    mirrored = replace(rows, xyz_mm=rows.xyz_mm * [1.0, 1.0, -1.0])
    yield "xyz are left-handed: one axis is negated or two are exchanged", mirrored
    yield from _out_of_step(rows)


def _exchanged(placement: Placement, rows: Measurements) -> Iterator[Supposed]:
    """Yield pairs of reflectors whose labels are exchanged in a part of the poses.

    There both miss by their distance, in opposite directions on the flange; where it is half of the
    poses, all miss by half of it.
    """
    R = forward(placement.arm, rows.joints_rad)[:, :3, :3]
    missed_mm = rows.xyz_mm - placement.predicted_mm(rows)
    on_flange = np.einsum("nji,nj->ni", placement.T_L_B[:3, :3] @ R, missed_mm)
    at = {key: n for n, key in enumerate(zip(rows.pose, rows.target, strict=True))}
    for a, b in combinations(sorted(set(rows.target)), 2):
        both = [pose for pose in dict.fromkeys(rows.pose) if (pose, a) in at and (pose, b) in at]
        if not both:
            continue
        apart = np.array([on_flange[at[pose, a]] - on_flange[at[pose, b]] for pose in both])
        along = apart @ np.linalg.svd(apart - apart.mean(axis=0))[2][0]
        far = along > (along.min() + along.max()) / 2.0
        far ^= np.count_nonzero(far) > len(both) / 2
        swapped = {pose for pose, each in zip(both, far, strict=True) if each}
        other = {a: b, b: a}
        target = [
            other.get(name, name) if pose in swapped else name
            for pose, name in zip(rows.pose, rows.target, strict=True)
        ]
        named = 5
        poses = ", ".join(sorted(swapped)[:named]) + ", ..." * (len(swapped) > named)
        says = f"reflectors {a} and {b} are exchanged in {len(swapped)} poses: {poses}"
        yield says, replace(rows, target=target)


def _units(arm: Arm, rows: Measurements) -> Iterator[Supposed]:
    turns = np.where(arm.turning, 1.0, 0.0)
    from_rad = replace(rows, joints_rad=rows.joints_rad * (turns * np.degrees(1.0) + 1.0 - turns))
    from_deg = replace(rows, joints_rad=rows.joints_rad * (turns * np.radians(1.0) + 1.0 - turns))
    yield "the joints are radians", from_rad
    yield "the joints are degrees twice converted", from_deg
    for unit, size_mm in (("metres", 1000.0), ("centimetres", 10.0), ("inches", 25.4)):
        yield f"the positions are {unit}", replace(rows, xyz_mm=rows.xyz_mm * size_mm)
    both = replace(from_rad, xyz_mm=rows.xyz_mm * 1000.0)
    yield "the joints are radians and the positions are metres", both


def _joints(arm: Arm, rows: Measurements) -> Iterator[Supposed]:
    joints, count = rows.joints_rad, len(arm)
    for axis in range(count):
        signs = np.where(np.arange(count) == axis, -1.0, 1.0)
        yield f"joint {axis + 1} turns the other way", replace(rows, joints_rad=joints * signs)
    revolute = [axis for axis in range(count) if arm.turning[axis]]
    for axis in range(1, count):
        if not {axis - 1, axis} <= set(revolute):
            continue
        for how, sign in (("with", 1.0), ("against", -1.0)):  # as if shown to the ground
            coupled = joints.copy()
            coupled[:, axis] += sign * joints[:, axis - 1]
            says = f"joint {axis + 1} turns {how} joint {axis}"
            yield says, replace(rows, joints_rad=coupled)
    for axis in revolute[1:-1]:  # base and reflectors follow the first and the last
        for offset_deg in (90.0, -90.0, 180.0):
            shift = np.where(np.arange(count) == axis, np.radians(offset_deg), 0.0)
            says = f"the zero of joint {axis + 1} is off by {offset_deg:g} deg"
            yield says, replace(rows, joints_rad=joints + shift)


def _out_of_step(rows: Measurements) -> Iterator[Supposed]:
    order = list(dict.fromkeys(rows.pose))
    number = np.array([order.index(pose) for pose in rows.pose])
    first = rows.joints_rad[[rows.pose.index(pose) for pose in order]]
    for says, shifted in (
        ("each pose has the joints of the pose after it", np.roll(first, 1, axis=0)),
        ("each pose has the joints of the pose before it", np.roll(first, -1, axis=0)),
        ("the poses' joints are in reverse order", first[::-1]),
    ):
        yield says, replace(rows, joints_rad=shifted[number])
