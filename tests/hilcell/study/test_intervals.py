"""Intervals of shares stay between 0 and 100 %, and cover as often as they promise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hilcell.study.intervals import share


@pytest.mark.parametrize("shares", [[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 0.98, 1.0], [0.0, 0.0, 0.02]])
def test_an_interval_is_between_none_and_all(shares: list[float]) -> None:
    found = share(shares, 50.0 * len(shares))
    assert 0.0 <= found.low <= found.mean <= found.high <= 1.0
    assert found.low < found.high


def test_it_is_clopper_and_pearson_s_where_machines_do_not_differ() -> None:
    """98 of 100; of many machines, so that Student's factor is nearly the normal one."""
    many = [0.98] * 400
    found = share(many, 100.0)
    assert (found.low, found.high) == pytest.approx((0.9296, 0.9976), abs=0.001)


@pytest.mark.parametrize("spread", [0.0, 0.04])
def test_it_covers_as_often_as_it_promises(spread: float) -> None:
    """Machines of 50 targets each, whose own shares differ: 0.93 on average."""
    rng, true = np.random.default_rng(1), 0.93
    hits = []
    for _ in range(600):
        own = np.clip(rng.uniform(true - spread, true + spread, 6), 0.0, 1.0)
        found = share(rng.binomial(50, own) / 50.0, 300.0)
        hits.append(found.low <= true <= found.high)
    assert 0.93 <= np.mean(hits) <= 1.0


def test_one_machine_gives_none() -> None:
    found = share([0.95], 100.0)
    assert found.mean == 0.95
    assert math.isnan(found.low)
    assert found.ends == (0.95, 0.95)


def test_machines_that_differ_widen_it() -> None:
    alike, different = share([0.9] * 4, 400.0), share([0.8, 1.0, 0.8, 1.0], 400.0)
    assert alike.mean == pytest.approx(different.mean)
    assert different.high - different.low > 1.5 * (alike.high - alike.low)
