"""Arms whose controller counts axis 3 from elsewhere than link 2."""

import re
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace as replaced

from hilcell.cell.file import Cell, load_cell
from hilcell.cell.robot import RobotTable
from hilcell.compensation.kinematic import RobotEntry
from hilcell.geometry.clearance import Body
from hilcell.geometry.inverse import NominalRobot, joint_jacobian, refined, status_of
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.identification.kinematics import Kinematics
from hilcell.run.collision import below
from procedures.axis_sweeps import AxisSweeps

PAPER = load_cell("paper")
LIMITS_RAD = PAPER.robot.margin_limits_rad
couplings = pytest.mark.parametrize("coupling", [1.0, -1.0])
seeds = st.integers(0, 2**32 - 1)


def arm_of(coupling: float) -> Arm:
    return replace(PAPER.robot.arm(), coupling=coupling)


def joints_of(seed: int, count: int) -> Array:
    """Joints (N, 6) of the uncoupled arm within its limits."""
    return np.random.default_rng(seed).uniform(LIMITS_RAD[0], LIMITS_RAD[1], (count, 6))


def cell_of(coupling: int) -> Cell:
    """The paper's cell with a coupled axis 3, its limits widened accordingly."""
    joint = list(PAPER.robot.joint)
    joint[2] = replaced(joint[2], min_deg=-350.0, max_deg=350.0, coupled_to=2, coupling=coupling)
    return replaced(PAPER, robot=replaced(PAPER.robot, joint=joint))


@couplings
@given(seeds)
def test_joint_2_alone_turns_axis_3_too(coupling: float, seed: int) -> None:
    joints, step = joints_of(seed, 3), 0.01 * np.eye(6)
    coupled = forward(arm_of(coupling), joints + step[1])
    plain = arm_of(0.0)
    moved = forward(plain, arm_of(coupling).angles(joints) + step[1] + coupling * step[2])
    np.testing.assert_allclose(coupled, moved, atol=1e-9)
    np.testing.assert_array_equal(plain.angles(joints), joints)


@couplings
@given(seeds)
def test_closed_form_returns_the_controllers_joints(coupling: float, seed: int) -> None:
    arm, angles = arm_of(coupling), joints_of(seed, 4)
    joints = arm.joints(angles)
    np.testing.assert_allclose(arm.angles(joints), angles, atol=1e-15)
    wide = np.radians([[-720.0] * 6, [720.0] * 6])
    for q, status in zip(joints, status_of(arm, joints), strict=True):
        found = NominalRobot(arm, int(status), wide, q).joints_for(forward(arm, q))
        np.testing.assert_allclose(found, q, atol=1e-6)


@couplings
@given(seeds)
def test_jacobian_and_refined_inverse(coupling: float, seed: int) -> None:
    arm, joints, step = arm_of(coupling), joints_of(seed, 2), 1e-6
    J = joint_jacobian(arm, joints)
    for n in range(6):
        ends = [forward(arm, joints + sign * step * np.eye(6)[n]) for sign in (1.0, -1.0)]
        shift = (ends[0] - ends[1])[:, :3, 3] / (2 * step)
        np.testing.assert_allclose(J[:, :3, n], shift, atol=1e-3)
    poses = forward(arm, joints)
    near, arrived = refined(arm, poses, joints + 1e-3)
    np.testing.assert_allclose(forward(arm, near[arrived]), poses[arrived], atol=1e-6)
    assert arrived.any()


@couplings
def test_bound_of_travel_covers_the_coupled_axis(coupling: float) -> None:
    surroundings = PAPER.surroundings
    assert surroundings is not None
    plain: Body = surroundings._body
    body = replace(plain, arm=arm_of(coupling))
    start, end = np.zeros((1, 7)), np.zeros((1, 7))
    end[0, 2] = 0.1
    levers_mm = body.travel_mm(start, end) - plain.travel_mm(start, end)
    end[0, 2:4] = 0.0, 0.1
    np.testing.assert_allclose(levers_mm, plain.travel_mm(start, end), atol=1e-9)


@couplings
@given(seeds)
def test_identification_works_with_the_angles_of_the_axes(coupling: float, seed: int) -> None:
    angles, arm = joints_of(seed, 3), arm_of(coupling)
    plain = Kinematics(arm_of(0.0))
    coupled = Kinematics(arm)
    smr_mm = np.array([PAPER.robot.smr_mm])
    values = np.random.default_rng(seed).normal(0.0, 1e-4, len(plain.prior[0]) - plain.placed)
    state = replace(plain.start(np.eye(4), smr_mm), values=values)
    expected = plain.linearised(state, angles)
    found = coupled.linearised(state, arm.joints(angles))
    for name in ("positions_mm", "by_parameter", "by_joint"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-6)


@pytest.mark.parametrize("coupling", [1, -1])
def test_cell_file(coupling: int) -> None:
    cell = cell_of(coupling)
    arm = cell.robot.arm()
    assert arm.coupling == coupling
    joints = np.radians(cell.robot.home_deg)
    came = arm.angles(joints) - arm.angles(below(cell, joints))
    np.testing.assert_allclose(came, np.radians(cell.robot.approach_deg), atol=1e-12)
    least_deg = np.degrees(cell.robot.margin_limits_rad[0, 2])
    assert least_deg >= -350.0 + np.degrees(cell.robot.approach_rad[2]) - 1e-9
    assert 2 in AxisSweeps.axes(PAPER)
    assert 2 not in AxisSweeps.axes(cell)
    assert cell.digest != PAPER.digest


@pytest.mark.parametrize(
    ("axis", "change", "named"),
    [
        (3, {"coupled_to": 2}, "joint[3].coupled_to"),
        (2, {"coupled_to": 1}, "joint[2].coupled_to"),
        (2, {"coupled_to": 2, "coupling": 0}, "coupling"),
    ],
)
def test_other_couplings_are_refused(axis: int, change: dict[str, int], named: str) -> None:
    values = msgspec.to_builtins(PAPER.robot)
    values["joint"][axis] |= change
    with pytest.raises(msgspec.ValidationError, match=re.escape(named)):
        msgspec.convert(values, RobotTable)


@pytest.mark.parametrize("coupling", [-1.0, 0.0, 1.0])
def test_calibration_file_keeps_the_coupling(coupling: float) -> None:
    arm = arm_of(coupling)
    entry = RobotEntry(
        arm.a_mm.tolist(), arm.alpha_rad.tolist(), arm.d_mm.tolist(), arm.offset_rad.tolist(),
        arm.sign.tolist(), arm.tool.tolist(), 2, LIMITS_RAD.tolist(), [0.0] * 6, arm.coupling,
    )  # fmt: skip
    assert entry.nominal().arm.coupling == coupling
