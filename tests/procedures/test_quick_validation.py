"""A quick plan: targets in octants, no more of them than the verdict needs, within its time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hilcell.calibration.decision_rule import Guard, decide, tolerance_limits
from hilcell.calibration.grid import grid_of
from hilcell.calibration.position_errors import Errors
from hilcell.cell.file import load_cell
from hilcell.journal.log import Log
from hilcell.model.outcome import Outcome
from hilcell.ports import HilcellError
from hilcell.run.cell_session import CellSession
from procedures import quick_validation
from procedures.calibrate import CALIBRATE
from procedures.paper import PaperRows
from procedures.quick_validation import Decision
from procedures.validate import MARGIN_MM, Validate, targets

QUICK = load_cell("paper", {"plan.quick": "true"})
MOST_S = 20 * 60.0


def test_every_block_has_one_target_in_each_octant() -> None:
    drawn, grid = targets(QUICK, 5), grid_of(QUICK)
    assert list(drawn) == ["S1100", "S300", "S1900"]
    for points in drawn.values():
        assert len(points) == QUICK.plan.most_targets
        assert (points >= grid.origin_mm + MARGIN_MM).all()
        assert (points <= grid.far_mm - MARGIN_MM).all()
        upper = points > (grid.origin_mm + grid.far_mm) / 2
        for block in np.split(upper, len(points) // 8):
            assert len(np.unique(block, axis=0)) == 8
    assert np.array_equal(targets(QUICK, 5)["S300"], drawn["S300"])
    assert not np.array_equal(targets(QUICK, 6)["S300"], drawn["S300"])


def test_a_quick_plan_takes_at_most_twenty_minutes_of_robot() -> None:
    plan = CALIBRATE.plan(QUICK, 1)
    assert plan.duration_s <= MOST_S
    assert plan.duration_s == pytest.approx(sum(step.duration_s for step in plan.steps))
    validate = next(step for step in plan.steps if step.name == "validate")
    assert validate.points == 3 * (8 + 32 + QUICK.touch.poses) + 2 * len(QUICK.layout.slide)


@pytest.mark.parametrize("decided", [8, 40, 96])
def test_targets_are_sent_until_the_station_is_decided(
    decided: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[int] = []

    def decision_at(log: Log, station: str) -> Decision:
        return Decision(Outcome.ACCEPTED if len(sent) >= decided else Outcome.UNDECIDED, len(sent))

    monkeypatch.setattr(quick_validation, "decision_at", decision_at)
    log = cast("Log", SimpleNamespace(cell=QUICK))
    for numbers in quick_validation.rounds(log, "S300", "chosen"):
        sent += numbers
    assert sent == list(range(decided))
    assert list(quick_validation.rounds(log, "S300", "before")) == [range(8)]


def test_a_station_stays_decided_by_the_uncertainty_of_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """U grew after S300 was decided: seed 22 of `hard` was accepted, and undecided in the end."""
    events: list[Any] = []
    found = Errors(np.zeros((40, 3)), np.tile([0.045, 0.0, 0.0], (40, 1)))
    log = cast("Log", SimpleNamespace(cell=QUICK, happened=lambda kind: events))
    session = cast(
        "CellSession",
        SimpleNamespace(log=log, add=events.append),
    )
    monkeypatch.setattr(quick_validation, "validation", lambda log, stations: {"chosen": found})
    now = Guard(0.03, 0.03)
    monkeypatch.setattr(quick_validation, "guard_band", lambda log, count: now)
    assert quick_validation.decision_at(log, "S300").outcome == Outcome.ACCEPTED
    quick_validation.record_guard(session, "S300")
    now = Guard(0.065, 0.065)
    assert quick_validation.decision_at(log, "S300").outcome == Outcome.ACCEPTED
    assert quick_validation.decision_at(log, "S1900").outcome == Outcome.UNDECIDED
    quick_validation.record_guard(session, "S300")
    assert len(events) == 1


def test_a_plan_that_can_never_accept_is_refused() -> None:
    cell = load_cell("paper", {"plan.quick": "true", "plan.most_targets": "24"})
    with pytest.raises(HilcellError, match="most_targets 24"):
        Validate().plan(cell, 1)


def test_a_tolerance_that_u_has_nearly_used_up_ends_undecided_and_not_in_a_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The plan was refused in the middle of the validation, when U was known."""
    cell = load_cell("paper", {"plan.quick": "true", "validation.mean_tolerance_mm": "0.025"})
    found = Errors(np.zeros((96, 3)), np.tile([0.002, 0.0, 0.0], (96, 1)))
    log = cast("Log", SimpleNamespace(cell=cell, happened=lambda kind: []))
    monkeypatch.setattr(quick_validation, "validation", lambda log, stations: {"chosen": found})
    monkeypatch.setattr(quick_validation, "guard_band", lambda log, count: Guard(0.0225, 0.0225))
    assert quick_validation.decision_at(log, "S300") == Decision(Outcome.UNDECIDED, 96)
    assert "most_targets" in quick_validation.judgement(log, ["S300"]).text


def test_the_paper_has_no_quick_plan() -> None:
    with pytest.raises(HilcellError, match="paper"):
        PaperRows().plan(QUICK, 1)


@pytest.mark.parametrize(
    ("error_mm", "outcome"),
    [
        (0.02, Outcome.ACCEPTED),
        (0.07, Outcome.UNDECIDED),  # shown to be above the tolerance less U: more do not help
        (0.18, Outcome.REJECTED),
    ],
)
def test_what_is_above_a_tolerance_less_u_is_out_of_tolerance_only_above_it_less_u_too(
    error_mm: float, outcome: Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report said undecided of the very figures that the verdict called rejected."""
    cell = load_cell("paper", {"plan.quick": "true", "validation.mean_tolerance_mm": "0.1"})
    found = Errors(np.zeros((96, 3)), np.tile([error_mm, 0.0, 0.0], (96, 1)))
    log = cast("Log", SimpleNamespace(cell=cell, happened=lambda kind: []))
    guard = Guard(0.06, 0.06)
    monkeypatch.setattr(quick_validation, "validation", lambda log, stations: {"chosen": found})
    monkeypatch.setattr(quick_validation, "guard_band", lambda log, count: guard)
    decided = quick_validation.decision_at(log, "S300")
    assert decided.outcome is not Outcome.UNDECIDED  # more would not help
    judgement = quick_validation.judgement(log, ["S300"])
    assert judgement.outcome == outcome
    verdict = decide(error_mm, error_mm, tolerance_limits(cell), guard, sequential=judgement)
    assert verdict.outcome == outcome
    assert "most_targets" not in judgement.text
    assert judgement.text.startswith(verdict.outcome.text)
