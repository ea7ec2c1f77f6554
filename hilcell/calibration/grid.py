"""Errors of a robot as measured by a run: the grid's vertices, free poses and curves.

Outlying vertices: each is judged by its studentized residual, divided by ``sqrt(1 - h)``, h its
leverage, from a smooth field of second order in x, y and z, against the spread of the residuals. A
limit in mm would be knowledge about one robot.

Similarity of errors (section 3.2, eq 8) falls with the distance of joints; that of tool points
replaces it only at one fixed orientation and configuration. One nearly equal pair dominates a mean
of similarities, so differences are averaged.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from statistics import NormalDist
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hilcell.calibration.known_arm import carried_arm
from hilcell.cell.file import Cell, coarsest_pitch_mm
from hilcell.compensation.grid import Grid, MeasuredGrid
from hilcell.compensation.kinematic import Kinematic
from hilcell.compensation.model import Measured, MeasuredArm, StaticPoses
from hilcell.geometry.frames import apply, inverse, matrix
from hilcell.geometry.kinematics import Array, Bools, Ints, forward
from hilcell.identification.measured_poses import Readings
from hilcell.identification.sweeps import transmission_curve
from hilcell.journal.log import Log, commanded_rad, covariances_mm2, positions_mm
from hilcell.model.point import Point, PointId

ORIENTED = "oriented"  # kind of a grid's vertex in another orientation than the grid's


def grid_of(cell: Cell) -> Grid:
    """The cell's grid in {B}; a quick plan's is as coarse as possible."""
    size_mm, pitch_mm = np.array(cell.grid.size_mm), cell.grid.pitch_mm
    if cell.plan.quick:
        pitch_mm = coarsest_pitch_mm(cell.grid.cells, pitch_mm)
    shape = np.round(size_mm / pitch_mm).astype(int) + 1
    origin_mm = cell.grid.centre.matrix()[:3, 3] - size_mm / 2
    return Grid(origin_mm, pitch_mm, (int(shape[0]), int(shape[1]), int(shape[2])))


def grid_errors_mm(log: Log) -> Array:
    """Errors e = actual - nominal at the vertices, (nx, ny, nz, 3), in {B}."""
    return measured_grid(log).errors_mm


def measured_grid(log: Log) -> MeasuredGrid:
    """Grid errors in {B} with the covariance of each vertex's averaged reading; those of a
    re-calibration as the arm that it follows has them.
    """
    points, grid = log.select("grid"), grid_of(log.cell)
    if carried_arm(log) is not None:
        vertices_mm = grid.vertices_mm()
        poses = matrix(log.cell.grid.centre.matrix()[:3, :3], vertices_mm.reshape(-1, 3))
        known = Kinematic.learn(measured_errors(log)).predict(poses)
        return MeasuredGrid(
            grid,
            known.error_mm.reshape(*grid.shape, 3),
            known.covariance_mm2.reshape(*grid.shape, 3, 3),
        )
    i, j, k = np.array([point.id.vertex for point in points], dtype=int).reshape(-1, 3).T
    errors_mm: Array = np.full((*grid.shape, 3), np.nan)
    covariance_mm2: Array = np.full((*grid.shape, 3, 3), np.nan)
    nominal_mm, actual_mm, covariance_mm2[i, j, k] = _static(log, points)
    errors_mm[i, j, k] = actual_mm - nominal_mm
    return MeasuredGrid(grid, errors_mm, covariance_mm2)


def _static(log: Log, points: list[Point]) -> tuple[Array, Array, Array]:
    """Nominal and actual positions (N, 3) in {B}, and the readings' covariances."""
    T_B_W = inverse(log.matrix("base"))
    T_B_L = T_B_W @ log.matrix("world")
    nominal_mm: Array = np.array([p.nominal_mm for p in points], dtype=float).reshape(-1, 3)
    actual_mm = apply(T_B_L, positions_mm(points))
    return apply(T_B_W, nominal_mm), actual_mm, covariances_mm2(points, T_B_L[:3, :3])


def measured_errors(log: Log) -> Measured:
    """Input of the models: poses as commanded, grid and free ones."""
    points = [*log.select("grid"), *log.select(ORIENTED), *log.select("pose")]
    robot, joints_rad = log.cell.robot.nominal(), commanded_rad(points)
    nominal_mm, actual_mm, covariance_mm2 = _static(log, points)
    nominal = matrix(forward(robot.arm, joints_rad)[:, :3, :3], nominal_mm)
    poses = StaticPoses.of(joints_rad, nominal, actual_mm - nominal_mm, covariance_mm2)
    curves = tuple(transmission_curve(record) for record in log.curves.values() if record.holds)
    seats_mm = log.cell.robot.seats_mm
    xyz_mm: Array = np.full((len(points), len(seats_mm), 3), np.nan)
    own_mm2: Array = np.full((*xyz_mm.shape, 3), np.nan)
    xyz_mm[:, 0], own_mm2[:, 0] = actual_mm, covariance_mm2
    T_B_L = inverse(log.matrix("base")) @ log.matrix("world")
    for row, point in enumerate(points):
        for n in range(1, len(seats_mm)):
            seen = log.find(point.id.at_seat(n + 1))
            if seen is not None:
                xyz_mm[row, n] = apply(T_B_L, positions_mm([seen]))[0]
                own_mm2[row, n] = covariances_mm2([seen], T_B_L[:3, :3])[0]
    readings, known = Readings(joints_rad, xyz_mm, np.nan_to_num(own_mm2)), carried_arm(log)
    lattice = measured_grid(log) if known is None else None
    return Measured(poses, lattice, MeasuredArm(robot, readings, seats_mm, curves, known))


