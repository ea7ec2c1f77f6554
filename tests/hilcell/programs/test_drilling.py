"""The arm keeps clear of the box that carries the holes, but for its wrist and its tool."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.cell.surroundings import KeepOut
from hilcell.cell.tables import Pose
from hilcell.geometry.frames import apply
from hilcell.geometry.inverse import NominalRobot
from hilcell.geometry.kinematics import forward, link_transforms
from hilcell.ports import Array
from hilcell.programs.drilling import Clearance, WorkPiece

CELL = load_cell("paper")
STATION = CELL.station_named("S1100")
ARM = CELL.robot.arm()
T_W_B = CELL.layout.nominal_base(STATION.rail_mm)
HOME_RAD = np.radians(CELL.robot.home_deg)
UP = np.array([0.0, 0.0, 1.0])
HALF_MM = 100.0


def clearance(at_mm: Array) -> Clearance:
    """Return that beside a box about a place in {W}, with one hole on its top."""
    x_mm, y_mm, z_mm = at_mm.tolist()
    box = KeepOut(
        name="jig",
        centre=Pose(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm),
        size_mm=(2.0 * HALF_MM, 2.0 * HALF_MM, 2.0 * HALF_MM),
    )
    cell = msgspec.structs.replace(CELL, keep_out=[box])
    hole = WorkPiece((at_mm + HALF_MM * UP)[None], UP[None])
    return Clearance(cell, STATION, ARM, T_W_B, hole, 50.0)


def end_mm(link: int) -> Array:
    """Return where a link ends (3,), in {W}."""
    ends = np.linalg.multi_dot([T_W_B, *link_transforms(ARM, HOME_RAD)[:link]])
    return np.asarray(ends[:3, 3], dtype=float)


@pytest.mark.parametrize("link", [2, 3])
def test_the_arm_keeps_clear_of_the_box_that_carries_the_holes(link: int) -> None:
    found = clearance(end_mm(link)).refusal(HOME_RAD, HOME_RAD)
    assert found.startswith("link ")
    assert "keep-out jig" in found


def test_wrist_and_tool_work_close_to_it() -> None:
    tip_mm = apply(T_W_B, forward(ARM, HOME_RAD)[None, :3, 3])[0]
    assert clearance(tip_mm - (HALF_MM + 60.0) * UP).refusal(HOME_RAD, HOME_RAD) == ""


def straight(*boxes: KeepOut, aside_mm: float = 0.0) -> str:
    """Return why a straight path along the tool's z to a hole is refused; a second hole may lie 40
    mm in front of it, ``aside_mm`` beside.
    """
    T = forward(ARM, HOME_RAD)
    outward = -T[:3, 2]
    poses = np.tile(T, (11, 1, 1))
    poses[:, :3, 3] += np.linspace(100.0, 0.0, 11)[:, None] * outward
    robot = CELL.robot
    joints_rad = NominalRobot(ARM, robot.status, robot.margin_limits_rad, HOME_RAD).joints_for(
        poses
    )
    holes = apply(T_W_B, T[None, :3, 3])
    normals = np.array([T_W_B[:3, :3] @ outward])
    if aside_mm:
        other = holes + 40.0 * normals + aside_mm * (T_W_B[:3, :3] @ T[:3, 1])
        holes, normals = np.concatenate([holes, other]), np.tile(normals, (2, 1))
    cell = msgspec.structs.replace(CELL, keep_out=list(boxes) or CELL.keep_out)
    return Clearance(cell, STATION, ARM, T_W_B, WorkPiece(holes, normals), 50.0).straight_refusal(
        joints_rad
    )


def test_a_straight_way_keeps_in_front_of_the_plane_of_other_holes() -> None:
    assert straight() == ""
    assert straight(aside_mm=200.0) == ""
    assert "inside the part on its straight path" in straight(aside_mm=10.0)


def test_the_line_from_flange_to_tip_keeps_out_of_boxes_on_the_straight_way() -> None:
    T = forward(ARM, HOME_RAD)
    middle_mm = apply(T_W_B, (T @ np.linalg.inv(ARM.tool))[None, :3, 3] / 2 + T[None, :3, 3] / 2)
    x_mm, y_mm, z_mm = middle_mm[0].tolist()
    clamp = KeepOut(
        name="clamp",
        centre=Pose(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm),
        size_mm=(10.0, 10.0, 10.0),
    )
    assert straight(clamp) == "the tool passes through keep-out clamp"
