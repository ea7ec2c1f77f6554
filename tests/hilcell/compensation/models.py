"""Interpolations of errors on a grid whose readings scatter by nothing, or by as much as said."""

import numpy as np
from numpy.typing import ArrayLike

from hilcell.cell.file import load_cell
from hilcell.compensation.grid import Grid, MeasuredGrid
from hilcell.compensation.interpolation import Interpolation
from hilcell.compensation.model import Measured, StaticPoses
from hilcell.geometry.frames import matrix
from hilcell.geometry.kinematics import Array

Kind = type[Interpolation]
ORIENTED = load_cell("paper").grid.centre.matrix()
GRID = Grid(ORIENTED[:3, 3] - 400.0, 400.0, (3, 3, 3))  # about the cell's, in {B}
NO_POSES = StaticPoses.of(
    np.zeros((0, 6)), np.zeros((0, 4, 4)), np.zeros((0, 3)), np.zeros((0, 3, 3))
)


def lattice(grid: Grid, errors_mm: ArrayLike, covariance_mm2: ArrayLike = 0.0) -> MeasuredGrid:
    """Return a measured grid; the covariance is that of all vertices, or one for each."""
    covariances = np.broadcast_to(np.asarray(covariance_mm2, dtype=float), (*grid.shape, 3, 3))
    return MeasuredGrid(grid, np.asarray(errors_mm, dtype=float), covariances)


def measured(grid: Grid, errors_mm: ArrayLike, covariance_mm2: ArrayLike = 0.0) -> Measured:
    """Return the same as models learn it, for those that look at the grid alone."""
    return Measured(NO_POSES, lattice(grid, errors_mm, covariance_mm2))


def level(points_mm: ArrayLike) -> Array:
    """Return poses (N, 4, 4) at points (N, 3), none of them turned."""
    points = np.asarray(points_mm, dtype=float)
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, 3] = points
    return poses


def exact(model: Kind, grid: Grid, errors_mm: ArrayLike) -> Interpolation:
    """Return the interpolation of errors, without any residual."""
    return model(lattice(grid, errors_mm), np.zeros((3, 3)))


def predicted_mm(model: Kind, grid: Grid, errors_mm: ArrayLike, targets_mm: ArrayLike) -> Array:
    """Return the errors (N, 3) that a model of a grid predicts at targets (N, 3)."""
    return exact(model, grid, errors_mm).predict(level(targets_mm)).error_mm


def poses_at(points_mm: Array) -> Array:
    """Return poses (N, 4, 4) at points (N, 3), oriented as the cell's grid."""
    return matrix(ORIENTED[:3, :3], points_mm)


def drawn_mm(seed: int, count: int) -> Array:
    """Return random points (N, 3) within `GRID`."""
    return ORIENTED[:3, 3] + np.random.default_rng(seed).uniform(-400.0, 400.0, (count, 3))