def learnt_points(log: Log) -> list[Point]:
    """The points from which the correction is learnt: the grid's, in a re-calibration poses."""
    return log.select("grid") or log.select("pose")


def vertex_ids(grid: Grid) -> list[PointId]:
    return [PointId("grid", vertex=(int(i), int(j), int(k))) for i, j, k in grid.serpentine()]


def outlying_vertices(log: Log) -> list[PointId]:
    """Outlying vertices, beyond the allowed deviation of a reading."""
    cell = log.cell
    if cell.plan.recalibrates:
        return []
    found = outlying(grid_errors_mm(log), least_mm=cell.tracker.max_std_mm)
    return [id for id in vertex_ids(grid_of(cell)) if found[id.vertex]]


def grid_pairs(log: Log) -> Pairs:
    """All pairs of measured vertices: joint and Cartesian distance, error difference."""
    points = log.select("grid")
    i, j, k = np.array([point.id.vertex for point in points]).T
    nominal_mm: Array = np.array([point.nominal_mm for point in points], dtype=float)
    return Pairs.of(commanded_rad(points), nominal_mm, grid_errors_mm(log)[i, j, k])


def outlying(errors_mm: ArrayLike, *, least_mm: float) -> Bools:
    """Which (nx, ny, nz) of errors (nx, ny, nz, 3) are outliers by more than ``least_mm``.

    The limit is the quantile exceeded once in a hundred sound grids, of the distance of three
    normal coordinates, at the spread shown by the median. The worst is removed and the rest judged
    again, so that it affects no neighbours.
    """
    false_alarms = 0.01  # expected of a whole grid whose residuals are normal
    errors = np.asarray(errors_mm, dtype=float)
    values, A = errors.reshape(-1, 3), _terms(errors.shape[:3])
    kept: Bools = np.asarray(np.isfinite(values).all(axis=1))
    highest = _quantile(1.0 - false_alarms / len(values))
    while 2 * np.count_nonzero(kept) > len(values):
        Q = np.linalg.qr(A[kept])[0]
        residuals = values[kept] - Q @ (Q.T @ values[kept])
        left = np.maximum(1.0 - np.sum(Q**2, axis=1), 1e-9)
        off_mm = np.linalg.norm(residuals, axis=1) / np.sqrt(left)  # studentized
        sigma_mm = float(np.median(off_mm)) / _quantile(0.5)
        if np.max(off_mm) <= max(highest * sigma_mm, least_mm):
            break
        kept[np.flatnonzero(kept)[np.argmax(off_mm)]] = False
    return ~kept.reshape(errors.shape[:3])


def _quantile(share: float) -> float:
    """Quantile of the distance of three standard normals (Wilson and Hilferty)."""
    cube = 1.0 - 2.0 / 27.0 + NormalDist().inv_cdf(share) * (2.0 / 27.0) ** 0.5
    return float((3.0 * cube**3) ** 0.5)


def _terms(shape: tuple[int, ...]) -> Array:
    """Terms (N, M) up to second order; a power only where the axis has enough vertices."""
    places = [np.linspace(-1.0, 1.0, count) for count in shape]
    axes = [each.ravel() for each in np.meshgrid(*places, indexing="ij")]
    columns = [np.ones(len(axes[0])), *axes]
    for one, other in combinations_with_replacement(range(3), 2):
        if one != other or shape[one] > 2:
            columns.append(axes[one] * axes[other])
    return np.column_stack(columns)


@dataclass(frozen=True, slots=True)
class Pairs:
    """All pairs of a set of poses: distances of joints and of tool points, difference of errors.

    Each (P,); ``joint_rad``: norm of the six joints' differences; ``cartesian_mm``: distance of
    nominal tool points; ``difference_mm``: norm of the difference of errors.
    """

    joint_rad: Array
    cartesian_mm: Array
    difference_mm: Array

    @classmethod
    def of(cls, joints_rad: Array, points_mm: Array, errors_mm: Array) -> Self:
        """All N (N - 1) / 2 pairs of poses: joints (N, 6), points and errors (N, 3)."""
        one, other = np.triu_indices(len(joints_rad), 1)
        sets = (joints_rad, points_mm, errors_mm)
        return cls(*(np.linalg.norm(each[one] - each[other], axis=1) for each in sets))


def binned(distance: Array, difference_mm: Array, edges: Array) -> tuple[Array, Array, Ints]:
    """Middles, mean differences and counts (K,) over rising ``edges`` (K + 1,) of a distance (P,).
    A bin includes its lower edge, the last one its upper edge too; an empty one's mean is NaN.
    """
    count, _ = np.histogram(distance, edges)
    total, _ = np.histogram(distance, edges, weights=difference_mm)
    mean = np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)
    return (edges[1:] + edges[:-1]) / 2, mean, count
