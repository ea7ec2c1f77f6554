"""Corrected commands: where to send the robot so that it arrives at the target.

With e = actual - nominal the command is P - e: the paper's "adding the error" doubles the error. P
- e(P) is first order only, so P_cmd = P - e(P_cmd), by fixed-point steps. Orientation likewise: the
actual one is exp(t) R_cmd, t the predicted rotation vector, so R_cmd = exp(-t(P_cmd)) R.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hilcell.compensation.grid import Grid
from hilcell.compensation.model import ErrorModel
from hilcell.geometry.frames import from_rotvec, matrix
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import lengths_mm
from hilcell.ports import HilcellError


def corrected(
    grid: Grid, poses: Array, model: ErrorModel, steps: int = 2,
    names: Sequence[str] | None = None,
) -> Array:  # fmt: skip
    """Commands (N, 3) for target poses (N, 4, 4), in the grid's frame.

    The commanded orientation is the target's. Every target must be inside; its command may leave
    the grid by the error itself, where the model is evaluated at the nearest point of the grid's
    face. Raises `OutsideGrid`, and `HilcellError` where the steps do not converge.

    Steps are compared with the first: inverse distances have a kink at every vertex and jump at
    every face between cells, so a command within micrometres may cross a face and jump once more.
    """
    return corrected_poses(grid, poses, model, steps, names, orientation=False)[:, :3, 3]


def corrected_poses(
    grid: Grid, poses: Array, model: ErrorModel, steps: int = 2,
    names: Sequence[str] | None = None, *, orientation: bool = True,
) -> Array:  # fmt: skip
    """Commands (N, 4, 4) as `corrected`, with ``orientation`` corrected on request."""
    targets, R, at = poses[:, :3, 3], poses[:, :3, :3], poses.copy()
    grid.check_inside(targets, names)
    command, first_mm = targets, np.full(len(targets), np.inf)
    for step in range(steps):
        at[:, :3, 3] = grid.clamped(command)
        predicted = model.predict(at)
        further = targets - predicted.error_mm
        moved_mm = lengths_mm(further - command)
        first_mm = moved_mm if step == 0 else first_mm
        _check_contraction(moved_mm, first_mm, step, names)
        command = further
        if orientation and predicted.orientation is not None:
            at[:, :3, :3] = from_rotvec(-predicted.orientation.error_rad) @ R
    return matrix(at[:, :3, :3], command)


def _check_contraction(
    moved_mm: Array, first_mm: Array, step: int, names: Sequence[str] | None
) -> None:
    contraction = 0.5  # step n + 1 may move the command by this share to the n-th of the first
    negligible_mm = 1e-3
    bad = np.flatnonzero(~(moved_mm <= contraction**step * first_mm + negligible_mm))
    if len(bad):
        n = bad[0]
        raise HilcellError(
            f"correction: {len(bad)} of {len(moved_mm)} targets do not settle: "
            f"{names[n] if names else f'target {n + 1}'} moves by {moved_mm[n]:.3f} mm in step "
            f"{step + 1} after {first_mm[n]:.3f} mm in the first, expected below "
            f"{contraction**step:.0%}; the error map jumps there: look for outliers on the "
            "vertices around it",
            code="HC-C21",
        )
