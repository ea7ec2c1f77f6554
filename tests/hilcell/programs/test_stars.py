"""Stars hold for every tour and are met by some; those grown from blossoms are stars indeed."""

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from hilcell.programs.route import Cut, Separation, _Growth, _Program, star
from tests.hilcell.programs.test_route import raster


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


def test_how_much_shares_miss() -> None:
    cut = nested(1)
    edges = np.array([[0, 3], [1, 4], [2, 5]])
    np.testing.assert_array_equal(cut.row(edges), [1, 1, 1])
    assert cut.missed(edges, np.array([1.0, 1.0, 0.5])) == pytest.approx(7.5)


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
