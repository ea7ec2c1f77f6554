"""Where a tracker is turned over, and why not elsewhere."""

from __future__ import annotations

import pytest

from hilcell.cell.file import load_cell
from procedures.calibrate import CALIBRATE
from procedures.two_faces import TwoFaces, left_out


@pytest.mark.parametrize(
    ("cell", "values", "word"),
    [
        ("paper", {}, ""),
        ("paper", {"plan.quick": "true"}, "quick"),
        ("paper", {"tracker.driver": "leica-geocom"}, "driver"),
        ("lab", {}, "driver"),
        ("paper", {"layout.reflectors": "by_hand"}, "by hand"),
    ],
)
def test_a_plan_says_why_a_tracker_is_not_turned_over(
    cell: str, values: dict[str, str], word: str
) -> None:
    reason = left_out(load_cell(cell, values))
    assert word in reason
    assert bool(word) == bool(reason)


def test_it_costs_little_of_a_full_plan() -> None:
    plan = CALIBRATE.plan(load_cell("paper"), 1)
    own_s = sum(step.duration_s for step in plan.steps if step.name.startswith("two-face"))
    assert 0.0 < own_s < 0.03 * plan.duration_s


def test_near_and_far_nests_are_seen_at_the_start_and_floor_nests_at_the_end() -> None:
    cell = load_cell("paper")
    start, end = (TwoFaces(at_end=last).plan(cell, 1).spans[0].measured for last in (False, True))
    assert (start, end) == (5, 3)
