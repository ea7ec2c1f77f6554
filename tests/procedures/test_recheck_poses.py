"""Poses of a re-check: turned where the calibration corrects other orientations than the grid's."""

import msgspec
import numpy as np
import pytest

from hilcell.cell.file import load_cell
from hilcell.geometry.frames import turned_deg
from hilcell.geometry.kinematics import forward
from procedures.recheck import commands_rad
from tests.hilcell.calibration.calibrations import calibration

CELL = load_cell("paper")


@pytest.mark.parametrize(
    ("tolerance_deg", "wanted_deg"),
    [(2.0, [0.0] * 7), (30.0, [0.0, 27.0, 0.0, 27.0, 0.0, 27.0, 0.0])],
)
def test_every_other_pose_is_turned(tolerance_deg: float, wanted_deg: list[float]) -> None:
    made = calibration()
    validity = msgspec.structs.replace(made.validity, orientation_tolerance_deg=tolerance_deg)
    made = msgspec.structs.replace(made, validity=validity)
    poses = forward(CELL.robot.arm(), commands_rad(CELL, made, 3))
    found_deg = turned_deg(np.array(validity.orientation), poses)
    np.testing.assert_allclose(found_deg, wanted_deg, atol=1e-4)
