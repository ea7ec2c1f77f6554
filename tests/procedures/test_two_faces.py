"""Where a tracker is turned over, and why not elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest

from fakes.in_process import InProcessCell
from hilcell.calibration.instrument import axis_off
from hilcell.cell.file import load_cell
from hilcell.model.verdicts import Cause
from hilcell.run import procedure
from hilcell.run.procedure import Procedure
from procedures.calibrate import CALIBRATE, point_table
from procedures.world_frame import Home, TwoFaces, WorldFrame

CELL = load_cell("paper")
BOTH = Procedure("both", "", (Home(), WorldFrame(), TwoFaces()), point_table)


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
    reason = TwoFaces.left_out(load_cell(cell, values))
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


@pytest.mark.parametrize("urad", [0.0, 50.0])
def test_an_axis_that_is_off_fails_its_verdict_and_is_suspected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, urad: float
) -> None:
    simulated = InProcessCell(CELL, 1)
    simulated.tracker._truth.tracker._axes_rad[1] += 1e-6 * urad  # type: ignore[attr-defined] # its own
    monkeypatch.setattr(procedure, "in_process_cell", lambda *seeds: simulated)
    log = procedure.run_in_process(CELL, BOTH, seed=1, machine_seed=1, folder=tmp_path)
    assert log.verdicts["two-face"].holds is not bool(urad)
    found = axis_off(log)
    assert (found is not None) is bool(urad)
    if found is not None:
        assert found.cause is Cause.INSTRUMENT
        assert found.size == pytest.approx(urad, abs=8.0)
