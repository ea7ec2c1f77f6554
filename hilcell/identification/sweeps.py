"""From two sweeps of one axis, upwards and downwards, to its transmission curve.

A lag between both streams looks like a constant error of the joint, of opposite sign in the two
directions, and shifts the curve along the joint by as much. So the constants tell the lag, as far
as lost motion lets them, and the lines of both directions improve it. The constant of a curve, its
slope and its long waves are never used: frames, kinematics and gravity are in them, too.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hilcell.geometry.kinematics import Arm, Array
from hilcell.geometry.statistics import rms
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.motion import BadStream, Motion, SweepStream, motion_of
from hilcell.identification.spectrum import (
    Found,
    Known,
    Records,
    Shift,
    search,
    without_lines,
)
from hilcell.model.events import URAD, CurveMeasured

DIFFERS = 0.5  # of the largest line: by how much the directions may differ


@dataclass(frozen=True, slots=True)
class SweptAxis:
    """The result of one axis: a curve, or the reason why there is none, with figures.

    ``shown_rad`` (B, 3) is for pictures: joint, short-wave error as measured, and by the curve;
    ``spectrum`` (F, 2) are cycles per revolution and amplitudes in rad.
    """

    axis: int
    reason: str = ""
    curve: TransmissionCurve | None = None
    lag_s: float = 0.0
    lag_sigma_s: float = 0.0
    noise_rad: float = 0.0
    signal_rad: float = 0.0  # rms of the curve over the swept range
    share: float = 0.0  # of the short-wave variance, explained by the curve
    differ_rad: float = 0.0  # the largest line by which the directions differ
    lost: int = 0  # samples
    shown_rad: Array = field(default_factory=lambda: np.zeros((0, 3)))
    spectrum: Array = field(default_factory=lambda: np.zeros((0, 2)))


def swept_axis(up: SweepStream, down: SweepStream, arm: Arm, axis: int) -> SweptAxis:
    """Return the curve of ``axis`` (0 to 5) by its sweeps upwards and downwards, or why not."""
    motions = []
    for name, stream in (("upwards", up), ("downwards", down)):
        try:
            motions.append(motion_of(stream, arm, axis))
        except BadStream as error:
            return SweptAxis(axis, f"{name}: {error}")
    rising, falling = motions
    if not (rising.speed_rad_s > 0 > falling.speed_rad_s):
        return SweptAxis(axis, "both sweeps turned the same way; wanted one upwards, one downwards")
    try:
        records, speed_rad_s = records_of(rising, falling), _speed(rising, falling)
    except BadStream as error:
        return SweptAxis(axis, str(error))
    shift_rad = _offset(records)
    longest_lag_s = 0.25
    if not abs(shift_rad) <= longest_lag_s * speed_rad_s:
        return SweptAxis(
            axis,
            f"tracker and joints are {shift_rad / speed_rad_s:.3f} s apart, wanted <= "
            f"{longest_lag_s:g} s: see the controller's and the tracker's load",
            lag_s=shift_rad / speed_rad_s,
        )
    half_gap_rad = 1e-4  # 1 sigma of the lost motion that is taken for lag
    found = search(records, Shift(shift_rad, half_gap_rad))
    return _judged(axis, records, found, rising, falling)


def records_of(rising: Motion, falling: Motion) -> Records:
    """Return both directions where both were swept; raises `BadStream`."""
    both = (rising, falling)
    low = max(float(motion.joint_rad.min()) for motion in both)
    high = min(float(motion.joint_rad.max()) for motion in both)
    widest = max(float(np.ptp(motion.joint_rad)) for motion in both)
    least_overlap = 0.8  # of the joint's range, swept in both directions
    if not high - low >= least_overlap * widest:
        raise BadStream(
            f"both directions share {np.degrees(high - low):.1f} deg of "
            f"{np.degrees(widest):.1f} deg, wanted >= {100 * least_overlap:g} %: sweep one range"
        )
    joint, error, side = list[Array](), list[Array](), list[Array]()
    for motion, sign in ((rising, 1.0), (falling, -1.0)):
        inside = (motion.joint_rad >= low) & (motion.joint_rad <= high)
        # Samples that are closer than a curve needs them are averaged.
        spacing_rad = float(np.radians(0.04))
        found_rad = float(np.median(np.abs(np.diff(motion.joint_rad[inside]))))
        size = max(1, int(spacing_rad / found_rad + 0.01))
        whole = np.count_nonzero(inside) // size * size
        for means, samples in ((joint, motion.joint_rad), (error, motion.error_rad)):
            means.append(samples[inside][:whole].reshape(-1, size).mean(axis=1))
        side.append(np.full(len(joint[-1]), sign))
    return Records(np.concatenate(joint), np.concatenate(error), np.concatenate(side))


def _speed(rising: Motion, falling: Motion) -> float:
    """Return the speed of both sweeps; raises `BadStream` where they had two."""
    up, down = rising.speed_rad_s, -falling.speed_rad_s
    if not abs(up / down - 1.0) <= 0.02:
        raise BadStream(
            f"swept upwards at {np.degrees(up):.3f} deg/s, downwards at {np.degrees(down):.3f} "
            "deg/s: sweep both at one speed"
        )
    return (up + down) / 2.0


def _offset(records: Records) -> float:
    """Return half the difference of both directions' means over their common range."""
    up = records.side > 0
    grid = np.linspace(records.joint_rad.min(), records.joint_rad.max(), 500)
    means = []
    for which in (up, ~up):
        order = np.argsort(records.joint_rad[which])
        joint, error = records.joint_rad[which][order], records.error_rad[which][order]
        means.append(float(np.interp(grid, joint, error).mean()))
    return (means[0] - means[1]) / 2.0


