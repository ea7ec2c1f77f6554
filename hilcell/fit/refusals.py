"""Rows that no fit may learn from, or be judged by, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import NoReturn

import numpy as np

from hilcell.compensation.interpolation import NEIGHBOURS
from hilcell.fit.measurements import Measurements
from hilcell.fit.placement import ABSURD_MM, CHECK_ROBOT, FitError, far_off
from hilcell.fit.robot_file import Robot
from hilcell.fit.suppositions import Mistake
from hilcell.geometry.frames import FrameError
from hilcell.geometry.kinematics import Array, Bools, Ints
from hilcell.identification.estimate import LEAST_POSES, Estimate
from hilcell.identification.measured_poses import (
    FOLDS,
    SAME_RAD,
    IdentificationError,
    ManyContradict,
    pose_folds,
    pose_numbers,
)
from hilcell.sanitize import counted

LEAST_INSIDE = 0.5  # share of test rows within 95 % bounds; below, they are not of this robot

Explaining = Callable[[Ints], Mistake]  # of all rows, those of an index too


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
    act = (
        f"judge any method by those left out, and {LEAST_POSES} to identify the robot; measure more"
    )
    if len(set(rows.target)) > 1:
        act = "interpolate (idw); correct its name, or measure it in more poses"
    return (
        f"{rows.where(own)}: target {rows.target[own[0]]} is measured in {counted(count, 'pose')}"
        f"{struck}, expected at least {expected} of different joints to {act}"
    )


def refuse_unplaced(rows: Measurements, error: FrameError | FitError, mistake: Mistake) -> NoReturn:
    why = f"{rows.source}: nominal positions do not meet the measured ones" if mistake else error
    raise FitError(f"{why}; {_act(mistake, CHECK_ROBOT)}") from error


def refuse_another_robot(rows: Measurements, nominal_mm: Array, mistake: Explaining) -> None:
    """Refuse rows of which nominal kinematics miss half grossly, and no robot is identified."""
    half_mm = float(np.median(nominal_mm))
    if not half_mm <= ABSURD_MM:
        every = np.arange(len(rows))
        raise FitError(f"{rows.source}: {far_off(half_mm)}: {_act(mistake(every), CHECK_ROBOT)}")


def refuse_gross(rows: Measurements, miss_mm: Array, mistake: Explaining) -> None:
    """Refuse misses that no slip explains: without these rows a wrong arm may fit the others."""
    bad = np.flatnonzero(~(miss_mm <= ABSURD_MM))
    if len(bad):
        says = mistake(bad)
        raise FitError(
            f"{rows.source}: {len(bad)} of {len(rows)} rows miss grossly, expected <= "
            f"{ABSURD_MM:g} mm: {_named(rows, bad, miss_mm, says)}; "
            f"{_act(says, f'mend or remove them, and {CHECK_ROBOT}')}"
        )


def refuse_unidentified(
    rows: Measurements, nominal_mm: Array, error: IdentificationError, mistake: Explaining
) -> None:
    """Refuse rows that identify no robot, but would without a mistake or many outliers."""
    doubtful_mm = 3.0
    many = isinstance(error, ManyContradict)
    if (many or np.median(nominal_mm) > doubtful_mm) and (
        (says := mistake(np.arange(len(rows)))) or many
    ):
        raise FitError(f"{rows.source}: {error}; {_act(says, CHECK_ROBOT)}") from error


def refuse_many(rows: Measurements, bad: Bools, miss_mm: Array, mistake: Explaining) -> None:
    """Refuse more outliers than slips explain."""
    struck = np.flatnonzero(bad)
    most_struck = 0.1  # share of training rows left out; beyond, they are no single slips
    if len(struck) <= most_struck * len(rows):
        return
    suspect = "the robot's and the tracker's state during the measurement"
    target, own = Counter(rows.target[n] for n in struck).most_common(1)[0]
    if len(set(rows.target)) > 1 and 2 * own > len(struck):
        suspect = f"reflector {target}, {own} of them: it may have moved on the flange"
    says = mistake(struck)
    raise FitError(
        f"{rows.source}: {len(struck)} of {len(rows)} training rows contradict the others, "
        f"expected at most {most_struck:.0%}: {_named(rows, struck, miss_mm, says)}; "
        f"{_act(says, f'check {suspect}, and measure again')}"
    )


def refuse_mistaken(
    rows: Measurements, bad: Bools, miss_mm: Array, estimate: Estimate, mistake: Explaining, *,
    moved: bool,
) -> None:  # fmt: skip
    """Refuse rows that a supposition explains better, and a robot unlike the robot file's.

    ``moved``: whether the tracker may have moved amid them.
    """
    far, scatter_mm = _farthest(estimate), estimate.noise.reading_mm
    doubtful = moved or far[1] > 6.0 or scatter_mm > 0.5  # standard deviations; mm
    struck = np.flatnonzero(bad)
    if not (len(struck) or doubtful):
        return
    if says := mistake(struck):
        left = f"the identified robot leaves {scatter_mm:.3g} mm"
        if len(struck):
            named = _named(rows, struck, miss_mm, says)
            left = f"{len(struck)} of {len(rows)} rows contradict the others: {named}"
        raise FitError(f"{rows.source}: {left}; {_act(says, '')}")
    name, sigmas, value = far
    most_sigmas = 25.0
    if not sigmas <= most_sigmas:
        most = abs(value) / sigmas * most_sigmas
        raise FitError(
            f"{rows.source}: the rows are of another robot than the robot file's: {name} differs "
            f"by {value:.4g}, expected <= {most:.3g}; {_act(says, CHECK_ROBOT)}"
        )


def _farthest(estimate: Estimate) -> tuple[str, float, float]:
    """The link parameter farthest from nominal: name, in standard deviations, and difference."""
    kinematics = estimate.kinematics
    links = slice(kinematics.placed, kinematics.placed + kinematics.links)
    values = kinematics.flat(estimate.state)[links]
    sigmas = np.abs(values) / np.sqrt(np.diag(kinematics.prior[1]))[links]
    n = int(np.argmax(sigmas))
    return kinematics.names[links][n], float(sigmas[n]), float(values[n])


def _act(mistake: Mistake, act: str) -> str:
    if mistake:
        return f"they fit if {mistake.says}: correct the files, and keep these rows"
    return f"{act}; none of the {mistake.tried} mistakes tried explains all rows (docs/fit.md)"


def untrained(robot: Robot, train: Measurements, test: Measurements) -> str:
    """Which joints of most test rows lie outside the trained ranges, and by how much, or ""."""
    clearly = 0.25  # of the trained range
    low, high = train.joints_rad.min(axis=0), train.joints_rad.max(axis=0)
    off_rad = np.maximum(low - test.joints_rad, test.joints_rad - high)
    outside = off_rad > np.maximum(clearly * (high - low), SAME_RAD)
    if np.count_nonzero(outside.any(axis=1)) <= len(test) / 2:
        return ""
    most, names = off_rad.max(axis=0) / robot.column_units, robot.joint_columns
    listed = ", ".join(f"{names[n]} by {most[n]:.3g}" for n in np.flatnonzero(outside.any(axis=0)))
    return f"most rows lie outside the trained joints, up to: {listed}; train there too"


def undetermined(test: Measurements, bound_mm: Array, limit_mm: float, outside: str) -> Ints:
    """Test rows (U,) that the training rows do not determine: other orientations, off one line.
    Raises `FitError` where none is left.
    """
    bad = np.flatnonzero(~(bound_mm <= limit_mm))
    if len(bad) == len(test):
        raise FitError(
            f"{test.source}: {len(bad)} of {len(test)} rows are not determined by the training "
            f"rows, expected 95 % bounds <= {limit_mm:.3g} mm: {_named(test, bad, bound_mm)}; "
            + (outside or "measure training poses with other orientations and places")
        )
    return bad


def refuse_mistaken_test(
    test: Measurements, bad: Ints, miss_mm: Array, mistake: Explaining
) -> None:
    """Refuse test rows that a supposition explains better."""
    if len(bad) and (says := mistake(bad)):
        raise FitError(
            f"{test.source}: {len(bad)} of {len(test)} rows are beyond their bounds: "
            f"{_named(test, bad, miss_mm, says)}; {_act(says, '')}"
        )


def refuse_contradicting(
    test: Measurements, chosen: str, share: float, bound_mm: float, mean_mm: float,
    mistake: Explaining, outside: str,
) -> None:  # fmt: skip
    """Refuse test rows that violate the bounds: corrections would be as wrong."""
    if not share >= LEAST_INSIDE:
        states = (
            "the robot's state (zeros, load, temperature) or the tracker's set-up differ from the "
            "training rows'; measure both files in one state"
        )
        act = _act(mistake(np.arange(len(test))), outside or states)
        raise FitError(
            f"{test.source}: {share:.1%} of {len(test)} rows are within the 95 % bounds "
            f"of {chosen} ({bound_mm:.4f} mm mean), expected >= {LEAST_INSIDE:.0%}; it "
            f"misses them by {mean_mm:.4f} mm in the mean; {act}"
        )


def _named(rows: Measurements, bad: Ints, miss_mm: Array, mistake: Mistake | None = None) -> str:
    """Rows and what they miss by; a mistake names them itself."""
    if mistake:
        return f"up to {miss_mm[bad].max():.4g} mm"
    named = 5  # rows that one message names
    anchors = [f" anchor {each}" for each in rows.anchor] or [""] * len(rows)
    listed = ", ".join(
        f"pose {rows.pose[n]} target {rows.target[n]}{anchors[n]} by {miss_mm[n]:.4g} mm"
        for n in bad[:named]
    )
    return f"{listed}{', ...' if len(bad) > named else ''}"
