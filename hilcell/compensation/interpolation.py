"""Interpolation of position errors within a cell of the grid, from its eight vertices.

`Idw` is the paper's (eqs 9-10), on distances between nominal positions. It does not reproduce even
a linear field (slope g on pitch h leaves 0.154 g h mean, 0.365 g h max); `Trilinear` does. For
poses that are no lattice `Idw` uses the nearest.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from itertools import product
from typing import Self

import msgspec
import numpy as np

from hilcell.compensation.grid import Grid, GridError, MeasuredGrid
from hilcell.compensation.model import LearntModel, Measured, ModelError, Prediction
from hilcell.decoding import Json, typed
from hilcell.geometry.kinematics import Array, Ints
from hilcell.language import marked

# (8, 3) steps from a cell's lowest vertex
CORNERS: Ints = np.array([*product((0, 1), repeat=3)])


class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The covariances (nx, ny, nz, 3, 3) of the errors at the vertices, and of the residual."""

    vertex_covariance_mm2: list[list[list[list[list[float]]]]]
    residual_covariance_mm2: list[list[float]]


@dataclass(frozen=True, eq=False)
class Interpolation(LearntModel):
    """Error interpolated from the eight vertices of the target's cell, with weights w that sum to
    1.

    The covariance is ``sum w_i^2 V_i + (1 - sum w_i^2) R``. V: of each vertex's averaged reading,
    independent (GUM 5.1.2). R: errors finer than the lattice, with the repeatability of single
    visits; estimated from vertices left out, less their readings' share, and assumed equal
    everywhere and at twice the pitch: good to about 30 %. Not covered: the tracker's systematic
    error, temperature, the repeatability of the visit to the target, the frames {W} and {S}. The
    error of {B} cancels: grid and targets are carried by the same {B}.
    """

    lattice: MeasuredGrid
    residual_mm2: Array

    @staticmethod
    @abstractmethod
    def weights(place: Array, pitch_mm: float | Array) -> Array:
        """Weights (N, 8) of `CORNERS` at positions (N, 3), 0..1 in a cell."""

    @classmethod
    def of_grid(cls, lattice: MeasuredGrid) -> Self:
        """Model with R: the covariance of errors at left-out vertices beyond readings."""
        own = lattice.covariance_mm2
        lows, inner, weights = _wide_cells(cls, lattice)
        missed = cls._missed_mm(lattice)
        corners = _at(own, lows[:, None, :] + CORNERS * _span(lattice.grid))
        readings = np.einsum("mc,bcxy->xy", weights**2, corners)
        readings += _at(own, lows[:, None, :] + inner).sum(axis=(0, 1))
        values, axes = np.linalg.eigh(missed.T @ missed - readings)
        share: float = len(lows) * float(_unshared(weights).sum())
        half = axes * np.sqrt(np.maximum(values, 0.0))
        return cls(lattice, np.asarray(half @ half.T / share))

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Predicted minus measured errors (M, 3) of vertices left out.

        A vertex is predicted from every cell two pitches wide that has it on an edge, a face or in
        its middle, but not as a corner; an axis with two vertices only is not widened. The grid's
        own corners are never predicted. The figures rank the models; at twice the pitch they are
        worse than at the pitch itself. Raises `GridError` where the grid is one cell or has gaps.
        """
        return cls._missed_mm(measured.grid)

    @classmethod
    def _missed_mm(cls, lattice: MeasuredGrid) -> Array:
        lows, inner, weights = _wide_cells(cls, lattice)
        errors = lattice.errors_mm
        corners = _at(errors, lows[:, None, :] + CORNERS * _span(lattice.grid))
        predicted = np.einsum("mc,bcx->bmx", weights, corners)
        left: Array = predicted - _at(errors, lows[:, None, :] + inner)
        return left.reshape(-1, 3)

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Json) -> Self:
        try:
            found = typed(parameters, Parameters)
            vertices = np.array(found.vertex_covariance_mm2, dtype=float)
            residual = np.array(found.residual_covariance_mm2, dtype=float)
        except (msgspec.ValidationError, ValueError) as error:
            raise ModelError(f"no covariances of a lattice: {error}") from error
        check_covariance("vertex_covariance_mm2", vertices, (*grid.shape, 3, 3))
        check_covariance("residual_covariance_mm2", residual, (3, 3))
        return cls(MeasuredGrid(grid, errors_mm, vertices), residual)

    def parameters(self) -> Json:
        return {
            "vertex_covariance_mm2": self.lattice.covariance_mm2.tolist(),
            "residual_covariance_mm2": self.residual_mm2.tolist(),
        }

    def predict(self, poses: Array) -> Prediction:
        """Errors at the positions of poses; raises `OutsideGrid`, `GridError` for gaps."""
        grid, errors = self.lattice.grid, self.lattice.errors_mm
        cells, place = grid.cells(poses[:, :3, 3])
        vertices = cells[:, None, :] + CORNERS
        corners = _at(errors, vertices)
        if not np.isfinite(corners).all():
            raise GridError(f"interpolation: {_missing(errors)}; measure them, or move the targets")
        weights = self.weights(place, grid.pitch_mm)
        own = _at(self.lattice.covariance_mm2, vertices)
        return Prediction(
            np.einsum("nc,ncx->nx", weights, corners),
            np.einsum("nc,ncxy->nxy", weights**2, own)
            + _unshared(weights)[:, None, None] * self.residual_mm2,
        )


class Idw(Interpolation):
    """Inverse distances, eqs 9-10; over `NearestPoses` where no lattice was measured."""

    name = "idw"
    text = marked(
        "corrected by inverse-distance interpolation of the grid's errors "
        "(Tian et al., Chinese Journal of Aeronautics, 2014)"
    )

    @classmethod
    def learn(cls, measured: Measured) -> LearntModel:
        if measured.lattice is None:
            return NearestPoses.learn(measured)
        return cls.of_grid(measured.lattice)

    @staticmethod
    def weights(place: Array, pitch_mm: float | Array) -> Array:
        """Eq 9's weights (N, 8) at positions (N, 3); on a vertex its own is exactly 1."""
        steps_mm = (place[:, None, :] - CORNERS) * pitch_mm
        return inverse_distance_weights(np.linalg.norm(steps_mm, axis=-1))


