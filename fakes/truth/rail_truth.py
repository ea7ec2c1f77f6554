"""The truth of the rail: motor, slide and strip; the slide's true position and tilt.

The motor reaches its commanded position. The slide follows it through backlash, along the error
curve of Fig 1, and lands with noise that grows with the length of the move. The strip reads the
slide; the motor's encoder shows none of this.
"""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

import numpy as np

from fakes.faults import Faults
from fakes.time import CellTime
from fakes.truth.machine import Machine, cell_machine
from fakes.truth.motion_record import MotionRecord, Travel
from fakes.truth.noise import KeyedNoise
from fakes.truth.robot_motion import Path
from fakes.truth.transforms import Array, frame, rotation
from hilcell.cell.file import Cell


class SmoothCurve:
    """A random Fourier series, zero at position 0, with about the given standard deviation."""

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
        total = -self._zero
        for weight, rate, phase in self._terms:
            total += weight * math.sin(rate * position_mm + phase)
        return total


class RailState(NamedTuple):
    """The rail at one poll: encoder, strip and switches; unquantised."""

    encoder_mm: float
    velocity_mm_s: float
    strip_mm: float
    moving: bool
    at_negative_limit: bool
    at_positive_limit: bool


class RailTruth:
    """The rail of one simulated cell; safe to use from several threads.

    It applies the faults ``rail.backlash``, ``rail.slip``, ``rail.pushed`` and
    ``rail.reference_lost``; the servers apply all others.
    """

    SWITCH_MM = 1.0  # distance of the limit switches from the travel
    STOP_MM = 0.5  # distance behind them at which the slide stops
    HOMING_MM_S2 = 200.0

    def __init__(
        self, cell: Cell, seed: int, time: CellTime, faults: Faults, run_seed: int | None = None
    ) -> None:
        self._lock = threading.RLock()
        self._time, self._faults = time, faults
        self._noise = KeyedNoise(seed, "rail", run_seed)
        machine = cell_machine(cell)
        self._sizes = machine.rail
        self._shape = _Shape(cell, machine, KeyedNoise(seed).generator("rail"))
        self._low_mm = cell.rail.travel_min_mm - self.SWITCH_MM
        self._high_mm = cell.rail.travel_max_mm + self.SWITCH_MM

        self._backlash_mm = self._shape.backlash_mm
        self._slip_mm = 0.0
        self._braked = True
        self._homing, self._homed_reads_mm = False, 0.0  # of the encoder, where it has homed
        power_on_mm = machine.rail.power_on_mm
        self._zero_mm = power_on_mm  # of the motor: its encoder reads 0 at power-on
        self._play_mm = power_on_mm  # slide behind the backlash, in the motor's coordinate
        self._landing_mm = (0.0, 0.0)  # at the start and at the end of the motion
        self._path = Path(time.now_s(), power_on_mm)
        self._rest_position: tuple[Path, float] | None = None  # of the slide, after a path
        self._followed_s = time.now_s()
        self._record = MotionRecord(np.array([power_on_mm]))

    def move(self, target_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> None:
        """Start for ``target_mm`` of the encoder, after braking a motion in progress.

        Does nothing while the brake is closed. Beyond a limit switch the slide stops behind it.
        """
        with self._lock:
            if self._braked:
                return
            self._homing = False
            low_mm, high_mm = self._low_mm - self.STOP_MM, self._high_mm + self.STOP_MM
            limited_mm = min(max(target_mm + self._zero_mm, low_mm), high_mm)
            path = self._fresh_path().brake(acceleration_mm_s2)
            distance_mm = abs(limited_mm - path.end)
            path.travel(limited_mm, speed_mm_s, acceleration_mm_s2)
            self._start(path, f"{target_mm:.3f}", distance_mm)

    def quick_stop(self, deceleration_mm_s2: float) -> None:
        with self._lock:
            self._homing = False
            before_mm = self._landing(self._time.now_s())
            self._begin(self._fresh_path().brake(deceleration_mm_s2))
            self._landing_mm = (before_mm, before_mm)

    def home(self, speed_mm_s: float, *, upper: bool = False, reads_mm: float = 0.0) -> None:
        """Move to the lower or the ``upper`` limit switch and back off it.

        There the encoder reads ``reads_mm``.
        """
        back_off_mm_s = 10.0
        with self._lock:
            if self._braked:
                return
            end_mm, out = (self._high_mm, 1) if upper else (self._low_mm, -1)
            a = self.HOMING_MM_S2
            path = self._fresh_path().brake(a).travel(end_mm + out * self.STOP_MM, speed_mm_s, a)
            path.travel(end_mm - out * self.SWITCH_MM, back_off_mm_s, a)
            self._home_along(path, reads_mm)

    def home_to_index(
        self, speed_mm_s: float, turn_mm: float, *, upwards: bool = False, reads_mm: float = 0.0
    ) -> None:
        """Move to the next index pulse below, or above: there the encoder reads ``reads_mm``."""
        with self._lock:
            if self._braked:
                return
            path = self._fresh_path().brake(self.HOMING_MM_S2)
            turns = path.end / turn_mm
            turn = math.floor(turns) + 1 if upwards else math.ceil(turns) - 1
            path.travel(turn * turn_mm, speed_mm_s, self.HOMING_MM_S2)
            self._home_along(path, reads_mm)

    def _home_along(self, path: Path, reads_mm: float) -> None:
        self._start(path, "home", self.SWITCH_MM)
        self._homing, self._homed_reads_mm = True, reads_mm

    def master(self, reads_mm: float | None = None) -> None:
        """Let the encoder read ``reads_mm`` here; None: the motor's true position."""
        with self._lock:
            here_mm = self._path.at(self._time.now_s())[0]
            self._zero_mm = 0.0 if reads_mm is None else here_mm - reads_mm

    def brake(self, closed: bool) -> None:
        brake_mm_s2 = 5000.0
        with self._lock:
            self._braked = closed
            if closed:
                self.quick_stop(brake_mm_s2)

    def poll(self) -> RailState:
        """Return the state now; in stepped time each poll advances a motion by a third."""
        with self._lock:
            now_s = self._time.poll(self._path.start_s, self._path.end_s)
            self._follow(now_s)
            self._apply_faults(now_s)
            motor_mm, velocity_mm_s = self._path.at(now_s)
            encoder_mm = motor_mm - self._zero_mm
            strip_mm = self._shape.strip_mm(self._slide_mm(now_s))
            return RailState(
                encoder_mm=encoder_mm,
                velocity_mm_s=velocity_mm_s,
                strip_mm=strip_mm if self._sizes.strip else encoder_mm,
                moving=now_s < self._path.end_s,
                at_negative_limit=motor_mm <= self._low_mm,
                at_positive_limit=motor_mm >= self._high_mm,
            )

    @property
    def at_rest(self) -> bool:
        """Whether the slide is at rest; no time passes."""
        return self._time.now_s() >= self._path.end_s

    @property
    def motion_ends_s(self) -> float:
        return self._path.end_s

    def travel(self) -> Travel:
        """Return the travel (1,) of the slide, in mm, since the last call; no time passes.

        The slide behind its backlash, in the motor's coordinate: without the error curve.
        """
        with self._lock:
            self._follow(self._time.now_s())
            return self._record.take(np.array([self._play_mm]))

    def slide_mm(self) -> float:
        """Return the slide's true position along the rail; no time passes."""
        with self._lock:
            now_s = self._time.now_s()
            self._follow(now_s)
            return self._slide_mm(now_s)

    def slide_pose(self) -> Array:
        """Return {S} in {W}, (4, 4): the true frame of the cell file's nominal {B}."""
        return self._shape.pose(self.slide_mm())

    def _apply_faults(self, now_s: float) -> None:
        self._zero_mm -= self._faults.amount("rail.reference_lost")
        if self._braked and now_s >= self._path.end_s:
            pushed_mm = self._faults.amount("rail.pushed")
            if pushed_mm:
                self._path = Path(now_s, self._path.at(now_s)[0] + pushed_mm)
                self._play_mm += pushed_mm

    def _fresh_path(self) -> Path:
        now_s = self._time.now_s()
        self._follow(now_s)
        return Path(now_s, *self._path.at(now_s))

    def _start(self, path: Path, key: str, distance_mm: float) -> None:
        self._backlash_mm += self._faults.amount("rail.backlash")
        self._slip_mm += self._faults.amount("rail.slip")
        long_move_mm = 100.0  # shorter moves land with less noise
        share = min(1.0, distance_mm / long_move_mm)
        long_mm, short_mm = self._sizes.landing_mm, self._sizes.short_landing_mm
        sigma_mm = short_mm + share * (long_mm - short_mm)
        lands_mm = sigma_mm * float(self._noise.normal(key, 1)[0])
        self._landing_mm = (self._landing(path.start_s), lands_mm)
        self._begin(path)

    def _begin(self, path: Path) -> None:
        self._path = path
        self._record.begin(np.array([path.fastest]))

    def _landing(self, now_s: float) -> float:
        before_mm, after_mm = self._landing_mm
        duration_s = self._path.end_s - self._path.start_s
        share = (now_s - self._path.start_s) / duration_s if duration_s > 0 else 1.0
        return before_mm + min(1.0, share) * (after_mm - before_mm)

    def _follow(self, now_s: float) -> None:
        """Drag the slide behind the motor up to ``now_s``, through every reversal of the path."""
        if self._rest_position is not None and self._rest_position[0] is self._path:
            self._followed_s = now_s
            return
        path = self._path
        moving_s = min(now_s, path.end_s) - max(self._followed_s, path.start_s)
        for motor_mm in (*path.corners(self._followed_s, now_s), path.at(now_s)[0]):
            self._play_mm = min(max(self._play_mm, motor_mm), motor_mm + self._backlash_mm)
            self._record.add(np.array([self._play_mm]), 0.0)
        self._record.add(np.array([self._play_mm]), max(0.0, moving_s))
        self._followed_s = now_s
        if self._homing and now_s >= self._path.end_s:
            self._homing = False
            self._zero_mm = self._path.end - self._homed_reads_mm

    def _slide_mm(self, now_s: float) -> float:
        if self._rest_position is not None and self._rest_position[0] is self._path:
            return self._rest_position[1]
        motor_mm = self._path.at(now_s)[0]
        behind = (self._play_mm - motor_mm) / self._backlash_mm
        error_mm = self._shape.error_mm(self._play_mm, behind)
        slide_mm = self._play_mm + error_mm + self._landing(now_s) + self._slip_mm
        if now_s >= self._path.end_s:
            self._rest_position = (self._path, slide_mm)
        return slide_mm


class FloorTruth:
    """Replaces `RailTruth` for a robot on the floor: a slide that is always at 0."""

    def __init__(self, cell: Cell) -> None:
        self._pose = frame(cell.layout.base)

    def slide_mm(self) -> float:
        return 0.0

    def slide_pose(self) -> Array:
        """Return the cell file's nominal {B} in {W}, (4, 4)."""
        return self._pose.copy()


class _Shape:
    """Properties that depend on the seed alone: error curves, straightness, tilt, strip."""

    def __init__(self, cell: Cell, machine: Machine, rng: np.random.Generator) -> None:
        sizes = self._sizes = machine.rail
        backlash_spread = 0.02
        spread = 1.0 + backlash_spread * float(rng.standard_normal())
        self.backlash_mm = sizes.backlash_mm * spread
        self._curve = SmoothCurve(rng, 1.0, 2 * sizes.curve_span_mm, 3)
        self._direction_curve = SmoothCurve(rng, sizes.ways_mm, 1500.0, 2)
        self._strip_long = SmoothCurve(rng, sizes.strip_long_mm, 4000.0, 3)
        self._pole_phase = float(rng.uniform(0.0, 2 * math.pi))
        self._straight = [SmoothCurve(rng, sizes.straightness_mm, 3500.0) for _ in range(2)]
        self._lean = [SmoothCurve(rng, sizes.lean_urad * 1e-6, 3500.0) for _ in range(3)]
        self._base = frame(cell.layout.base)
        self._tilt = rotation(sizes.tilt_urad * 1e-6 * rng.standard_normal(3))
        self._along = self._tilt @ np.array(cell.layout.rail_direction)
        self._across = np.linalg.svd(self._along[None])[2][1:]
        self._share = 1.0
        arm = machine.chain(cell.robot.smr_mm)
        parked_rad = arm.commands(np.radians(machine.reference.parked_deg))
        flange_mm = arm.pose(parked_rad)[:3, 3]
        self._share = self._share_as_surveyed(self._base[:3, :3] @ flange_mm)

    def _share_as_surveyed(self, lever_mm: Array) -> float:
        """Return the factor that scales the survey of Fig 1 to its largest error.

        The survey was made at the flange of a parked robot, so it contains the slide's tilt times
        the lever arm (3,). The factor is limited, for the two may cancel.
        """
        largest_mm = self._sizes.curve_mm
        positions_mm = np.linspace(0.0, self._sizes.curve_span_mm, 201).tolist()
        own_mm = largest_mm * np.array([self._curve(s) for s in positions_mm])
        leans_rad = np.array([self._lean_rad(s) for s in positions_mm])
        surveyed_mm = own_mm + np.vecdot(np.cross(leans_rad, lever_mm), self._along)
        largest_share = 1.5
        return min(largest_share, largest_mm / float(np.abs(surveyed_mm).max()))

    def _lean_rad(self, slide_mm: float) -> Array:
        return self._share * np.array([curve(slide_mm) for curve in self._lean])

    def error_mm(self, play_mm: float, behind: float) -> float:
        """Return Fig 1's error; ``behind`` is 0 when moving up, 1 when moving down."""
        along_mm = self._share * self._sizes.curve_mm * self._curve(play_mm)
        return along_mm + behind * self._direction_curve(play_mm)

    def strip_mm(self, slide_mm: float) -> float:
        """Return the strip's reading, unquantised."""
        pole_pitch_mm = 5.0
        pole = math.sin(2 * math.pi * slide_mm / pole_pitch_mm + self._pole_phase)
        return slide_mm + self._strip_long(slide_mm) + self._sizes.strip_pole_mm * pole

    def pose(self, slide_mm: float) -> Array:
        """Return {S} in {W}, (4, 4)."""
        T = self._base.copy()
        T[:3, :3] = rotation(self._lean_rad(slide_mm)) @ self._tilt @ T[:3, :3]
        T[:3, 3] += slide_mm * self._along
        for curve, direction in zip(self._straight, self._across, strict=True):
            T[:3, 3] += curve(slide_mm) * direction
        return T
