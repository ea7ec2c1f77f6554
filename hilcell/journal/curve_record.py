"""An axis's curve as the journal keeps it, and the curve again."""

from __future__ import annotations

import numpy as np

from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.sweeps import SweptAxis
from hilcell.model.events import URAD, CurveMeasured


def curve_measured(found: SweptAxis) -> CurveMeasured:
    """Return the event of an axis's sweeps, of their curve or of the reason why there is none."""
    empty = np.zeros((0, 2))
    nothing = TransmissionCurve(
        found.axis, np.zeros(0), empty, np.zeros((0, 0)), 0.0, 0.0, 0.0, 0.0, 0.0
    )
    curve = found.curve or nothing
    return CurveMeasured(
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
        shown=np.round(found.shown_rad * [np.degrees(1.0), URAD, URAD], 3).tolist(),
        spectrum=np.round(found.spectrum * [1.0, URAD], 3).tolist(),
    )


def curve_of(measured: CurveMeasured) -> TransmissionCurve:
    """Return the curve of an event, to be used where it holds."""
    count = len(measured.cycles)
    return TransmissionCurve(
        measured.axis - 1,
        np.array(measured.cycles),
        np.array(measured.amplitude_rad).reshape(count, 2),
        np.array(measured.covariance_rad2).reshape(2 * count, 2 * count),
        measured.shift_rad,
        measured.shift_sigma_rad,
        measured.low_rad,
        measured.high_rad,
        measured.noise_rad,
    )
