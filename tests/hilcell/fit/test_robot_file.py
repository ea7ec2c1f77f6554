"""Robot file: strict, all problems at once."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from hilcell.cell.file import load_cell
from hilcell.cell.settings import SettingsError
from hilcell.compensation.targets import read_targets
from hilcell.fit.robot_file import Robot, read_dh

ROW = "[[robot.joint]]\na_mm = 10\nalpha_deg = -90.0\nd_mm = 20.5\noffset_deg = 0\n"
ROBOT = '[robot]\nname = "arm"\nconvention = "standard-dh"\n'
Write = Callable[[str], Path]


def file_problems(read: Callable[[Path], object], path: Path) -> str:
    with pytest.raises(SettingsError) as caught:
        read(path)
    return str(caught.value)


def test_robot_is_read(written: Write) -> None:
    arm = read_dh(written(ROBOT + 5 * ROW + ROW + "sign = -1\n")).arm
    np.testing.assert_array_equal(arm.a_mm, 6 * [10.0])
    np.testing.assert_array_equal(arm.d_mm, 6 * [20.5])
    np.testing.assert_allclose(arm.alpha_rad, 6 * [-np.pi / 2])
    np.testing.assert_array_equal(arm.sign, [1, 1, 1, 1, 1, -1])
    np.testing.assert_array_equal(arm.tool, np.eye(4))


@given(st.integers(0, 2**32 - 1))
def test_modified_rows_are_the_product_of_their_motions(seed: int) -> None:
    """Of any chain, against Craig's product, written with independent rotations."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 10))
    rows, q = rng.uniform(-180, 180, (count, 4)), rng.uniform(-1, 1, count)
    prismatic, sign = rng.uniform(size=count) < 0.4, rng.choice([-1.0, 1.0], count)
    robot = Robot.from_dh("any", rows, sign, prismatic=prismatic, convention="modified-dh")
    wanted = RigidTransform.identity()
    for (a_mm, alpha_deg, d_mm, offset_deg), each, shifts in zip(
        rows, sign * q, prismatic, strict=True
    ):
        turn_deg, shift_mm = (0.0, 1000 * each) if shifts else (np.degrees(each), 0.0)
        for axis, length_mm, angle_deg in (
            (0, a_mm, alpha_deg),
            (2, d_mm + shift_mm, offset_deg + turn_deg),
        ):
            turn = Rotation.from_euler("xyz"[axis], angle_deg, degrees=True)
            wanted *= RigidTransform.from_components(length_mm * np.eye(3)[axis], turn)
    np.testing.assert_allclose(robot.poses(q), wanted.as_matrix(), atol=1e-9)


def test_a_rail_and_a_coupled_axis_are_read(written: Write) -> None:
    rail = ROW + 'type = "prismatic"\n'
    robot = read_dh(written(ROBOT + rail + 6 * ROW))
    assert robot.arm.prismatic == (0,)
    assert robot.joint_columns == ["j1_mm", *(f"j{n}_deg" for n in range(2, 8))]
    np.testing.assert_array_equal(robot.column_units, [1e-3, *6 * [np.pi / 180]])
    assert read_dh(written(ROBOT + "coupling = -1\n" + 6 * ROW)).arm.coupling == -1.0


def test_a_byte_order_mark_is_taken_in_every_file(written: Write, tmp_path: Path) -> None:
    assert read_dh(written("\ufeff" + ROBOT + 6 * ROW)).name == "arm"
    targets = "\ufeffname,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\nH1,1,2,3,0,0,0\n"
    assert read_targets(written(targets))[0] == ["H1"]
    built_in = (resources.files("hilcell.cells") / "paper.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text("\ufeff" + built_in, "utf-8")
    assert load_cell(str(tmp_path / "cell.toml")).digest == load_cell("paper").digest


def test_all_problems_of_a_robot_come_at_once(written: Write) -> None:
    text = (ROBOT + 6 * ROW).replace("standard-dh", "screws").replace("a_mm = 10", "a_m = 10", 1)
    said = file_problems(read_dh, written(text.replace("d_mm = 20.5", "d_mm = nan", 1)))
    assert "robot.convention" in said
    for key in ("a_m", "a_mm", "d_mm"):
        assert f"robot.joint[0].{key}: " in said


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (ROBOT + "joint = []\n", "robot: expected 1 to 9 joints, got 0"),
        (ROBOT + 10 * ROW, "robot: expected 1 to 9 joints, got 10"),
        (ROBOT + 6 * ROW + 'type = "helical"\n', "robot.joint[5].type"),
        (ROBOT + "coupling = 2\n" + 6 * ROW, "robot.coupling"),
        (ROBOT + "coupling = 1\n" + 2 * ROW, "at least 3 revolute joints, got 2"),
        (ROBOT + "coupling = 1\n" + 3 * ROW + 'type = "prismatic"\n', "3 revolute joints, got 2"),
        (ROBOT + 5 * ROW + ROW + "sign = 0\n", "joint 6: sign"),
        (ROBOT + 5 * ROW + ROW + "sign = 2\n", "robot.joint[5].sign"),
        (ROBOT.replace('"arm"', "3") + 6 * ROW, "robot.name"),
        (ROBOT + (6 * ROW).replace("d_mm = 20.5", "d_mm = 1e308", 1), "robot.joint[0].d_mm"),
        (ROBOT + (6 * ROW).replace("-90.0", "-1e308", 1), "robot.joint[0].alpha_deg"),
        ("[robot\n", "TOML"),
        ("", "robot: "),
    ],
)
def test_robot_is_refused(written: Write, text: str, says: str) -> None:
    assert says in file_problems(read_dh, written(text))


def test_missing_files_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.toml", tmp_path):
        assert file_problems(read_dh, path)
