"""Rows that no fit may learn from, or be judged by, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from hilcell.compensation.interpolation import NEIGHBOURS
from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import ABSURD_MM, FitError, supposition
from hilcell.geometry import statistics
from hilcell.geometry.kinematics import Arm, Array, Bools, Ints
from hilcell.identification.measured_poses import FOLDS, pose_folds, pose_numbers
from hilcell.sanitize import counted

UNDETERMINED_MM = 5.0  # a bound beyond this says that the training rows do not determine a row
LEAST_INSIDE = 0.5  # share of test rows within 95 % bounds; below, they are not of this robot


def refuse_few_poses(rows: Measurements, left_out: int = 0) -> None:
    """Refuse too few poses for cross-validation; ``left_out``: outliers."""
    if few := _few_poses(rows, range(len(rows)), left_out):
        raise FitError(rare_target(rows, left_out) or few)


def rare_target(rows: Measurements, left_out: int = 0) -> str:
    """Why there are too few poses to interpolate each target's errors, or ""."""
    targets = (target for target, _ in reversed(Counter(rows.target).most_common()))
    return next(filter(None, (_few_poses(rows, rows.of(each), left_out) for each in targets)), "")


def no_positions(rows: Measurements) -> str:
    """Why errors of distances are not interpolated, or ""."""
    return "" if rows.along is None else f"{rows.source}: distances have no positions' errors"


def _few_poses(rows: Measurements, own: Sequence[int], left_out: int) -> str:
    pose, fold = pose_numbers(rows.joints_rad), pose_folds(rows.joints_rad)
    count = len(np.unique(pose[own]))
    others = min(len(np.unique(pose[own][fold[own] != each])) for each in range(FOLDS))
    if others >= NEIGHBOURS:
        return ""
    least = -(-NEIGHBOURS * FOLDS // (FOLDS - 1))  # of which a fifth is left out
    expected = max(least, count + NEIGHBOURS - others)
    struck = f" (and {counted(left_out, 'row')} contradict the others)" if left_out else ""
    name = "correct its name, or " if len(set(rows.target)) > 1 else ""
    return (
        f"{rows.where(own)}: target {rows.target[own[0]]} is measured in {counted(count, 'pose')}"
        f"{struck}, expected at least {expected} of different joints, a fifth of which "
        f"cross-validation leaves out; {name}measure it in more poses"
    )


def refuse_absurd(arm: Arm, rows: Measurements, miss_mm: Array) -> None:
    """Refuse errors larger than any robot's."""
    bad = np.flatnonzero(~(miss_mm <= ABSURD_MM))
    if len(bad):
        # Without the rows that show it the others fit, and a wrong arm would correct them.
        found = supposition(arm, rows, float(miss_mm[bad].max()), bad.tolist())
        fitting = f"they fit if {found}: correct the files, and keep these rows"
        act = fitting if found else "mend or remove them"
        raise FitError(
            f"{rows.source}: {len(bad)} of {len(rows)} training rows miss grossly, expected "
            f"<= {ABSURD_MM:g} mm: {_named(rows, bad, miss_mm)}; {act}"
        )


def refuse_many(rows: Measurements, bad: Bools, miss_mm: Array) -> None:
    """Refuse more outliers than slips explain."""
    struck = np.flatnonzero(bad)
    most_struck = 0.1  # share of training rows left out; beyond, they are no single slips
    if len(struck) <= most_struck * len(rows):
        return
    suspect = "the robot's and the tracker's state during the measurement"
    target, own = Counter(rows.target[n] for n in struck).most_common(1)[0]
    if len(set(rows.target)) > 1 and 2 * own > len(struck):
        suspect = f"reflector {target}, {own} of them: it may have moved on the flange"
    raise FitError(
        f"{rows.source}: {len(struck)} of {len(rows)} training rows contradict the others, "
        f"expected at most {most_struck:.0%}: {_named(rows, struck, miss_mm)}; check {suspect}, "
        "and measure again"
    )


def refuse_undetermined(test: Measurements, miss_mm: Array, bound_mm: Array) -> None:
    """Refuse test rows that the training rows do not determine: other orientations, off
    one line.
    """
    bad = np.flatnonzero(~(bound_mm <= UNDETERMINED_MM))
    if len(bad):
        rest = "no other row is left"
        if len(bad) < len(test):
            left = statistics.figures_of(statistics.lengths_mm(np.delete(miss_mm, bad, axis=0)))
            figures = " / ".join(f"{value:.4f}" for value in left)
            rest = f"the others are missed by {figures} mm (mean / p95 / max)"
        raise FitError(
            f"{test.source}: {len(bad)} of {len(test)} rows are not determined by the training "
            f"rows, expected 95 % bounds <= {UNDETERMINED_MM:g} mm: {_named(test, bad, bound_mm)}; "
            f"{rest}; measure poses with other orientations and places"
        )


def refuse_contradicting(
    test: Measurements, chosen: str, share: float, bound_mm: float, mean_mm: float
) -> None:
    """Refuse test rows that violate the bounds: corrections would be as wrong."""
    if not share >= LEAST_INSIDE:
        raise FitError(
            f"{test.source}: {share:.1%} of {len(test)} rows are within the 95 % bounds "
            f"of {chosen} ({bound_mm:.4f} mm mean), expected >= {LEAST_INSIDE:.0%}; it "
            f"misses them by {mean_mm:.4f} mm in the mean: the robot's state (zeros, load, "
            "temperature), the tracker's set-up or the units differ from the training rows'; "
            "measure both files in one state"
        )


def _named(rows: Measurements, bad: Ints, miss_mm: Array) -> str:
    named = 5  # rows that one message names
    listed = ", ".join(
        f"pose {rows.pose[n]} target {rows.target[n]} by {miss_mm[n]:.4g} mm" for n in bad[:named]
    )
    return f"{listed}{', ...' if len(bad) > named else ''}"
