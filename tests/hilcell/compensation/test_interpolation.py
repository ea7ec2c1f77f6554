"""IDW and trilinear: exactness, weights, the linear field of slip 6, gaps, cross-validation."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from hilcell.compensation.grid import Grid, GridError
from hilcell.compensation.interpolation import Idw, Trilinear
from hilcell.compensation.model import Measured, ModelError, StaticPoses
from hilcell.compensation.model_choice import Nominal, chosen
from hilcell.geometry.kinematics import Array
from hilcell.identification.measured_poses import FOLDS
from tests.hilcell.compensation.models import Kind, exact, lattice, level, measured, predicted_mm

Weights = Callable[[Array, ArrayLike], Array]
GRID = Grid(np.array([1400.0, -450.0, 500.0]), 300.0, (4, 4, 4))
seeds = st.integers(0, 2**32 - 1)
places = st.lists(st.lists(st.floats(0, 1), min_size=3, max_size=3), min_size=1, max_size=5)
models = pytest.mark.parametrize("model", [Idw, Trilinear])


def random_errors(seed: int, grid: Grid = GRID) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 1, (*grid.shape, 3))


def targets_of(seed: int, count: int = 50) -> np.ndarray:
    return np.random.default_rng(seed).uniform(GRID.origin_mm, GRID.far_mm, (count, 3))


@given(places, st.floats(1, 1000))
@pytest.mark.parametrize("inverse_covariance", [Idw.weights, Trilinear.weights])
def test_weights_are_shares(
    inverse_covariance: Weights, place: list[list[float]], pitch: float
) -> None:
    weights = inverse_covariance(np.array(place), pitch)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert (weights >= 0).all()


@given(seeds)
@models
def test_vertices_are_exact(model: Kind, seed: int) -> None:
    errors = random_errors(seed)
    found = predicted_mm(model, GRID, errors, GRID.vertices_mm().reshape(-1, 3))
    np.testing.assert_allclose(found, errors.reshape(-1, 3), rtol=0, atol=1e-12)


@given(seeds)
@models
def test_result_lies_between_the_cell_s_vertices_only(model: Kind, seed: int) -> None:
    errors = np.full((*GRID.shape, 3), np.nan)
    errors[1:3, 1:3, 1:3] = np.random.default_rng(seed).uniform(-1, 1, (2, 2, 2, 3))
    inside = GRID.origin_mm + 300 * (1 + np.random.default_rng(seed).uniform(0, 0.999, (20, 3)))
    found = predicted_mm(model, GRID, errors, inside)
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
    np.testing.assert_allclose(
        predicted_mm(Idw, GRID, errors, [target])[0], total / norm, atol=1e-9
    )


@given(seeds)
@models
def test_a_constant_error_and_a_turned_grid_stay_what_they_are(model: Kind, seed: int) -> None:
    targets, shift = targets_of(seed), np.array([0.3, -0.2, 1.1])
    constant = np.broadcast_to(shift, (*GRID.shape, 3))
    np.testing.assert_allclose(
        predicted_mm(model, GRID, constant, targets), np.tile(shift, (50, 1)), atol=1e-12
    )
    errors = random_errors(seed)
    turned = Grid(GRID.origin_mm[[1, 2, 0]], 300.0, GRID.shape)
    np.testing.assert_allclose(
        predicted_mm(model, turned, np.moveaxis(errors, 0, 2), targets[:, [1, 2, 0]]),
        predicted_mm(model, GRID, errors, targets),
        atol=1e-12,
    )


def test_trilinear_has_a_linear_field_and_idw_has_not() -> None:
    """Slip 6: slope g on pitch h leaves 0.154 g h mean, 0.365 g h max with IDW."""
    slope = 0.002 * np.eye(3)
    errors = GRID.vertices_mm() @ slope
    targets = targets_of(1, 20_000)
    exact = targets @ slope
    np.testing.assert_allclose(predicted_mm(Trilinear, GRID, errors, targets), exact, atol=1e-9)
    left = np.abs(predicted_mm(Idw, GRID, errors, targets) - exact)[:, 0] / (0.002 * 300)
    assert left.mean() == pytest.approx(0.154, abs=0.002)
    assert left.max() == pytest.approx(0.365, abs=0.003)


@models
def test_a_gap_is_refused_where_it_counts(model: Kind) -> None:
    errors = random_errors(0)
    errors[3, 3, 3, 1] = np.nan
    assert np.isfinite(predicted_mm(model, GRID, errors, [GRID.origin_mm + 1])).all()
    with pytest.raises(GridError, match="3-3-3"):
        predicted_mm(model, GRID, errors, [GRID.far_mm - 1])
    with pytest.raises(GridError, match="3-3-3"):
        Idw.left_out_mm(measured(GRID, errors))


@settings(max_examples=6)
@given(seeds, st.sampled_from([Idw, Trilinear]))
def test_cross_validation_predicts_each_vertex_without_itself(seed: int, model: Kind) -> None:
    """Against the public interpolation on every cell two pitches wide."""
    errors = random_errors(seed)
    found = model.left_out_mm(measured(GRID, errors))
    assert len(found) == 8 * 19
    left = []
    for low in np.ndindex(2, 2, 2):
        block = errors[tuple(slice(n, n + 3) for n in low)]
        wide = Grid(np.zeros(3), 600.0, (2, 2, 2))
        for index in np.ndindex(3, 3, 3):
            if any(n == 1 for n in index):
                predicted = predicted_mm(
                    model, wide, block[::2, ::2, ::2], [300.0 * np.array(index)]
                )
                left.append(predicted[0] - block[index])
    np.testing.assert_allclose(found, left, atol=1e-9)


def test_cross_validation_of_one_cell_is_refused() -> None:
    cell = Grid(np.zeros(3), 100.0, (2, 2, 2))
    with pytest.raises(GridError, match="cell"):
        Idw.left_out_mm(measured(cell, np.zeros((2, 2, 2, 3))))


def test_the_better_method_is_chosen() -> None:
    choice = chosen(measured(GRID, GRID.vertices_mm() * 0.001))
    figures = choice.figures
    assert figures["trilinear"].max < 1e-9 < figures["idw"].mean <= figures["idw"].p95
    assert choice.model == "trilinear"
    assert "no pose" in choice.refused["nominal"]


# -- covariance ------------------------------------------------------------------------------------


def random_covariances(seed: int, grid: Grid = GRID) -> Array:
    """Return positive definite covariances (nx, ny, nz, 3, 3), about (10 um)^2."""
    A = np.random.default_rng(seed).normal(0, 0.01, (*grid.shape, 3, 3))
    return np.asarray(A @ A.swapaxes(-1, -2))


@given(seeds)
@models
def test_at_a_vertex_the_covariance_is_the_vertex_s_own(model: Kind, seed: int) -> None:
    covariances = random_covariances(seed)
    learnt = model.learn(measured(GRID, random_errors(seed), covariances))
    found = learnt.predict(level(GRID.vertices_mm().reshape(-1, 3)))
    assert (found.error_mm == random_errors(seed).reshape(-1, 3)).all()
    assert (found.covariance_mm2 == covariances.reshape(-1, 3, 3)).all()


@given(seeds)
@example(222)  # a covariance that nearly vanishes
@models
def test_covariances_are_symmetric_and_no_variance_is_below_zero(model: Kind, seed: int) -> None:
    learnt = model.learn(measured(GRID, random_errors(seed), random_covariances(seed)))
    found = learnt.predict(level(targets_of(seed))).covariance_mm2
    np.testing.assert_allclose(found, found.swapaxes(1, 2), rtol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0


@models
def test_noise_of_the_vertices_scatters_predictions_as_propagated(model: Kind) -> None:
    grid, rng = Grid(np.zeros(3), 300.0, (2, 2, 2)), np.random.default_rng(3)
    covariances, targets = random_covariances(3, grid), rng.uniform(0, 300, (4, 3))
    roots = np.linalg.cholesky(covariances)
    drawn = [
        predicted_mm(model, grid, np.einsum("...ij,...j", roots, noise), targets)
        for noise in rng.standard_normal((1500, *grid.shape, 3))
    ]
    known = lattice(grid, np.zeros((*grid.shape, 3)), covariances)
    wanted = model(known, np.zeros((3, 3))).predict(level(targets)).covariance_mm2
    for target in range(len(targets)):
        found = np.cov(np.array(drawn)[:, target], rowvar=False)
        size = float(np.trace(wanted[target]))
        np.testing.assert_allclose(found, wanted[target], atol=0.12 * size)


@models
def test_the_residual_is_what_vertices_left_out_miss_beyond_their_readings(model: Kind) -> None:
    """Of errors that are independent from vertex to vertex, not of their readings' noise."""
    grid, rng = Grid(np.zeros(3), 100.0, (7, 7, 7)), np.random.default_rng(4)
    unresolved = rng.normal(0, [0.03, 0.05, 0.02], (*grid.shape, 3))
    noise = rng.normal(0, 0.04, (*grid.shape, 3))
    readings = 0.04**2 * np.eye(3)
    both = model.of_grid(lattice(grid, unresolved + noise, readings)).residual_mm2
    alone = model.of_grid(lattice(grid, unresolved)).residual_mm2
    nothing = model.of_grid(lattice(grid, noise, readings)).residual_mm2
    np.testing.assert_allclose(np.diag(both), np.diag(alone), rtol=0.3, atol=2e-4)
    assert np.trace(nothing) < 0.15 * np.trace(alone)


