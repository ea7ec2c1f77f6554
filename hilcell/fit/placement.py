"""Base and reflectors of a measured robot, by nominal kinematics.

Rows far off nominal kinematics are of another robot or in other units: likely mistakes are tried,
and the one that explains the rows is named.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice, permutations

import numpy as np

from hilcell.fit.measurements import Measurements
from hilcell.geometry import statistics
from hilcell.geometry.frames import (
    ONE_PLACE_MM,
    FrameError,
    apply,
    apply_each,
    cross_matrix,
    from_rotvec,
    matrix,
    rigid_fit,
)
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.ports import HilcellError
from hilcell.sanitize import counted

ABSURD_MM = 20.0  # a miss beyond this is no robot's error
CHECK_ROBOT = "check the robot file, joint signs and units, and that the rows are of this robot"
ITERATIONS = 100
CONVERGED = 1e-9
EXPLAINED = 0.1  # of the median miss: a supposition that leaves less explains the rows


class FitError(HilcellError):
    """Measurements that cannot be learnt from."""

    code = "HC-C22"


@dataclass(frozen=True, slots=True)
class Placement:
    """The base in the tracker's frame, ``T_L_B`` (4, 4), and reflectors (3,) on the flange."""

    arm: Arm
    T_L_B: Array
    smr_mm: Mapping[str, Array]

    def nominal(self, rows: Measurements) -> Array:
        """Nominal poses (N, 4, 4) in {B}: each reflector, oriented as the flange."""
        refuse_unknown_targets(rows, self.smr_mm)
        offsets_mm = np.array([self.smr_mm[target] for target in rows.target])
        flange = forward(self.arm, rows.joints_rad)
        return matrix(flange[:, :3, :3], apply_each(flange, offsets_mm))

    def predicted_mm(self, rows: Measurements) -> Array:
        """Nominal positions (N, 3) in the tracker's frame."""
        return apply(self.T_L_B, self.nominal(rows)[:, :3, 3])

    def miss_mm(self, rows: Measurements) -> Array:
        """Distances from nominal positions (N,)."""
        return statistics.lengths_mm(rows.seen_mm(rows.xyz_mm - self.predicted_mm(rows)))

    def relabelled(self, rows: Measurements, half_mm: float) -> Iterator[str]:
        """Yield reflectors whose swap would make rows match a known placement."""
        names = sorted(self.smr_mm)
        most_reflectors = 4  # of which all permutations are tried
        if not 1 < len(names) <= most_reflectors:
            return
        for others in permutations(names):
            other = dict(zip(names, others, strict=True))
            changed = replace(rows, target=[other[target] for target in rows.target])
            left_mm = float(np.median(self.miss_mm(changed)))
            if left_mm <= min(EXPLAINED * half_mm, ABSURD_MM):
                swapped = ", ".join(f"{a} is {b}" for a, b in other.items() if a != b)
                yield f"the reflectors are swapped: {swapped}"


def place(arm: Arm, rows: Measurements) -> Placement:
    """Estimate base and reflectors by Gauss-Newton with soft-L1 weights; raises `FitError`."""
    try:
        placement, step = _estimate(arm, rows)
    except FrameError as error:
        fitting = next(_fitting(arm, rows, ABSURD_MM / EXPLAINED, np.median), None)
        act = CHECK_ROBOT if fitting is None else f"they fit if {fitting}"
        raise FitError(f"{error}; {act}") from error
    refuse_another_robot(placement, rows)
    if not step <= CONVERGED:
        raise FitError(
            f"{rows.source}: base and reflectors do not settle: the last of {ITERATIONS} steps is "
            f"{step:.3g}, expected <= {CONVERGED}: measure more poses with other orientations"
        )
    return placement


def refuse_unknown_targets(rows: Measurements, known: Collection[str]) -> None:
    """Refuse targets that no training row measures."""
    for target in sorted(set(rows.target).difference(known)):
        raise FitError(
            f"{rows.where(rows.of(target))}: no training row measures target {target}; correct its "
            f"name, or measure it in training rows; known: {', '.join(sorted(known))}"
        )


def refuse_another_robot(placement: Placement, rows: Measurements) -> None:
    """Refuse rows of which half are far off: another robot, other joint signs or units."""
    half_mm = float(np.median(placement.miss_mm(rows)))
    if not half_mm <= ABSURD_MM:
        fitting = _fitting(placement.arm, rows, half_mm, np.median)
        found = [*placement.relabelled(rows, half_mm), *fitting]
        act = f"they fit if {found[0]}; " if found else ""
        raise FitError(
            f"{rows.source}: nominal kinematics miss half of the measured targets by {half_mm:.4g} "
            f"mm or more, expected <= {ABSURD_MM:g} mm: {act}{CHECK_ROBOT}"
        )


def _fitting(
    arm: Arm, rows: Measurements, size_mm: float, of: Callable[[Array], float]
) -> Iterator[str]:
    """Yield corrections that explain rows off by ``size_mm``, the likeliest first."""
    for says, changed in _suppositions(rows):
        with suppress(HilcellError):
            left_mm = float(of(_estimate(arm, changed)[0].miss_mm(changed)))
            if left_mm <= min(EXPLAINED * size_mm, ABSURD_MM):
                yield says


