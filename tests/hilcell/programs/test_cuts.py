"""Cuts hold for every tour, and what their prices prove is below the shortest of small cases."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from hilcell.programs.route import Cut, Separation, _Program, cut_bound, lower_bound, route
from tests.hilcell.programs.test_route import least, raster, scattered

seeds = st.integers(0, 2**32 - 1)


def program_of(seed: int, points: np.ndarray) -> _Program:
    order = np.random.default_rng(seed).permutation(len(points))
    return _Program(cdist(points, points), order)


def kind_of(cut: Cut) -> str:
    if len(cut.sets) == 1:
        return "subtour"
    return "blossom" if cut.least == 3 * (len(cut.sets) - 1) + 1 else "star"


def crossing(seed: int) -> np.ndarray:
    """Return holes (N, 3) of single rows that cross: their shares break many blossoms."""
    flat = np.vstack([raster(12, 3, 25.0, 120.0), raster(10, 3, 25.0, 130.0)[:, ::-1]])
    points = np.pad(flat, ((0, 0), (0, 1)))
    return points + np.random.default_rng(seed).normal(0, 0.5, points.shape)


@settings(max_examples=12)
@given(seeds, st.integers(4, 7))
def test_bound_is_below_the_shortest(seed: int, count: int) -> None:
    points = scattered(seed, count)
    order = np.random.default_rng(seed).permutation(count)
    assert cut_bound(cdist(points, points), order, np.inf) <= least(points) * (1 + 1e-12) + 1e-9


@given(seeds, st.integers(4, 7), st.integers(0, 6))
def test_any_prices_prove_a_bound(seed: int, count: int, cuts: int) -> None:
    points, rng = scattered(seed, count), np.random.default_rng(seed)
    program = program_of(seed, points)
    for _ in range(cuts):
        size = rng.integers(1, count)
        nodes = np.zeros(count + 1, dtype=bool)
        nodes[rng.permutation(count + 1)[:size]] = True
        program.add([Cut(nodes[None], 2.0)])
        program._cut_price = rng.uniform(1, 50, len(program._cuts))
    program._node_price = rng.normal(0, 100, count + 1)
    assert program.proven()[0] <= least(points) + 1e-6


def test_every_tour_respects_every_cut() -> None:
    """In rounds as the bound takes them, on rows that cross; subtours, blossoms and stars."""
    points, rng = crossing(1), np.random.default_rng(1)
    program, good = program_of(1, points), np.append(route(points).order, len(points))
    separation = Separation(good)
    tours = [rng.permutation(len(points) + 1) for _ in range(20)]
    tours += [np.arange(len(points) + 1), good]
    kinds = set()
    for _ in range(4):
        program.solve()
        cuts = separation.broken(program.edges, program.share)
        for cut in cuts:
            kinds.add(kind_of(cut))
            assert program.share @ cut.row(program.edges) < cut.least
            for tour in tours:
                steps = np.column_stack([tour, np.roll(tour, -1)])
                assert cut.row(steps).sum() >= cut.least
        program.add(cuts)
    assert kinds == {"subtour", "blossom", "star"}


def test_cuts_sharpen_the_bound_where_rows_cross() -> None:
    points = crossing(1)
    distance, order = cdist(points, points), np.arange(len(points))
    assert cut_bound(distance, order, np.inf) > 1.03 * lower_bound(distance, order)


def test_edges_that_the_program_has_not_seen_count_too() -> None:
    """On a bad tour's edges alone the solver finds far too long an answer; that proves nothing."""
    points = np.random.default_rng(2).uniform(0, 500, (30, 3))
    distance, good = cdist(points, points), route(points)
    order = np.random.default_rng(1).permutation(30)
    tour = np.append(order, 30)
    program = _Program(distance, order)
    program.edges = np.sort(np.column_stack([tour, np.roll(tour, -1)]), axis=1)
    assert program.solve() > 2 * good.travel_mm
    bound_mm, missing = program.proven()
    assert bound_mm <= good.travel_mm
    assert len(missing) > 0
    assert cut_bound(distance, order, np.inf) <= good.travel_mm