@given(seeds)
@models
def test_a_model_comes_back_from_its_parameters(model: Kind, seed: int) -> None:
    learnt = model.learn(measured(GRID, random_errors(seed), random_covariances(seed)))
    kept = json.loads(json.dumps(learnt.parameters()))
    back = model.restore(GRID, random_errors(seed), kept)
    one, other = (each.predict(level(targets_of(seed))) for each in (learnt, back))
    assert (one.error_mm == other.error_mm).all()
    assert (one.covariance_mm2 == other.covariance_mm2).all()


@pytest.mark.parametrize(
    "change",
    [
        {"residual_covariance_mm2": [[1.0]]},
        {"residual_covariance_mm2": (1e308 * np.eye(3)).tolist()},
        {"residual_covariance_mm2": (-np.eye(3)).tolist()},
        {"residual_covariance_mm2": np.triu(np.ones((3, 3))).tolist()},
        {"vertex_covariance_mm2": []},
        {"vertex_covariance_mm2": "much"},
        {"more": 1.0},
    ],
)
def test_bad_parameters_are_refused(change: dict[str, Any]) -> None:
    errors = random_errors(0)
    kept = exact(Idw, GRID, errors).parameters()
    with pytest.raises(ModelError):
        Idw.restore(GRID, errors, kept | change)


