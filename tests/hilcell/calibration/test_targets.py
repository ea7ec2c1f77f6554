"""Which targets a calibration corrects, and which it refuses by name."""

import numpy as np
import pytest

from hilcell.calibration.file import Calibration, compensate_targets
from hilcell.compensation.model import PredictedOrientation, Prediction
from hilcell.geometry.frames import inverse, pose_from_zyx, poses_from_zyx, to_rotvec, zyx_from_pose
from hilcell.ports import Array, HilcellError
from tests.hilcell.calibration.calibrations import LOW_MM, PITCH_MM, T_W_B, calibration, field_mm

VERTEX_MM = LOW_MM + PITCH_MM


def target(turn_deg: float = 0.0, at_mm: Array = VERTEX_MM) -> Array:
    """Return a target (1, 6) in {W}, turned away from the calibrated orientation about x."""
    x, y, z = (float(value) for value in at_mm)
    T_B_T = pose_from_zyx(x, y, z, 0, 75, 0) @ pose_from_zyx(0, 0, 0, 0, 0, turn_deg)
    return zyx_from_pose(T_W_B @ T_B_T)[None]


@pytest.mark.parametrize("turn_deg", [0.0, 1.9, -1.9])
def test_a_target_is_commanded_by_its_error_beside_itself(turn_deg: float) -> None:
    nominal = target(turn_deg)
    command = compensate_targets(calibration(), "S1100", nominal, ["hole"])
    error_mm = T_W_B[:3, :3] @ field_mm(1.2)[1, 1, 1]
    np.testing.assert_allclose(command[0, :3] + error_mm, nominal[0, :3], atol=2e-3)
    np.testing.assert_allclose(command[0, 3:], nominal[0, 3:], atol=1e-9)


@pytest.mark.parametrize("turn_deg", [2.1, -2.1, 90.0, 170.0])
def test_a_target_that_is_turned_away_is_refused(turn_deg: float) -> None:
    with pytest.raises(HilcellError, match=f"hole by {abs(turn_deg)}"):
        compensate_targets(calibration(), "S1100", target(turn_deg), ["hole"])


@pytest.mark.parametrize("turn_deg", [178.5, 180.0])
def test_a_target_whose_tool_points_out_of_the_part_is_named_so(turn_deg: float) -> None:
    with pytest.raises(HilcellError, match=r"outward normal.*hole"):
        compensate_targets(calibration(), "S1100", target(turn_deg), ["hole"])


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9, -1e9])
def test_a_target_that_is_nowhere_is_refused(value: float) -> None:
    for number in range(6):
        bad = target()
        bad[0, number] = value
        with pytest.raises(HilcellError, match="hole"):
            compensate_targets(calibration(), "S1100", bad, ["hole"])


def test_a_target_outside_the_grid_is_refused() -> None:
    with pytest.raises(HilcellError, match="hole"):
        compensate_targets(calibration(), "S1100", target(at_mm=LOW_MM - 1.0), ["hole"])


class Turned:
    """Predicts that the tool arrives 1 mrad too far about z of {B}, and in its place."""

    def predict(self, poses: Array) -> Prediction:
        zeros = np.zeros((len(poses), 3, 3))
        return Prediction(
            zeros[:, 0],
            zeros,
            PredictedOrientation(np.tile([0.0, 0.0, 1e-3], (len(poses), 1)), zeros),
        )


def test_a_calibrated_orientation_is_corrected_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Calibration, "learnt_model", lambda self: Turned())
    nominal = target()
    nominal[0, 3] += 360.0  # as a program may state it
    command = compensate_targets(calibration(), "S1100", nominal, ["hole"])
    np.testing.assert_allclose(command[0, :3], nominal[0, :3], atol=1e-9)
    found, wanted = (inverse(T_W_B) @ poses_from_zyx(each)[0] for each in (command, nominal))
    turn = to_rotvec(found[:3, :3] @ wanted[:3, :3].T)
    np.testing.assert_allclose(turn, [0.0, 0.0, -1e-3], atol=1e-9)
    assert np.abs(command[0, 3:] - nominal[0, 3:]).max() < 1.0
