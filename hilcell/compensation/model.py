"""A model of a robot's errors: nominal poses in, predicted errors and their covariance out.

A model is one module with one class, registered under its name in `hilcell.compensation.choice`;
nothing else in the core names it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

from hilcell.compensation.grid import Grid
from hilcell.compensation.measured import Measured
from hilcell.geometry.kinematics import Array
from hilcell.ports import HilcellError


class ModelError(HilcellError):
    """Parameters of which no model can be made."""

    code = "HC-C21"


@dataclass(frozen=True, eq=False, slots=True)
class Turn:
    """Errors of orientation at N targets as rotation vectors (N, 3), and their covariances
    (N, 3, 3): actual = exp(vector) nominal, so that the axes are those of the model's frame.
    """

    error_rad: Array
    covariance_rad2: Array


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """Errors e = actual - nominal (N, 3) at N targets, and their covariances (N, 3, 3), NaN where
    a calibration states none. ``turn`` is None where the model knows positions only.

    The covariance covers parameters, residual and the repeatability of one visit, as far as the
    data that the model learnt from show it. The frame is the model's.
    """

    error_mm: Array
    covariance_mm2: Array
    turn: Turn | None = None


class ErrorModel(Protocol):
    """Predicts the robot's error of position, and of orientation if it can."""

    def predict(self, poses: Array) -> Prediction:
        """Return the errors at nominal poses (N, 4, 4) in {B}; raises `HilcellError` outside."""


class LearntModel(ErrorModel, Protocol):
    """A model that a calibration learns from what it measured, judges and keeps in its file.

    ``turns``: its predictions hold for other orientations than the grid's.
    """

    turns: ClassVar[bool]

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        """Return the model; raises `HilcellError` where what was measured is not enough."""

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Return predicted less measured errors (M, 3) of poses that were not learnt from."""

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Mapping[str, Any]) -> Self:
        """Return the model of a calibration file; raises `ModelError` for bad parameters.

        The file has the grid's errors (nx, ny, nz, 3) beside the model's own parameters.
        """

    def parameters(self) -> dict[str, Any]:
        """Return what `restore` needs besides the grid's errors, as plain JSON values."""
