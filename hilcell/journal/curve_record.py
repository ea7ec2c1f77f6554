"""The journal's record of an axis's sweeps: its curve, or the reason why there is none."""

from __future__ import annotations

from typing import Self

import msgspec
import numpy as np

from hilcell.identification.curve import TransmissionCurve
from hilcell.identification.sweeps import SweptAxis
from hilcell.ports import Array

URAD = 1e6
Pair = tuple[float, float]


class CurveRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of one axis, 1 to 6.

    ``reason`` is empty where the curve holds. ``amplitude_rad`` are cosine and sine of each of
    ``cycles`` per revolution, ``covariance_rad2`` theirs by turns. ``shown`` is for pictures: joint
    in deg, short-wave error as measured and by the curve in urad; ``spectrum`` cycles and urad.
    """

    axis: int
    reason: str = ""
    cycles: list[float]
    amplitude_rad: list[Pair]
    covariance_rad2: list[list[float]]
    shift_rad: float
    shift_sigma_rad: float
    low_rad: float
    high_rad: float
    noise_rad: float
    lag_s: float
    lag_sigma_s: float
    signal_rad: float
    share: float
    differ_rad: float
    lost: int
    shown: list[tuple[float, float, float]]
    spectrum: list[Pair]

    @classmethod
    def of(cls, found: SweptAxis) -> Self:
        """Return the record of a result."""
        curve = found.curve or _nothing(found)
        shown = found.shown_rad * [np.degrees(1.0), URAD, URAD]
        spectrum = found.spectrum * [1.0, URAD]
        return cls(
            axis=found.axis + 1,
            reason=found.reason,
            cycles=curve.cycles.tolist(),
            amplitude_rad=curve.amplitude_rad.tolist(),
            covariance_rad2=curve.covariance_rad2.tolist(),
            shift_rad=curve.shift_rad,
            shift_sigma_rad=curve.shift_sigma_rad,
            low_rad=curve.low_rad,
            high_rad=curve.high_rad,
            noise_rad=found.noise_rad,
            lag_s=found.lag_s,
            lag_sigma_s=found.lag_sigma_s,
            signal_rad=found.signal_rad,
            share=found.share,
            differ_rad=found.differ_rad,
            lost=found.lost,
            shown=np.round(shown, 3).tolist(),
            spectrum=np.round(spectrum, 3).tolist(),
        )

    @property
    def holds(self) -> bool:
        """Whether there is a curve; one without any line states that the gear has none."""
        return not self.reason

    @property
    def amplitudes_rad(self) -> Array:
        """Return the size of each line (K,)."""
        found: Array = np.linalg.norm(np.array(self.amplitude_rad).reshape(-1, 2), axis=1)
        return found

    @property
    def words(self) -> str:
        """Return the result as one short line."""
        if not self.holds:
            return f"A{self.axis} not used: {self.reason}"
        sizes = sorted(zip(self.amplitudes_rad * URAD, self.cycles, strict=True), reverse=True)
        lines = ", ".join(f"{size:.1f} urad at {cycles:.1f}" for size, cycles in sizes)
        return f"A{self.axis}: {lines or 'no line'}; lag {self.lag_s * 1e3:.1f} ms"

    def curve(self) -> TransmissionCurve:
        """Return the curve, to be used where it holds."""
        count = len(self.cycles)
        return TransmissionCurve(
            self.axis - 1,
            np.array(self.cycles),
            np.array(self.amplitude_rad).reshape(count, 2),
            np.array(self.covariance_rad2).reshape(2 * count, 2 * count),
            self.shift_rad,
            self.shift_sigma_rad,
            self.low_rad,
            self.high_rad,
            self.noise_rad,
        )


def _nothing(found: SweptAxis) -> TransmissionCurve:
    empty = np.zeros((0, 2))
    return TransmissionCurve(
        found.axis, np.zeros(0), empty, np.zeros((0, 0)), 0.0, 0.0, 0.0, 0.0, 0.0
    )