def poses(seed: int, count: int = 60) -> StaticPoses:
    """Return poses with smooth errors and 20 um of noise; each fifth is left out with others."""
    rng = np.random.default_rng(seed)
    points_mm = rng.uniform(0, 1000, (count, 3))
    error_mm = points_mm @ rng.normal(0, 5e-4, (3, 3)) + rng.normal(0, 0.02, (count, 3))
    unknown_mm2 = np.full((count, 3, 3), np.nan)
    fold = np.arange(count) % FOLDS
    return StaticPoses(np.zeros((count, 6)), level(points_mm), error_mm, unknown_mm2, fold)


@given(seeds)
def test_a_pose_is_predicted_exactly_and_others_between_its_neighbours(seed: int) -> None:
    known = poses(seed)
    model = Idw.learn(Measured(known))
    np.testing.assert_allclose(model.predict(known.nominal).error_mm, known.error_mm, atol=1e-12)
    found_mm = model.predict(level(known.nominal[:5, :3, 3] + 1.0)).error_mm
    assert (found_mm >= known.error_mm.min(axis=0)).all()
    assert (found_mm <= known.error_mm.max(axis=0)).all()


@pytest.mark.parametrize("count", [8, 60])
def test_the_covariance_is_the_mean_square_of_poses_left_out(count: int) -> None:
    known = poses(5, count)
    missed = []
    for number in range(count):
        model = Idw.learn(Measured(known.at(known.fold != number % FOLDS)))
        missed.append(known.error_mm[number] - model.predict(known.nominal[[number]]).error_mm[0])
    found = Idw.learn(Measured(known)).predict(level(np.full((3, 3), 7.0))).covariance_mm2
    wanted = sum(np.outer(each, each) for each in missed) / count
    np.testing.assert_allclose(found, np.tile(wanted, (3, 1, 1)), rtol=1e-9)
    assert np.linalg.eigvalsh(wanted).min() > 0


def test_nominal_kinematics_predict_no_error_and_know_how_large_it_is() -> None:
    known = poses(6)
    found = Nominal.learn(Measured(known)).predict(known.nominal[:4])
    assert (found.error_mm == 0).all()
    wanted = known.error_mm.T @ known.error_mm / len(known)
    np.testing.assert_allclose(found.covariance_mm2[3], wanted)


def test_trilinear_interpolation_wants_a_lattice() -> None:
    with pytest.raises(GridError, match="lattice"):
        Trilinear.learn(Measured(poses(6)))
