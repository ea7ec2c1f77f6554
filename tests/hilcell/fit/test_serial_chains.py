"""Fits of chains other than six revolute axes: the truth is recovered within its uncertainty."""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hilcell.fit.measurements import Measurements
from hilcell.fit.methods import RobotFit, fit_robot
from hilcell.fit.rigid_arm import rigid_arm, urdf_bytes, write_dh
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import apply, apply_each, pose_from_zyx
from hilcell.geometry.kinematics import Array, forward
from hilcell.ports import HilcellError
from hilcell.programs.pose_correction import PoseCorrection
from tests.hilcell.fit.urdfs import reached_m

T_L_B = pose_from_zyx(2200, -150, -600, 170, 2, -1)
SMR_MM = {"SMR1": [0.2, -0.8, 120.5], "SMR2": [75.2, 90.6, 213.4]}
NOISE_MM = 0.02  # of each coordinate
PITCH = 2e-4  # error of a prismatic joint's way
SIX = [[1250, 0, 0, 0], [-55, -90, 0, -90], [0, 90, 1500, 0], [0, -90, 0, 0], [0, 0, 215, 180]]
FIRST = [350, -90, 675, 0]
SIX_RAD = (2.0, 0.6, 0.7, 2.5, 1.5, 2.5)


@dataclass(frozen=True, eq=False)
class Chain:
    """A nominal robot, one with errors of 1 mm or so, and how far its joints move, rad or m."""

    robot: Robot
    spread_rad: tuple[float, ...]

    def joints(self, seed: int, poses: int) -> Array:
        drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, (poses, len(self.spread_rad)))
        return np.asarray(drawn * self.spread_rad)

    def reached_mm(self, joints_rad: Array, smr_mm: Array) -> Array:
        """Where the true robot has reflectors (N, 3), in the tracker's frame."""
        arm, rng = self.robot.arm, np.random.default_rng(99)
        errors = rng.normal(0.0, [[0.3], [0.3], [5e-4], [5e-4], [3e-4]], (5, len(arm)))
        true = replace(
            arm,
            a_mm=arm.a_mm + errors[0],
            d_mm=arm.d_mm + errors[1],
            alpha_rad=arm.alpha_rad + errors[2],
            offset_rad=arm.offset_rad + errors[3],
            beta_rad=arm.beta_rad + errors[4],
        )
        landed = joints_rad * np.where(arm.turning, 1.0, 1.0 + PITCH)
        return apply_each(T_L_B @ self.robot.base @ forward(true, landed), smr_mm)

    def measured(self, seed: int, poses: int, targets: list[str]) -> Measurements:
        joints = np.repeat(self.joints(seed, poses), len(targets), axis=0)
        xyz_mm = self.reached_mm(joints, np.array([SMR_MM[each] for each in targets * poses]))
        xyz_mm += NOISE_MM * np.random.default_rng([seed, 1]).standard_normal(xyz_mm.shape)
        labels = [str(n // len(targets)) for n in range(len(joints))]
        return Measurements.from_arrays(joints, xyz_mm, targets * poses, labels)


CHAINS = {
    "seven axes": Chain(
        Robot.from_dh(
            "LBR iiwa",
            [
                *([0, -90, 360, 0], [0, 90, 0, 0], [0, 90, 420, 0], [0, -90, 0, 0]),
                *([0, -90, 400, 0], [0, 90, 0, 0], [0, 0, 126, 0]),
            ],
        ),
        (2.6, 1.8, 2.6, 1.8, 2.6, 1.8, 2.9),
    ),
    "SCARA": Chain(
        Robot.from_dh(
            "SCARA",
            [[325, 0, 200, 0], [275, 180, 0, 0], [0, 0, 50, 0], [0, 0, 0, 0]],
            prismatic=[False, False, True, False],
        ),
        (2.0, 2.0, 0.1, 2.8),
    ),
    "on a rail": Chain(
        Robot.from_dh("on a rail", [[0, 90, 0, 90], FIRST, *SIX], prismatic=[True] + 6 * [False]),
        (2.5, *SIX_RAD),
    ),
    "gantry": Chain(
        Robot.from_dh("gantry", [[0, -90, 0, -90]] * 2 + [[0, 0, 0, 0]], prismatic=True),
        (2.0, 1.0, 0.5),
    ),
    "on a column": Chain(
        Robot.from_dh("on a column", [[0, 0, 500, 0], FIRST, *SIX], prismatic=[True] + 6 * [False]),
        (0.8, *SIX_RAD),
    ),
    "modified, five axes": Chain(
        Robot.from_dh(
            "modified",
            [
                *([0, 0, 300, 0], [50, -90, 0, 0], [400, 0, 0, 0]),
                *([350, 0, 0, -90], [0, -90, 80, 0]),
            ],
            convention="modified-dh",
        ),
        (2.0, 0.9, 0.9, 1.2, 2.5),
    ),
}
every_chain = pytest.mark.parametrize("name", CHAINS)


@cache
def fitted(name: str) -> RobotFit:
    chain = CHAINS[name]
    return fit_robot(chain.robot, chain.measured(1, 90, ["SMR2"]))


@every_chain
def test_other_poses_are_predicted_within_the_uncertainty(name: str) -> None:
    chain, fit = CHAINS[name], fitted(name)
    joints = chain.joints(2, 200)
    found = fit.predict(joints, "SMR2")
    true_mm = chain.reached_mm(joints, np.array(SMR_MM["SMR2"]))
    missed_mm = np.linalg.norm(found.xyz_mm - true_mm, axis=1)
    assert missed_mm.mean() < NOISE_MM
    # A bound is of a reading, whose noise is in it.
    assert (missed_mm <= found.bound95_mm).mean() > 0.9
    methods = fit.result["methods"]
    assert methods["nominal"]["mean_mm"] > 0.15
    assert methods[fit.chosen]["mean_mm"] < 2.0 * NOISE_MM


@every_chain
def test_corrected_joints_bring_the_tool_to_its_targets(name: str) -> None:
    chain, correction = CHAINS[name], PoseCorrection.of(fitted(name), "SMR2")
    joints = 0.5 * chain.joints(3, 20)
    joints[:, chain.robot.arm.turning != 0.0] += 0.3  # away from a stretched arm
    corrected = correction.of_joints(joints)
    wanted_mm = apply(correction.controller.root, corrected.nominal[:, :3, 3])
    smr_mm = np.array(SMR_MM["SMR2"])
    before_mm, after_mm = (
        np.linalg.norm(chain.reached_mm(each, smr_mm) - wanted_mm, axis=1)
        for each in (joints, corrected.command_rad())
    )
    assert before_mm.mean() > 0.1
    assert after_mm.max() < 0.05
    if len(joints[0]) != 6:
        with pytest.raises(HilcellError, match=r"joints of .* give joints"):
            correction.of_poses(corrected.nominal)


def test_the_arm_on_a_rail_is_written_as_one_chain(tmp_path: Path) -> None:
    robot, arm = CHAINS["on a rail"].robot, rigid_arm(fitted("on a rail"))
    write_dh(tmp_path / "dh.json", robot, arm, inputs=[])
    table = json.loads((tmp_path / "dh.json").read_text())
    assert (len(table["parameters"]), table["prismatic"]) == (35, [1])
    (tmp_path / "c.urdf").write_bytes(urdf_bytes(robot, arm, [""]))
    text = (tmp_path / "c.urdf").read_text()
    for joints in CHAINS["on a rail"].joints(4, 5):
        reached = reached_m(text, {f"joint_{n}": q for n, q in enumerate(joints, start=1)})
        reached[:3, 3] *= 1000.0
        np.testing.assert_allclose(reached, forward(arm.arm, joints), atol=1e-8)


def test_a_coupled_axis_is_an_option_of_the_robot(tmp_path: Path) -> None:
    """An arm whose controller counts its joint 3 against the ground, on a rail."""
    chain = CHAINS["on a rail"]
    coupled = replace(chain.robot, arm=replace(chain.robot.arm, coupling=1.0))
    plain = chain.measured(1, 50, ["SMR1"])
    rows = replace(plain, joints_rad=plain.joints_rad.copy())
    rows.joints_rad[:, 3] -= plain.joints_rad[:, 2]
    fit = fit_robot(coupled, rows)
    found = fit.predict(rows.joints_rad, "SMR1").xyz_mm
    assert np.linalg.norm(found - plain.xyz_mm, axis=1).mean() < 2.0 * NOISE_MM
    (tmp_path / "c.urdf").write_bytes(urdf_bytes(coupled, rigid_arm(fit), [""]))
    assert "J4 + J3" in (tmp_path / "c.urdf").read_text()
