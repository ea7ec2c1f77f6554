"""The lattice: order of visit, cells and faces, refusals that name the target."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilcell.compensation.grid import Grid, GridError, OutsideGrid

GRID = Grid(np.array([1400.0, -450.0, 500.0]), 300.0, (4, 4, 4))
shapes = st.tuples(*[st.integers(2, 5)] * 3)


@given(shapes)
def test_serpentine_visits_every_vertex_once_by_single_pitches(shape: tuple[int, int, int]) -> None:
    order = Grid(np.zeros(3), 300.0, shape).serpentine()
    assert len({tuple(index) for index in order}) == len(order) == np.prod(shape)
    assert (order.min(axis=0) == 0).all()
    assert (order.max(axis=0) == np.array(shape) - 1).all()
    np.testing.assert_array_equal(np.abs(np.diff(order, axis=0)).sum(axis=1), 1)


def test_serpentine_positions_are_the_vertices() -> None:
    indices = GRID.serpentine()
    np.testing.assert_array_equal(GRID.vertices_mm()[tuple(indices.T)], GRID.serpentine_mm())
    np.testing.assert_array_equal(GRID.far_mm, [2300, 450, 1400])


@given(st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_cell_and_place_give_the_target_back(share: list[float]) -> None:
    target = GRID.origin_mm + np.array(share) * 900
    cell, place = GRID.cells(target[None])
    assert (cell >= 0).all()
    assert (cell <= 2).all()
    np.testing.assert_allclose(GRID.origin_mm + 300 * (cell + place)[0], target, atol=1e-9)


def test_upper_faces_belong_to_the_last_cell() -> None:
    cell, place = GRID.cells([GRID.far_mm, GRID.origin_mm, GRID.origin_mm + 300])
    np.testing.assert_array_equal(cell, [[2, 2, 2], [0, 0, 0], [1, 1, 1]])
    np.testing.assert_array_equal(place, [[1, 1, 1], [0, 0, 0], [0, 0, 0]])


def test_outside_names_the_targets_and_by_how_much() -> None:
    targets = np.array(
        [GRID.origin_mm, GRID.far_mm + np.array([3, 4, 0]), GRID.origin_mm - np.array([0, 0, 0.25])]
    )
    with pytest.raises(
        OutsideGrid,
        match=r"2 of 3 targets .* mm in \{B\}: target 2 by 5\.000 mm \(at .*target 3 by 0\.250 mm",
    ):
        GRID.check_inside(targets)
    with pytest.raises(OutsideGrid, match="H2"):
        GRID.check_inside(targets, ["H1", "H2", "H3"])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_is_outside(bad: float) -> None:
    with pytest.raises(OutsideGrid):
        GRID.cells([[1500.0, bad, 600.0]])


@pytest.mark.parametrize(
    ("origin", "pitch", "shape"),
    [
        ([0, 0, np.nan], 300.0, (4, 4, 4)),
        ([0, 0], 300.0, (4, 4, 4)),
        ([0, 0, 0], 0.0, (4, 4, 4)),
        ([0, 0, 0], np.nan, (4, 4, 4)),
        ([0, 0, 0], np.inf, (4, 4, 4)),
        ([0, 0, 0], 300.0, (4, 1, 4)),
    ],
)
def test_grid_refuses(origin: list[float], pitch: float, shape: tuple[int, int, int]) -> None:
    with pytest.raises(GridError):
        Grid(np.array(origin, dtype=float), pitch, shape)
