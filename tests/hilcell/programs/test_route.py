"""Routes and their bound against every order of small cases; large ones near their bound."""

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from hilcell.programs.route import (
    Cut,
    Separation,
    _evaluated,
    _Growth,
    _Program,
    _Search,
    cut_bound,
    lower_bound,
    route,
    star,
)
from tests.whole.bench import sweep

seeds = st.integers(0, 2**32 - 1)


def scattered(seed: int, count: int) -> np.ndarray:
    """Return points (N, 3): any, on a coarse raster with ties and doubles, or on one line."""
    rng = np.random.default_rng(seed)
    kind = seed % 3
    if kind == 0:
        return rng.uniform(-500, 500, (count, 3))
    if kind == 1:
        return rng.integers(0, 3, (count, 3)) * 25.0
    return rng.uniform(-500, 500, (count, 1)) * [0.6, 0.8, 0.0]


def raster(along: int, across: int, pitch_mm: float, gap_mm: float) -> np.ndarray:
    """Return holes (N, 2) of rows with one pitch, a gap apart."""
    return np.array([(pitch_mm * i, gap_mm * j) for j in range(across) for i in range(along)])


PANELS = {
    "stringers": raster(50, 10, 25.0, 180.0),
    "stringers in double rows": np.vstack(
        [raster(50, 5, 25.0, 200.0), raster(50, 5, 25.0, 200.0) + [12.5, 22.0]]
    ),
    "butt strap": raster(125, 4, 22.0, 20.0),
    "clips of four": np.vstack(
        [raster(11, 11, 250.0, 180.0) + each for each in raster(2, 2, 25.0, 25.0)]
    ),
    "stringers and frames in double rows": np.vstack(
        [raster(50, 3, 25.0, 400.0) + [0, shift] for shift in (0, 22)]
        + [raster(25, 4, 22.5, 300.0)[:, ::-1] + [12 + shift, 0] for shift in (0, 22)]
    ),
}


def curved(flat: np.ndarray, seed: int) -> np.ndarray:
    """Return the holes (N, 3) on a fuselage panel, shuffled, each a little off its raster."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([flat, 200.0 * np.cos(flat[:, 1] / 600.0)])
    return rng.permutation(points + rng.normal(0, 0.05, points.shape))


def least(points: np.ndarray) -> float:
    """Return the length of the shortest of all open routes."""
    orders = np.array(list(permutations(range(len(points)))))
    distance = cdist(points, points)
    return float(distance[orders[:, :-1], orders[:, 1:]].sum(axis=1).min())


def travelled(points: np.ndarray, order: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points[order], axis=0), axis=1).sum())


@given(seeds, st.integers(1, 7))
@example(1, 7)
@example(3, 2)
def test_small_cases_against_every_order(seed: int, count: int) -> None:
    points = scattered(seed, count)
    best_mm, found = least(points), route(points)
    assert found.travel_bound_mm <= best_mm * (1 + 1e-12)
    assert found.travel_mm >= best_mm * (1 - 1e-12)
    assert found.travel_mm <= 1.03 * best_mm + 1e-9
    assert found.travel_bound_mm >= 0.75 * best_mm - 1e-9


@given(seeds, st.integers(3, 7), st.floats(0, 300))
def test_bound_holds_for_any_prices(seed: int, count: int, spread: float) -> None:
    points = scattered(seed, count)
    price = np.random.default_rng(seed).normal(0, spread, count)
    bound_mm, tree = _evaluated(cdist(points, points), price)
    assert bound_mm <= least(points) + 1e-9
    assert len(tree) == count - 1


@given(seeds, st.integers(3, 40))
def test_tree_is_the_least(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    points, price = rng.uniform(0, 100, (count, 3)), rng.uniform(0, 50, count)
    distance = cdist(points, points)
    weight = np.triu(distance + price[:, None] + price, 1)
    wanted = minimum_spanning_tree(weight).sum() + np.sort(price)[:2].sum() - 2 * price.sum()
    assert _evaluated(distance, price)[0] == pytest.approx(wanted)


@settings(max_examples=10)
@given(seeds, st.integers(1, 60))
def test_every_hole_once_and_the_length_is_true(seed: int, count: int) -> None:
    points = scattered(seed, count)
    found = route(points)
    assert sorted(found.order.tolist()) == list(range(count))
    assert found.travel_mm == pytest.approx(travelled(points, found.order))
    assert found.travel_bound_mm <= found.travel_mm


@given(seeds, st.integers(4, 40))
def test_search_keeps_its_books(seed: int, count: int) -> None:
    """Every gain that a move or kick claims is the change of the tour's length."""
    points = scattered(seed, count)
    search = _Search(cdist(points, points), np.random.default_rng(seed).permutation(count))
    before = search._length()
    search._enqueue(range(count + 1))
    gain = search._shortened()
    assert search._length() == pytest.approx(before - gain, abs=1e-6)
    for place, node in enumerate(search._tour):
        assert search._place[node] == place
    assert sorted(search._tour) == list(range(count + 1))


