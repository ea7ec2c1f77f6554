"""Position and orientation of the tool: predicted by several reflectors, and corrected."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.cell.file import load_cell
from hilcell.compensation.correction import corrected, corrected_poses
from hilcell.compensation.kinematic import Kinematic, seats_mm
from hilcell.compensation.model import (
    Measured,
    MeasuredArm,
    ModelError,
    PredictedOrientation,
    Prediction,
    StaticPoses,
)
from hilcell.compensation.residual import Pass, TargetResiduals, WithTargetResiduals
from hilcell.geometry.frames import from_rotvec, matrix, orientations, to_rotvec
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.geometry.statistics import lengths_mm
from hilcell.identification.measured_poses import Readings
from tests.hilcell.compensation.models import GRID, ORIENTED, drawn_mm, lattice, poses_at

SEATS = {"robot.more_smr_mm": "[[-40.0, 110.0, 127.0], [-40.0, -110.0, 127.0]]"}
CELL = load_cell("paper", SEATS)
ROBOT, NOMINAL_MM = CELL.robot.nominal(), CELL.robot.seats_mm
MOUNTED_MM = NOMINAL_MM + np.array([[0.3, -0.2, 0.1], [-6.0, 3.0, -5.0], [6.0, 2.0, 4.0]])
NOISE_MM = 0.01
seeds = st.integers(0, 2**32 - 1)


def crooked(seed: int) -> Arm:
    """Return an arm with errors of some millimetres and milliradians, in the same base."""
    rng = np.random.default_rng(seed)
    arm = ROBOT.arm
    return replace(
        arm,
        a_mm=arm.a_mm + rng.normal(0.0, 0.3, 6),
        d_mm=arm.d_mm + rng.normal(0.0, 0.3, 6),
        alpha_rad=arm.alpha_rad + rng.normal(0.0, 2e-4, 6),
        offset_rad=arm.offset_rad + rng.normal(0.0, 3e-4, 6),
    )


def flanges(arm: Arm, poses: Array) -> Array:
    """Return where the flange (N, 4, 4) goes when commanded to poses of the nominal tool."""
    return forward(replace(arm, tool=np.eye(4)), ROBOT.joints_for(poses))


def seen_mm(arm: Arm, poses: Array) -> Array:
    T = flanges(arm, poses)
    seen: Array = np.einsum("nij,kj->nki", T[:, :3, :3], MOUNTED_MM) + T[:, None, :3, 3]
    return seen


def measured(seed: int = 3, noise_mm: float = NOISE_MM) -> Measured:
    """Return the grid's 27 vertices and 16 more poses of a crooked arm, three reflectors each."""
    vertices = GRID.vertices_mm()
    points_mm = np.vstack([vertices.reshape(-1, 3), drawn_mm(1, 16)])
    poses = poses_at(points_mm)
    at_mm = seen_mm(crooked(seed), poses)
    at_mm += noise_mm * np.random.default_rng(seed).standard_normal(at_mm.shape)
    own_mm2 = np.broadcast_to(noise_mm**2 * np.eye(3), (*at_mm.shape, 3))
    grid = lattice(GRID, (at_mm[:27, 0] - points_mm[:27]).reshape(vertices.shape), noise_mm**2)
    joints_rad = ROBOT.joints_for(poses)
    static = StaticPoses.of(joints_rad, poses, at_mm[:, 0] - points_mm, own_mm2[:, 0])
    readings = Readings(joints_rad, at_mm, own_mm2)
    return Measured(static, grid, MeasuredArm(ROBOT, readings, NOMINAL_MM))


@pytest.fixture(scope="module")
def known() -> tuple[Kinematic, Array]:
    """Return the model of `measured`, and where it has the reflectors."""
    data = measured()
    return Kinematic.learn(data), seats_mm(data)


Known = tuple[Kinematic, Array]


@dataclass(frozen=True)
class Exact:
    """Predicts an arm's errors in full."""

    arm: Arm

    def predict(self, poses: Array) -> Prediction:
        T = forward(self.arm, ROBOT.joints_for(poses))
        turn = to_rotvec(T[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2))
        unknown = np.full((len(poses), 3, 3), np.nan)
        return Prediction(
            T[:, :3, 3] - poses[:, :3, 3], unknown, PredictedOrientation(turn, unknown)
        )


@given(seeds)
def test_position_and_orientation_vanish_on_an_arm_whose_errors_are_known(seed: int) -> None:
    rng, arm = np.random.default_rng(seed), crooked(seed)
    turns = from_rotvec(rng.normal(0.0, 0.1, (5, 3)))
    targets = matrix(turns @ ORIENTED[:3, :3], drawn_mm(seed, 5) * 0.9 + 0.1 * ORIENTED[:3, 3])
    commands = corrected_poses(GRID, targets, Exact(arm), steps=8)
    reached = forward(arm, ROBOT.joints_for(commands))
    assert lengths_mm(reached[:, :3, 3] - targets[:, :3, 3]).max() < 1e-9
    off_rad = to_rotvec(reached[:, :3, :3] @ np.swapaxes(targets[:, :3, :3], 1, 2))
    assert np.abs(off_rad).max() < 1e-9
    two = forward(arm, ROBOT.joints_for(corrected_poses(GRID, targets, Exact(arm))))
    assert lengths_mm(two[:, :3, 3] - targets[:, :3, 3]).max() < 0.02


