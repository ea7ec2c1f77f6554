"""Forward kinematics against an independent composition of rotations and translations."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.jacobian import (
    by_joints,
    link_errors,
    moved,
    parameter_jacobian,
    parameters,
    tool_and_jacobian,
)
from hilcell.geometry.kinematics import MM, Arm, forward, link_transforms


def arm_of(rng: np.random.Generator, rows: int = 6, prismatic: tuple[int, ...] = ()) -> Arm:
    return Arm(
        a_mm=rng.uniform(-1000, 1000, rows),
        alpha_rad=rng.uniform(-np.pi, np.pi, rows),
        d_mm=rng.uniform(-1000, 1000, rows),
        offset_rad=rng.uniform(-np.pi, np.pi, rows),
        sign=rng.choice([-1.0, 1.0], rows),
        tool=pose_from_zyx(*rng.uniform(-200, 200, 3), *rng.uniform(-180, 180, 3)),
        beta_rad=rng.uniform(-0.1, 0.1, rows),
        prismatic=prismatic,
    )


def chain_of(rng: np.random.Generator) -> Arm:
    """Return an arm of 1 to 9 joints, some of them prismatic."""
    rows = int(rng.integers(1, 10))
    return arm_of(rng, rows, tuple(np.flatnonzero(rng.uniform(size=rows) < 0.3).tolist()))


def joints_of(arm: Arm, rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.uniform(-np.pi, np.pi, (*shape, len(arm)))


def peer_link(arm: Arm, row: int, joint: float) -> RigidTransform:
    """Return Rot(z) Trans(z) Trans(x) Rot(x) Rot(y) as a product of five motions."""
    theta, d_mm = arm.offset_rad[row], arm.d_mm[row]
    if row in arm.prismatic:
        d_mm += 1000.0 * arm.sign[row] * joint
    else:
        theta += arm.sign[row] * joint
    return (
        RigidTransform.from_rotation(Rotation.from_euler("z", theta))
        * RigidTransform.from_translation([0, 0, d_mm])
        * RigidTransform.from_translation([arm.a_mm[row], 0, 0])
        * RigidTransform.from_rotation(Rotation.from_euler("x", arm.alpha_rad[row]))
        * RigidTransform.from_rotation(Rotation.from_euler("y", arm.beta_rad[row]))
    )


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_forward_agrees_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = chain_of(rng)
    joints = joints_of(arm, rng, 3)
    for q, pose, links in zip(
        joints, forward(arm, joints), link_transforms(arm, joints), strict=True
    ):
        peer = RigidTransform.identity()
        for row in range(len(arm)):
            link = peer_link(arm, row, q[row])
            np.testing.assert_allclose(links[row], link.as_matrix(), atol=1e-9)
            peer = peer * link
        np.testing.assert_allclose(pose, peer.as_matrix() @ arm.tool, atol=1e-8)


PAPER = load_cell("paper").robot.arm()
RELATIVE = 1e-7
seeds = st.integers(0, 2**32 - 1)


def differences(low: np.ndarray, high: np.ndarray, step: float) -> np.ndarray:
    """Return the motion (..., 6) in {B} from frames at -step to those at +step, per unit."""
    turn = high[..., :3, :3] @ np.swapaxes(low[..., :3, :3], -1, -2)
    vector = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(turn.shape[:-1])
    return np.concatenate([high[..., :3, 3] - low[..., :3, 3], vector], axis=-1) / (2 * step)


def check(arm: Arm, joints: np.ndarray) -> None:
    J = parameter_jacobian(arm, joints)
    assert J.shape == (len(joints), 6, 5 * len(arm) + 3)
    reach = np.abs(arm.a_mm).sum() + np.abs(arm.d_mm).sum() + np.linalg.norm(arm.tool[:3, 3])
    reach += MM * np.pi * len(arm.prismatic)
    for parameter, name in enumerate(parameters(arm)):
        step = 1e-5 if "rad" in name else 1e-2
        low, high = (forward(moved(arm, parameter, each), joints) for each in (-step, step))
        found = differences(low, high, step)
        size = reach if "rad" in name else 1.0
        np.testing.assert_allclose(J[:, :3, parameter], found[:, :3], rtol=0, atol=RELATIVE * size)
        np.testing.assert_allclose(J[:, 3:, parameter], found[:, 3:], rtol=0, atol=RELATIVE)


@settings(max_examples=8)
@given(seeds)
def test_paper_arm_with_hayati_against_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    check(replace(PAPER, beta_rad=rng.uniform(-0.5, 0.5, 6)), rng.uniform(-np.pi, np.pi, (3, 6)))


@settings(max_examples=8)
@given(seeds)
def test_any_arm_against_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = chain_of(rng)
    check(arm, joints_of(arm, rng, 3))


@settings(max_examples=8)
@given(seeds)
def test_link_errors_are_those_of_eqs_3_and_4(seed: int) -> None:
    """A_i^-1 dA_i is the error matrix, whatever the joint angle."""
    rng = np.random.default_rng(seed)
    arm = chain_of(rng)
    joints = joints_of(arm, rng)
    back, errors = inverse(link_transforms(arm, joints)), link_errors(arm)
    step = 1e-5
    for parameter in range(5 * len(arm)):
        kind, row = divmod(parameter, len(arm))
        dA = (
            link_transforms(moved(arm, parameter, step), joints)[row]
            - link_transforms(moved(arm, parameter, -step), joints)[row]
        ) / (2 * step)
        delta = back[row] @ dA
        found = [*delta[:3, 3], delta[2, 1], delta[0, 2], delta[1, 0]]
        np.testing.assert_allclose(found, errors[row, :, kind], atol=1e-5)


@given(seeds)
def test_first_order_is_all_but_the_square(seed: int) -> None:
    """Eq 5's product less eq 6's sum shrinks with the square of the errors."""
    rng = np.random.default_rng(seed)
    joints, errors = rng.uniform(-np.pi, np.pi, (4, 6)), rng.normal(0, 1e-3, 33)
    missed = []
    for share in (1.0, 0.1):
        arm = PAPER
        for parameter in range(33):
            arm = moved(arm, parameter, share * errors[parameter])
        shift = forward(arm, joints)[:, :3, 3] - forward(PAPER, joints)[:, :3, 3]
        predicted = parameter_jacobian(PAPER, joints)[:, :3] @ (share * errors)
        missed.append(np.linalg.norm(shift - predicted, axis=1).max())
    assert missed[1] == pytest.approx(missed[0] / 100, rel=0.1)


@given(seeds)
def test_parameters_move_the_tool_as_joints_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = chain_of(rng)
    joints = joints_of(arm, rng, 2, 3)
    found = by_joints(arm, parameter_jacobian(arm, joints))
    step = 1e-6
    for axis in range(len(arm)):
        q = step * np.eye(len(arm))[axis]
        wanted = differences(forward(arm, joints - q), forward(arm, joints + q), step)
        np.testing.assert_allclose(found[..., :3, axis], wanted[..., :3], atol=1e-2)
        np.testing.assert_allclose(found[..., 3:, axis], wanted[..., 3:], atol=1e-6)


@given(seeds)
def test_axes_of_the_tool_and_of_the_base(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = chain_of(rng)
    joints = joints_of(arm, rng)
    R = forward(arm, joints)[:3, :3]
    here, there = tool_and_jacobian(arm, joints)[1], parameter_jacobian(arm, joints)
    np.testing.assert_allclose(R @ here[:3], there[:3], atol=1e-9)
    np.testing.assert_allclose(R @ here[3:], there[3:], atol=1e-12)


def test_parallel_axes_need_hayati() -> None:
    """Slips 3: d2 and d3 cannot be separated, and only beta 2 tilts axis 3 out of its plane."""
    joints = np.random.default_rng(1).uniform(-np.pi, np.pi, (40, 6))
    J = parameter_jacobian(PAPER, joints)
    d, beta = (parameters(PAPER).index(name) for name in ("d_mm[0]", "beta_rad[0]"))
    np.testing.assert_allclose(J[..., d + 1], J[..., d + 2], atol=1e-12)
    plain = J[..., :24].reshape(-1, 24)
    tilt = J[..., beta + 1].ravel()
    missed = tilt - plain @ np.linalg.lstsq(plain, tilt, rcond=1e-12)[0]
    assert np.linalg.norm(missed) > 0.1 * np.linalg.norm(tilt)
