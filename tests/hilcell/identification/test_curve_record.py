"""An axis's result in the journal: rebuilt as it was, and said in one line."""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.sweeps import transmission_curve, without_curve
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.events import CurveMeasured

CURVE = TransmissionCurve(
    axis=1,
    cycles=np.array([40.0, 203.5]),
    amplitude_rad=np.array([[30e-6, -10e-6], [0.0, 20e-6]]),
    covariance_rad2=1e-12 * np.eye(4),
    shift_rad=0.0,
    shift_sigma_rad=50e-6,
    low_rad=-1.0,
    high_rad=0.2,
    noise_rad=5e-6,
)
FOUND = replace(
    without_curve(1, "", 0.0123),
    cycles=CURVE.cycles.tolist(),
    amplitude_rad=CURVE.amplitude_rad.tolist(),
    covariance_rad2=CURVE.covariance_rad2.tolist(),
    shift_sigma_rad=50e-6,
    low_rad=-1.0,
    high_rad=0.2,
    noise_rad=5e-6,
    shown=np.column_stack([np.linspace(-57.3, 11.5, 9), np.full((9, 2), 12.0)]).tolist(),
    spectrum=[(24.0, 1.0), (25.0, 2.0)],
)


def body_of(found: CurveMeasured) -> dict[str, object]:
    body: dict[str, object] = msgspec.to_builtins(found)
    return {"what": "curve"} | body


def test_a_log_has_the_curve_as_it_was() -> None:
    log = Log([Record(1, "", "event", "", body_of(FOUND))])
    found = transmission_curve(log.curves[2])
    for name in ("axis", "shift_sigma_rad", "low_rad", "high_rad", "noise_rad"):
        assert getattr(found, name) == getattr(CURVE, name)
    q = np.linspace(-1.0, 0.2, 50)
    np.testing.assert_array_equal(found.evaluate(q), CURVE.evaluate(q))
    np.testing.assert_array_equal(found.covariance_rad2, CURVE.covariance_rad2)


def test_a_result_without_a_curve_says_why() -> None:
    record = without_curve(4, "upwards: 9 samples")
    assert not record.holds
    assert "upwards: 9 samples" in record.words
    assert len(transmission_curve(record).cycles) == 0
