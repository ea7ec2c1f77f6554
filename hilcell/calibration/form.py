"""The form of a calibration file: its tables as typed structures, nothing else.

All lengths mm, frames as homogeneous matrices; the errors of the grid stand in {B}.
"""

from __future__ import annotations

import msgspec
import numpy as np

from hilcell.compensation.grid import Grid


class StationEntry(msgspec.Struct, frozen=True):
    """A station's frames: {B} and {S} in {W}, covariance (6, 6) of {S}, tool-point uncertainty."""

    T_W_B: list[list[float]]
    T_W_S: list[list[float]]
    covariance: list[list[float]]
    tool_uncertainty_mm: float
    strip_mm: float


class Validity(msgspec.Struct, frozen=True):
    """Where the calibration holds: the cube in {B}, one orientation, the measured temperatures."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    orientation: list[list[float]]
    orientation_tolerance_deg: float
    temperature_c: tuple[float, float]


class Provenance(msgspec.Struct, frozen=True):
    """Where the calibration comes from, and whether its sign was proven on the cell."""

    run: str
    cell: str
    digest: str
    simulated: bool
    operator: str
    job: str
    software: str
    written: str
    sign_checked: bool = False


class Calibration(msgspec.Struct, frozen=True):
    """The file."""

    schema: int
    provenance: Provenance
    validity: Validity
    stations: dict[str, StationEntry]
    method: str
    pitch_mm: float
    grid_errors_mm: list[list[list[tuple[float, float, float]]]]

    def grid(self) -> Grid:
        """Return the grid in {B}."""
        errors = np.array(self.grid_errors_mm)
        shape = (errors.shape[0], errors.shape[1], errors.shape[2])
        return Grid(np.array(self.validity.low_mm), self.pitch_mm, shape)
