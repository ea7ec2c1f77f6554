"""Chains of revolute joints and DH rows are the same arm, to the rounding of a double."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilcell.fit.urdf_file import Chain
from hilcell.geometry.frames import matrix
from hilcell.geometry.kinematics import Arm, Array, forward
from tests.hilcell.fit.chains import chain_forward
from tests.hilcell.geometry.test_kinematics import arm_of as random_arm

EXACT = 1e-9  # mm, and of a rotation's elements
SEEDS = st.integers(0, 2**32 - 1)
AXES = np.vstack([np.eye(3), -np.eye(3)])


def random_chain(rng: np.random.Generator) -> Chain:
    """Axes in any direction, or as robots have them: parallel, opposite, crossing, in one line."""
    frames = [_frame(rng) for _ in range(7)]
    axes = [AXES[rng.integers(6)] if rng.random() < 0.8 else _unit(rng) for _ in range(6)]
    return Chain(np.array(frames[:6]), np.array(axes), frames[6])


def _frame(rng: np.random.Generator) -> Array:
    shift = rng.uniform(-1000, 1000, 3) * (rng.random(3) < 0.5)
    quarter = Rotation.from_euler("zyx", rng.integers(-2, 3, 3) * 90, degrees=True)
    slight = Rotation.from_rotvec(rng.normal(size=3) * rng.choice([0.0, 1e-12, 1e-4, 0.1, 2.0]))
    return matrix((quarter * slight).as_matrix(), shift)


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def joints_of(rng: np.random.Generator) -> Array:
    return rng.uniform(-np.pi, np.pi, (5, 6))


@given(SEEDS)
def test_every_chain_is_an_arm_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chain, joints = random_chain(rng), joints_of(rng)
    base, arm = chain.arm()
    np.testing.assert_allclose(
        base @ forward(arm, joints), chain_forward(chain, joints), atol=EXACT
    )


@given(SEEDS)
def test_rows_of_axes_that_are_not_parallel_are_standard_dh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, arm = random_chain(rng).arm()
    crossing = np.abs(np.sin(arm.alpha_rad)) > 0.11
    np.testing.assert_array_equal(arm.beta_rad[crossing], 0.0)
    assert (np.abs(arm.beta_rad) <= 0.11).all()
    assert (arm.a_mm >= 0.0).all()
    assert (np.abs(np.column_stack([arm.a_mm, arm.d_mm])) < 1e5).all()


@given(SEEDS)
def test_every_arm_is_a_chain_exactly_and_returns(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, base, joints = random_arm(rng), _frame(rng), joints_of(rng)
    chain = Chain.of(base, arm)
    wanted = base @ forward(arm, joints)
    np.testing.assert_allclose(chain_forward(chain, joints), wanted, atol=EXACT)
    base, arm = chain.arm()
    np.testing.assert_allclose(base @ forward(arm, joints), wanted, atol=EXACT)


@given(SEEDS)
def test_a_chain_beside_another_keeps_its_motion_and_takes_the_other_s_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal, joints = random_chain(rng), joints_of(rng)
    base, arm = nominal.arm()
    crooked = Chain.of(base, crooked_arm(arm, rng))
    found = crooked.beside(nominal)
    np.testing.assert_allclose(
        chain_forward(found, joints), chain_forward(crooked, joints), atol=EXACT
    )
    np.testing.assert_array_equal(found.axes, nominal.axes)
    assert np.abs(found.origins[:, :3, :3] - nominal.origins[:, :3, :3]).max() < 0.05


def crooked_arm(arm: Arm, rng: np.random.Generator) -> Arm:
    """An arm with the errors of a real robot: lengths 1 mm, angles 2 mrad."""
    return replace(
        arm,
        a_mm=arm.a_mm + rng.normal(0, 1, 6),
        d_mm=arm.d_mm + rng.normal(0, 1, 6),
        alpha_rad=arm.alpha_rad + rng.normal(0, 2e-3, 6),
        offset_rad=arm.offset_rad + rng.normal(0, 2e-3, 6),
        beta_rad=arm.beta_rad + rng.normal(0, 2e-3, 6),
    )


@pytest.mark.parametrize("axis", AXES)
def test_a_chain_beside_itself_is_itself(axis: Array) -> None:
    rng = np.random.default_rng(5)
    chain = random_chain(rng)
    chain.axes[:] = axis
    base, arm = chain.arm()
    found = Chain.of(base, arm).beside(chain)
    np.testing.assert_allclose(found.origins, chain.origins, atol=EXACT)
    np.testing.assert_allclose(found.tip, chain.tip, atol=EXACT)