class Trilinear(Interpolation):
    """Linear along each axis."""

    name = "trilinear"
    text = marked("corrected by trilinear interpolation of the grid's errors")
    scattered = False

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        return cls.of_grid(measured.grid)

    @staticmethod
    def weights(place: Array, pitch_mm: float | Array) -> Array:
        share = np.where(CORNERS == 1, place[:, None, :], 1.0 - place[:, None, :])
        return np.asarray(share.prod(axis=-1))


NEIGHBOURS = 8  # poses that one prediction is interpolated from


@dataclass(frozen=True, eq=False)
class NearestPoses(LearntModel):
    """Eqs 9-10 over the `NEIGHBOURS` nearest of scattered poses, at points and of errors (N, 3).

    One covariance (3, 3) for all targets: the mean square of errors at poses left out, with
    readings, repeatability and what lies between the poses. It does not state where a prediction is
    worse.
    """

    points_mm: Array
    errors_mm: Array
    covariance_mm2: Array

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        poses, missed_mm = measured.poses, cls.left_out_mm(measured)
        covariance_mm2 = missed_mm.T @ missed_mm / len(poses)
        return cls(poses.nominal[:, :3, 3], poses.error_mm, covariance_mm2)

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        poses, points_mm = measured.poses, measured.poses.nominal[:, :3, 3]
        missed_mm = -poses.error_mm
        for fold in np.unique(poses.fold):
            out = poses.fold == fold
            missed_mm[out] += cls._blended(points_mm[~out], poses.error_mm[~out], points_mm[out])
        return missed_mm

    def predict(self, poses: Array) -> Prediction:
        """Errors at poses (N, 4, 4); only their positions count."""
        error_mm = self._blended(self.points_mm, self.errors_mm, poses[:, :3, 3])
        return Prediction(error_mm, np.broadcast_to(self.covariance_mm2, (len(poses), 3, 3)))

    @staticmethod
    def _blended(points_mm: Array, errors_mm: Array, targets_mm: Array) -> Array:
        distance = np.linalg.norm(targets_mm[:, None] - points_mm, axis=-1)
        nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
        weights = inverse_distance_weights(np.take_along_axis(distance, nearest, axis=1))
        return np.asarray(np.einsum("nk,nkx->nx", weights, errors_mm[nearest]))


