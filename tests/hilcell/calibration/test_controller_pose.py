"""The controller's pose is compared with that of its joints: other links, a tool or a base show."""

from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.controller_pose import check_links, check_pose
from hilcell.cell.file import load_cell
from hilcell.cell.robot import RobotTable
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array, DeviceError, HilcellError, RobotReading
from tests.hilcell.calibration.calibrations import calibration

ROBOT = load_cell("paper").robot
SAFE_RAD = np.radians(ROBOT.safe_deg)
BENT_RAD = np.radians([15.0, -95.0, 100.0, 20.0, -40.0, 10.0])


def with_joint(number: int, **changes: float) -> RobotTable:
    """Return the robot as a controller knows it whose joint ``number`` (from 1) differs."""
    joints = list(ROBOT.joint)
    joint = joints[number - 1]
    more = {key: getattr(joint, key) + by for key, by in changes.items()}
    joints[number - 1] = msgspec.structs.replace(joint, **more)
    return msgspec.structs.replace(ROBOT, joint=joints)


def reading(known: RobotTable, joints_rad: Array = BENT_RAD, **more: Any) -> RobotReading:
    return RobotReading(joints_rad, forward(known.arm(), joints_rad), True, 0.0, **more)


def refused(found: RobotReading) -> DeviceError:
    with pytest.raises(DeviceError) as error:
        check_pose(ROBOT, found, "park")
    assert error.value.code == "HC-B36"
    return error.value


@pytest.mark.parametrize("joints_rad", [SAFE_RAD, BENT_RAD])
def test_the_same_links_give_the_same_pose(joints_rad: Array) -> None:
    check_pose(ROBOT, reading(ROBOT, joints_rad), "park")


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_last_digits_of_a_robot_that_holds_still_are_no_difference(sign: float) -> None:
    """Joints and pose are rounded each by itself, and flicker."""
    found = reading(ROBOT)
    found.pose[:3, 3] += 0.002 * sign
    joints_rad = found.joints_rad + sign * np.radians(2e-4)
    check_pose(ROBOT, RobotReading(joints_rad, found.pose, True, 0.0), "park")


@pytest.mark.parametrize(
    ("number", "change", "name"),
    [
        (4, {"d_mm": 5.0}, "d_mm of joint 4"),
        (4, {"d_mm": -1.0}, "d_mm of joint 4"),
        (2, {"a_mm": 50.0}, "a_mm of joint 2"),
        (3, {"a_mm": 0.5}, "a_mm of joint 3"),
        (5, {"offset_deg": 0.2}, "offset_deg of joint 5"),
    ],
)
def test_the_length_or_angle_that_differs_is_named(
    number: int, change: dict[str, float], name: str
) -> None:
    fits = refused(reading(with_joint(number, **change))).fields["fits"]
    assert isinstance(fits, dict)
    (by,) = change.values()
    assert fits[name] == pytest.approx(by, abs=0.02)


def test_the_distance_is_stated_with_its_limit() -> None:
    fields = refused(reading(with_joint(4, d_mm=5.0))).fields
    assert fields["off_mm"] == pytest.approx(5.0, abs=0.001)
    assert 0.0 < float(str(fields["limit_mm"])) < 0.15


def test_several_lengths_that_differ_fit_nothing() -> None:
    joints = with_joint(4, d_mm=5.0).joint
    joints[1] = msgspec.structs.replace(joints[1], a_mm=joints[1].a_mm - 40.0, alpha_deg=3.0)
    other = msgspec.structs.replace(ROBOT, joint=joints)
    assert refused(reading(other)).fields["fits"] == {}


def test_a_tool_that_is_elsewhere_is_named() -> None:
    x, y, z = ROBOT.smr_mm
    other = msgspec.structs.replace(ROBOT, smr_mm=(x, y + 3.0, z))
    fits = refused(reading(other)).fields["fits"]
    assert isinstance(fits, dict)
    assert fits["smr_mm y"] == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize("place", [(0, 3), (1, 1)])
def test_what_is_no_number_is_refused(place: tuple[int, int]) -> None:
    found = reading(ROBOT)
    found.pose[place] = np.nan
    refused(found)


def test_links_measured_in_a_factory_may_differ_by_millimetres() -> None:
    check_pose(ROBOT, reading(with_joint(4, d_mm=1.2), by_factory_links=True), "park")
    limit_mm = refused(reading(with_joint(4, d_mm=40.0), by_factory_links=True)).fields["limit_mm"]
    assert limit_mm == 15.0


def test_cartesian_points_that_a_factory_s_links_solve_are_not_corrected() -> None:
    check_links(calibration(), "drill.script")
    with pytest.raises(HilcellError) as error:
        check_links(calibration(links="factory"), "drill.script")
    assert error.value.code == "HC-C10"
