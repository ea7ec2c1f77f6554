"""A transmission curve: its value at commanded angles, and its shift along them."""

import numpy as np

from hilcell.identification.kinematics import TransmissionCurve

CURVE = TransmissionCurve(
    axis=1,
    cycles=np.array([40.0, 203.5]),
    amplitude_rad=np.array([[30e-6, -10e-6], [0.0, 20e-6]]),
    covariance_rad2=1e-12 * np.eye(4),
    shift_rad=350e-6,
    shift_sigma_rad=50e-6,
    low_rad=-1.0,
    high_rad=0.2,
    noise_rad=5e-6,
)


def test_it_is_the_sum_of_its_waves_at_the_shifted_angle() -> None:
    q = np.linspace(-1.0, 0.2, 7)
    at = q + 350e-6
    wanted = 30e-6 * np.cos(40 * at) - 10e-6 * np.sin(40 * at) + 20e-6 * np.sin(203.5 * at)
    np.testing.assert_allclose(CURVE.evaluate(q), wanted, atol=1e-18)
    assert CURVE.basis(q.reshape(7, 1)).shape == (7, 1, 4)
