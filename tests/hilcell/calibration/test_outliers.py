"""Vertices that stand out are found at the spread that the grid itself shows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.calibration.grid import Pairs, binned, outlying
from hilcell.cell.file import load_cell
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.jacobian import parameter_jacobian, parameters
from hilcell.geometry.kinematics import Array, forward

SHAPE = (4, 4, 4)


def field_mm(seed: int, spread_mm: float, shape: tuple[int, int, int] = SHAPE) -> Array:
    """Return a smooth error of a millimetre with normal deviations from it."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    smooth = np.stack([1 + x * y, z - 0.5 * x**2, y + 0.3 * z * z], axis=-1)
    return smooth + rng.normal(0.0, spread_mm, smooth.shape)


def found(errors_mm: Array, least_mm: float = 0.0) -> list[tuple[int, ...]]:
    return [tuple(map(int, at)) for at in np.argwhere(outlying(errors_mm, least_mm=least_mm))]


@pytest.mark.parametrize("spread_mm", [0.005, 0.06, 0.5])
def test_a_spike_of_eight_sigmas_is_found_and_nothing_else(spread_mm: float) -> None:
    """Whatever the size of the spread is, and at corners, edges, faces and inside."""
    for seed in range(5):
        for at in ((0, 0, 0), (0, 0, 1), (0, 2, 1), (1, 2, 1)):
            errors_mm = field_mm(seed, spread_mm)
            errors_mm[at] += spread_mm * np.array([-8.0, 8.0, 0.0])
            assert found(errors_mm) == [at]


@pytest.mark.parametrize("shape", [(3, 3, 3), (4, 4, 4), (3, 4, 7), (7, 7, 7)])
def test_sound_grids_raise_few_false_alarms(shape: tuple[int, int, int]) -> None:
    alarms = sum(len(found(field_mm(seed, 0.05, shape))) for seed in range(100))
    assert alarms <= 5  # 1 is expected


def test_a_smooth_field_has_none_however_small_the_deviations_are() -> None:
    assert found(field_mm(1, 0.0), least_mm=1e-9) == []


def test_less_than_a_reading_may_deviate_never_stands_out() -> None:
    errors_mm = field_mm(1, 0.001)
    errors_mm[1, 1, 1, 0] += 0.04
    assert found(errors_mm) == [(1, 1, 1)]
    assert found(errors_mm, least_mm=0.05) == []


CELL = load_cell("paper")
ARM = CELL.robot.arm()
LIMITS = CELL.robot.margin_limits_rad
HOME = np.radians(CELL.robot.home_deg)
seeds = st.integers(0, 2**32 - 1)


def test_the_difference_of_eq_8_is_in_mm() -> None:
    errors_mm = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 5.0]])
    pairs = Pairs.of(np.zeros((3, 6)), np.zeros((3, 3)), errors_mm)
    assert pairs.difference_mm.tolist() == [0.0, 2.0, 2.0]


def position_errors(joints: np.ndarray, seed: int) -> np.ndarray:
    """Return errors (N, 3) in {B} of a robot with random link errors."""
    rng = np.random.default_rng(seed)
    sigma = np.array([0.3 if "mm" in name else 3e-4 for name in parameters(ARM)])
    error: np.ndarray = parameter_jacobian(ARM, joints)[:, :3] @ rng.normal(0, sigma)
    return error


def pairs_of(joints: np.ndarray, seed: int) -> Pairs:
    return Pairs.of(joints, forward(ARM, joints)[:, :3, 3], position_errors(joints, seed))


def free_joints(rng: np.random.Generator, count: int = 300) -> np.ndarray:
    return rng.uniform(LIMITS[0], LIMITS[1], (count, 6))


def fixed_joints(rng: np.random.Generator, count: int = 300) -> np.ndarray:
    """Return joints of random points of the cube, all with one orientation and status."""
    poses = np.tile(CELL.grid.centre.matrix(), (count, 1, 1))
    poses[:, :3, 3] += rng.uniform(-450, 450, (count, 3))
    return NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).joints_for(poses)


def clouds(rng: np.random.Generator) -> np.ndarray:
    """Return joints in clouds, so that pairs of every distance from near to far exist."""
    centres = free_joints(rng, 20)
    return (centres[:, None] + rng.normal(0, 0.05, (20, 15, 6))).reshape(-1, 6)


@settings(max_examples=10)
@given(seeds)
def test_similarity_falls_with_joint_distance(seed: int) -> None:
    pairs = pairs_of(clouds(np.random.default_rng(seed)), seed)
    edges = np.array([0.0, 0.1, 0.2, 0.4, 20.0])
    _, difference_mm, count = binned(pairs.joint_rad, pairs.difference_mm, edges)
    known_mm = difference_mm[count > 20]
    assert len(known_mm) >= 3
    assert (np.diff(known_mm) > 0).all()
    assert known_mm[-1] > 4 * known_mm[0]  # far poses differ alike, however far


@settings(max_examples=8)
@given(seeds)
def test_at_one_orientation_and_configuration_points_stand_for_joints(seed: int) -> None:
    pairs = pairs_of(fixed_joints(np.random.default_rng(seed)), seed)
    for distance in (pairs.joint_rad, pairs.cartesian_mm):
        _, found_mm, _ = binned(distance, pairs.difference_mm, np.quantile(distance, QUARTERS))
        assert (np.diff(found_mm) > 0).all()
    assert np.corrcoef(pairs.joint_rad, pairs.cartesian_mm)[0, 1] > 0.7


QUARTERS = np.linspace(0, 1, 5)


def test_at_free_orientation_and_configuration_they_do_not() -> None:
    """Poses of one point differ in their errors as poses of far points do."""
    rng = np.random.default_rng(5)
    joints = np.vstack([same_point(rng) for _ in range(40)])
    pairs = pairs_of(joints, 5)
    edges_mm, edges_rad = np.array([0.0, 1.0, 200.0, 4000.0]), np.array([0.0, 0.3, 20.0])
    _, point_mm, _ = binned(pairs.cartesian_mm, pairs.difference_mm, edges_mm)
    same = pairs.cartesian_mm < 1.0
    _, joint_mm, count = binned(pairs.joint_rad[same], pairs.difference_mm[same], edges_rad)
    assert (count > 100).all()
    assert point_mm[-1] < 2 * point_mm[0]
    assert joint_mm[1] > 4 * joint_mm[0]


def same_point(rng: np.random.Generator) -> np.ndarray:
    """Return joints (8, 6) that bring the tool to one point, by orientations of two kinds."""
    pose = CELL.grid.centre.matrix()
    pose[:3, 3] += rng.uniform(-300, 300, 3)
    turned = np.tile(pose, (8, 1, 1))
    roll = np.radians([0, 1, 2, 3, 178, 179, 180, 181])
    turn = np.zeros((8, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(roll)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(roll), -np.sin(roll), 1.0
    turned[:, :3, :3] = turned[:, :3, :3] @ turn
    return NominalRobot(ARM, CELL.robot.status, LIMITS, HOME).joints_for(turned)
