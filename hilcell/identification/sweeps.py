"""Transmission curve of one axis from two sweeps, upwards and downwards.

A lag between both streams resembles a constant error of the joint, of opposite sign in the two
directions, and shifts the curve along the joint. The constants determine the lag, as far as lost
motion allows, and the lines of both directions improve it. The constant of a curve, its slope and
one and two waves a revolution are not used: they contain frames, kinematics and gravity.

A curve is lines and, where there is evidence for it, a smooth error below them
(`hilcell.identification.smooth_error`). Long waves of it, half a period in the range and less, are
left to the static poses: the records hardly determine them, and the covariance says so.

Lines are detected in both records at once, which have their own smooth errors and are apart along
the joint by twice the shift. Signal is common to both directions; their difference is noise, at any
frequency, possibly coloured and unknown beforehand.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from hilcell.geometry.kinematics import Arm, Array
from hilcell.geometry.statistics import rms
from hilcell.identification.axis_motion import BadStream, Motion, SweepStream, axis_motion
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.smooth_error import HIGHEST as SMOOTH_HIGHEST
from hilcell.identification.smooth_error import Regression, most_likely
from hilcell.model.events import URAD, CurveMeasured

DIFFERS = 0.5  # of the largest line: by how much the directions may differ


def swept_axis(up: SweepStream, down: SweepStream, arm: Arm, axis: int) -> CurveMeasured:
    """Curve of ``axis`` (0 to 5) by its sweeps upwards and downwards, or why there is none."""
    motions = []
    for name, stream in (("upwards", up), ("downwards", down)):
        try:
            motions.append(axis_motion(stream, arm, axis))
        except BadStream as error:
            return without_curve(axis, f"{name}: {error}")
    rising, falling = motions
    try:
        records, speed_rad_s = sweep_records(rising, falling), _speed(rising, falling)
    except BadStream as error:
        return without_curve(axis, str(error))
    shift_rad = _offset(records)
    longest_lag_s = 0.25
    if not abs(shift_rad) <= longest_lag_s * speed_rad_s:
        return without_curve(
            axis,
            f"tracker and joints are {shift_rad / speed_rad_s:.3f} s apart, expected <= "
            f"{longest_lag_s:g} s: see the controller's and the tracker's load",
            shift_rad / speed_rad_s,
        )
    half_gap_rad = 1e-4  # 1 sigma of the lost motion that is taken for lag
    found = search(records, Shift(shift_rad, half_gap_rad))
    return _judged(axis, found, rising, falling)


def sweep_records(rising: Motion, falling: Motion) -> Records:
    """Records of both sweeps, limited to the common range; raises `BadStream`."""
    if not (rising.speed_rad_s > 0 > falling.speed_rad_s):
        raise BadStream("both sweeps turned the same way, expected one up and one down")
    both = (rising, falling)
    low = max(float(motion.joint_rad.min()) for motion in both)
    high = min(float(motion.joint_rad.max()) for motion in both)
    widest = max(float(np.ptp(motion.joint_rad)) for motion in both)
    least_overlap = 0.8  # of the joint's range, swept in both directions
    if not high - low >= least_overlap * widest:
        raise BadStream(
            f"both directions share {np.degrees(high - low):.1f} deg of "
            f"{np.degrees(widest):.1f} deg, expected >= {100 * least_overlap:g} %: sweep one range"
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


def without_curve(axis: int, reason: str, lag_s: float = 0.0) -> CurveMeasured:
    """Event of an axis (0 to 5) without a curve."""
    return CurveMeasured(
        axis=axis + 1, reason=reason, cycles=[], amplitude_rad=[], covariance_rad2=[],
        shift_rad=0.0, shift_sigma_rad=0.0, low_rad=0.0, high_rad=0.0, noise_rad=0.0, lag_s=lag_s,
        lag_sigma_s=0.0, signal_rad=0.0, share=0.0, differ_rad=0.0, lost=0, shown=[], spectrum=[],
        smooth_cycles=[], smooth_amplitude_rad=[], smooth_rad=0.0,
    )  # fmt: skip


def _judged(axis: int, found: Found, rising: Motion, falling: Motion) -> CurveMeasured:
    records, lines, speed_rad_s = found.records, found.lines, _speed(rising, falling)
    curve = found.curve(axis, speed_rad_s * max(rising.clock_s, falling.clock_s))
    still = at_rest(curve, speed_rad_s)
    curve_rad = curve.evaluate(records.joint_rad + lines.shift.rad * records.side)
    left, signal = float(np.mean(np.square(found.waves.left_rad))), float(np.var(curve_rad))
    largest_rad = float(np.linalg.norm(lines.amplitude_rad, axis=1).max(initial=0.0))
    reason = ""
    if not found.differ_rad <= DIFFERS * largest_rad:
        reason = (
            f"the directions differ by a line of {found.differ_rad * 1e6:.1f} urad, the largest "
            f"that they share has {largest_rad * 1e6:.1f} urad: expected <= {100 * DIFFERS:g} %"
        )
    seen = replace(
        without_curve(axis, reason, lines.shift.rad / speed_rad_s),
        lag_sigma_s=lines.shift.sigma_rad / speed_rad_s,
        noise_rad=curve.noise_rad,
        signal_rad=float(np.sqrt(signal)),
        share=signal / (signal + left),  # of the variance, explained by the curve
        smooth_rad=found.smooth_rad(),
        differ_rad=found.differ_rad,
        lost=rising.lost + falling.lost,
        shown=np.round(found.shown(curve) * [np.degrees(1.0), URAD, URAD], 3).tolist(),
        spectrum=np.round(found.spectrum() * [1.0, URAD], 3).tolist(),
    )
    if reason:
        return seen
    count = len(lines.cycles)
    return replace(
        seen,
        cycles=curve.cycles[:count].tolist(),
        amplitude_rad=still.amplitude_rad[:count].tolist(),
        smooth_cycles=still.cycles[count:].tolist(),
        smooth_amplitude_rad=still.amplitude_rad[count:].tolist(),
        covariance_rad2=still.covariance_rad2.tolist(),
        shift_sigma_rad=curve.shift_sigma_rad,
        low_rad=curve.low_rad,
        high_rad=curve.high_rad,
    )


def at_rest(curve: TransmissionCurve, speed_rad_s: float) -> TransmissionCurve:
    """Return the curve of a joint at rest, by that of one turning at a speed.

    A joint's waves drive the arm, a resonator at f0: of a wave of frequency f it shows
    1 / (1 - (f / f0)^2). All waves share the uncertainty of f0.
    """
    resonance_hz, doubt = 10.0, 0.5  # lowest of a large arm, and 1 sigma of its square's share
    hz = np.repeat(curve.cycles, 2) * speed_rad_s / (2.0 * np.pi)
    grown = np.square(hz / resonance_hz)
    doubted_rad = doubt * grown * curve.amplitude_rad.ravel()
    return dataclasses.replace(
        curve,
        amplitude_rad=curve.amplitude_rad * (1.0 - grown.reshape(-1, 2)),
        covariance_rad2=curve.covariance_rad2 * np.outer(1.0 - grown, 1.0 - grown)
        + np.outer(doubted_rad, doubted_rad),
    )


def transmission_curve(measured: CurveMeasured) -> TransmissionCurve:
    """Curve of an event, where valid."""
    cycles = [*measured.cycles, *measured.smooth_cycles]
    amplitude_rad = [*measured.amplitude_rad, *measured.smooth_amplitude_rad]
    count = len(cycles)
    return TransmissionCurve(
        measured.axis - 1,
        np.array(cycles),
        np.array(amplitude_rad).reshape(count, 2),
        np.array(measured.covariance_rad2).reshape(2 * count, 2 * count),
        measured.shift_rad,
        measured.shift_sigma_rad,
        measured.low_rad,
        measured.high_rad,
        measured.noise_rad,
    )


Complex = NDArray[np.complex128]

LOWEST, HIGHEST = 18.0, 560.0  # cycles per joint revolution
LINE_RAD = 1e-4  # 1 sigma of a line's cosine and sine


@dataclass(frozen=True)
class Records:
    """Records of both directions, concatenated: joint, error and direction of N samples."""

    FREE_RAD = 0.1  # 1 sigma of constant and slope: nothing is known of them
    GEOMETRY_RAD: ClassVar = {1: 1e-3, 2: 5e-4}  # 1 sigma of these waves a revolution, the arm's

    joint_rad: Array  # (N,) as read, not yet shifted
    error_rad: Array  # (N,)
    side: Array  # (N,) 1 upwards, -1 downwards

    @property
    def middle_rad(self) -> float:
        return float(self.joint_rad.max() + self.joint_rad.min()) / 2.0

    @property
    def half_rad(self) -> float:
        return float(np.ptp(self.joint_rad)) / 2.0

    @property
    def width(self) -> float:
        """Return the width of a line, in cycles per revolution."""
        return np.pi / self.half_rad

    @property
    def lowest(self) -> float:
        """Return the cycles per revolution below which an error counts as smooth."""
        least_periods = 1.9  # of a line in the range
        return max(LOWEST, least_periods * self.width)

    def angle_rad(self, shift_rad: float) -> Array:
        """Return the joint (N,) from its middle, each direction shifted."""
        return self.joint_rad + shift_rad * self.side - self.middle_rad

    @cached_property
    def directions(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        return np.flatnonzero(self.side > 0), np.flatnonzero(self.side < 0)

    @cached_property
    def smooth(self) -> Array:
        """Columns (N, P) of smooth errors, separate for each direction, in units of 1 sigma."""
        below_lines = {3: 2e-4, 4: 5e-5, 5: 2e-5} | dict.fromkeys(range(6, 18, 3), 1e-5)
        return self.each_direction(self.GEOMETRY_RAD | below_lines)

    def each_direction(self, waves_rad: dict[int, float]) -> Array:
        """Columns (N, P), separate for each direction, of constant, slope and waves, in units of
        the 1 sigma of each wave's order.
        """
        angle = self.angle_rad(0.0)
        columns = [np.full_like(angle, self.FREE_RAD), self.FREE_RAD * angle / self.half_rad]
        for order, sigma in waves_rad.items():
            columns += [sigma * np.cos(order * angle), sigma * np.sin(order * angle)]
        both, up = np.stack(columns, axis=1), (self.side > 0)[:, None]
        return np.hstack([both * up, both * ~up])

    @cached_property
    def _smooth_products(self) -> Array:
        return self.smooth.T @ self.smooth

    @cached_property
    def _smooth_right(self) -> Array:
        return self.smooth.T @ self.error_rad

    def equations(self, columns: Array) -> tuple[Array, Array]:
        """Normal equations of the error by smooth and more columns (N, Q). Matrix (P + Q, P + Q)
        and right side (P + Q,).
        """
        across = self.smooth.T @ columns
        normal = np.block([[self._smooth_products, across], [across.T, columns.T @ columns]])
        return normal, np.concatenate([self._smooth_right, columns.T @ self.error_rad])

    def left_rad(self, columns: Array, found: Array) -> Array:
        """Return what smooth and more columns (N, Q) with coefficients (P + Q,) leave (N,)."""
        count = self.smooth.shape[1]
        return self.error_rad - self.smooth @ found[:count] - columns @ found[count:]

    def frequencies(self, oversampled: int) -> Array:
        """Return frequencies (F,) in even steps, a part of a line's width apart."""
        steps_rad = np.abs(np.diff(self.joint_rad))
        highest = min(HIGHEST, 0.8 * np.pi / float(np.median(steps_rad)))
        count = int((highest - self.lowest) / self.width * oversampled)
        return np.linspace(self.lowest, highest, max(count, 4))

    def rms_rad(self, lines: Lines) -> float:
        waves = _waves(self.angle_rad(lines.shift.rad), lines.cycles)
        return rms(waves @ lines.amplitude_rad.ravel())

    def refined(self, lines: Lines, prior: Shift) -> Lines:
        cycles, amplitude, shift_rad = lines.cycles, lines.amplitude_rad, lines.shift.rad
        count, sigma_rad, sigma = len(cycles), rms(lines.left_rad), prior.sigma_rad
        first = self.smooth.shape[1]
        settled, longest_step = 1e-4, 0.2  # of a line's width
        for _ in range(12):
            angle = self.angle_rad(shift_rad)
            waves = _waves(angle, cycles)
            turned = waves[:, ::2] * amplitude[:, 1] - waves[:, 1::2] * amplitude[:, 0]
            by_cycles = self.width * angle[:, None] * turned
            by_shift = prior.sigma_rad * (self.side * (turned @ cycles))[:, None]
            columns = np.hstack([LINE_RAD * waves, by_cycles, by_shift])
            towards = (prior.rad - shift_rad) / prior.sigma_rad
            found, inverse = self._solved(columns, sigma_rad, towards)
            sigma_rad = rms(self.left_rad(columns, found))
            sigma = prior.sigma_rad * sigma_rad * float(np.sqrt(inverse[-1, -1]))
            amplitude = LINE_RAD * found[first : first + 2 * count].reshape(-1, 2)
            step = np.clip(found[-1 - count : -1], -longest_step, longest_step)
            cycles = np.clip(cycles + self.width * step, self.lowest, HIGHEST)
            shift_rad += prior.sigma_rad * float(found[-1])
            if not np.any(np.abs(step) > settled):
                break
        columns = LINE_RAD * _waves(self.angle_rad(shift_rad), cycles)
        found, _ = self._solved(columns, sigma_rad)
        amplitude = LINE_RAD * found[first:].reshape(-1, 2)
        return Lines(cycles, amplitude, Shift(shift_rad, sigma), self.left_rad(columns, found))

    def _solved(self, columns: Array, sigma_rad: float, last: float = 0.0) -> tuple[Array, Array]:
        """Best coefficients (P,) of smooth and these columns, and the inverse (P, P). Their prior
        is 1 sigma = 1 about 0, of the last one about ``last``.
        """
        normal, right = self.equations(columns)
        normal[np.diag_indices_from(normal)] += sigma_rad**2
        right[-1] += sigma_rad**2 * last
        inverse = np.linalg.inv(normal)
        found: Array = inverse @ right
        return found, np.array(inverse, dtype=float)


