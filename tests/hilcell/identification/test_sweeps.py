"""Streams of an axis become its transmission curve; streams that cannot be used are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from hilcell.geometry.kinematics import Array
from hilcell.identification.axis_motion import SweepStream
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.sweeps import (
    Known,
    Records,
    Shift,
    Trial,
    swept_axis,
    transmission_curve,
    without_curve,
    without_lines,
)
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.events import CurveMeasured
from tests.hilcell.identification.axis_streams import ARM, Axis, Ripple, periodic

URAD = 1e-6


def swept(axis: Axis) -> CurveMeasured:
    return swept_axis(*axis.streams(), ARM, axis.axis)


def left_urad(axis: Axis, found: CurveMeasured) -> float:
    """Return the rms of the curve's error over the range, its long waves taken off."""
    assert found.holds, found.reason
    low, high = axis.range_rad
    q = np.linspace(low, high, 3000)[80:-80]
    off = transmission_curve(found).evaluate(q) - axis.ripple(q)
    off -= np.polyval(np.polyfit(q - q.mean(), off, 4), q - q.mean())
    return float(np.sqrt(np.mean(off**2))) / URAD


def lines(*lines: tuple[float, float, float]) -> Ripple:
    """Return lines of cycles, amplitude in urad, phase."""

    def curve(q: Array) -> Array:
        return sum(
            (URAD * size * np.sin(n * q + phase) for n, size, phase in lines), np.zeros_like(q)
        )

    return curve


TWO = lines((41.0, 30.0, 0.4), (203.5, 25.0, 2.0))
AXIS_1 = Axis(0, TWO, lag_s=0.02)
FOUND_1 = swept(AXIS_1)


def test_lines_of_an_unknown_gear_are_found_with_their_phase() -> None:
    np.testing.assert_allclose(FOUND_1.cycles, [41.0, 203.5], atol=0.1)
    assert left_urad(AXIS_1, FOUND_1) < 1.5
    assert FOUND_1.share > 0.9
    assert FOUND_1.noise_rad < 8 * URAD


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_a_lag_is_found_and_leaves_the_curve_where_it_is(lag_s: float) -> None:
    axis = replace(AXIS_1, lag_s=lag_s)
    found = swept(axis)
    assert left_urad(axis, found) < 1.5
    assert found.lag_s - FOUND_1.lag_s == pytest.approx(lag_s - 0.02, abs=0.002)


@pytest.mark.parametrize("late_s", [0.0, 0.03])
def test_joints_with_the_controller_s_times_are_placed_by_these(late_s: float) -> None:
    """Of late answers only the quickest one counts; otherwise their mean lateness is a lag."""
    axis = replace(AXIS_1, late_s=late_s)
    by_windows, by_stamps = swept(axis), swept(replace(axis, stamped=True))
    assert left_urad(axis, by_stamps) < 1.5
    assert by_stamps.holds
    assert abs(by_stamps.lag_s - swept(replace(AXIS_1, stamped=True)).lag_s) < 0.004
    if late_s:
        assert abs(by_windows.lag_s - FOUND_1.lag_s) > 0.01


@pytest.mark.parametrize(("axis", "size_urad"), [(1, 15.0), (2, 100.0), (4, 15.0)])
def test_other_axes_and_other_sizes(axis: int, size_urad: float) -> None:
    rng = np.random.default_rng([axis, int(size_urad)])
    tried = Axis(axis, periodic(rng, size_urad * URAD), seed=axis)
    assert left_urad(tried, swept(tried)) < (4.0 if axis < 4 else 8.0)


@pytest.mark.parametrize(
    "ripple",
    [
        lambda q: 45 * URAD * np.sin(203.5 * q) * (1 + 0.9 * q),  # it follows the load
        lambda q: 45 * URAD * np.sin(70 * q + 8 * q**2),
    ],
)
def test_an_error_that_is_not_quite_periodic_is_followed_for_the_most_part(ripple: Ripple) -> None:
    axis = Axis(0, ripple, lag_s=0.02)
    assert left_urad(axis, swept(axis)) < 7.0  # of 32


def test_the_covariance_states_the_curve_s_error() -> None:
    squares = []
    for seed in range(4):
        axis = Axis(0, TWO, seed=seed)
        curve = transmission_curve(swept(axis))
        q = np.linspace(*axis.range_rad, 40)[2:-2]
        B = curve.basis(q)
        variance = np.einsum("nk,kl,nl->n", B, curve.covariance_rad2, B)
        squares.append(np.mean((curve.evaluate(q) - TWO(q)) ** 2 / variance))
    assert 0.5 < np.mean(squares) < 2.5


