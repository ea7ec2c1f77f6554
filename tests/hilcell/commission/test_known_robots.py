"""Robots as sold: their files against the chains that others publish."""

import itertools
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilcell.cell.file import load_cell
from hilcell.commission.known_robots import KnownRobot, known_robots, stated_robot
from hilcell.geometry.inverse import NominalRobot, joint_jacobian, status_of
from hilcell.geometry.kinematics import Array, forward
from hilcell.identity import Identity

CHAINS = tomllib.loads(Path(__file__).with_name("robot_chains.toml").read_text())
ROBOTS = known_robots("kuka") | known_robots("ur") | known_robots("abb")
EACH = pytest.mark.parametrize("known", ROBOTS.values(), ids=ROBOTS)


def fixed(part: dict[str, Any]) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", part["turned_deg"], degrees=True).as_matrix()
    T[:3, 3] = part["at_mm"]
    return T


def flange_of(chain: dict[str, Any], joints_rad: Array) -> Array:
    """Return the flange in {B} by a chain of origins and axes."""
    T = np.eye(4)
    for joint, angle in zip(chain["joint"], joints_rad, strict=True):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(np.array(joint["axis"]) * angle).as_matrix()
        T = T @ fixed(joint) @ turn
    return T @ fixed(chain["flange"])


def some_joints(known: KnownRobot, count: int) -> Array:
    """Return joints within their limits, of the revolution that a status is of."""
    low, high = known.robot.nominal().limits_rad.clip(-np.pi, np.pi)
    return np.random.default_rng(7).uniform(low, high, (count, 6))


def vertices(known: KnownRobot) -> Array:
    grid = known.grid
    edges = [
        np.linspace(-size / 2, size / 2, cells + 1)
        for size, cells in zip(grid.size_mm, grid.cells, strict=True)
    ]
    corners = np.array(list(itertools.product(*edges)))
    T = np.tile(np.eye(4), (len(corners), 1, 1))
    T[:, :3, 3] = corners
    return np.asarray(grid.centre.matrix() @ T)


def test_all_have_a_chain() -> None:
    assert set(CHAINS) == set(ROBOTS)


@EACH
def test_forward_kinematics_are_those_of_the_published_chain(known: KnownRobot) -> None:
    chain, joints = CHAINS[known.robot.name], some_joints(known, 50)
    published = np.array([flange_of(chain, each) for each in joints])
    smr = np.eye(4)
    smr[:3, 3] = known.robot.smr_mm
    np.testing.assert_allclose(forward(known.robot.arm(), joints), published @ smr, atol=1e-6)


@EACH
def test_inverse_kinematics_return_the_joints(known: KnownRobot) -> None:
    arm, joints = known.robot.arm(), some_joints(known, 200)
    regular = np.abs(np.linalg.det(joint_jacobian(arm, joints))) > 1e4
    assert regular.mean() > 0.9
    for q, status in zip(joints[regular], status_of(arm, joints[regular]), strict=True):
        nominal = NominalRobot(arm, int(status), known.robot.nominal().limits_rad, q)
        np.testing.assert_allclose(nominal.joints_for(forward(arm, q)), q, atol=1e-7)


@EACH
def test_cube_and_circles_are_within_limits_in_one_posture(known: KnownRobot) -> None:
    robot, frame = known.robot, known.base_frame
    arm, (low, high) = robot.arm(), robot.nominal().limits_rad
    joints = robot.nominal().joints_for(vertices(known))  # raises where one is out of reach
    assert (status_of(arm, joints) == robot.status).all()
    assert np.degrees(np.abs(joints[:, 4])).min() > 15.0
    ends = [list(frame.axis_1_deg), list(frame.axis_6_deg)]
    rows = []
    for row, axis, sweep in zip(
        ends, (0, 5), (frame.axis_1_sweep_deg, frame.axis_6_sweep_deg), strict=True
    ):
        rows += [[*row[:axis], end, *row[axis + 1 :]] for end in sweep]
    circles = np.radians([*rows, robot.home_deg, robot.safe_deg])
    assert ((circles >= low) & (circles <= high)).all()
    assert (status_of(arm, circles) == robot.status).all()


@pytest.mark.parametrize("name", [name for name in ROBOTS if " R" in name])
def test_a_kuka_reaches_as_far_as_its_name_says(name: str) -> None:
    joint = ROBOTS[name].robot.joint
    reach_mm = joint[0].a_mm + joint[1].a_mm + np.hypot(joint[2].a_mm, joint[3].d_mm)
    assert reach_mm == pytest.approx(float(name.partition(" R")[2][:4].split()[0]), abs=12.0)


@pytest.mark.parametrize("cell", ["paper", "unknown", "lab", "abb"])
def test_robots_of_built_in_cells_are_the_same(cell: str) -> None:
    robot = load_cell(cell).robot
    assert ROBOTS[robot.name].robot.joint == robot.joint


@pytest.mark.parametrize(
    ("driver", "model", "software", "name"),
    [
        ("kuka-c3", "#KR210R2700_2 C4 FLR", "", "KR 210 R2700-2"),
        ("kuka-eki", "#KR210R2700 EXTRA C4 FLR", "", "KR 210 R2700 extra"),
        ("kuka-c3", "#KR6R900 SIXX C4 FLR", "", "KR 6 R900 sixx"),
        ("kuka-c3", "#KR210R2700 PRIME C4 FLR", "", None),
        ("kuka-c3", "", "", None),
        ("ur-rtde", "UR10", "URSoftware 3.12.0.1101319", "UR10"),
        ("ur-rtde", "UR10", "URSoftware 5.12.0.1101319", "UR10e"),
        ("ur-rtde", "UR3", "URSoftware 5.6.0", "UR3e"),
        ("ur-rtde", "UR30", "URSoftware 5.15.0", "UR30"),
        ("ur-rtde", "UR10", "version unknown", None),
        ("ur-rtde", "UR10", "PolyScope 10.7.0", None),
        ("ur-rtde", "UR15", "URSoftware 5.20.0", None),
        ("abb-egm", "IRB 6700-235/2.65 Type A", "RobotWare 6.15", "IRB 6700-235/2.65"),
        ("abb-egm", "IRB 6700-150/3.20", "RobotWare 6.15", None),
    ],
)
def test_a_robot_is_the_one_that_its_controller_states(
    driver: str, model: str, software: str, name: str | None
) -> None:
    found = stated_robot(known_robots(driver), Identity("Robot", model, firmware=software))
    assert (found and found.robot.name) == name


def test_the_page_names_them() -> None:
    page = (Path(__file__).parents[3] / "docs/hardware.md").read_text()
    listed = "; ".join(", ".join(known_robots(maker)) for maker in ("kuka", "ur", "abb"))
    assert f"nominal kinematics of {listed} (" in page


def test_a_maker_without_robots_has_none() -> None:
    assert known_robots("another-maker") == {}