@dataclass(frozen=True, slots=True)
class Shift:
    """How far each direction lies behind, and its standard uncertainty, in rad."""

    rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of white noise equivalent to the noise at a frequency; its log is a parabola."""

    CHANCE = 1e-3  # that any line at all is found where there is none

    coefficients: Array  # (3,)
    covariance: Array  # (3, 3)

    def variance_rad2(self, cycles: Array) -> Array:
        """Return the variances (...) at frequencies (...)."""
        return np.exp(_powers_of_log(cycles) @ self.coefficients)

    def chance(self, score: float, cycles: float) -> float:
        """Probability of a noise power of ``score`` times its variance, or more.

        Powers have two degrees of freedom, and the noise is estimated from few frequencies: F
        distribution with 2 and 2 / u^2 degrees, u of the variance's logarithm.
        """
        x = _powers_of_log(cycles)
        degrees = 1.0 / float(x @ self.covariance @ x)
        return float((1.0 + score / 2.0 / degrees) ** -degrees)

    def is_line(self, score: Array, cycles: Array) -> bool:
        """Whether the best of scores (F,) at frequencies (F,) is more than noise by chance."""
        best = int(np.argmax(score))
        return bool(len(score) * self.chance(score[best], cycles[best]) < self.CHANCE)


@dataclass(frozen=True, slots=True)
class Lines:
    """K lines about the records' middle, and what they leave of N samples."""

    cycles: Array  # (K,) per revolution
    amplitude_rad: Array  # (K, 2) of cosine and sine
    shift: Shift
    left_rad: Array  # (N,)


