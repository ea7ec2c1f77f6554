"""Targets of other orientations than the grid's: drawn, measured for, and stated in the file."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.calibration.file import ORIENTATION_TOLERANCE_DEG, orientation_tolerance_deg
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.kinematics import forward
from hilcell.geometry.rotations import to_rotvec
from hilcell.ports import Array
from procedures.chosen_poses import ChosenPoses, judged_rad
from procedures.plan import poses_at
from procedures.validate import target_poses, targets

LEVEL = load_cell("paper")
TILTED = load_cell("paper", {"plan.tilt_deg": "30.0"})


def turns_deg(cell: Cell, poses: Array) -> Array:
    R = cell.grid.centre.matrix()[:3, :3]
    turned: Array = np.degrees(np.linalg.norm(to_rotvec(poses[:, :3, :3] @ R.T), axis=-1))
    return turned


def test_targets_are_turned_about_any_axis_by_up_to_the_tilt() -> None:
    found = target_poses(TILTED, 5)
    for name, points_mm in targets(LEVEL, 5).items():
        np.testing.assert_array_equal(found[name][:, :3, 3], points_mm)
        TILTED.robot.nominal().joints_for(found[name])  # all can be reached
        turned = turns_deg(TILTED, found[name])
        assert turned.max() <= 30.0 + 1e-9
        assert np.median(turned) == pytest.approx(30.0 * 0.5 ** (1 / 3), abs=2.0)
        vectors = to_rotvec(found[name][:, :3, :3] @ found[name][0, :3, :3].T)
        assert np.linalg.matrix_rank(vectors, tol=0.1) == 3
    again = target_poses(TILTED, 5)
    assert all(np.array_equal(found[name], again[name]) for name in found)


def test_without_tilt_all_have_the_grid_s_orientation() -> None:
    for name, poses in target_poses(LEVEL, 5).items():
        np.testing.assert_array_equal(poses, poses_at(LEVEL, targets(LEVEL, 5)[name]))


def test_a_full_plan_measures_turned_poses_for_turned_targets() -> None:
    assert ChosenPoses().plan(LEVEL, 1).points == 0
    assert ChosenPoses().plan(TILTED, 1).points == TILTED.plan.tilt_poses
    arm = TILTED.robot.arm()
    assert turns_deg(TILTED, forward(arm, judged_rad(TILTED))).max() > 15.0
    assert turns_deg(LEVEL, forward(arm, judged_rad(LEVEL))).max() < 1e-6


@pytest.mark.parametrize(
    ("cell", "method", "wanted_deg"),
    [
        (LEVEL, "kinematic", ORIENTATION_TOLERANCE_DEG),
        (TILTED, "kinematic", 30.0),
        (TILTED, "trilinear", ORIENTATION_TOLERANCE_DEG),
        (load_cell("paper", {"plan.tilt_deg": "1.0"}), "kinematic", ORIENTATION_TOLERANCE_DEG),
    ],
)
def test_the_file_states_the_orientations_that_were_calibrated(
    cell: Cell, method: str, wanted_deg: float
) -> None:
    assert orientation_tolerance_deg(cell, method) == wanted_deg
