"""A pair of faults that failed once; a pair is drawn by its seed."""

from __future__ import annotations

import pytest

from campaigns.faults.bed import hasten
from campaigns.faults.injections import Knob
from campaigns.faults.pairs import FAILED, judge_pair, pair_of
from tests.whole.bench import sweep


@pytest.mark.wall
@pytest.mark.parametrize("seed", [FAILED[0], *sweep(*FAILED[1:], *range(1, 45))])
def test_a_pair_of_faults(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    hasten(monkeypatch.setattr)
    assert judge_pair(seed).problems == ()


def test_a_pair_is_its_seed() -> None:
    pairs = [pair_of(seed) for seed in range(1, 200)]
    assert pairs == [pair_of(seed) for seed in range(1, 200)]
    assert all(pair.moments == tuple(sorted(pair.moments)) for pair in pairs)
    drawn = {each.name for pair in pairs for each in pair.injections if isinstance(each, Knob)}
    assert len(drawn) > 40
