"""The models that a calibration chooses from, and the choice by cross-validation."""

from __future__ import annotations

from collections.abc import Mapping

from hilcell.compensation.interpolation import Idw, Trilinear
from hilcell.compensation.measured import Measured
from hilcell.compensation.model import LearntModel
from hilcell.geometry.statistics import figures_of, lengths_mm

MODELS: dict[str, type[LearntModel]] = {"idw": Idw, "trilinear": Trilinear}


def cross_validate(measured: Measured) -> dict[str, dict[str, float]]:
    """Return mean, p95 and max (mm) of the misses at poses left out, by model."""
    return {
        name: figures_of(lengths_mm(model.left_out_mm(measured)))._asdict()
        for name, model in MODELS.items()
    }


def choose(figures: Mapping[str, Mapping[str, float]]) -> str:
    """Return the model with the least mean of `cross_validate`."""
    return min(figures, key=lambda name: figures[name]["mean"])
