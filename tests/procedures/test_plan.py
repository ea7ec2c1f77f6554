"""Pure functions of procedures: targets, sides, sweeps, plans."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.calibration.frames import axis_6_height_mm
from hilcell.calibration.grid import grid_of
from hilcell.cell.file import load_cell
from hilcell.geometry.frames import turned_deg
from hilcell.geometry.kinematics import forward
from hilcell.journal.log import Log
from hilcell.ports import HilcellError
from procedures.base_frame import FEWEST_ON_ARC, BaseFrame, sweep
from procedures.calibrate import CALIBRATE
from procedures.paper import ROWS, PaperRows
from procedures.plan import check_range, check_reach, joints_for, poses_at
from procedures.rail import StationRepeatability
from procedures.recheck import Recheck
from procedures.validate import MARGIN_MM, targets
from tests.hilcell.alarms.journals import log_of, point
from tests.hilcell.calibration.calibrations import calibration
from tests.whole.bench import command, end_of, events, sets, simulation

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
    sides = StationRepeatability.sides(seed, repeats)
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


# -- Which part of a sweep the shorter arcs take ---------------------------------------------------


@given(points=st.integers(4, 200))
def test_arcs_of_enough_points_grow_about_the_middle_to_the_whole_sweep(points: int) -> None:
    found = BaseFrame.arcs(points)
    assert found[-1] == range(points)
    for shorter, wider in pairwise(found):
        assert set(shorter) <= set(wider)
    for arc in found:
        assert len(arc) >= min(points, FEWEST_ON_ARC)
        assert abs((points - 1 - arc[-1]) - arc[0]) <= 1


# -- Poses of a re-check: turned where the calibration corrects other orientations than the grid'


@pytest.mark.parametrize(
    ("tolerance_deg", "wanted_deg"),
    [(2.0, [0.0] * 7), (30.0, [0.0, 27.0, 0.0, 27.0, 0.0, 27.0, 0.0])],
)
def test_every_other_pose_is_turned(tolerance_deg: float, wanted_deg: list[float]) -> None:
    made = calibration()
    validity = msgspec.structs.replace(made.validity, orientation_tolerance_deg=tolerance_deg)
    made = msgspec.structs.replace(made, validity=validity)
    poses = forward(CELL.robot.arm(), Recheck.commands_rad(CELL, made, 3))
    found_deg = turned_deg(np.array(validity.orientation), poses)
    np.testing.assert_allclose(found_deg, wanted_deg, atol=1e-4)


# -- A rail whose backlash has grown is reported by the survey -------------------------------------


SHORT = {"survey.step_mm": "500.0", "layout.nest_samples": "1"}


def test_a_backlash_that_has_grown_is_reported(tmp_path: Path) -> None:
    with simulation() as cell:
        assert cell.ask(do="fault", name="rail.backlash", value=0.3)["ok"]
        words: list[str | Path] = ["--unattended", "--runs", tmp_path, "--json"]
        to = sets(SHORT | {"simulation.address": cell.control})
        done = command("run", "rail-survey", *words, *to)
    assert done.returncode == 1, done.stderr
    (verdict,) = [e for e in events(done.stdout) if e.get("key") == "backlash"]
    assert not verdict["holds"]
    found = end_of(done)["result"]["rail_survey"]["backlash_mm"]["value"]
    assert abs(found) == pytest.approx(0.5, abs=0.05)


# -- Which rows of the paper a run can answer ------------------------------------------------------


AIR = {"sec5.1.temperature.min", "sec5.1.temperature.max"}


def names_for(log: Log) -> set[str]:
    return {row.name for row in PaperRows.rows(log)}


def test_the_rows_of_the_air_need_a_weather_station() -> None:
    every = {row.name for row in ROWS}
    assert names_for(log_of(point("a", None), point("b", 22.0))) == every
    assert names_for(log_of(point("a", None))) == every - AIR
