"""Rotations of the simulated cell, against those of scipy, and its arms against kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fakes.truth.machine import cell_machine, controller_arm, nominal_chain
from fakes.truth.transforms import Chain, components, frame, inverse, rotation, rotation_vector
from hilcell.cell.file import Cell, load_cell
from hilcell.cell.tables import Pose
from hilcell.geometry import frames
from hilcell.geometry.inverse import joint_jacobian, status_of
from hilcell.geometry.kinematics import Array, forward
from hilcell.ports import HilcellError

AXES = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.48, 0.64, 0.6]]


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-3, 1.0, 2.0, 3.1, np.pi - 1e-9])
@pytest.mark.parametrize("axis", AXES)
def test_a_rotation_vector_leads_back_to_its_rotation(axis: list[float], angle_rad: float) -> None:
    turned = Rotation.from_rotvec(angle_rad * np.array(axis))
    found = rotation_vector(turned.as_matrix())
    assert found == pytest.approx(turned.as_rotvec(), abs=1e-14)
    assert rotation(turned.as_rotvec()) == pytest.approx(turned.as_matrix(), abs=1e-12)


@pytest.mark.parametrize("axis", AXES)
def test_half_a_turn_has_either_sign(axis: list[float]) -> None:
    turned = Rotation.from_rotvec(np.pi * np.array(axis))
    found = rotation_vector(turned.as_matrix())
    assert np.linalg.norm(found) == pytest.approx(np.pi)
    assert Rotation.from_rotvec(found).as_matrix() == pytest.approx(turned.as_matrix(), abs=1e-14)


CELLS = ("paper", "six-r", "replay")


def joints(count: int = 100) -> Array:
    return np.random.default_rng(7).uniform(-3.1, 3.1, (count, 6))


def design(cell: Cell) -> Chain:
    return controller_arm(cell).chain


@pytest.mark.parametrize("name", CELLS)
def test_design_is_the_cell_files_nominal_robot(name: str) -> None:
    """The cell file only claims what the machine is; both are written down apart."""
    cell = load_cell(name)
    arm, q = cell.robot.arm(), joints()
    chain = nominal_chain(cell) if name == "replay" else cell_machine(cell).chain(cell.robot.smr_mm)
    np.testing.assert_allclose(chain.pose(q), forward(arm, q), atol=1e-9)
    np.testing.assert_allclose(chain.jacobian(q), joint_jacobian(arm, q), atol=1e-9)


def test_rows_give_the_same_arm_as_the_machines_axes(cell: Cell) -> None:
    of_rows, of_file = nominal_chain(cell), cell_machine(cell).chain(cell.robot.smr_mm)
    np.testing.assert_allclose(of_rows.pose(joints()), of_file.pose(joints()), atol=1e-9)


@pytest.mark.parametrize("name", CELLS)
def test_controller_states_pose_status_and_turn_of_the_standard(name: str) -> None:
    cell = load_cell(name, {"simulation.data": "A.csv"} if name == "replay" else {})
    arm, controller = cell.robot.arm(), controller_arm(cell)
    for q in joints(40):
        stated = frames.pose_from_zyx(*components(controller.chain.pose(q)).tolist())
        np.testing.assert_allclose(stated, forward(arm, q), atol=1e-9)
        assert controller.status(q) == int(status_of(arm, q))
        assert controller.turn(q) == int(np.sum((q < 0) << np.arange(6)))


def test_solve_finds_the_joints_of_the_starts_posture(cell: Cell) -> None:
    chain = design(cell)
    centre = cell.grid.centre.matrix()
    poses = np.tile(centre, (8, 1, 1))
    poses[:, :3, 3] += 450.0 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T
    robot = cell.robot
    closed = robot.nominal().joints_for(poses)
    found = chain.solve(poses, np.radians([0.0, -75.0, 100.0, 0.0, -40.0, 0.0]))
    np.testing.assert_allclose(found, closed, atol=1e-9)


def test_a_pose_out_of_reach_is_refused(cell: Cell) -> None:
    pose = np.eye(4)
    pose[0, 3] = 9000.0
    with pytest.raises(HilcellError):
        design(cell).solve(pose[None], np.zeros(6))


def test_a_grown_arm_is_longer_by_the_strain(cell: Cell) -> None:
    chain, q = design(cell), joints(20)
    shorter, longer = chain.pose(q), chain.pose(q, 1e-3)
    np.testing.assert_allclose(longer[:, :3, 3], 1.001 * shorter[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(longer[:, :3, :3], shorter[:, :3, :3], atol=1e-12)


@pytest.mark.parametrize("b_deg", [0.0, 30.0, 90.0, -90.0, 120.0])
def test_frames_agree_with_the_cores(b_deg: float) -> None:
    pose = Pose(x_mm=1.0, y_mm=-2.0, z_mm=3.0, a_deg=40.0, b_deg=b_deg, c_deg=-70.0)
    T = frame(pose)
    np.testing.assert_allclose(T, pose.matrix(), atol=1e-12)
    again = frames.pose_from_zyx(*components(T).tolist())
    np.testing.assert_allclose(again, T, atol=1e-9)
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-12)


def test_an_arm_with_a_coupled_axis_is_the_same_arm_for_other_joints() -> None:
    chain = design(load_cell("paper"))
    coupled = design(load_cell("paper", {"simulation.sizes.coupling": "-1.0"}))
    turned, step_rad = joints(20), 1e-6
    commands = coupled.commands(turned)
    np.testing.assert_array_equal(commands[:, 2], turned[:, 2] + turned[:, 1])
    np.testing.assert_allclose(coupled.pose(commands), chain.pose(turned), atol=1e-9)
    for joint in range(6):
        step = step_rad * np.eye(6)[joint]
        ahead, behind = coupled.pose(commands + step), coupled.pose(commands - step)
        slope = (ahead - behind)[:, :3, 3] / (2 * step_rad)
        np.testing.assert_allclose(coupled.jacobian(commands)[:, :3, joint], slope, atol=1e-3)
