"""Models that a calibration chooses from, and the choice by cross-validation.

A model is judged by the mean and the largest error at poses that it did not learn from, each
relative to the best of all models: the best in the mean may be bad somewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from hilcell.compensation.grid import Grid, GridError
from hilcell.compensation.interpolation import Idw, Trilinear, check_covariance
from hilcell.compensation.kinematic import Kinematic
from hilcell.compensation.model import LearntModel, Measured, Prediction
from hilcell.decoding import Json
from hilcell.geometry.kinematics import Array
from hilcell.geometry.statistics import Figures, figures_of, lengths_mm
from hilcell.identification.measured_poses import IdentificationError
from hilcell.language import marked


@dataclass(frozen=True, eq=False)
class Nominal(LearntModel):
    """Predicts no error; the covariance (3, 3) is the mean square of those measured."""

    name = "nominal"
    text = marked("not corrected: no model did better than nominal positions")
    any_orientation = True

    covariance_mm2: Array

    @classmethod
    def learn(cls, measured: Measured) -> Self:
        errors_mm = measured.poses.error_mm
        return cls(errors_mm.T @ errors_mm / len(errors_mm))

    @classmethod
    def restore(cls, grid: Grid, errors_mm: Array, parameters: Json) -> Self:
        model = super().restore(grid, errors_mm, parameters)
        check_covariance("covariance_mm2", model.covariance_mm2, (3, 3))
        return model

    def predict(self, poses: Array) -> Prediction:
        count = len(poses)
        return Prediction(np.zeros((count, 3)), np.broadcast_to(self.covariance_mm2, (count, 3, 3)))


NOMINAL = Nominal.name
WEIGHTS = {"mean": 2.0, "max": 1.0}  # the largest of few dozen misses scatters much more
MODELS: dict[str, type[LearntModel]] = {
    model.name: model for model in (Nominal, Idw, Trilinear, Kinematic)
}


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen model and why; figures of errors at poses left out; why others were refused."""

    model: str
    reason: str
    figures: dict[str, Figures]
    refused: dict[str, str]


def chosen(measured: Measured, *, reoriented: bool = False) -> Choice:
    """The best model; for ``reoriented`` targets, of those that predict them."""
    figures, refused = {}, {}
    for name, model in MODELS.items():
        try:
            figures[name] = figures_of(lengths_mm(model.left_out_mm(measured)))
        except (IdentificationError, GridError) as error:
            refused[name] = str(error)
        if reoriented and not model.any_orientation:
            refused[name] = "predicts the error in the grid's orientation only"
    name = choose({each: of for each, of in figures.items() if each not in refused})
    reason = f"least mean and largest miss at poses left out: {listed(figures)}"
    if name == NOMINAL:
        reason = f"no model beats nominal positions at poses left out: {listed(figures)}"
    return Choice(name, reason, figures, refused)


def choose(figures: Mapping[str, Figures], weights: Mapping[str, float] = WEIGHTS) -> str:
    """The model with the least figures by ``weights``, if possible better than nominal."""
    nominal = figures.get(NOMINAL)
    best = {kind: min(getattr(each, kind) for each in figures.values()) for kind in weights}
    return min(
        (
            name
            for name, each in figures.items()
            if name == NOMINAL or nominal is None or each.mean < nominal.mean
        ),
        key=lambda name: sum(
            weight * _relative(getattr(figures[name], kind), best[kind])
            for kind, weight in weights.items()
        ),
    )


def _relative(value: float, best: float) -> float:
    return value / best if best > 0.0 else float(value > 0.0)


def listed(figures: Mapping[str, Figures], weights: Mapping[str, float] = WEIGHTS) -> str:
    rows = (
        f"{name} " + " / ".join(f"{getattr(each, kind):.4f}" for kind in weights)
        for name, each in figures.items()
    )
    return f"{' / '.join(weights)} mm {', '.join(rows)}"
