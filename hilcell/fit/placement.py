"""Base and reflectors of a measured robot, by nominal kinematics."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass

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

ITERATIONS = 100
ABSURD_MM = 20.0  # a miss beyond this is no robot's error, and no slip of a reading
CHECK_ROBOT = "check the robot file, and that the rows are of this robot"
CONVERGED, ROUNDING = 1e-9, 1e-12
BAD_ROW_MM = 1.0  # rows that miss by more count less (soft L1), so one bad row moves nothing


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


def place(arm: Arm, rows: Measurements) -> Placement:
    """Estimate base and reflectors by Gauss-Newton with soft-L1 weights.

    Raises `FitError`, and `FrameError` for positions that are no rigid motion of nominal ones.
    """
    placement, step = _estimate(arm, rows, ITERATIONS)
    if not step <= CONVERGED:
        half_mm = float(np.median(placement.miss_mm(rows)))
        if half_mm > ABSURD_MM:  # as of another robot, whose rows need not settle
            raise FitError(f"{rows.source}: {far_off(half_mm)}")
        raise FitError(
            f"{rows.source}: base and reflectors do not settle: the last of {ITERATIONS} steps is "
            f"{step:.3g}, expected <= {CONVERGED}: measure more poses with other orientations"
        )
    return placement


def far_off(half_mm: float) -> str:
    return (
        f"nominal kinematics miss half of the measured targets by {half_mm:.4g} mm or more, "
        f"expected <= {ABSURD_MM:g} mm"
    )


def place_roughly(arm: Arm, rows: Measurements) -> Placement:
    """Estimate the same in few steps, by which a supposition is judged."""
    return _estimate(arm, rows, 20)[0]


def refuse_unknown_targets(rows: Measurements, known: Collection[str]) -> None:
    """Refuse targets that no training row measures."""
    for target in sorted(set(rows.target).difference(known)):
        raise FitError(
            f"{rows.where(rows.of(target))}: no training row measures target {target}; correct its "
            f"name, or measure it in training rows; known: {', '.join(sorted(known))}"
        )


def _estimate(arm: Arm, rows: Measurements, iterations: int) -> tuple[Placement, float]:
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
    T, smr_mm = _first(flange, rows)
    smr = np.tile(smr_mm, (len(targets), 1))
    cost, step, share = _cost(T, smr, flange, which, rows.xyz_mm), np.inf, 1.0
    for _ in range(iterations):
        further = _improved(T, smr, flange, which, rows.xyz_mm, share)
        after = _cost(*further[:2], flange, which, rows.xyz_mm)
        if not after <= cost * (1.0 + ROUNDING):
            share /= 4.0
            continue
        (T, smr, step), cost, share = further, after, min(4.0 * share, 1.0)
        if step <= CONVERGED:
            break
    return Placement(arm, T, dict(zip(targets, smr, strict=True))), step


def _first(flange: Array, rows: Measurements) -> tuple[Array, Array]:
    """Base (4, 4) and one reflector (3,) on all flanges (N, 4, 4), where the search begins."""
    names = f"{rows.source}: nominal positions", f"{rows.source}: measured positions"
    try:
        return rigid(flange[:, :3, 3], rows.xyz_mm, names), np.zeros(3)
    except FrameError:
        # Of poses near one another the reflector's own way is more than the flange's.
        lever_mm = 200.0
        for smr_mm in lever_mm * np.concatenate([np.eye(3), -np.eye(3)]):
            with suppress(FrameError):
                return rigid(apply_each(flange, smr_mm), rows.xyz_mm, names), smr_mm
        own = rows.of(rows.target[0])  # other reflectors are beside its line
        return _along_a_line(flange[own, :3, 3], rows.at(own)), np.zeros(3)


def rigid(a_mm: Array, b_mm: Array, names: tuple[str, str] = ("points", "points")) -> Array:
    """The motion (4, 4) of most points, by weights that fade beyond the median residual, first by
    how far their distances from others differ: one stray mirrors or turns a whole set.
    """
    some = slice(None, None, len(a_mm) // 200 + 1)  # enough others
    a_apart, b_apart = (np.linalg.norm(p[:, None] - p[some], axis=-1) for p in (a_mm, b_mm))
    lengths_mm: Array = np.median(np.abs(a_apart - b_apart), axis=1)
    for _ in range(6):
        scale_mm = max(float(np.median(lengths_mm)), ONE_PLACE_MM)
        fit = rigid_fit(a_mm, b_mm, 1.0 / (1.0 + (lengths_mm / scale_mm) ** 2), names)
        lengths_mm = statistics.lengths_mm(fit.residuals_mm)
    return fit.T


def _along_a_line(flange_mm: Array, rows: Measurements) -> Array:
    """The base (4, 4) by positions on a line."""
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


def _cost(T: Array, smr: Array, flange: Array, which: Array, measured: Array) -> float:
    left = measured - apply(T, apply_each(flange, smr[which]))
    return float(np.sum(np.sqrt(1.0 + np.sum((left / BAD_ROW_MM) ** 2, axis=1))))


def _improved(
    T: Array, smr: Array, flange: Array, which: Array, measured: Array, share: float
) -> tuple[Array, Array, float]:
    """Base (4, 4), reflectors (K, 3) and the step's size after a share of a Gauss-Newton step."""
    found = apply(T, apply_each(flange, smr[which]))
    middle = found.mean(axis=0)
    left = measured - found
    weight = (1.0 + np.sum((left / BAD_ROW_MM) ** 2, axis=1)) ** -0.25  # squared in the sum
    J = np.zeros((len(found), 3, 6 + smr.size))
    J[:, :, :3], J[:, :, 3:6] = np.eye(3), -cross_matrix(found - middle)
    turned = T[:3, :3] @ flange[:, :3, :3]
    for number in range(len(smr)):
        own = which == number
        J[own, :, 6 + 3 * number : 9 + 3 * number] = turned[own]
    rows = (weight[:, None, None] * J).reshape(-1, J.shape[2])
    # With one tool orientation base and reflector shift each other: the least step is taken.
    step = np.linalg.lstsq(rows, (weight[:, None] * left).ravel(), rcond=1e-10)[0] * share
    R = from_rotvec(step[3:6])
    moved = matrix(R, middle + step[:3] - R @ middle) @ T
    return moved, smr + step[6:].reshape(-1, 3), float(np.abs(step).max())
