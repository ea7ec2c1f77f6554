"""The cost of a straight path: only axes that reverse on it err."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.calibration.file import LostMotion
from hilcell.calibration.lost_motion import TAKE_UP_RAD, straight_path
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import pose_from_zyx
from hilcell.geometry.kinematics import forward
from hilcell.ports import Array

CELL = load_cell("paper")
ARM = CELL.robot.arm()
T_W_B = pose_from_zyx(-1850.0, -3.0, 300.0, 20.0, 0.1, -0.06)
END = np.radians([5.0, -80.0, 100.0, 4.0, -40.0, 3.0])
LOST_RAD = [30e-6, 50e-6, 40e-6, 0.0, 0.0, 0.0]
U_RAD = [5e-6, 6e-6, 7e-6, 1e-4, 1e-4, 1e-4]
LOST = LostMotion(LOST_RAD, U_RAD, measured=True)


def way(turn_rad: list[float]) -> Array:
    shares = np.linspace(1.0, 0.0, 5)[:, None]
    found: Array = (END - shares * np.array(turn_rad))[None]
    return found


@given(st.lists(st.sampled_from([-0.02, 0.0, 0.02]), min_size=6, max_size=6))
def test_axes_that_turn_down_stand_lower_by_what_they_lose(turn_rad: list[float]) -> None:
    found = straight_path(LOST, ARM, T_W_B, way(turn_rad))
    down = np.array(turn_rad) < 0.0
    ends = np.stack([END, END - LOST_RAD * down.astype(float)])
    places = (T_W_B @ forward(ARM, ends))[:, :3, 3]
    np.testing.assert_allclose(found.shift_mm[0], places[1] - places[0], atol=1e-5)
    assert (np.trace(found.covariance_mm2[0]) > 0.0) == bool(down.any())


@pytest.mark.parametrize("share", [0.25, 0.75])
def test_an_axis_that_hardly_turns_down_is_half_known(share: float) -> None:
    turn = [-share * TAKE_UP_RAD, 0.0, 0.0, 0.0, 0.0, 0.0]
    found = straight_path(LOST, ARM, T_W_B, way(turn))
    whole = straight_path(LOST, ARM, T_W_B, way([-0.02, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(found.shift_mm, share * whole.shift_mm, rtol=1e-9)
    least = share**2 * np.trace(whole.covariance_mm2[0])
    assert np.trace(found.covariance_mm2[0]) > least


def test_an_axis_that_comes_up_in_the_end_loses_nothing() -> None:
    """Though it stands lower than on its way."""
    dip = np.tile(END, (1, 5, 1))
    dip[0, :, 0] += [0.02, 0.01, -0.01, -0.005, 0.0]
    found = straight_path(LOST, ARM, T_W_B, dip)
    np.testing.assert_array_equal(found.shift_mm, 0.0)