def _judged(
    axis: int, records: Records, found: Found, rising: Motion, falling: Motion
) -> SweptAxis:
    lines, speed_rad_s = found.lines, _speed(rising, falling)
    curve = _curve(axis, records, found, speed_rad_s * max(rising.clock_s, falling.clock_s))
    curve_rad = curve.evaluate(records.joint_rad + lines.shift.rad * records.side)
    left, signal = float(np.mean(np.square(lines.left_rad))), rms(curve_rad) ** 2
    largest_rad = float(np.linalg.norm(lines.amplitude_rad, axis=1).max(initial=0.0))
    reason = ""
    if not found.differ_rad <= DIFFERS * largest_rad:
        reason = (
            f"the directions differ by a line of {found.differ_rad * 1e6:.1f} urad, the largest "
            f"that they share has {largest_rad * 1e6:.1f} urad: wanted <= {100 * DIFFERS:g} %"
        )
    return SweptAxis(
        axis,
        reason,
        None if reason else curve,
        lag_s=lines.shift.rad / speed_rad_s,
        lag_sigma_s=lines.shift.sigma_rad / speed_rad_s,
        noise_rad=float(np.sqrt(left)),
        signal_rad=float(np.sqrt(signal)),
        share=signal / (signal + left),
        differ_rad=found.differ_rad,
        lost=rising.lost + falling.lost,
        shown_rad=_shown(records, found, curve),
        spectrum=_spectrum(records, found),
    )


def _curve(axis: int, records: Records, found: Found, clocks_rad: float) -> TransmissionCurve:
    """Return the curve of the joint itself: the lines are about the records' middle."""
    order = np.argsort(found.lines.cycles)
    cycles = found.lines.cycles[order]
    angle = cycles * records.middle_rad
    turn = np.zeros((2 * len(cycles), 2 * len(cycles)))
    for k, (c, s) in enumerate(zip(np.cos(angle), np.sin(angle), strict=True)):
        turn[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[c, -s], [s, c]]
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    covariance = found.covariance_rad2[np.ix_(rows, rows)]
    amplitude = turn @ found.lines.amplitude_rad[order].ravel()
    shift_sigma_rad = 1e-5  # of the abscissa, besides the clocks': landing, reading cycle
    return TransmissionCurve(
        axis,
        cycles,
        amplitude.reshape(-1, 2),
        turn @ covariance @ turn.T,
        shift_rad=0.0,
        shift_sigma_rad=float(np.hypot(shift_sigma_rad, clocks_rad)),
        low_rad=float(records.joint_rad.min()),
        high_rad=float(records.joint_rad.max()),
        noise_rad=rms(found.lines.left_rad),
    )


def _shown(records: Records, found: Found, curve: TransmissionCurve) -> Array:
    """Return joint, short-wave error and curve (B, 3), means of both directions."""
    joint_rad = records.joint_rad + found.lines.shift.rad * records.side
    by_curve = curve.evaluate(joint_rad)
    shown_rad = float(np.radians(0.1))  # one point of a picture
    number = ((joint_rad - joint_rad.min()) / shown_rad).astype(int)
    count = np.bincount(number)
    rows = [joint_rad, found.lines.left_rad + by_curve, by_curve]
    sums = np.stack([np.bincount(number, weights=row) for row in rows], axis=1)
    return sums[count > 0] / count[count > 0, None]


def _spectrum(records: Records, found: Found) -> Array:
    """Return cycles and amplitudes (F, 2) of what both directions share, nothing taken out."""
    shift = found.lines.shift
    known = Known(records, without_lines(records, shift))
    amplitude = found.trial.explained(known, shift)[0].amplitude_rad
    return np.column_stack([found.trial.cycles, np.linalg.norm(amplitude, axis=1)])[::2]


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