def test_the_command_is_turned_back_by_the_predicted_turn() -> None:
    @dataclass(frozen=True)
    class Turned:
        def predict(self, poses: Array) -> Prediction:
            zero = np.zeros((len(poses), 3, 3))
            return Prediction(
                zero[:, 0],
                zero,
                PredictedOrientation(np.tile([0.0, 0.0, 1e-3], (len(poses), 1)), zero),
            )

    target = poses_at(drawn_mm(1, 1))
    (command,) = corrected_poses(GRID, target, Turned())
    turned = to_rotvec(command[:3, :3] @ target[0, :3, :3].T)
    np.testing.assert_allclose(turned, [0.0, 0.0, -1e-3], atol=1e-12)
    np.testing.assert_array_equal(corrected(GRID, target, Turned())[0], target[0, :3, 3])


def test_unseen_poses_are_predicted_in_orientation_within_their_bounds(known: Known) -> None:
    (model, seats), arm = known, crooked(3)
    poses = poses_at(drawn_mm(9, 60))
    found = model.predict(poses)
    assert found.orientation is not None
    # As a tracker without noise would see it, by the reflectors where they were identified.
    R = orientations(seats, seen_mm(arm, poses))
    turned = to_rotvec(R @ np.swapaxes(poses[:, :3, :3], 1, 2))
    left = turned - found.orientation.error_rad
    assert lengths_mm(turned).mean() > 1.5e-4
    assert lengths_mm(left).mean() < 3e-5
    squares = np.einsum(
        "ni,ni->n",
        left,
        np.linalg.solve(found.orientation.covariance_rad2, left[..., None])[..., 0],
    )
    assert squares.mean() / 3 < 2.0
    assert np.sqrt(np.trace(found.orientation.covariance_rad2, axis1=1, axis2=2)).max() < 3e-4


def test_the_tool_s_orientation_is_that_of_the_flange(known: Known) -> None:
    """By the reflectors' nominal places, which are millimetres off, it would be 40 mrad off.

    What is left are the last link's errors, which nothing tells from the mounting.
    """
    found = known[1]
    assert np.linalg.norm(to_rotvec(orientations(NOMINAL_MM, MOUNTED_MM[None]))) > 0.04
    turn = to_rotvec(orientations(MOUNTED_MM, found[None]))[0]
    assert np.linalg.norm(turn) < 6e-4


def test_a_reflector_that_was_not_seen_at_a_pose_is_left_out() -> None:
    data = measured()
    assert data.arm is not None
    unseen = np.zeros(data.arm.readings.known.shape, dtype=bool)
    unseen[5, 2] = True
    readings = data.arm.readings.without(unseen)
    model = Kinematic.learn(replace(data, arm=replace(data.arm, readings=readings)))
    assert model.predict(poses_at(drawn_mm(2, 1))).orientation is not None


def test_a_model_of_three_reflectors_comes_back_from_its_file(known: Known) -> None:
    model = known[0]
    kept = json.loads(json.dumps(model.parameters()))
    again = Kinematic.restore(GRID, np.zeros((3, 3, 3, 3)), kept)
    poses = poses_at(drawn_mm(2, 5))
    one, other = model.predict(poses), again.predict(poses)
    assert one.orientation is not None
    assert other.orientation is not None
    np.testing.assert_array_equal(one.error_mm, other.error_mm)
    np.testing.assert_array_equal(one.orientation.error_rad, other.orientation.error_rad)
    np.testing.assert_allclose(
        one.orientation.covariance_rad2, other.orientation.covariance_rad2, rtol=1e-12
    )
    assert again.parameters() == model.parameters()
    kept["more_reflectors_mm"][1] = kept["more_reflectors_mm"][0] = kept["reflector_mm"]
    with pytest.raises(ModelError, match="triangle"):
        Kinematic.restore(GRID, np.zeros((3, 3, 3, 3)), kept)


def test_targets_folded_in_leave_the_orientation() -> None:
    model, poses = Exact(crooked(1)), poses_at(drawn_mm(2, 3))
    zeros = np.zeros((3, 3))
    residuals = TargetResiduals([Pass(poses, zeros, np.tile(np.eye(3), (3, 1, 1)), np.eye(7))], 1.0)
    found, wanted = (
        WithTargetResiduals(model, residuals).predict(poses).orientation,
        model.predict(poses).orientation,
    )
    assert found is not None
    assert wanted is not None
    np.testing.assert_array_equal(found.error_rad, wanted.error_rad)


def test_one_reflector_tells_no_orientation_and_no_more_of_the_position(known: Known) -> None:
    data = measured()
    assert data.arm is not None
    one = replace(data.arm.readings, xyz_mm=data.arm.readings.xyz_mm[:, :1],
                  covariance_mm2=data.arm.readings.covariance_mm2[:, :1])  # fmt: skip
    alone = Kinematic.learn(replace(data, arm=MeasuredArm(ROBOT, one, NOMINAL_MM[:1])))
    poses, arm = poses_at(drawn_mm(9, 60)), crooked(3)
    assert alone.predict(poses).orientation is None
    wanted_mm = seen_mm(arm, poses)[:, 0] - poses[:, :3, 3]
    one_mm, three_mm = (
        lengths_mm(model.predict(poses).error_mm - wanted_mm).mean() for model in (alone, known[0])
    )
    assert three_mm < 1.1 * one_mm
    assert known[0].noise.pose_mm > 0.0