@dataclass(frozen=True, slots=True)
class Found:
    """The significant lines, and all K waves: these lines, then those of a smooth error, if any.

    ``covariance_rad2`` (2K, 2K) of the waves' amplitudes. ``differ_rad``: largest amplitude of the
    difference between the directions at one frequency, 0 where it may be chance.
    """

    records: Records
    lines: Lines
    waves: Lines
    covariance_rad2: Array
    differ_rad: float
    trial: Trial

    def curve(self, axis: int, clocks_rad: float) -> TransmissionCurve:
        """Return the curve of the joint itself: the waves are about the records' middle."""
        lines, waves = len(self.lines.cycles), self.waves
        order = np.append(np.argsort(self.lines.cycles), np.arange(lines, len(waves.cycles)))
        cycles = waves.cycles[order]
        angle = cycles * self.records.middle_rad
        turn = np.zeros((2 * len(cycles), 2 * len(cycles)))
        for k, (c, s) in enumerate(zip(np.cos(angle), np.sin(angle), strict=True)):
            turn[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[c, -s], [s, c]]
        rows = (2 * order[:, None] + np.arange(2)).ravel()
        covariance = self.covariance_rad2[np.ix_(rows, rows)]
        amplitude = turn @ waves.amplitude_rad[order].ravel()
        shift_sigma_rad = 1e-5  # of the abscissa, besides the clocks': landing, reading cycle
        return TransmissionCurve(
            axis,
            cycles,
            amplitude.reshape(-1, 2),
            turn @ covariance @ turn.T,
            shift_rad=0.0,
            shift_sigma_rad=float(np.hypot(shift_sigma_rad, clocks_rad)),
            low_rad=float(self.records.joint_rad.min()),
            high_rad=float(self.records.joint_rad.max()),
            noise_rad=rms(waves.left_rad),
        )

    def smooth_rad(self) -> float:
        """Return the rms of the smooth error over the range, less a straight line."""
        angle, first = self.records.angle_rad(self.lines.shift.rad), len(self.lines.cycles)
        cycles, amplitude = self.waves.cycles[first:], self.waves.amplitude_rad[first:]
        smooth = _waves(angle, cycles) @ amplitude.ravel()
        return rms(smooth - np.polyval(np.polyfit(angle, smooth, 1), angle))

    def shown(self, curve: TransmissionCurve) -> Array:
        """Return joint, error and curve (B, 3), means of both directions."""
        joint_rad = self.records.joint_rad + self.lines.shift.rad * self.records.side
        by_curve = curve.evaluate(joint_rad)
        shown_rad = float(np.radians(0.1))  # one point of a picture
        number = ((joint_rad - joint_rad.min()) / shown_rad).astype(int)
        count = np.bincount(number)
        rows = [joint_rad, self.waves.left_rad + by_curve, by_curve]
        sums = np.stack([np.bincount(number, weights=row) for row in rows], axis=1)
        return sums[count > 0] / count[count > 0, None]

    def spectrum(self) -> Array:
        """Return cycles and amplitudes (F, 2) of what both directions share, nothing taken out."""
        shift = self.lines.shift
        known = Known(self.records, without_lines(self.records, shift))
        amplitude = self.trial.explained(known, shift)[0].amplitude_rad
        return np.column_stack([self.trial.cycles, np.linalg.norm(amplitude, axis=1)])[::2]