@pytest.mark.parametrize("seed", [0, *sweep(1, 2)])
def test_random_holes_within_5_percent_of_the_bound(seed: int) -> None:
    found = route(np.random.default_rng(seed).uniform(-900, 900, (200, 3)) * [0.05, 1, 1])
    assert 1.0 <= found.travel_mm / found.travel_bound_mm <= 1.05


HARDEST = "stringers and frames in double rows"


@pytest.mark.parametrize("kind", [HARDEST, *sweep(*sorted(PANELS.keys() - {HARDEST}))])
def test_500_holes_of_a_panel_within_5_percent_of_the_bound(kind: str) -> None:
    found = route(curved(PANELS[kind], 1))
    assert 480 <= len(found.order) <= 500
    assert 1.0 <= found.travel_mm / found.travel_bound_mm <= 1.05


def test_single_rows_that_meet_need_the_stars() -> None:
    """Rows that end on others: without cuts the bound leaves more than 5 percent."""
    long = raster(25, 3, 2800 / 49, 300.0) + [-1400, 950]
    short = raster(10, 5, 66.0, 311.0)[:, ::-1] + [-1400, 905]
    points = np.pad(np.vstack([long, short]), ((0, 0), (1, 0)), constant_values=-60.0)
    found = route(points)
    assert len(found.order) == 125
    assert 1.0 <= found.travel_mm / found.travel_bound_mm <= 1.05
    assert lower_bound(cdist(points, points), found.order) < found.travel_mm / 1.05


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


def nested(handles: int) -> Cut:
    """Return a star of three teeth with one node in each shell: levels 0 .. handles, three each."""
    level, tooth = np.divmod(np.arange(3 * (handles + 1)), 3)
    return star(level <= np.arange(handles)[:, None], tooth == np.arange(3)[:, None])


@pytest.mark.parametrize("handles", [1, 2])
def test_a_star_against_every_tour(handles: int) -> None:
    cut = nested(handles)
    count = cut.sets.shape[1]
    tours = np.array([(0, *rest) for rest in permutations(range(1, count))])
    steps = np.stack([tours, np.roll(tours, -1, axis=1)], axis=-1).reshape(-1, 2)
    left = cut.row(steps).reshape(len(tours), count).sum(axis=1)
    assert left.min() == cut.least == 4 * handles + 6


@settings(max_examples=4)
@given(st.integers(0, 2**32 - 1))
def test_grown_stars_have_a_node_of_every_tooth_in_every_shell(seed: int) -> None:
    """Where rows end on another row."""
    flat = np.vstack([raster(40, 1, 25.0, 1.0), raster(10, 3, 30.0, 250.0)[:, ::-1] + [240, 20]])
    points = flat + np.random.default_rng(seed).normal(0, 0.5, flat.shape)
    program = _Program(cdist(points, points), np.arange(len(points)))
    separation, most = Separation(np.arange(len(points) + 1)), 0
    for _ in range(3):
        program.solve()
        program.add(separation.broken(program.edges, program.share))
        matrix = np.zeros((len(points) + 1,) * 2)
        matrix[tuple(program.edges.T)] = program.share
        for seed_cut in separation._stars._seeds.values():
            growth = _Growth(matrix + matrix.T, seed_cut)
            growth.star()
            check(growth._handles, growth._teeth)
            most = max(most, len(growth._handles))
    assert most > 2


def check(handles: np.ndarray, teeth: np.ndarray) -> None:
    """Fail unless handles are nested, complements counting, and teeth disjoint and everywhere."""
    first = handles[0]
    chain = [each if (each | ~first).all() else ~each for each in handles]
    chain.sort(key=lambda each: each.sum())
    for inner, outer in pairwise(chain):
        assert (outer | ~inner).all()
    level = np.sum(chain, axis=0)
    for tooth in teeth:
        assert set(level[tooth]) == set(range(len(chain) + 1))
    assert teeth.sum(axis=0).max() == 1
    assert len(teeth) % 2 == 1
