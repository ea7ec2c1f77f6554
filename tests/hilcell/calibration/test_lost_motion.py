"""What the joints lose when they reverse, from vertices that were approached from both sides."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.calibration.budget import target_uncertainty
from hilcell.calibration.causes import zero_columns
from hilcell.calibration.diagnosis import suspected_causes
from hilcell.calibration.file import LostMotion
from hilcell.calibration.lost_motion import (
    REVERSAL,
    TAKE_UP_RAD,
    lost_too_much,
    reversal,
    reversal_verdict,
    straight_path,
)
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import inverse, pose_from_zyx
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log, commanded_rad
from hilcell.model.verdicts import LostMotionJudged
from hilcell.ports import Array

NATURAL_URAD = 60.0  # at most, of the simulated machines' gears


def with_lost(log: Log, lost_urad: Array) -> Log:
    """Let the axes lose more where they were approached from above."""
    arm, points = log.cell.robot.arm(), log.select(REVERSAL)
    R_L_B = (inverse(log.matrix("world")) @ log.matrix("base"))[:3, :3]
    J = zero_columns(arm, commanded_rad(points))
    moved_mm = -(J @ (1e-6 * lost_urad)) @ R_L_B.T
    for point, off_mm in zip(points, moved_mm, strict=True):
        x, y, z = (np.array(point.xyz_mm) + off_mm).tolist()
        log.points[point.key] = msgspec.structs.replace(point, xyz_mm=(x, y, z))
    return log


def found_in(log: Log) -> LostMotionJudged:
    found = reversal(log)
    assert found is not None
    return found


def test_a_healthy_robot_loses_little_and_is_not_suspected(log: Log) -> None:
    found = found_in(log)
    assert found.points == 4
    assert found.holds
    assert lost_too_much(log) is None
    for lost, U in zip(found.lost_urad, found.U_urad, strict=True):
        assert abs(lost) - U < NATURAL_URAD
        assert U < NATURAL_URAD


@pytest.mark.parametrize("axis", [1, 3])
def test_the_axis_that_loses_too_much_is_named(log: Log, axis: int) -> None:
    before = found_in(log).lost_urad[axis - 1]
    found = found_in(with_lost(log, 180.0 * np.eye(6)[axis - 1]))
    assert found.lost_urad[axis - 1] - before == pytest.approx(180.0, abs=1.0)
    assert not found.holds
    (suspicion,) = suspected_causes(log)
    assert (suspicion.cause, suspicion.unit) == ("reversal", f"urad of axis {axis}")
    assert suspicion.size == pytest.approx(before + 180.0, abs=1.0)


@pytest.mark.parametrize(("stated_mm", "counts"), [(0.0, False), (0.05, True), (9.0, True)])
def test_the_budget_takes_the_larger_of_limit_and_measurement(
    log: Log, stated_mm: float, counts: bool
) -> None:
    stated = msgspec.structs.replace(log.cell.uncertainty, reversal_limit_mm=stated_mm)
    log._cell = msgspec.structs.replace(log.cell, uncertainty=stated)
    (line,) = (each for each in target_uncertainty(log).lines if each.name == "Approach direction")
    seen_mm = found_in(log).max_mm
    wanted_mm = max(stated_mm, seen_mm) if counts else 0.0
    assert line.covariance[0][0] == pytest.approx(wanted_mm**2 / 3)


def test_without_such_points_nothing_is_said(log: Log) -> None:
    for point in log.select(REVERSAL):
        log._drop(point.key)
    assert reversal(log) is None
    (line,) = (each for each in target_uncertainty(log).lines if each.name == "Approach direction")
    assert not np.array(line.covariance).any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_figure_that_is_no_number_does_not_hold(axis: int) -> None:
    lost_urad = [30.0, 30.0, 30.0]
    lost_urad[axis] = float("nan")
    assert not reversal_verdict([0.1], lost_urad, [10.0] * 3, 100.0).holds


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
