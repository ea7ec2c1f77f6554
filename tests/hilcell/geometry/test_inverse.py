"""Inverse kinematics: round trips by status, limits, refusals; the paper cell's whole cube."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.inverse import (
    NominalRobot,
    ReachError,
    inverse_kinematics,
    joint_jacobian,
    nearest_revolutions,
    refined,
    status_of,
)
from hilcell.geometry.kinematics import Arm, forward

CELL = load_cell("paper")
ARM = CELL.robot.arm()
LIMITS = CELL.robot.margin_limits_rad
HOME = np.radians(CELL.robot.home_deg)
PARALLEL = Arm(  # the design of Universal Robots' UR10e, by its maker's table
    a_mm=np.array([0.0, -612.7, -571.55, 0.0, 0.0, 0.0]),
    alpha_rad=np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0]),
    d_mm=np.array([180.7, 0.0, 0.0, 174.15, 119.85, 116.55]),
    offset_rad=np.zeros(6),
    sign=np.ones(6),
    tool=pose_from_zyx(30.0, -10.0, 95.0, 20.0, 10.0, -15.0),
)
ARMS = pytest.mark.parametrize("design", [ARM, PARALLEL], ids=["spherical", "parallel"])
seeds = st.integers(0, 2**32 - 1)
signs = st.lists(st.sampled_from([-1.0, 1.0]), min_size=6, max_size=6)


def joints_of(seed: int, count: int = 20) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-3.1, 3.1, (count, 6))


def cube() -> np.ndarray:
    """The corners and centre of the paper cell's cube, tool orientation of its centre."""
    poses = np.tile(CELL.grid.centre.matrix(), (27, 1, 1))
    steps = np.stack(np.meshgrid(*[(-450.0, 0.0, 450.0)] * 3), axis=-1).reshape(-1, 3)
    poses[:, :3, 3] += steps
    return poses


@ARMS
@settings(max_examples=12)
@given(seeds, signs)
def test_joints_return_by_their_status(design: Arm, seed: int, sign: list[float]) -> None:
    arm = replace(design, sign=np.array(sign))
    joints = joints_of(seed, 4)
    joints = joints[np.abs(np.sin(joints[:, 4])) > 1e-2]
    for q, status in zip(joints, status_of(arm, joints), strict=True):
        found = inverse_kinematics(arm, forward(arm, q), int(status))
        np.testing.assert_allclose(forward(arm, found), forward(arm, q), atol=1e-8)
        assert status_of(arm, found) == status
        if abs(np.linalg.det(joint_jacobian(arm, q))) > 1e4:
            np.testing.assert_allclose(found, q, atol=1e-9)


@ARMS
@settings(max_examples=12)
@given(seeds)
def test_every_reachable_status_is_a_posture_of_the_pose(design: Arm, seed: int) -> None:
    poses = forward(design, joints_of(seed, 5))
    for status in range(8):
        ok = NominalRobot(design, status, LIMITS, HOME).excess_mm(poses) == 0
        joints = inverse_kinematics(design, poses[ok], status)
        np.testing.assert_allclose(forward(design, joints), poses[ok], atol=1e-7)
        assert (status_of(design, joints) == status).all()


def test_home_of_the_paper_cell_has_status_6() -> None:
    assert status_of(ARM, HOME) == 6
    np.testing.assert_allclose(
        NominalRobot(ARM, 6, LIMITS, HOME).joints_for(forward(ARM, HOME)), HOME, atol=1e-9
    )


def test_whole_cube_keeps_within_limits_in_status_6() -> None:
    joints = NominalRobot(ARM, 6, LIMITS, HOME).joints_for(cube())
    room = np.radians(15.0)
    assert ((joints > LIMITS[0] + room) & (joints < LIMITS[1] - room)).all()
    assert np.ptp(joints[:, 3]) < np.radians(75)  # no half turns of A4 from target to target


def test_message_names_the_first_unreachable_poses_and_by_how_much() -> None:
    poses = np.stack([pose_from_zyx(x, 0, 1000, 0, 90, 0) for x in (1500, 9000, 1600)])
    with pytest.raises(ReachError, match="pose 2"):
        inverse_kinematics(ARM, poses, 6)
    wrist_mm = np.hypot(9000 - 127 - 215 - 330, 1000 + 98 - 645)
    excess = NominalRobot(ARM, 6, LIMITS, HOME).excess_mm(poses)
    assert excess[0] == excess[2] == 0
    assert excess[1] == pytest.approx(wrist_mm - 1150 - np.hypot(115, 1220), abs=1e-6)


