"""Smooth random curves along a length: error of a rail, straightness, angles of its slide."""

from __future__ import annotations

import math

import numpy as np


class SmoothCurve:
    """A random Fourier series, zero at position 0, of about the wanted standard deviation."""

    def __init__(
        self, rng: np.random.Generator, deviation: float, period_mm: float, harmonics: int = 4
    ) -> None:
        orders = np.arange(1, harmonics + 1)
        weights = rng.standard_normal(harmonics) / orders
        weights *= deviation * math.sqrt(2.0) / float(np.linalg.norm(weights))
        phases = rng.uniform(0.0, 2 * math.pi, harmonics)
        rates = 2 * math.pi * orders / period_mm
        self._terms = list(zip(weights.tolist(), rates.tolist(), phases.tolist(), strict=True))
        self._zero = 0.0
        self._zero = self(0.0)

    def __call__(self, position_mm: float) -> float:
        """Return the curve's value."""
        total = -self._zero
        for weight, rate, phase in self._terms:
            total += weight * math.sin(rate * position_mm + phase)
        return total
