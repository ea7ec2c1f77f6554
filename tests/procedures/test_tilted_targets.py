"""Targets of other orientations than the grid's: drawn, measured for, and stated in the file."""

from __future__ import annotations

import numpy as np
import pytest

from hilcell.calibration.file import Validity
from hilcell.calibration.from_run import ORIENTATION_TOLERANCE_DEG, orientation_tolerance_deg
from hilcell.cell.file import Cell, load_cell
from hilcell.geometry.frames import from_zyx, matrix, to_rotvec, turned_deg
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, HilcellError
from procedures.plan import poses_at
from procedures.robot_grid import ChosenPoses, RobotGrid, judged_rad
from procedures.validate import target_poses, targets

LEVEL = load_cell("paper")
SEVERAL = load_cell("paper", {"plan.grid_orientations": "[[0.0, 100.0, 0.0], [20.0, 75.0, 0.0]]"})
TILTED = load_cell("paper", {"plan.tilt_deg": "30.0"})


def turns_deg(cell: Cell, poses: Array) -> Array:
    R = cell.grid.centre.matrix()[:3, :3]
    reoriented: Array = np.degrees(np.linalg.norm(to_rotvec(poses[:, :3, :3] @ R.T), axis=-1))
    return reoriented


def test_targets_are_turned_about_any_axis_by_up_to_the_tilt() -> None:
    found = target_poses(TILTED, 5)
    for name, points_mm in targets(LEVEL, 5).items():
        np.testing.assert_array_equal(found[name][:, :3, 3], points_mm)
        TILTED.robot.nominal().joints_for(found[name])  # all can be reached
        reoriented = turns_deg(TILTED, found[name])
        assert reoriented.max() <= 30.0 + 1e-9
        assert np.median(reoriented) == pytest.approx(30.0 * 0.5 ** (1 / 3), abs=2.0)
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


def test_the_grid_is_measured_in_each_orientation() -> None:
    one, three = RobotGrid().plan(LEVEL, 1), RobotGrid().plan(SEVERAL, 1)
    assert three.points == 3 * one.points
    far = load_cell("paper", {"plan.grid_orientations": "[[180.0, 75.0, 0.0]]"})
    with pytest.raises(HilcellError, match="A 180°, B 75°, C 0°"):
        RobotGrid().plan(far, 1)


@pytest.mark.parametrize("more", ["[[0.0, 75.0, 0.0]]", "[[0, 100, 0], [360, 100, 0]]"])
def test_an_orientation_that_adds_nothing_is_refused(more: str) -> None:
    with pytest.raises(HilcellError, match="same orientation"):
        RobotGrid().plan(load_cell("paper", {"plan.grid_orientations": more}), 1)


def test_targets_have_the_orientations_of_the_grid_in_turn() -> None:
    wanted = from_zyx([[0.0, 75.0, 0.0], [0.0, 100.0, 0.0], [20.0, 75.0, 0.0]])
    for name, poses in target_poses(SEVERAL, 5).items():
        np.testing.assert_array_equal(poses[:, :3, 3], targets(LEVEL, 5)[name])
        reoriented = [turned_deg(R, poses) < 1e-6 for R in wanted]
        assert np.sum(reoriented, axis=0).tolist() == [1] * len(poses)
        assert min(each.sum() for each in reoriented) > len(poses) // 4


def test_a_calibration_holds_for_each_orientation_that_was_measured() -> None:
    R = SEVERAL.grid.centre.matrix()[:3, :3].tolist()
    more = [from_zyx(angles).tolist() for angles in SEVERAL.plan.grid_orientations]
    validity = Validity((0.0,) * 3, (1.0,) * 3, R, 2.0, None, more)
    angles = [[0.0, 101.5, 0.0], [20.0, 75.0, 1.0], [0.0, 85.0, 0.0]]
    poses = matrix(from_zyx(angles), np.zeros((3, 3)))
    np.testing.assert_allclose(validity.turned_deg(poses), [1.5, 1.0, 10.0], atol=1e-9)
