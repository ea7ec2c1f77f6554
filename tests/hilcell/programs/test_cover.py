"""The fewest stations, against all subsets."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.ports import HilcellError
from hilcell.programs.plan import fewest


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 8), st.floats(0.1, 0.9))
def test_against_all_subsets(seed: int, holes: int, stations: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    ok = rng.random((holes, stations)) < share
    ok[np.arange(holes), rng.integers(0, stations, holes)] = True
    burden = rng.random(stations)
    chosen = fewest(ok, burden)
    covers = [
        subset
        for size in range(1, stations + 1)
        for subset in combinations(range(stations), size)
        if ok[:, subset].any(axis=1).all()
    ]
    size = min(len(subset) for subset in covers)
    assert len(chosen) == size
    assert ok[:, chosen].any(axis=1).all()
    lightest = min(burden[list(subset)].sum() for subset in covers if len(subset) == size)
    assert burden[chosen].sum() == pytest.approx(lightest, abs=1e-4)


def test_burden_never_buys_a_station() -> None:
    ok = np.array([[True, False, True], [False, True, True]])
    np.testing.assert_array_equal(fewest(ok, np.array([0.0, 0.0, 1.0])), [2])


def test_a_hole_reached_from_nowhere_is_refused() -> None:
    with pytest.raises(HilcellError, match="station"):
        fewest(np.array([[True, True], [False, False]]), np.zeros(2))
