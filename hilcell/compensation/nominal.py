"""No correction: nominal kinematics, where no model predicts poses left out better."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from hilcell.compensation.grid import Grid
from hilcell.compensation.interpolation import check_covariance
from hilcell.compensation.measured import Measured
from hilcell.compensation.model import ModelError, Prediction
from hilcell.geometry.kinematics import Array
from hilcell.identification.readings import IdentificationError


@dataclass(frozen=True, eq=False)
class Nominal:
    """Predicts no error; the covariance (3, 3) is the mean square of those measured."""

    turns: ClassVar[bool] = True

    covariance_mm2: Array

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        """Return the model with the errors' mean square."""
        errors = -cls.left_out_mm(measured)
        return cls(errors.T @ errors / len(errors))

    @classmethod
    def left_out_mm(cls, measured: Measured) -> Array:
        """Return the nominal less the measured positions (M, 3).

        Raises `IdentificationError` where no pose was measured.
        """
        if not len(measured.poses):
            raise IdentificationError("nominal positions: no pose was measured")
        return measured.poses.nominal_mm - measured.poses.actual_mm

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Mapping[str, Any]) -> Self:
        """Return the model as `parameters` keeps it."""
        try:
            covariance = np.array(dict(parameters)["covariance_mm2"], dtype=float)
        except (KeyError, ValueError, TypeError) as error:
            raise ModelError(f"no covariance of nominal positions: {error}") from error
        check_covariance("covariance_mm2", covariance, (3, 3))
        return cls(covariance)

    def parameters(self) -> dict[str, Any]:
        """Return the covariance."""
        return {"covariance_mm2": self.covariance_mm2.tolist()}

    def predict(self, poses: Array) -> Prediction:
        """Return no error at poses (N, 4, 4)."""
        count = len(poses)
        return Prediction(np.zeros((count, 3)), np.broadcast_to(self.covariance_mm2, (count, 3, 3)))