@dataclass(frozen=True, slots=True)
class Explained:
    """The sum of squares (F,) that each of F waves alone explains, and its amplitudes (F, 2)."""

    powers_rad2: Array
    amplitude_rad: Array

    @classmethod
    def by(cls, normal: Array, across: Complex, right: Complex) -> Self:
        """Waves beside orthogonal columns. Of the waves' products (F, 2, 2), with the columns (P,
        F) and with the residual (F,).
        """
        cosine, sine = across.real, across.imag
        taken = (
            np.einsum("pf,pf->f", *pair)
            for pair in ((cosine, cosine), (cosine, sine), (sine, sine))
        )
        products = np.stack([right.real, right.imag], axis=1)
        amplitude = np.linalg.solve(normal - _symmetric(*taken), products[..., None])[..., 0]
        return cls(np.einsum("fi,fi->f", products, amplitude), np.array(amplitude, dtype=float))


class Trial:
    """Waves exp(i f angle) of many frequencies f (F,) at the samples of each direction, unshifted.
    Their sums over the samples of a direction rotate with its shift.
    """

    def __init__(self, records: Records) -> None:
        oversampled = 4  # trial frequencies in one width of a line
        self.cycles = records.frequencies(oversampled)
        self.apart = slice(None, None, oversampled)  # of them, as good as independent
        self._directions, angle_rad = records.directions, records.angle_rad(0.0)
        half = records.smooth.shape[1] // 2
        self._waves, self._squares, self._smooth = list[Complex](), list[Complex](), list[Complex]()
        for n, samples in enumerate(self._directions):
            waves, squares = self._even_waves(angle_rad[samples])
            self._waves.append(waves)
            self._squares.append(squares)
            self._smooth.append(
                self._sums(records.smooth[samples, n * half : (n + 1) * half], waves)
            )

    def explained(self, known: Known, shift: Shift) -> tuple[Explained, Explained]:
        """Return what waves of both directions explain, and those of opposite sign in them."""
        up = np.exp(1j * shift.rad * self.cycles)
        turns = (up, up.conj())
        rows = np.column_stack([known.waves, known.left_rad])
        sums = [
            self._sums(rows[samples], waves) * turn
            for samples, waves, turn in zip(self._directions, self._waves, turns, strict=True)
        ]
        smooth = [each * turn for each, turn in zip(self._smooth, turns, strict=True)]
        squares = self._squares[0] * up**2 + self._squares[1] * up.conj() ** 2
        count = len(rows)
        normal = _symmetric(
            (count + squares.real) / 2, squares.imag / 2, (count - squares.real) / 2
        )
        same, opposite = (
            Explained.by(
                normal,
                known.root
                @ np.vstack([smooth[0], sign * smooth[1], sums[0][:-1] + sign * sums[1][:-1]]),
                sums[0][-1] + sign * sums[1][-1],
            )
            for sign in (1.0, -1.0)
        )
        return same, opposite

    def difference(self, opposite: Explained) -> tuple[Noise, float]:
        """Return the noise by what the directions differ, and the largest line in that."""
        noise = spectral_noise(opposite.powers_rad2[self.apart], self.cycles[self.apart])
        score = opposite.powers_rad2 / noise.variance_rad2(self.cycles)
        best = int(np.argmax(score))
        is_line = noise.is_line(score, self.cycles)
        return noise, float(np.linalg.norm(opposite.amplitude_rad[best])) if is_line else 0.0

    def _even_waves(self, angle_rad: Array) -> tuple[Complex, Complex]:
        """Waves (N, F) at F frequencies in even steps, by adding angles, and their squares' sums
        (F,).
        """
        cycles = self.cycles
        step = np.exp(1j * angle_rad * (cycles[1] - cycles[0]))
        block = 16  # frequencies, of which one cosine and sine each is computed
        fine = self._series(np.ones_like(step), step, block)
        first = np.exp(1j * angle_rad * cycles[0])
        coarse = self._series(first, fine[:, -1] * step, -(-len(cycles) // block))
        waves = (coarse[:, :, None] * fine[:, None, :]).reshape(len(angle_rad), -1)
        squares = ((coarse * coarse).T @ (fine * fine)).ravel()
        return waves[:, : len(cycles)], squares[: len(cycles)]

    @staticmethod
    def _series(first: Complex, ratio: Complex, count: int) -> Complex:
        """Return geometric series (N, count)."""
        factors = np.repeat(ratio[:, None], count, axis=1)
        factors[:, 0] = first
        return np.multiply.accumulate(factors, axis=1)

    @staticmethod
    def _sums(columns: Array, waves: Complex) -> Complex:
        """Return the sums (M, F) of waves (N, F) times columns (N, M), over the samples."""
        return np.asarray((columns.T @ waves.view(float)).view(complex))


class Known:
    """Smooth errors and the lines so far: columns (N, P) with priors of 1 sigma = 1, fitted."""

    def __init__(self, records: Records, lines: Lines) -> None:
        self.waves = LINE_RAD * _waves(records.angle_rad(lines.shift.rad), lines.cycles)
        normal, right = records.equations(self.waves)
        normal[np.diag_indices_from(normal)] += np.mean(lines.left_rad**2)
        self.root = np.linalg.inv(np.linalg.cholesky(normal))
        explained = self.root.T @ (self.root @ right)
        self.left_rad = records.left_rad(self.waves, explained)

    def covariance(self, lines: Lines, noises: tuple[Noise, ...]) -> Array:
        """Return the covariance (2K, 2K) of the amplitudes."""
        first = len(self.root) - 2 * len(lines.cycles)
        block = (self.root.T @ self.root)[first:, first:] * LINE_RAD**2
        sigma = np.repeat(_line_noise_rad(noises, lines.cycles), 2)
        return block * np.outer(sigma, sigma)


def _line_noise_rad(noises: tuple[Noise, ...], cycles: Array) -> Array:
    """Return the strongest noise (K,) at lines, as far as it affects their amplitudes."""
    # variance of a line with its frequency free over that with a known one, in the mean
    freed = 1.5
    strongest: Array = np.max([noise.variance_rad2(cycles) for noise in noises], axis=0)
    return np.sqrt(freed * strongest)


def with_smooth(found: Found, noises: tuple[Noise, ...]) -> Found:
    """Add a smooth error where the evidence is for it."""
    records, lines = found.records, found.lines
    highest = max(SMOOTH_HIGHEST, records.lowest)
    ranges = 3.0  # after which the smooth error repeats
    cycles = np.arange(1.0, highest * ranges / records.width) * records.width / ranges
    geometry = records.each_direction(records.GEOMETRY_RAD)
    angle, first = records.angle_rad(lines.shift.rad), geometry.shape[1]
    columns = np.hstack([geometry, _waves(angle, np.append(lines.cycles, cycles))])
    known = np.append(np.ones(first), np.full(2 * len(lines.cycles), LINE_RAD))
    regression = Regression.of(columns, records.error_rad)
    likely = most_likely(regression, known, cycles, rms(lines.left_rad))
    least_gain = 6.0  # of the evidence's logarithm
    if not likely.gain >= least_gain:
        return found
    lowest = np.array([records.lowest])
    noise_rad = max(likely.noise, *(float(each.variance_rad2(lowest)[0]) ** 0.5 for each in noises))
    sigma = np.append(known, np.repeat(likely.kernel.sigma_rad(cycles), 2))
    mean, covariance = regression.posterior(sigma, noise_rad)
    own = np.append(_line_noise_rad(noises, lines.cycles) / noise_rad, np.ones(len(cycles)))
    waves = Lines(
        np.append(lines.cycles, cycles),
        mean[first:].reshape(-1, 2),
        lines.shift,
        records.error_rad - columns @ mean,
    )
    scale = np.repeat(own, 2)
    scaled = covariance[first:, first:] * np.outer(scale, scale)
    return Found(records, lines, waves, scaled, found.differ_rad, found.trial)


def search(records: Records, shift: Shift) -> Found:
    """Detect lines one by one, the strongest against the noise first, until chance explains the
    rest, then the smooth error. ``shift`` is the initial value; the lines improve it.
    """
    trial, lines = Trial(records), without_lines(records, shift)
    smooth_left_rad, refused = rms(lines.left_rad), list[float]()
    grown = 1.6  # rms of all lines over that of what smooth errors leave: more is trade with those
    most_lines = 16
    apart = 0.45  # widths of a line, between two of them
    while True:
        known = Known(records, lines)
        same, opposite = trial.explained(known, shift)
        noise, differ_rad = trial.difference(opposite)
        score = same.powers_rad2 / noise.variance_rad2(trial.cycles)
        tried = (*lines.cycles, *refused)
        for cycles in tried:
            score[np.abs(trial.cycles - cycles) < apart * records.width] = 0.0
        best = int(np.argmax(score))
        rest = spectral_noise(same.powers_rad2[trial.apart], trial.cycles[trial.apart])
        if len(tried) == most_lines or not noise.is_line(score, trial.cycles):
            noises = (noise, rest)
            covariance = known.covariance(lines, noises)
            return with_smooth(Found(records, lines, lines, covariance, differ_rad, trial), noises)
        more = Lines(
            np.append(lines.cycles, trial.cycles[best]),
            np.vstack([lines.amplitude_rad, same.amplitude_rad[best]]),
            lines.shift,
            lines.left_rad,
        )
        more = records.refined(more, shift)
        better = bool(np.all(np.diff(np.sort(more.cycles)) >= apart * records.width))
        better &= rms(more.left_rad) < rms(lines.left_rad)
        if better and records.rms_rad(more) <= grown * smooth_left_rad:
            lines = more
        else:
            refused.append(float(trial.cycles[best]))


def without_lines(records: Records, shift: Shift) -> Lines:
    return records.refined(Lines(np.zeros(0), np.zeros((0, 2)), shift, records.error_rad), shift)


def spectral_noise(powers_rad2: Array, cycles: Array) -> Noise:
    """Noise of sums of squares (F,) of two degrees of freedom at frequencies (F,). Exponentially
    distributed: maximum likelihood by Fisher's scoring, robust against single outliers.
    """
    mean = np.maximum(powers_rad2 / 2.0, 1e-24)
    X = _powers_of_log(cycles)
    found: Array = np.array([np.log(mean.mean()), 0.0, 0.0])
    prior = np.diag([0.0, 0.5, 0.5])  # few frequencies tell no colour
    covariance = np.array(np.linalg.inv(X.T @ X + prior), dtype=float)
    stands_out = 4.0  # times the mean power: single powers beyond it are no noise
    least_step = 1e-14  # of a variance's logarithm
    for _ in range(50):
        ratio = np.minimum(mean * np.exp(-X @ found), stands_out) / (1.0 - np.exp(-stands_out))
        step = covariance @ (X.T @ (ratio - 1.0) - prior @ found)
        found = found + np.clip(step, -1.0, 1.0)
        if np.abs(step).max() < least_step:
            break
    return Noise(found, covariance)


def _powers_of_log(cycles: Array | float) -> Array:
    x = 2.0 * np.log(np.asarray(cycles, dtype=float) / LOWEST) / np.log(HIGHEST / LOWEST) - 1.0
    return np.stack([np.ones_like(x), x, x * x], axis=-1)


def _waves(angle_rad: Array, cycles: Array) -> Array:
    """Return cosines and sines (N, 2K) by turns."""
    phases = angle_rad[:, None] * cycles
    return np.stack([np.cos(phases), np.sin(phases)], axis=-1).reshape(len(angle_rad), -1)


def _symmetric(first: Array, across: Array, last: Array) -> Array:
    """Return matrices (F, 2, 2)."""
    return np.stack([first, across, across, last], axis=-1).reshape(-1, 2, 2)
