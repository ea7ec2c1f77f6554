from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fakes.truth.robot_motion import Path

numbers = st.floats(0.01, 1000.0)


def test_trapezoid_by_hand() -> None:
    path = Path(10.0, 5.0).travel(105.0, 20.0, 10.0)  # 2 s up, 3 s at speed, 2 s down
    assert path.end_s == pytest.approx(17.0)
    assert path.at(9.0) == (5.0, 0.0)
    assert path.at(12.0) == pytest.approx((25.0, 20.0))
    assert path.at(15.0) == pytest.approx((85.0, 20.0))
    assert path.at(16.0) == pytest.approx((100.0, 10.0))
    assert path.at(99.0) == (105.0, 0.0)


def test_short_move_is_a_triangle() -> None:
    path = Path(0.0, 0.0).travel(-10.0, 1000.0, 10.0)
    assert path.end_s == pytest.approx(2.0)
    assert path.at(1.0) == pytest.approx((-5.0, -10.0))


def test_brake_in_motion_then_go_back() -> None:
    path = Path(0.0, 0.0, velocity=20.0).brake(10.0).travel(0.0, 20.0, 10.0)
    assert path.at(2.0) == pytest.approx((20.0, 0.0))
    assert path.end == 0.0
    assert max(path.corners(0.0, path.end_s)) == pytest.approx(20.0)


@example(start=0.0, target=5e-324, speed=1000.0, ramp=0.01)
@given(start=st.floats(-500, 500), target=st.floats(-500, 500), speed=numbers, ramp=numbers)
def test_position_is_continuous_and_arrives(
    start: float, target: float, speed: float, ramp: float
) -> None:
    path = Path(0.0, start).travel(target, speed, ramp)
    assert path.at(path.end_s) == (target, 0.0)
    steps = [path.at(path.end_s * n / 50) for n in range(51)]
    assert all(abs(velocity) <= speed * (1 + 1e-9) for _, velocity in steps)
    for (before, _), (after, _) in pairwise(steps):
        assert abs(after - before) <= speed * path.end_s / 50 * (1 + 1e-6) + 1e-6


@given(start=st.floats(-500, 500), target=st.floats(-500, 500), speed=numbers, ramp=numbers)
def test_many_positions_are_those_of_each_time(
    start: float, target: float, speed: float, ramp: float
) -> None:
    path = Path(1.0, start, velocity=speed).brake(ramp).travel(target, speed, ramp)
    times_s = np.linspace(0.0, path.end_s + 1.0, 50)
    assert path.positions(times_s).tolist() == [path.at(at_s)[0] for at_s in times_s.tolist()]