LONG = ((5.0, 20.0, 1.0), (9.3, 60.0, 0.1), (14.2, 40.0, 2.0))
FEW = ((26.0, 25.0, 0.5), (203.5, 25.0, 2.0))


@pytest.mark.parametrize("times", [1.0, 3.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_smooth_error_below_the_lines_is_followed(axis: int, times: float) -> None:
    both = lines(*((n, times * size, phase) for n, size, phase in LONG), *FEW)
    tried = Axis(axis, both, lag_s=0.02)
    found = swept(tried)
    assert left_urad(tried, found) < 2.0 * times
    assert 20.0 * times < found.smooth_rad / URAD < 60.0 * times
    assert found.share > 0.9


def test_no_smooth_error_without_evidence_for_it() -> None:
    assert not FOUND_1.smooth_cycles
    assert FOUND_1.smooth_rad == 0.0


def test_what_a_sweep_hardly_determines_is_uncertain() -> None:
    """The arm's geometry, as large as a smooth error's long waves, is in no sweep told from it."""
    squares = []
    for seed in range(4):
        axis = Axis(0, lines(*LONG, *FEW), seed=seed)
        curve = transmission_curve(swept(axis))
        q = np.linspace(*axis.range_rad, 40)[2:-2]
        off, B = curve.evaluate(q) - axis.ripple(q), curve.basis(q)
        variance = np.einsum("nk,kl,nl->n", B, curve.covariance_rad2, B)
        short = off - np.polyval(np.polyfit(q, off, 3), q)
        assert np.sqrt(variance.mean()) > 10 * np.std(short)
        squares.append(np.mean(off**2 / variance))
    assert 0.05 < np.mean(squares) < 2.5


@pytest.mark.parametrize("resonance_hz", [8.0, 10.0, 14.0])
def test_what_a_resonance_adds_to_a_fast_sweep_is_taken_off_and_doubted(
    resonance_hz: float,
) -> None:
    speed_deg_s, cycles, size = 3.0, 300.0, 45.0
    grown = 1.0 / (1.0 - (cycles * speed_deg_s / 360.0 / resonance_hz) ** 2)
    fast = replace(AXIS_1, speed_deg_s=speed_deg_s, rate_hz=60.0)
    curve = transmission_curve(swept(replace(fast, ripple=lines((cycles, grown * size, 0.4)))))
    off_urad = float(np.linalg.norm(curve.amplitude_rad[0])) / URAD - size
    sigma_urad = float(np.sqrt(np.trace(curve.covariance_rad2[:2, :2]))) / URAD
    assert abs(off_urad) < (0.5 if resonance_hz == 10.0 else 1.5 * sigma_urad)
    assert 1.0 < sigma_urad < 3.0
    as_shown = replace(fast, ripple=lines((30.0, size, 0.4)))
    assert left_urad(as_shown, swept(as_shown)) < 1.0


def test_lost_samples_and_single_spikes_are_survived() -> None:
    up, down = AXIS_1.streams()
    keep = np.ones(len(up.device_s), dtype=bool)
    keep[200:215] = keep[400:440] = False
    holey = only(up, keep)
    holey.xyz_mm[[50, 300]] += 3.0
    found = swept_axis(holey, down, ARM, 0)
    assert left_urad(AXIS_1, found) < 1.5
    assert found.lost >= 55


def late(stream: SweepStream) -> Array:
    return np.where(np.arange(len(stream.device_s)) > 300, 1.0, 0.0)


def paused(up: SweepStream) -> SweepStream:
    n = np.arange(len(up.xyz_mm))
    return replace(up, xyz_mm=up.xyz_mm[np.where(n < 330, np.minimum(n, 300), n - 30)])


def only(up: SweepStream, kept: NDArray[np.bool_]) -> SweepStream:
    return replace(
        up, device_s=up.device_s[kept], xyz_mm=up.xyz_mm[kept], window_s=up.window_s[kept]
    )


def thinned(up: SweepStream) -> SweepStream:
    n = np.arange(len(up.device_s))
    return only(up, (n < 450) | (n % 3 == 0))


def not_finite(up: SweepStream) -> SweepStream:
    return replace(up, xyz_mm=np.where(np.arange(len(up.xyz_mm))[:, None] == 7, np.nan, up.xyz_mm))


def others_move(up: SweepStream) -> SweepStream:
    ramp = np.linspace(0.0, 0.1, len(up.joints_rad))[:, None] * (np.arange(6) == 3)
    return replace(up, joints_rad=up.joints_rad + ramp)


SPOILT: dict[str, Callable[[SweepStream], SweepStream]] = {
    "the clock jumps": lambda up: replace(up, device_s=up.device_s + 2 * late(up)),
    "by a little": lambda up: replace(up, device_s=up.device_s + 0.04 * late(up)),
    "back": lambda up: replace(up, device_s=up.device_s - 0.2 * late(up)),
    "the axis pauses": paused,
    "metres": lambda up: replace(up, xyz_mm=up.xyz_mm / 1000),
    "inches": lambda up: replace(up, xyz_mm=up.xyz_mm / 25.4),
    "degrees": lambda up: replace(up, joints_rad=np.degrees(up.joints_rad)),
    "not finite": not_finite,
    "few": lambda up: only(up, up.device_s < up.device_s[50]),
    "many lost": thinned,
    "other axes turn": others_move,
    "another sweep's joints": lambda up: replace(up, asked_s=up.asked_s * 1.05),
    "the controller's clock set": (
        lambda up: replace(up, stamped_s=np.roll(np.linspace(1, 9, len(up.asked_s)), 9))
    ),
    "some without the controller's time": (
        lambda up: replace(up, stamped_s=np.where(np.arange(len(up.asked_s)) % 9, 1.0, np.nan))
    ),
    "far apart": lambda up: replace(up, asked_s=up.asked_s + 0.6),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_stream_that_cannot_be_used_is_named(name: str) -> None:
    up, down = AXIS_1.streams()
    found = swept_axis(SPOILT[name](up), down, ARM, 0)
    assert found.reason
    assert not found.cycles


def test_directions_that_differ_are_refused() -> None:
    up = Axis(0, lines((41.0, 40.0, 0.0))).stream(1.0)
    down = Axis(0, lines((90.0, 40.0, 0.0))).stream(-1.0)
    found = swept_axis(up, down, ARM, 0)
    assert "differ" in found.reason
    assert found.differ_rad > 10 * URAD
    assert not found.cycles


@pytest.mark.parametrize("low", [23.0, 37.0])
def test_a_long_line_and_its_double_are_both_found(low: float) -> None:
    """Few periods of the lowest fit into the range, and the noise there is known worst."""
    axis = Axis(0, lines((low, 70.0, 0.3), (2 * low, 70.0, 1.0)))
    found = swept(axis)
    np.testing.assert_allclose(found.cycles, [low, 2 * low], atol=0.2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_trial_has_the_amplitudes_of_least_squares_beside_smooth_errors(sign: float) -> None:
    """Of shifted waves that both directions share, and of those that have opposite signs."""
    rng, shift = np.random.default_rng(1), Shift(3e-3, 1e-4)
    joint_rad, side = np.tile(np.linspace(-0.6, 0.6, 400), 2), np.repeat([1.0, -1.0], 400)
    records = Records(joint_rad, rng.normal(0.0, 1e-5, 800), side)
    lines, trial = without_lines(records, shift), Trial(records)
    explained = trial.explained(Known(records, lines), shift)[0 if sign > 0 else 1]
    phase = np.outer(records.angle_rad(shift.rad), trial.cycles[40:41])
    waves = np.hstack([np.cos(phase), np.sin(phase)]) * np.where(side > 0, 1.0, sign)[:, None]
    columns = np.hstack([records.smooth, waves])
    prior = np.full(columns.shape[1], np.mean(lines.left_rad**2))
    prior[-2:] = 0.0
    best = np.linalg.solve(columns.T @ columns + np.diag(prior), columns.T @ records.error_rad)
    np.testing.assert_allclose(explained.amplitude_rad[40], best[-2:], rtol=1e-5)


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


RECORDED = replace(CURVE, shift_rad=0.0)
FOUND = msgspec.structs.replace(
    without_curve(1, "", 0.0123),
    cycles=RECORDED.cycles.tolist(),
    amplitude_rad=RECORDED.amplitude_rad.tolist(),
    covariance_rad2=RECORDED.covariance_rad2.tolist(),
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
        assert getattr(found, name) == getattr(RECORDED, name)
    q = np.linspace(-1.0, 0.2, 50)
    np.testing.assert_array_equal(found.evaluate(q), RECORDED.evaluate(q))
    np.testing.assert_array_equal(found.covariance_rad2, RECORDED.covariance_rad2)


def test_a_result_without_a_curve_says_why() -> None:
    record = without_curve(4, "upwards: 9 samples")
    assert not record.holds
    assert "upwards: 9 samples" in record.summary
    assert len(transmission_curve(record).cycles) == 0
