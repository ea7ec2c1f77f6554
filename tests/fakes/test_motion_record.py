"""The travel that the simulated cell answers: whole motions, however seldom anybody looks."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from fakes.truth.cell_truth import CellTruth
from fakes.truth.rail_truth import RailTruth
from hilcell.cell.file import Cell
from tests.fakes.conftest import simulated_site


@pytest.fixture
def truth(cell: Cell) -> CellTruth:
    return simulated_site(cell)[1]


def test_a_slide_that_went_out_and_back_between_two_questions(truth: CellTruth) -> None:
    rail, time = truth.rail, truth.time
    assert isinstance(rail, RailTruth)
    rail.brake(closed=False)
    rail.travel()
    begin_mm = 640.0
    rail.move(50.0, 100.0, 200.0)
    time.advance(10.0)
    rail.move(-20.0, 100.0, 200.0)
    time.advance(10.0)
    travel = rail.travel()
    backlash_mm = 0.3
    assert travel.begin == pytest.approx([begin_mm])
    assert travel.high == pytest.approx([begin_mm + 50.0])
    assert travel.low == pytest.approx([begin_mm - 20.0], abs=backlash_mm)
    assert travel.excursion == pytest.approx([50.0])
    assert travel.moving_s == pytest.approx((50 / 100 + 0.5) + (70 / 100 + 0.5))
    out, back = travel.strokes
    assert (out.low[0], out.begin[0], out.high[0]) == (begin_mm, begin_mm, begin_mm + 50.0)
    assert (back.low[0], back.begin[0], back.high[0]) == (travel.low[0], out.high[0], out.high[0])
    assert out.fastest[0] == back.fastest[0] == 100.0
    assert out.began <= back.began <= datetime.now(UTC).isoformat(timespec="milliseconds")
    rest = rail.travel()
    assert rest.excursion.tolist() == [0.0]
    assert rest.moving_s == 0.0
    assert not rest.strokes


def test_a_slide_that_is_stopped_on_its_way(truth: CellTruth) -> None:
    rail = truth.rail
    assert isinstance(rail, RailTruth)
    rail.brake(closed=False)
    rail.travel()
    rail.move(500.0, 100.0, 200.0)
    truth.time.advance(1.25)  # 25 mm up the ramp, 75 mm at speed
    rail.quick_stop(400.0)
    truth.time.advance(5.0)
    travel = rail.travel()
    assert travel.excursion == pytest.approx([25.0 + 75.0 + 12.5])
    assert [each.high[0] - each.begin[0] for each in travel.strokes] == pytest.approx([100.0, 12.5])
    assert travel.moving_s == pytest.approx(1.25 + 0.25)


def test_a_slide_that_turned_round_within_one_motion(truth: CellTruth) -> None:
    rail = truth.rail
    assert isinstance(rail, RailTruth)
    rail.brake(closed=False)
    rail.travel()
    rail.move(500.0, 100.0, 200.0)
    truth.time.advance(1.25)  # at 100 mm and 100 mm/s
    rail.move(0.0, 100.0, 200.0)
    truth.time.advance(60.0)
    assert rail.travel().excursion == pytest.approx([100.0 + 25.0])


def test_the_axes_that_moved_and_for_how_long(cell: Cell, truth: CellTruth) -> None:
    robot = truth.robot
    home_rad = np.radians(cell.robot.home_deg)
    step_rad = np.radians([0.0, 5.0, 0.0, 0.0, -3.0, 0.0])
    robot.travel()
    robot.move(home_rad + step_rad, 0.1)
    truth.time.advance(60.0)
    robot.move(home_rad, 0.1)
    ends_s = robot.motion_ends_s - truth.time.now_s()
    truth.time.advance(60.0)
    travel = robot.travel()
    assert travel.begin == pytest.approx(home_rad)
    assert travel.excursion == pytest.approx(np.abs(step_rad))
    assert travel.moving_s == pytest.approx(2 * ends_s)
    speeds_rad_s = 0.1 * np.radians([joint.speed_deg_s for joint in cell.robot.joint])
    assert [each.fastest[1] for each in travel.strokes] == pytest.approx([speeds_rad_s[1]] * 2)
    robot.move(home_rad + step_rad, 0.1)
    truth.time.advance(ends_s / 2)
    robot.brake()
    truth.time.advance(60.0)
    stopped = robot.travel()
    assert 0.4 * abs(step_rad[1]) < stopped.excursion[1] < 0.9 * abs(step_rad[1])
    assert ends_s / 2 < stopped.moving_s < ends_s
