"""Pure parts of procedures: targets, sides, sweeps, plans."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.calibration.frames import axis_6_height_mm
from hilcell.calibration.grid import grid_of
from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import forward
from hilcell.ports import HilcellError
from procedures.base_frame import sweep
from procedures.calibrate import CALIBRATE
from procedures.plan import check_range, check_reach, joints_for, poses_at
from procedures.rail import random_sides
from procedures.validate import MARGIN_MM, targets

CELL = load_cell("paper")


@given(seed=st.integers(0, 2**31))
def test_targets_fill_every_grid_cell(seed: int) -> None:
    drawn = targets(CELL, seed)
    grid = grid_of(CELL)
    assert {name: len(points) for name, points in drawn.items()} == {
        "S1100": 135,
        "S300": 75,
        "S1900": 75,
    }
    for points in drawn.values():
        assert (points >= grid.origin_mm + MARGIN_MM).all()
        assert (points <= grid.far_mm - MARGIN_MM).all()
    cells = np.floor((drawn["S1100"] - grid.origin_mm) / grid.pitch_mm).astype(int)
    _, counts = np.unique(cells, axis=0, return_counts=True)
    assert counts.tolist() == [5] * 27


@given(seed=st.integers(0, 2**31), repeats=st.integers(4, 50))
def test_half_of_the_approaches_come_from_each_side(seed: int, repeats: int) -> None:
    sides = random_sides(seed, repeats)
    assert sorted(set(sides)) == [-1, 1]
    assert abs(sum(sides)) <= 1


@pytest.mark.parametrize("axis", [1, 6])
def test_a_sweep_moves_one_axis(axis: int) -> None:
    joints = sweep(CELL, axis)
    moving = np.ptp(joints, axis=0) > 0
    assert moving.tolist() == [number == axis - 1 for number in range(6)]


def test_axis_6_stands_at_its_nominal_height() -> None:
    """Worked out by hand: A2 -130, A3 150, A5 -20 deg, axis 6 level."""
    shoulder = 645.0 + 1150.0 * np.sin(np.radians(130.0))
    fore = np.radians(20.0)
    wrist = shoulder + 115.0 * np.cos(fore) - 1220.0 * np.sin(fore)
    assert axis_6_height_mm(CELL) == pytest.approx(wrist, abs=1e-6)


def test_what_is_commanded_is_reached_nominally() -> None:
    points = targets(CELL, 1)["S1100"]
    found = forward(CELL.robot.arm(), joints_for(CELL, points))
    np.testing.assert_allclose(found, poses_at(CELL, points), atol=1e-9)


def test_plans_refuse_before_anything_moves() -> None:
    with pytest.raises(HilcellError, match="far"):
        check_reach(CELL, poses_at(CELL, np.array([[1850.0, 0, 950.0], [3500.0, 0, 950.0]])), "far")
    with pytest.raises(HilcellError, match="1 of 2"):
        check_range(CELL, np.array([[0.0, 0.0, 0.0], [20_000.0, 0.0, 0.0]]), "nests")


def test_all_refusals_are_reported_at_once() -> None:
    cell = load_cell("paper", {"tracker.max_range_mm": "4000.0", "grid.centre.x_mm": "2600.0"})
    with pytest.raises(HilcellError) as raised:
        CALIBRATE.plan(cell, 1)
    for part in ("world-frame", "robot-grid", "station-frames", "validate"):
        assert f"\n{part}: " in str(raised.value)


def test_one_cell_is_no_grid() -> None:
    cell = load_cell("paper", {"grid.pitch_mm": "900.0"})
    with pytest.raises(HilcellError, match="2 x 2 x 2"):
        CALIBRATE.plan(cell, 1)
