"""IDW and trilinear: exactness, weights, the linear field of slip 6, gaps, cross-validation."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from hilcell.compensation.grid import Grid, GridError, OutsideGrid
from hilcell.compensation.interpolation import (
    METHODS,
    choose,
    cross_validate,
    idw,
    idw_weights,
    loocv,
    trilinear,
    trilinear_weights,
)
from hilcell.geometry.kinematics import Array

Method = Callable[[Grid, ArrayLike, ArrayLike], Array]
Weights = Callable[[Array, ArrayLike], Array]
GRID = Grid(np.array([1400.0, -450.0, 500.0]), 300.0, (4, 4, 4))
seeds = st.integers(0, 2**32 - 1)
places = st.lists(st.lists(st.floats(0, 1), min_size=3, max_size=3), min_size=1, max_size=5)
methods = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())


def random_errors(seed: int, grid: Grid = GRID) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 1, (*grid.shape, 3))


def targets_of(seed: int, count: int = 50) -> np.ndarray:
    return np.random.default_rng(seed).uniform(GRID.origin_mm, GRID.far_mm, (count, 3))


@given(places, st.floats(1, 1000))
@pytest.mark.parametrize("weights_of", [idw_weights, trilinear_weights])
def test_weights_are_shares(weights_of: Weights, place: list[list[float]], pitch: float) -> None:
    weights = weights_of(np.array(place), pitch)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert (weights >= 0).all()


@given(seeds)
@methods
def test_vertices_are_exact(method: Method, seed: int) -> None:
    errors = random_errors(seed)
    found = method(GRID, errors, GRID.vertices_mm().reshape(-1, 3))
    np.testing.assert_allclose(found, errors.reshape(-1, 3), rtol=0, atol=1e-12)


def test_idw_is_exact_at_distance_zero_and_continuous_beside_it() -> None:
    errors = random_errors(7)
    vertex = GRID.vertices_mm()[1, 2, 1]
    assert (idw(GRID, errors, [vertex])[0] == errors[1, 2, 1]).all()
    np.testing.assert_allclose(idw(GRID, errors, [vertex + 1e-7])[0], errors[1, 2, 1], atol=1e-7)


@given(seeds)
@methods
def test_the_middle_of_a_cell_is_the_mean_of_its_vertices(method: Method, seed: int) -> None:
    errors = random_errors(seed)
    middle = GRID.origin_mm + 300 * np.array([2.5, 0.5, 1.5])
    mean = errors[2:4, 0:2, 1:3].mean(axis=(0, 1, 2))
    np.testing.assert_allclose(method(GRID, errors, [middle])[0], mean, atol=1e-12)


@given(seeds)
@methods
def test_result_lies_between_the_cell_s_vertices_only(method: Method, seed: int) -> None:
    errors = np.full((*GRID.shape, 3), np.nan)
    errors[1:3, 1:3, 1:3] = np.random.default_rng(seed).uniform(-1, 1, (2, 2, 2, 3))
    inside = GRID.origin_mm + 300 * (1 + np.random.default_rng(seed).uniform(0, 0.999, (20, 3)))
    found = method(GRID, errors, inside)
    corners = errors[1:3, 1:3, 1:3].reshape(-1, 3)
    assert (found >= corners.min(axis=0) - 1e-12).all()
    assert (found <= corners.max(axis=0) + 1e-12).all()


@given(seeds)
def test_idw_is_equations_9_and_10_written_out(seed: int) -> None:
    errors, target = random_errors(seed), targets_of(seed, 1)[0]
    low = np.floor((target - GRID.origin_mm) / 300).astype(int)
    total, norm = np.zeros(3), 0.0
    for corner in np.ndindex(2, 2, 2):
        index = tuple(low + corner)
        distance = float(np.linalg.norm(target - GRID.vertices_mm()[index]))
        total, norm = total + errors[index] / distance, norm + 1 / distance
    np.testing.assert_allclose(idw(GRID, errors, [target])[0], total / norm, atol=1e-9)


@given(seeds)
@methods
def test_a_constant_error_and_a_turned_grid_stay_what_they_are(method: Method, seed: int) -> None:
    targets, shift = targets_of(seed), np.array([0.3, -0.2, 1.1])
    constant = np.broadcast_to(shift, (*GRID.shape, 3))
    np.testing.assert_allclose(method(GRID, constant, targets), np.tile(shift, (50, 1)), atol=1e-12)
    errors = random_errors(seed)
    turned = Grid(GRID.origin_mm[[1, 2, 0]], 300.0, GRID.shape)
    np.testing.assert_allclose(
        method(turned, np.moveaxis(errors, 0, 2), targets[:, [1, 2, 0]]),
        method(GRID, errors, targets),
        atol=1e-12,
    )


def test_trilinear_has_a_linear_field_and_idw_has_not() -> None:
    """Slip 6: slope g on pitch h leaves 0.154 g h mean, 0.365 g h max with IDW."""
    slope = 0.002 * np.eye(3)
    errors = GRID.vertices_mm() @ slope
    targets = targets_of(1, 100_000)
    exact = targets @ slope
    np.testing.assert_allclose(trilinear(GRID, errors, targets), exact, atol=1e-9)
    left = np.abs(idw(GRID, errors, targets) - exact)[:, 0] / (0.002 * 300)
    assert left.mean() == pytest.approx(0.154, abs=0.002)
    assert left.max() == pytest.approx(0.365, abs=0.003)


@methods
def test_outside_is_refused(method: Method) -> None:
    with pytest.raises(OutsideGrid, match=r"target 1 by 1\.000 mm"):
        method(GRID, random_errors(0), GRID.far_mm + np.array([[1, 0, 0]]))


@methods
def test_a_gap_is_refused_where_it_counts(method: Method) -> None:
    errors = random_errors(0)
    errors[3, 3, 3, 1] = np.nan
    assert np.isfinite(method(GRID, errors, [GRID.origin_mm + 1])).all()
    with pytest.raises(GridError, match=r"1 vertices have no error: 3-3-3"):
        method(GRID, errors, [GRID.far_mm - 1])
    with pytest.raises(GridError, match="3-3-3"):
        loocv(GRID, errors, "idw")


def test_errors_of_another_shape_are_refused() -> None:
    with pytest.raises(GridError, match="wanted"):
        idw(GRID, np.zeros((4, 4, 3, 3)), [GRID.origin_mm])


@given(seeds, st.sampled_from(sorted(METHODS)))
def test_cross_validation_predicts_each_vertex_without_itself(seed: int, method: str) -> None:
    """Against the public interpolation on every cell two pitches wide."""
    errors = random_errors(seed)
    found = loocv(GRID, errors, method)
    assert len(found) == 8 * 19
    left = []
    for low in np.ndindex(2, 2, 2):
        block = errors[tuple(slice(n, n + 3) for n in low)]
        wide = Grid(np.zeros(3), 600.0, (2, 2, 2))
        for index in np.ndindex(3, 3, 3):
            if any(n == 1 for n in index):
                predicted = METHODS[method](wide, block[::2, ::2, ::2], [300.0 * np.array(index)])
                left.append(predicted[0] - block[index])
    np.testing.assert_allclose(found, left, atol=1e-9)


def test_cross_validation_of_a_flat_grid() -> None:
    flat = Grid(np.zeros(3), 100.0, (3, 2, 2))
    errors = flat.vertices_mm() * 0.01
    np.testing.assert_allclose(loocv(flat, errors, "trilinear"), 0, atol=1e-12)
    assert len(loocv(flat, errors, "idw")) == 4


def test_cross_validation_of_one_cell_is_refused() -> None:
    cell = Grid(np.zeros(3), 100.0, (2, 2, 2))
    with pytest.raises(GridError, match="one cell"):
        loocv(cell, np.zeros((2, 2, 2, 3)), "idw")


def test_the_better_method_is_chosen() -> None:
    figures = cross_validate(GRID, GRID.vertices_mm() * 0.001)
    assert figures["trilinear"]["max"] < 1e-9 < figures["idw"]["mean"] <= figures["idw"]["p95"]
    assert choose(figures) == "trilinear"
    assert choose({"idw": {"mean": 0.1}, "trilinear": {"mean": 0.2}}) == "idw"