def supposition(arm: Arm, rows: Measurements, worst_mm: float, bad: Iterable[int]) -> str:
    """Correction that explains all rows, ``bad`` among them, off by up to ``worst_mm``; "" for
    none.
    """
    most_tried = 500  # rows by which a supposition is judged
    some = range(0, len(rows), len(rows) // most_tried + 1)
    tried = rows.at(sorted({*some, *islice(bad, most_tried)}))
    return next(_fitting(arm, tried, worst_mm, np.max), "")


def _suppositions(rows: Measurements) -> Iterator[tuple[str, Measurements]]:
    joints, xyz = rows.joints_rad, rows.xyz_mm
    yield "the joints are radians", replace(rows, joints_rad=np.degrees(joints))
    mm_per_m, mm_per_inch = 1000.0, 25.4
    yield "the positions are metres", replace(rows, xyz_mm=xyz * mm_per_m)
    yield "the positions are inches", replace(rows, xyz_mm=xyz * mm_per_inch)
    for axis in range(joints.shape[1]):
        turned = joints * np.where(np.arange(joints.shape[1]) == axis, -1.0, 1.0)
        yield f"joint {axis + 1} turns the other way", replace(rows, joints_rad=turned)
    for how, sign in (("with", 1.0), ("against", -1.0)):  # controllers that show it to the ground
        coupled = joints.copy()
        coupled[:, 2] += sign * joints[:, 1]
        yield f"joint 3 turns {how} joint 2", replace(rows, joints_rad=coupled)
    order = list(dict.fromkeys(rows.pose))
    number = np.array([order.index(pose) for pose in rows.pose])
    first = joints[[rows.pose.index(pose) for pose in order]]
    for says, shifted in (
        ("each pose has the joints of the pose after it", np.roll(first, 1, axis=0)),
        ("each pose has the joints of the pose before it", np.roll(first, -1, axis=0)),
        ("the poses' joints are in reverse order", first[::-1]),
    ):
        yield says, replace(rows, joints_rad=shifted[number])


def _estimate(arm: Arm, rows: Measurements) -> tuple[Placement, float]:
    """Base and reflectors, and the size of the last step."""
    targets = sorted(set(rows.target))
    least = 3 + len(targets)
    if not len(rows) >= least:
        raise FitError(
            f"{rows.source}: {counted(len(rows), 'row')}, expected at least {least} to place the "
            f"robot's base and {counted(len(targets), 'reflector')}; measure more poses"
        )
    which = np.array([targets.index(target) for target in rows.target])
    flange = forward(arm, rows.joints_rad)
    T, smr = _first(flange[:, :3, 3], rows), np.zeros((len(targets), 3))
    step = np.inf
    for _ in range(ITERATIONS):
        T, smr, step = _improved(T, smr, flange, which, rows.xyz_mm)
        if step <= CONVERGED:
            break
    return Placement(arm, T, dict(zip(targets, smr, strict=True))), step


def _first(flange_mm: Array, rows: Measurements) -> Array:
    xyz_mm = rows.xyz_mm
    names = f"{rows.source}: nominal positions", f"{rows.source}: measured positions"
    try:
        return rigid_fit(flange_mm, xyz_mm, names=names).T
    except FrameError:
        a, b = (points - points.mean(axis=0) for points in (flange_mm, xyz_mm))
        if not np.isfinite(b).all():
            raise
        sizes = np.linalg.svd(b, compute_uv=False)
        one_line = 0.02  # across over along: below, positions lie on one line
        if not (sizes[0] > ONE_PLACE_MM and sizes[1] <= one_line * sizes[0]):
            raise
    along_b = np.linalg.svd(b)[2][0]
    along_a = a.T @ (b @ along_b)
    along_a /= max(float(np.linalg.norm(along_a)), 1e-12)
    axis = np.cross(along_a, along_b)
    sine, cosine = float(np.linalg.norm(axis)), float(along_a @ along_b)
    R = from_rotvec(axis * (np.arctan2(sine, cosine) / max(sine, 1e-12)))
    return matrix(R, xyz_mm.mean(axis=0) - R @ flange_mm.mean(axis=0))


def _improved(
    T: Array, smr: Array, flange: Array, which: Array, measured: Array
) -> tuple[Array, Array, float]:
    """Base (4, 4), reflectors (K, 3) and the step's size after one Gauss-Newton step."""
    found = apply(T, apply_each(flange, smr[which]))
    middle = found.mean(axis=0)
    left = measured - found
    bad_row_mm = 1.0  # rows that miss by more count less (soft L1), so one bad row moves nothing
    weight = (1.0 + np.sum((left / bad_row_mm) ** 2, axis=1)) ** -0.25  # squared in the sum
    J = np.zeros((len(found), 3, 6 + smr.size))
    J[:, :, :3], J[:, :, 3:6] = np.eye(3), -cross_matrix(found - middle)
    turned = T[:3, :3] @ flange[:, :3, :3]
    for number in range(len(smr)):
        own = which == number
        J[own, :, 6 + 3 * number : 9 + 3 * number] = turned[own]
    rows = (weight[:, None, None] * J).reshape(-1, J.shape[2])
    # With one tool orientation base and reflector shift each other: the least step is taken.
    step = np.linalg.lstsq(rows, (weight[:, None] * left).ravel(), rcond=1e-10)[0]
    R = from_rotvec(step[3:6])
    moved = matrix(R, middle + step[:3] - R @ middle) @ T
    return moved, smr + step[6:].reshape(-1, 3), float(np.abs(step).max())
