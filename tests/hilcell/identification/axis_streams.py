"""Streams of one axis's sweeps, made by formulas: a robot with errors, two clocks, late packets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hilcell.cell.file import load_cell
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.identification.axis_motion import SweepStream

ARM = load_cell("paper").robot.arm()
POSE_DEG = (0.0, -72.0, 104.0, 0.0, -42.0, 0.0)  # near the middle of the cube
RANGES_DEG = ((-19.5, 19.5), (-104.0, -41.0), (75.0, 133.0), (-38.0, 38.0), (-68.0, -15.0))
PACKETS = (8, 3, 12, 5, 9)
POLL_S, EXCHANGE_S, CYCLE_S, RAMP_S = 0.07, 0.008, 0.012, 0.05

Ripple = Callable[[Array], Array]


def none(joint_rad: Array) -> Array:
    return np.zeros_like(joint_rad)


def periodic(rng: np.random.Generator, size_rad: float) -> Ripple:
    """Return one to three lines of random gears, together ``size_rad`` / sqrt(2) rms."""
    pins, ratio = rng.integers(30, 52), rng.integers(150, 251)
    cycles = rng.permutation([pins, 2 * pins, ratio, 2 * ratio])[: rng.integers(1, 4)]
    sizes = rng.uniform(0.3, 1.0, len(cycles))
    sizes *= size_rad / np.linalg.norm(sizes)
    phases = rng.uniform(0, 2 * np.pi, len(cycles))
    return lambda q: (sizes * np.sin(q[..., None] * cycles + phases)).sum(axis=-1)


@dataclass(frozen=True)
class Axis:
    """One robot's axis, and how it is swept."""

    axis: int = 0
    ripple: Ripple = none
    lag_s: float = 0.0  # by which the joints' readings are older than they seem
    late_s: float = 0.0  # mean of what a single answer comes later, by chance
    stamped: bool = False  # the controller says when it took its joints
    half_gap_rad: float = 15e-6
    noise_mm: float = 0.008
    wander_mm: float = 0.0  # of the tool point, correlated over a degree
    speed_deg_s: float = 1.0
    rate_hz: float = 20.0
    seed: int = 1

    @property
    def range_rad(self) -> tuple[float, float]:
        low, high = np.radians(RANGES_DEG[self.axis])
        return float(low), float(high)

    def streams(self) -> tuple[SweepStream, SweepStream]:
        return self.stream(1.0), self.stream(-1.0)

    def stream(self, side: float) -> SweepStream:
        rng = np.random.default_rng([self.seed, int(side > 0)])
        low, high = self.range_rad
        begin = low if side > 0 else high
        speed = side * np.radians(self.speed_deg_s)
        end_s = (high - low) / abs(speed) + RAMP_S
        motion = _Motion(begin, speed, end_s)
        taken_s = np.arange(0.0, end_s + 1.0, 1.0 / self.rate_hz)
        joints_rad = np.tile(np.radians(POSE_DEG), (len(taken_s), 1))
        joints_rad[:, self.axis] = motion.at(taken_s)
        xyz_mm = self.seen_mm(joints_rad, side, rng)
        asked_s = np.arange(0.01, end_s + 0.8, POLL_S)
        read_rad = np.tile(np.radians(POSE_DEG), (len(asked_s), 1))
        tick_s = np.floor((asked_s + EXCHANGE_S / 2 - self.lag_s) / CYCLE_S) * CYCLE_S
        read_rad[:, self.axis] = motion.at(tick_s)
        read_rad += 5e-6 * rng.standard_normal(read_rad.shape)
        answered_s = asked_s + EXCHANGE_S + self.late_s * rng.standard_exponential(len(asked_s))
        return SweepStream(
            123_456.0 + (1 + 25e-6) * taken_s,
            xyz_mm,
            900.0 + _windows(taken_s, asked_s),
            read_rad,
            900.0 + np.column_stack([asked_s, answered_s]),
            5_000.0 + (1 - 40e-6) * tick_s if self.stamped else np.full(len(tick_s), np.nan),
        )

    def seen_mm(self, joints_rad: Array, side: float, rng: np.random.Generator) -> Array:
        true_rad = joints_rad + 2e-4
        q = joints_rad[:, self.axis]
        smooth = 1.2e-4 * np.sin(q) + 6e-5 * np.cos(2 * q) + 3e-5 * np.sin(3 * q + 1.0)
        true_rad[:, self.axis] += smooth + self.ripple(q) + side * self.half_gap_rad
        at_mm = forward(bent(self.seed), true_rad)[:, :3, 3]
        at_mm += self.noise_mm * rng.standard_normal(at_mm.shape)
        keep = np.exp(-self.speed_deg_s / self.rate_hz)
        wander = np.zeros(at_mm.shape)
        for n in range(1, len(wander)) if self.wander_mm else ():
            fresh = np.sqrt(1 - keep**2) * rng.standard_normal(3)
            wander[n] = keep * wander[n - 1] + self.wander_mm * fresh
        return at_mm + wander


@dataclass(frozen=True)
class _Motion:
    begin_rad: float
    speed_rad_s: float
    end_s: float
    start_s: float = 0.3

    def at(self, time_s: Array) -> Array:
        """Return the angle: a trapezoid's ramps are short."""
        u = np.clip(time_s - self.start_s, 0.0, self.end_s - self.start_s)
        return self.begin_rad + self.speed_rad_s * (
            np.where(u < RAMP_S, u**2 / (2 * RAMP_S), u - RAMP_S / 2)
        )


def bent(seed: int) -> Arm:
    """Return a robot whose links are not the nominal ones."""
    rng = np.random.default_rng([seed, 7])
    return replace(
        ARM,
        a_mm=ARM.a_mm + 0.4 * rng.standard_normal(6),
        d_mm=ARM.d_mm + 0.4 * rng.standard_normal(6),
        alpha_rad=ARM.alpha_rad + 1e-4 * rng.standard_normal(6),
    )


def _windows(taken_s: Array, polls_s: Array) -> Array:
    """Return when each sample arrived at the latest and at the earliest, (N, 2)."""
    windows = np.zeros((len(taken_s), 2))
    first = packet = 0
    while first < len(taken_s):
        last = min(first + PACKETS[packet % 5], len(taken_s)) - 1
        sent_s = taken_s[last] + 0.005 + (0.06 if packet % 5 == 0 else 0.0)
        n = int(np.searchsorted(polls_s, sent_s))
        by_s = polls_s[n] if n < len(polls_s) else sent_s
        windows[first : last + 1] = polls_s[max(0, min(n, len(polls_s)) - 1)], by_s
        first, packet = last + 1, packet + 1
    return windows
