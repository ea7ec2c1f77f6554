"""Which part of a sweep the shorter arcs take."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from procedures.base_frame import FEWEST_ON_ARC, arcs

by_points = given(points=st.integers(4, 200))


@by_points
def test_every_arc_has_points_enough_for_a_circle_and_no_others(points: int) -> None:
    for arc in arcs(points):
        assert len(arc) >= min(points, FEWEST_ON_ARC)
        assert set(arc) <= set(range(points))


@by_points
def test_arcs_grow_about_the_middle_to_the_whole_sweep(points: int) -> None:
    found = arcs(points)
    assert found[-1] == range(points)
    for shorter, wider in pairwise(found):
        assert set(shorter) <= set(wider)
    for arc in found:
        assert abs((points - 1 - arc[-1]) - arc[0]) <= 1