def inverse_distance_weights(distance: Array) -> Array:
    """Eq 9's weights (N, K) of distances (N, K): exactly 1 for a distance of 0."""
    nearest = distance.min(axis=1, keepdims=True)
    # nearest / distance instead of 1 / distance: the same weights, finite at distance 0.
    weight = np.divide(nearest, distance, out=np.ones_like(distance), where=distance > nearest)
    return np.asarray(weight / weight.sum(axis=1, keepdims=True))


def _unshared(weights: Array) -> Array:
    """1 - sum w^2 (N,) of weights (N, K): 0 on a vertex, largest in the middle."""
    return np.asarray(np.maximum(1.0 - np.sum(weights**2, axis=1), 0.0))


def _span(grid: Grid) -> Ints:
    """Size in pitches (3,) of the cells that predict left-out vertices."""
    return np.asarray(np.minimum(np.array(grid.shape) - 1, 2))


def _wide_cells(model: type[Interpolation], lattice: MeasuredGrid) -> tuple[Ints, Ints, Array]:
    """Wide cells' lowest vertices (B, 3), steps (M, 3) to those left out, weights (M, 8)."""
    grid = lattice.grid
    if not np.isfinite(lattice.errors_mm).all():
        raise GridError(f"cross-validation: {_missing(lattice.errors_mm)}; measure the whole grid")
    span = _span(grid)
    if span.max() < 2:
        raise GridError("cross-validation: the grid is one cell; measure three vertices an axis")
    steps = np.array(list(product(*(range(s + 1) for s in span))))
    inner = steps[(steps % span != 0).any(axis=1)]
    lows = np.array(list(product(*(range(n - s) for n, s in zip(grid.shape, span, strict=True)))))
    pitches_mm = np.array(span * grid.pitch_mm, dtype=float)
    return lows, inner, model.weights(inner / span, pitches_mm)


def check_covariance(name: str, found: Array, shape: tuple[int, ...]) -> None:
    """Raise `ModelError` for an array (..., 3, 3) that is not a covariance."""
    if found.shape != shape or not np.isfinite(found).all():
        counts = " x ".join(map(str, shape))
        raise ModelError(f"{name}: expected {counts} finite numbers")
    largest = float(np.abs(found).max())
    most_mm2 = 1e4  # beyond is no uncertainty of a robot's error
    if not largest <= most_mm2:
        raise ModelError(f"{name}: {largest:g} mm2, expected within +-{most_mm2:g} mm2")
    symmetric = 1e-9  # of a covariance, relative to its largest element
    slack = symmetric * max(largest, np.finfo(float).tiny)
    if not np.abs(found - found.swapaxes(-1, -2)).max() <= slack:
        raise ModelError(f"{name}: not symmetric")
    if not np.linalg.eigvalsh(found).min() >= -slack:
        raise ModelError(f"{name}: a variance below zero")


def _at(values: Array, indices: Ints) -> Array:
    return values[indices[..., 0], indices[..., 1], indices[..., 2]]


def _missing(errors: Array) -> str:
    gaps = np.argwhere(~np.isfinite(errors).all(axis=-1))
    named = ", ".join("-".join(map(str, gap)) for gap in gaps[:5])
    return f"{len(gaps)} vertices have no error: {named}{', ...' if len(gaps) > 5 else ''}"
