"""The sequential verdict: its risks by trial, its efforts, and what must never be accepted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hilcell.model.outcome import Outcome
from procedures.quick_validation import SequentialRule

RULE = SequentialRule(
    mean_limit_mm=0.2, max_limit_mm=1.0, share=0.1, accept_risk=0.05, reject_risk=0.05, block=8
)
MOST, TRIALS = 96, 250
PARTS = np.array([0.2, 0.4, 0.7, 0.9, 1.1, 1.3, 1.6, 1.8])  # of the mean, by octant


def shares(draw: np.ndarray) -> dict[str, float]:
    """Return how often each outcome is reached for errors (TRIALS, MOST)."""
    outcomes = [RULE.decide(errors).outcome for errors in draw]
    return {name: outcomes.count(name) / len(draw) for name in (Outcome.ACCEPTED, Outcome.REJECTED)}


def spread(mean_mm: float, seed: int) -> np.ndarray:
    """Return errors that differ from octant to octant, their mean as wanted."""
    rng = np.random.default_rng(seed)
    level = mean_mm * np.tile(PARTS, MOST // len(PARTS))
    return rng.gamma(9.0, level / 9.0, size=(TRIALS, MOST))


def two_sizes(mean_mm: float, large_mm: float, seed: int) -> np.ndarray:
    """Return errors that are none but for a few large ones: the hardest to notice."""
    rng = np.random.default_rng(seed)
    return large_mm * (rng.uniform(size=(TRIALS, MOST)) < mean_mm / large_mm)


@pytest.mark.parametrize("draw", [spread(0.2, 1), two_sizes(0.2, 0.9, 2), two_sizes(0.2, 0.4, 3)])
def test_at_the_limit_of_the_mean_both_risks_are_kept(draw: np.ndarray) -> None:
    found = shares(np.minimum(draw, 1.0))
    assert found["accepted"] <= 0.05
    assert found["rejected"] <= 0.05


def test_a_share_above_the_maximum_is_accepted_at_most_at_its_risk() -> None:
    draw = np.where(np.random.default_rng(4).uniform(size=(TRIALS, MOST)) < 0.1, 1.1, 0.02)
    found = shares(draw)
    assert 0.0 < found["accepted"] <= 0.05 + 2 * math.sqrt(0.05 * 0.95 / TRIALS)
    assert found["accepted"] + found["rejected"] == 1.0


@pytest.mark.parametrize(
    ("mean_mm", "outcome", "targets"),
    [(0.04, "accepted", 32), (0.1, "accepted", 48), (0.4, "rejected", 16)],
)
def test_clear_cases_take_few_targets(mean_mm: float, outcome: str, targets: int) -> None:
    decisions = [RULE.decide(errors) for errors in spread(mean_mm, 5)]
    assert {each.outcome for each in decisions} == {outcome}
    assert np.median([each.targets for each in decisions]) <= targets


def test_a_decision_stays_as_it_was_when_more_is_measured() -> None:
    for errors in spread(0.12, 6)[:50]:
        found = RULE.decide(errors)
        if found.outcome != "undecided":
            assert RULE.decide(errors[: found.targets]) == found
            assert RULE.decide(errors[: found.targets - 1]).outcome == "undecided"


def test_nothing_is_decided_before_a_block_is_whole() -> None:
    assert RULE.decide([]).outcome == "undecided"
    assert RULE.decide(np.full(7, 5.0)) == RULE.decide([])
    assert RULE.decide(np.full(8, 5.0)).outcome == "rejected"


@pytest.mark.parametrize("bad", [1.001, math.nan, math.inf])
def test_one_target_above_the_maximum_rejects(bad: float) -> None:
    errors = np.full(64, 0.01)
    errors[20] = bad
    found = RULE.decide(errors)
    assert (found.outcome, found.targets) == ("rejected", 24)
