"""A regular lattice of measured vertices: order of visit, cells, inside test.

A target on the upper face belongs to the last cell. Outside nothing is known: `OutsideGrid` refuses
instead of extrapolating.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hilcell.geometry.kinematics import Array, Ints
from hilcell.ports import HilcellError
from hilcell.sanitize import counted

ROUNDING_MM = 1e-6  # a target on a face may lie outside by the rounding of its frame
NAMED = 5  # targets that one message names


class GridError(HilcellError):
    """An invalid lattice, or invalid errors on it."""

    code = "HC-C21"


class OutsideGrid(GridError):
    """Targets outside the measured volume."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Vertices ``origin + index * pitch`` in one frame; ``shape`` counts them along x, y, z."""

    origin_mm: Array
    pitch_mm: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        if np.shape(self.origin_mm) != (3,) or not np.isfinite(self.origin_mm).all():
            raise GridError(f"grid: origin {self.origin_mm} mm, expected three finite numbers")
        if not (self.pitch_mm > 0 and np.isfinite(self.pitch_mm)):
            raise GridError(f"grid: pitch {self.pitch_mm} mm, expected above 0")
        if min(self.shape) < 2:
            raise GridError(
                f"grid: shape {self.shape}, expected at least 2 vertices along each axis"
            )

    @property
    def far_mm(self) -> Array:
        return self.origin_mm + self.pitch_mm * (np.array(self.shape) - 1)

    def vertices_mm(self) -> Array:
        return self.origin_mm + self.pitch_mm * np.moveaxis(np.indices(self.shape), 0, -1)

    def serpentine(self) -> Ints:
        """Indices (N, 3) in an order of visit whose every step is one pitch long."""
        nx, ny, nz = self.shape
        order = []
        for k in range(nz):
            for row in range(ny):
                j = row if k % 2 == 0 else ny - 1 - row
                forth = (k * ny + row) % 2 == 0
                order += [(i, j, k) for i in (range(nx) if forth else reversed(range(nx)))]
        return np.array(order)

    def serpentine_mm(self) -> Array:
        return self.origin_mm + self.pitch_mm * self.serpentine()

    def cells(self, targets_mm: ArrayLike) -> tuple[Ints, Array]:
        """Cells' lowest vertices and positions in them, 0..1, (N, 3); raises `OutsideGrid`."""
        targets = np.asarray(targets_mm, dtype=float)
        self.check_inside(targets)
        place = (self.clamped(targets) - self.origin_mm) / self.pitch_mm
        cell = np.clip(np.floor(place).astype(int), 0, np.array(self.shape) - 2)
        return cell, np.clip(place - cell, 0.0, 1.0)

    def clamped(self, targets_mm: ArrayLike) -> Array:
        """Targets (N, 3), those outside moved to the nearest point of the faces."""
        return np.asarray(np.clip(np.asarray(targets_mm, dtype=float), self.origin_mm, self.far_mm))

    def check_inside(self, targets_mm: ArrayLike, names: Sequence[str] | None = None) -> None:
        """Raise `OutsideGrid` naming targets (N, 3) that lie outside, and by how much."""
        targets = np.asarray(targets_mm, dtype=float)
        if targets.ndim != 2 or targets.shape[1] != 3:
            raise GridError(f"targets: shape {targets.shape}, expected (N, 3)")
        excess = np.linalg.norm(targets - self.clamped(targets), axis=1)
        bad = np.flatnonzero(~(excess <= ROUNDING_MM))
        if len(bad):
            named = ", ".join(
                f"{names[n] if names else f'target {n + 1}'} by {excess[n]:.3f} mm "
                f"(at {self._text(targets[n])})"
                for n in bad[:NAMED]
            )
            raise OutsideGrid(
                f"{len(bad)} of {counted(len(targets), 'target')} outside the calibrated volume "
                f"{self._text(self.origin_mm)} .. {self._text(self.far_mm)} mm in {{B}}: {named}"
                f"{', ...' if len(bad) > NAMED else ''}; move them, or calibrate a larger volume"
            )

    @staticmethod
    def _text(point: Array) -> str:
        return "(" + ", ".join(f"{value:.1f}" for value in point) + ")"


@dataclass(frozen=True, eq=False)
class MeasuredGrid:
    """Errors e = actual - nominal at a grid's vertices, in the grid's frame. ``errors_mm`` (nx, ny,
    nz, 3), NaN: not measured; ``covariance_mm2`` (nx, ny, nz, 3, 3): of each averaged reading.
    """

    grid: Grid
    errors_mm: Array
    covariance_mm2: Array

    def __post_init__(self) -> None:
        vertices, found = self.grid.shape, (self.errors_mm.shape, self.covariance_mm2.shape)
        expected = (*vertices, 3), (*vertices, 3, 3)
        if found != expected:
            raise GridError(f"errors and covariances: shapes {found}, expected {expected}")