def test_nan_is_never_reachable() -> None:
    pose = cube()[0]
    pose[0, 3] = np.nan
    assert not NominalRobot(ARM, 6, LIMITS, HOME).reachable(pose)
    with pytest.raises(ReachError):
        inverse_kinematics(ARM, pose, 6)
    with pytest.raises(ReachError):
        NominalRobot(ARM, 6, LIMITS, HOME).joints_for(pose)


@pytest.mark.parametrize(("end", "limit_deg"), [(1, 80.0), (0, 100.0)])
def test_limits_are_named(end: int, limit_deg: float) -> None:
    pose = forward(ARM, np.radians([0.0, -90, 90, 0, -30, 0]))
    tight = LIMITS.copy()
    tight[end, 2] = np.radians(limit_deg)
    robot = NominalRobot(ARM, 6, tight, HOME)
    assert not robot.reachable(pose)
    with pytest.raises(ReachError, match=r"pose 1 A3 90\.00 deg"):
        robot.joints_for(pose)


def test_status_out_of_range_is_refused() -> None:
    with pytest.raises(ReachError, match="7"):
        inverse_kinematics(ARM, cube()[0], 8)


@given(seeds)
def test_turns_are_the_nearest_within_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    joints, reference = rng.uniform(-np.pi, np.pi, 6), rng.uniform(LIMITS[0], LIMITS[1])
    turned = nearest_revolutions(joints, LIMITS, reference)
    np.testing.assert_allclose(np.exp(1j * turned), np.exp(1j * joints), atol=1e-12)
    for joint in range(6):
        options = joints[joint] + 2 * np.pi * np.arange(-3, 4)
        inside = options[(options >= LIMITS[0, joint]) & (options <= LIMITS[1, joint])]
        if inside.size:
            nearest = np.abs(inside - reference[joint]).min()
            assert abs(turned[joint] - reference[joint]) == pytest.approx(nearest, abs=1e-12)


@given(seeds)
def test_jacobian_against_differences(seed: int) -> None:
    joints, step = joints_of(seed, 1)[0], 1e-6
    J = joint_jacobian(ARM, joints)
    for joint in range(6):
        nudge = np.eye(6)[joint] * step
        low, high = forward(ARM, joints - nudge), forward(ARM, joints + nudge)
        shift = (high[:3, 3] - low[:3, 3]) / (2 * step)
        turn = Rotation.from_matrix(high[:3, :3] @ low[:3, :3].T).as_rotvec() / (2 * step)
        np.testing.assert_allclose(J[:, joint], [*shift, *turn], atol=1e-4)


@given(seeds)
def test_refined_inverse_of_a_crooked_arm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = replace(
        ARM,
        a_mm=ARM.a_mm + rng.normal(0, 1, 6),
        alpha_rad=ARM.alpha_rad + rng.normal(0, 2e-3, 6),
        beta_rad=rng.normal(0, 2e-3, 6),
    )
    start = NominalRobot(ARM, 6, LIMITS, HOME).joints_for(cube())
    joints, arrived = refined(true, cube(), start)
    assert arrived.all()
    np.testing.assert_allclose(forward(true, joints), cube(), atol=1e-6)
    assert np.abs(joints - start).max() < np.radians(2)


def test_arm_outside_the_family_is_refused_and_can_be_refined() -> None:
    offset_wrist = replace(ARM, a_mm=ARM.a_mm + 30.0 * np.eye(6)[4])
    with pytest.raises(ReachError, match="a4, a5, a6"):
        inverse_kinematics(offset_wrist, cube(), 6)
    joints = HOME + 0.1
    found, arrived = refined(offset_wrist, forward(offset_wrist, joints)[None], HOME[None])
    assert arrived.all()
    np.testing.assert_allclose(found[0], joints, atol=1e-8)


def test_refining_says_when_it_does_not_arrive() -> None:
    assert not refined(ARM, pose_from_zyx(9000, 0, 1000, 0, 90, 0)[None], HOME[None])[1].any()
