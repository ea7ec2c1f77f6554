"""Positions and derivatives against differences; the parameters' order against their names."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.geometry.frames import apply
from hilcell.geometry.kinematics import Arm, forward
from hilcell.identification.kinematics import Kinematics
from hilcell.identification.weight import gravity_basis, gravity_loads, tool_basis, tool_loads
from tests.hilcell.geometry.test_kinematics import chain_of
from tests.hilcell.identification.robots import ARM, SMR_MM, T_L_B, Robot, curve

seeds = st.integers(0, 2**32 - 1)
GRAVITY_AXES = [axis for axis, _ in gravity_loads(ARM)]
CURVES = (curve(0, (31.0, 170.0), 1), curve(2, (62.5,), 2))


def drawn(kinematics: Kinematics, seed: int) -> tuple[Robot, np.ndarray]:
    """Return a robot of six axes or any chain, and joints of it (3, n)."""
    robot = Robot.drawn(kinematics, seed)
    shape = 3, len(kinematics.arm)
    return robot, np.random.default_rng([seed, 2]).uniform(-1.0, 1.0, shape)


@pytest.mark.parametrize("any_chain", [False, True])
@given(seed=seeds)
@settings(max_examples=3)
def test_derivatives_are_those_of_the_positions(seed: int, any_chain: bool) -> None:
    kinematics = Kinematics(ARM, 2, curves=CURVES, levers_mm=(900.0, 800.0, 700.0))
    if any_chain:
        kinematics = Kinematics(chain_of(np.random.default_rng(seed)), 2, tool=True)
    robot, joints = drawn(kinematics, seed)
    found = robot.kinematics.linearised(robot.state, joints)
    np.testing.assert_allclose(
        found.positions_mm, robot.kinematics.positions_mm(robot.state, joints), atol=1e-9
    )
    for column, name in enumerate(robot.kinematics.names):
        step = 1e-2 if name.endswith("mm") else 1e-6
        change = step * np.eye(len(robot.kinematics.names))[column]
        high, low = (
            robot.kinematics.positions_mm(robot.kinematics.moved(robot.state, s * change), joints)
            for s in (1, -1)
        )
        wanted = (high - low) / (2 * step)
        size = 1.0 if name.endswith("mm") else 3000.0
        np.testing.assert_allclose(
            found.by_parameter[..., column], wanted, atol=3e-6 * size, err_msg=name
        )


@given(seeds)
@settings(max_examples=10)
def test_derivatives_by_joints_are_those_of_the_positions(seed: int) -> None:
    arm = chain_of(np.random.default_rng(seed))
    robot, joints = drawn(Kinematics(arm, 2, waves=False, gravity=False), seed)
    found = robot.kinematics.linearised(robot.state, joints).by_joint
    for axis in range(len(arm)):
        step = 1e-6 * np.eye(len(arm))[axis]
        high, low = (robot.kinematics.positions_mm(robot.state, joints + s * step) for s in (1, -1))
        np.testing.assert_allclose(found[..., axis], (high - low) / 2e-6, atol=1e-2)


def test_a_robot_without_errors_is_nominal() -> None:
    kinematics = Kinematics(ARM, 3)
    robot = Robot.drawn(kinematics, 1)
    joints = robot.joints_rad(1, 4)
    found = kinematics.positions_mm(kinematics.start(T_L_B, SMR_MM), joints)
    flange = forward(ARM, joints)
    for k, smr in enumerate(SMR_MM):
        wanted = [apply(T_L_B, apply(each, smr[None]))[0] for each in flange]
        np.testing.assert_allclose(found[:, k], wanted, atol=1e-9)


def test_a_curve_turns_its_own_joint() -> None:
    kinematics = Kinematics(ARM, gravity=False, waves=False, curves=CURVES)
    state = kinematics.start(T_L_B, SMR_MM[:1])
    joints = Robot(kinematics, state).joints_rad(1, 5)
    turned = kinematics.joints_of(state, joints) - joints
    np.testing.assert_allclose(turned[:, 0], CURVES[0].evaluate(joints[:, 0]), atol=1e-15)
    np.testing.assert_allclose(turned[:, 2], CURVES[1].evaluate(joints[:, 2]), atol=1e-15)
    assert not turned[:, [1, 3, 4, 5]].any()


def test_gravity_bends_the_joints_by_its_loads() -> None:
    """Of two robots at the same joints, each by its own: the loads are kept from step to step."""
    bent, stiff = Kinematics(ARM, waves=False), Kinematics(ARM, waves=False, gravity=False)
    state = replace(bent.start(T_L_B, SMR_MM), values=np.zeros(bent.links + len(GRAVITY_AXES)))
    state.values[bent.links :] = 1e-4 * np.arange(1.0, 7.0)
    joints = Robot(bent, state).joints_rad(1, 5)
    by_axis = np.eye(6)[GRAVITY_AXES]
    wanted = (gravity_basis(ARM, joints) * state.values[bent.links :]) @ by_axis
    for _ in range(2):
        np.testing.assert_allclose(bent.joints_of(state, joints) - joints, wanted, atol=1e-15)
        assert not (stiff.joints_of(stiff.start(T_L_B, SMR_MM), joints) - joints).any()


@pytest.mark.parametrize("axis", [1, 2])
def test_gravity_loads_a_horizontal_link_most(axis: int) -> None:
    """With the arm stretched out level both cosines are 1 and both sines 0."""
    joints = np.zeros((1, 6))
    joints[0, 2] = np.arctan2(ARM.a_mm[2], ARM.d_mm[3])  # the forearm's line, not its tube
    loads = gravity_basis(ARM, joints)[0]
    own = loads[[n for n, each in enumerate(GRAVITY_AXES) if each == axis]]
    np.testing.assert_allclose(np.abs(own), [1.0, 0.0] * (len(own) // 2), atol=1e-9)


CARRIED = Arm(
    a_mm=np.array([0.0, *ARM.a_mm]),
    alpha_rad=np.array([0.0, *ARM.alpha_rad]),
    d_mm=np.array([0.0, *ARM.d_mm]),
    offset_rad=np.array([0.0, *ARM.offset_rad]),
    sign=np.array([1.0, *ARM.sign]),
    tool=np.eye(4),
    beta_rad=np.zeros(7),
    prismatic=(0,),
)
"""`ARM` on a prismatic joint."""


@pytest.mark.parametrize("tilt_rad", [0.0, np.pi / 2], ids=["column", "rail"])
def test_weight_loads_an_arm_on_a_column_or_rail_as_one_on_the_floor(tilt_rad: float) -> None:
    joints = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 7))
    carried = replace(CARRIED, alpha_rad=np.array([tilt_rad, *ARM.alpha_rad]))
    for loads, basis in ((gravity_loads, gravity_basis), (tool_loads, tool_basis)):
        assert loads(carried) == [(axis + 1, load) for axis, load in loads(ARM)]
        np.testing.assert_allclose(basis(carried, joints), basis(ARM, joints[:, 1:]), atol=1e-12)


def test_weight_loads_each_axis_of_other_chains_by_the_links_before_it() -> None:
    """A level chain of three parallel axes: each link stretched out loads with its whole length."""
    row = np.zeros(3)
    chain = Arm(row + 500.0, row, row, row, row + 1.0, np.eye(4), row)
    level = replace(chain, alpha_rad=np.array([np.pi / 2, 0.0, 0.0]))
    assert [axis for axis, _ in gravity_loads(level)] == [0, 0, 0, 1, 1, 2]
    found = gravity_basis(level, np.array([0.3, 0.2, -0.2]))
    np.testing.assert_allclose(found, [0.0, 0.0, 0.0, np.cos(0.2), 1.0, 1.0], atol=1e-12)
    gantry = replace(chain, prismatic=(0, 1, 2))
    assert gravity_basis(gantry, row).shape == tool_basis(gantry, row).shape == (0,)
