"""Planned durations against the motions of the simulated cell, and spans against their steps."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.time import CellTime
from fakes.truth.robot_motion import Path, RobotMotion
from hilcell.cell.file import Station, load_cell
from hilcell.model.plan import PlannedStep
from procedures import plan
from procedures.paper import EXPERIMENTS
from procedures.plan import first_pass_percent, flange_points, joints_for
from procedures.repeatability import Repeatability

CELL = load_cell("paper")
PARTS = {part.name: part for part in EXPERIMENTS}


@cache
def step(name: str) -> PlannedStep:
    """Return the planned step of a part: some take long to plan, and many tests ask."""
    return PARTS[name].plan(CELL, 1)


@given(
    here_deg=st.lists(st.floats(-90.0, 90.0), min_size=6, max_size=6),
    there_deg=st.lists(st.floats(-90.0, 90.0), min_size=6, max_size=6),
    percent=st.integers(1, 100),
)
def test_a_robots_motion_takes_what_its_trapezoid_takes(
    here_deg: list[float], there_deg: list[float], percent: int
) -> None:
    cell = load_cell("paper", {"robot.speed_percent": str(percent)})
    here_rad, there_rad = np.radians(here_deg), np.radians(there_deg)
    time = CellTime()
    motion = RobotMotion(cell, time, lambda _: lambda: np.zeros(6))
    motion.move(here_rad, 1.0)
    time.advance(1e4)
    began_s = time.now_s()
    motion.move(there_rad, percent / 100.0)
    took_s = motion._path.end_s - began_s
    planned_s = float(plan.robot_moves_s(cell, here_rad, there_rad))
    assert planned_s - plan.MOTION_END_S == pytest.approx(took_s, abs=2e-3)


@given(distance_mm=st.floats(0.001, 3000.0), back=st.booleans())
def test_the_slides_travel_takes_what_its_trapezoid_takes(distance_mm: float, back: bool) -> None:
    rail = CELL.rail
    planned_s = plan.rail_travel_s(CELL, -distance_mm if back else distance_mm)
    planned_s -= plan.MOTION_END_S + rail.standstill_dwell_s
    path = Path(0.0, 0.0).travel(distance_mm, rail.speed_mm_s, rail.acceleration_mm_s2)
    assert planned_s == pytest.approx(path.end_s)


def test_a_farther_station_takes_longer_and_the_robot_is_parked_first() -> None:
    near, far = (Station(name=n, rail_mm=mm, strip_mm=mm) for n, mm in (("N", 500.0), ("F", 2e3)))
    here = CELL.station[0]
    (there, proof), (farther, _) = (plan.leg(CELL, here, each) for each in (near, far))
    assert there.duration_s < farther.duration_s
    alone_s = plan.approach_s(CELL, here.rail_mm, far)
    assert farther.duration_s == pytest.approx(alone_s + plan.park_s(CELL))
    assert proof.measured == 1
    assert proof.duration_s == pytest.approx(plan.measure_s(CELL, 1))


def test_the_trackers_times_are_those_of_the_cell() -> None:
    slow = load_cell("paper", {"tracker.reading_s": "2.0", "tracker.pointing_s": "1.5"})
    assert plan.measure_s(slow, 3) == pytest.approx(1.5 + 6.0)
    assert plan.measure_s(CELL, 3) == pytest.approx(CELL.tracker.pointing_s + 1.5)


@pytest.mark.parametrize("name", PARTS)
def test_spans_add_up_to_their_step(name: str) -> None:
    planned = step(name)
    assert math.isfinite(planned.duration_s)
    assert planned.duration_s >= 0.0
    if planned.spans:
        assert sum(span.duration_s for span in planned.spans) == pytest.approx(planned.duration_s)
        assert sum(span.measured for span in planned.spans) >= planned.points


def test_a_robot_twice_as_fast_shortens_what_it_moves_and_nothing_else() -> None:
    fast = load_cell("paper", {"robot.speed_percent": "60"})
    named = ("validate", "world-frame", "rail-survey")
    sooner = {name: PARTS[name].plan(fast, 1).duration_s for name in named}
    assert sooner["validate"] < 0.95 * step("validate").duration_s
    assert sooner["world-frame"] == step("world-frame").duration_s
    assert sooner["rail-survey"] == step("rail-survey").duration_s


def test_a_plan_counts_with_the_first_pass() -> None:
    """Poses outside of the cube are driven to slowly; those in it are not."""
    home = np.radians([CELL.robot.home_deg])
    cube = joints_for(CELL, Repeatability.places_mm(CELL))[:1]
    usual = CELL.robot.speed_percent
    assert first_pass_percent(CELL, np.vstack([home, cube])).tolist() == [10.0, usual]
    slow = load_cell("paper", {"robot.first_pass_percent": "5.0"})
    assert flange_points(slow, home).duration_s > flange_points(CELL, home).duration_s
    assert flange_points(slow, cube).duration_s == flange_points(CELL, cube).duration_s
