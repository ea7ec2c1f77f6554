"""Interpolation of position errors within a cell of the grid, from its eight vertices.

``idw`` is the paper's (eqs 9-10), on distances from nominal to nominal position. Its trap: it
does not reproduce even a linear field (slope g on pitch h leaves 0.154 g h mean, 0.365 g h max);
``trilinear`` on the same vertices does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from hilcell.compensation.grid import Grid, GridError, Ints
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import figures_of, lengths_mm

CORNERS = np.array(list(product((0, 1), repeat=3)))  # (8, 3) steps from a cell's lowest vertex


def idw(grid: Grid, errors_mm: ArrayLike, targets_mm: ArrayLike) -> Array:
    """Return errors (N, 3) at targets (N, 3) by inverse distances, eqs 9-10.

    ``errors_mm`` (nx, ny, nz, 3) at the vertices. Raises `OutsideGrid`, and `GridError` where a
    vertex of a target's cell was not measured.
    """
    return _blended(grid, errors_mm, targets_mm, idw_weights)


def trilinear(grid: Grid, errors_mm: ArrayLike, targets_mm: ArrayLike) -> Array:
    """Return errors (N, 3) at targets (N, 3), linear along each axis; else as `idw`."""
    return _blended(grid, errors_mm, targets_mm, trilinear_weights)


def idw_weights(place: Array, pitch: ArrayLike) -> Array:
    """Return eq 9's weights (N, 8) at places (N, 3), 0..1 in a cell with this pitch.

    On a vertex its own weight is exactly 1.
    """
    return inverse_distance_weights(np.linalg.norm((place[:, None, :] - CORNERS) * pitch, axis=-1))


def inverse_distance_weights(distance: Array) -> Array:
    """Return eq 9's weights (N, K) of distances (N, K): exactly 1 for a distance of 0."""
    nearest = distance.min(axis=1, keepdims=True)
    # nearest / distance instead of 1 / distance: the same weights, finite at distance 0.
    weight = np.divide(nearest, distance, out=np.ones_like(distance), where=distance > nearest)
    normal: Array = weight / weight.sum(axis=1, keepdims=True)
    return normal


def trilinear_weights(place: Array, pitch: ArrayLike) -> Array:
    """Return the trilinear weights (N, 8) at places (N, 3), 0..1 in a cell."""
    share = np.where(CORNERS == 1, place[:, None, :], 1.0 - place[:, None, :])
    weight: Array = share.prod(axis=-1)
    return weight


METHODS: Mapping[str, Callable[[Grid, ArrayLike, ArrayLike], Array]] = {
    "idw": idw,
    "trilinear": trilinear,
}
WEIGHTS: Mapping[str, Callable[[Array, ArrayLike], Array]] = {
    "idw": idw_weights,
    "trilinear": trilinear_weights,
}


def loocv(grid: Grid, errors_mm: ArrayLike, method: str) -> Array:
    """Return predicted minus measured errors (M, 3) of vertices left out.

    A vertex is predicted from every cell two pitches wide that has it on an edge, a face or in
    its middle, but not as a corner; an axis with two vertices only is not widened. The grid's own
    corners are never predicted. So the figures rank the methods; at twice the pitch they are
    worse than at the pitch itself. Raises `GridError` where the grid is one cell or has gaps.
    """
    errors = _checked(grid, errors_mm)
    if not np.isfinite(errors).all():
        raise GridError(f"cross-validation: {_missing(errors)}; measure the whole grid")
    span = np.minimum(np.array(grid.shape) - 1, 2)
    if span.max() < 2:
        raise GridError("cross-validation: the grid is one cell; measure three vertices an axis")
    steps = np.array(list(product(*(range(s + 1) for s in span))))
    inner = steps[(steps % span != 0).any(axis=1)]
    weights = WEIGHTS[method](inner / span, span * grid.pitch_mm)
    lows = np.array(list(product(*(range(n - s) for n, s in zip(grid.shape, span, strict=True)))))
    corners = _at(errors, lows[:, None, :] + CORNERS * span)
    predicted = np.einsum("mc,bcx->bmx", weights, corners)
    left: Array = predicted - _at(errors, lows[:, None, :] + inner)
    return left.reshape(-1, 3)


def cross_validate(grid: Grid, errors_mm: ArrayLike) -> dict[str, dict[str, float]]:
    """Return mean, p95 and max (mm) of `loocv` by method."""
    figures = {}
    for method in METHODS:
        figures[method] = figures_of(lengths_mm(loocv(grid, errors_mm, method)))._asdict()
    return figures


def choose(figures: Mapping[str, Mapping[str, float]]) -> str:
    """Return the method with the least mean of `cross_validate`."""
    return min(figures, key=lambda method: figures[method]["mean"])


def _blended(
    grid: Grid,
    errors_mm: ArrayLike,
    targets_mm: ArrayLike,
    weights_of: Callable[[Array, ArrayLike], Array],
) -> Array:
    errors = _checked(grid, errors_mm)
    cells, place = grid.cells(targets_mm)
    corners = _at(errors, cells[:, None, :] + CORNERS)
    if not np.isfinite(corners).all():
        raise GridError(f"interpolation: {_missing(errors)}; measure them, or move the targets")
    blended: Array = np.einsum("nc,ncx->nx", weights_of(place, grid.pitch_mm), corners)
    return blended


def _at(errors: Array, indices: Ints) -> Array:
    picked: Array = errors[indices[..., 0], indices[..., 1], indices[..., 2]]
    return picked


def _checked(grid: Grid, errors_mm: ArrayLike) -> Array:
    errors = np.asarray(errors_mm, dtype=float)
    if errors.shape != (*grid.shape, 3):
        raise GridError(f"errors: shape {errors.shape}, wanted {(*grid.shape, 3)}")
    return errors


def _missing(errors: Array) -> str:
    gaps = np.argwhere(~np.isfinite(errors).all(axis=-1))
    named = ", ".join("-".join(map(str, gap)) for gap in gaps[:5])
    return f"{len(gaps)} vertices have no error: {named}{', ...' if len(gaps) > 5 else ''}"
