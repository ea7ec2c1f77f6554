"""Targets of a robot: joints for poses in the posture that was measured, and files of both."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import write_rows
from hilcell.fit.robot_file import Robot
from hilcell.geometry.frames import pose_from_zyx, zyx_from_pose
from hilcell.geometry.kinematics import forward
from hilcell.ports import HilcellError
from hilcell.programs.pose_correction import Reach, joint_header, joint_rows, read_list, shifted
from tests.hilcell.identification.robots import ARM, MIDDLE_RAD
from tests.hilcell.lists import write_targets

BASE = pose_from_zyx(100, -200, 300, 20, 5, -5)


def reach(spread_rad: float = 0.5) -> Reach:
    rng = np.random.default_rng(1)
    known = MIDDLE_RAD + rng.uniform(-spread_rad, spread_rad, (50, 6))
    tool = pose_from_zyx(100.0, 20.0, 150.0, 0.0, 0.0, 0.0)
    return Reach(Robot("arm", ARM, BASE, tool), known)


def joints(count: int) -> np.ndarray:
    return np.asarray(MIDDLE_RAD + np.random.default_rng(2).uniform(-0.5, 0.5, (count, 6)))


def test_the_tool_point_is_where_the_tool_frame_says() -> None:
    tool = pose_from_zyx(1, 2, 3, 90, 0, 0)
    found = shifted(tool, np.array([10.0, 0.0, 5.0]))
    np.testing.assert_allclose(found[:3, 3], [1, 12, 8], atol=1e-12)
    np.testing.assert_array_equal(found[:3, :3], tool[:3, :3])


def test_a_pose_takes_the_posture_of_the_nearest_measured_one() -> None:
    wanted = joints(30)
    found = reach().joints(reach().poses(wanted), [""] * 30)
    np.testing.assert_allclose(found, wanted, atol=1e-8)


def test_a_pose_out_of_reach_is_refused() -> None:
    far = reach().poses(joints(3))
    far[1, :3, 3] += 9000.0
    with pytest.raises(HilcellError, match=r"1 of 3 .*: b"):
        reach().joints(far, list("abc"))


def test_another_posture_is_not_taken() -> None:
    wanted = joints(4)
    wanted[2, 3:] += [np.pi, 0.0, np.pi]
    wanted[2, 4] *= -1.0  # the wrist flipped: the same pose
    here = replace(reach(), known_rad=wanted[2:3])
    found = here.joints(here.poses(joints(4))[2:3], ["c"])
    np.testing.assert_allclose(found, wanted[2:3], atol=1e-7)


def test_poses_are_refused_where_several_postures_were_measured() -> None:
    flipped = reach().known_rad.copy()
    flipped[:, 3:] += [np.pi, 0.0, -np.pi]
    flipped[:, 4] *= -1.0
    here = replace(reach(), known_rad=np.concatenate([reach().known_rad, flipped]))
    with pytest.raises(HilcellError, match="postures"):
        here.joints(here.poses(joints(2)), ["a", "b"])


def test_joints_near_others_reach_the_corrected_pose() -> None:
    start = joints(5)
    poses = reach().poses(start)
    poses[:, :3, 3] += [0.5, -0.3, 0.2]
    found = reach().near(poses, start, list("abcde"))
    np.testing.assert_allclose(reach().poses(found), poses, atol=1e-6)
    assert 0 < np.abs(found - start).max() < 5e-3


def test_joints_in_a_singular_wrist_are_named() -> None:
    start = joints(2)
    start[1, 4] = 1e-5
    poses = reach().poses(start)
    poses[:, :3, 3] += [0.0, 2.0, 0.0]
    with pytest.raises(HilcellError, match=r"1 of 2 .*5 deg: b"):
        reach().near(poses, start, ["a", "b"])


def test_poses_are_read_and_written(tmp_path: Path) -> None:
    poses = reach().poses(joints(3))
    write_targets(tmp_path / "t.csv", list("abc"), zyx_from_pose(poses))
    names, found, joints_rad, as_joints = read_list(tmp_path / "t.csv", reach())
    assert (names, as_joints) == (list("abc"), False)
    np.testing.assert_allclose(found, poses, atol=1e-4)
    np.testing.assert_allclose(joints_rad, joints(3), atol=1e-6)


def test_joints_are_read_and_written(tmp_path: Path) -> None:
    robot = reach().robot
    write_rows(tmp_path / "t.csv", joint_header(robot), joint_rows(robot, list("abc"), joints(3)))
    names, found, joints_rad, as_joints = read_list(tmp_path / "t.csv", reach())
    assert (names, as_joints) == (list("abc"), True)
    np.testing.assert_allclose(joints_rad, joints(3), atol=1e-8)
    wanted = BASE @ forward(reach().arm, joints(3))
    np.testing.assert_allclose(found, wanted, atol=1e-4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "header"),
        ("name,j1\na,1\n", "header"),
        ("name,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg\n", "no targets"),
        ("name,j1_deg,j2_deg,j3_deg,j4_deg,j5_deg,j6_deg\na,1,2,nan,4,5,6\n", "j3_deg"),
    ],
)
def test_odd_lists_are_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(SettingsError, match=says):
        read_list(tmp_path / "t.csv", reach())
