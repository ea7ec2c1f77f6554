"""The truth of the tracker: its pose, the visible reflectors, its readings, and the air.

Noise along the beam is a length, across it an angle. Positions are in the tracker's frame, mm. Cell
time between two measurements depends slightly on the PC's speed, so slow drift and air follow the
number of measurements, each counted as 5 s.

A followed reflector is sampled by the tracker's own clock, with its own offset and drift. The truth
of a sample is the reflector's position at the sample's time, however late it is collected. Noise
follows the sample's number in its stream.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fakes.faults import Faults
from fakes.truth.machine import cell_machine
from fakes.truth.noise import KeyedNoise
from fakes.truth.robot_motion import RobotMotion
from fakes.truth.transforms import Array, frame, inverse, rigid, rotation, transform_point
from hilcell.cell.file import Cell
from hilcell.fit.measurements import read_measurements
from hilcell.ports import Air


class Measurement(NamedTuple):
    """Stationary measurements: position (..., 3) and 1-sigma (..., 3), mm, tracker's frame."""

    xyz_mm: Array
    std_mm: Array


class _MeasurementFaults(NamedTuple):
    offset_mm: float
    noisy_mm: float | None
    spike_mm: float


class TrackerTruth:
    """A tracker that measures reflectors given in {W}.

    It applies the faults ``tracker.drift_step``, ``tracker.scale_ppm``, ``tracker.nest_lifted``,
    ``tracker.noisy``, ``tracker.spike``, ``tracker.warmer``, ``tracker.wrong_offset``,
    ``tracker.wrong_target``, ``tracker.collimation``, ``tracker.transit``, ``tracker.index``,
    ``tracker.unadjusted``, ``tracker.warming`` and ``tracker.turning``; the server applies all
    others.
    """

    WARM_UP = 240  # measurements, a time constant of 20 min

    MEASUREMENT_S = 5.0
    URAD = 1e-6

    def __init__(
        self,
        cell: Cell,
        seed: int,
        faults: Faults,
        reflectors_in_world: Callable[[], dict[str, Array]],  # (3,) by name
        run_seed: int | None = None,
    ) -> None:
        rng = KeyedNoise(seed).generator("tracker")
        self._noise = KeyedNoise(seed, "tracker", run_seed)
        self._back = KeyedNoise(seed, "tracker's back", run_seed)
        self._faults, self._reflectors = faults, reflectors_in_world
        self.measured = 0  # number of measurements
        self._range_mm = (cell.tracker.min_range_mm, cell.tracker.max_range_mm)
        machine = cell_machine(cell)
        self._sizes = machine.tracker
        tilt_rad = machine.mounting.tracker_urad * 1e-6 * rng.standard_normal(3)
        placed = rigid(rotation(tilt_rad), machine.mounting.tracker_mm * rng.standard_normal(3))
        self.pose_in_world = frame(cell.tracker.pose) @ placed
        self._from_world = inverse(self.pose_in_world)
        self._drift = tuple(rng.standard_normal((2, 3)) * self._sizes.drift_mm)
        self._air_phases: list[float] = rng.uniform(0.0, 2 * math.pi, 3).tolist()
        self._bump_mm, self._scale = np.zeros(3), 1.0
        axes = KeyedNoise(seed).generator("tracker's axes")
        self._axes_rad = self._sizes.axes_urad * self.URAD * axes.standard_normal(3)
        self._turning_rad, self._turning_since = 0.0, 0  # of 1000 measurements; their number
        self._warming_rad, self._warming_since = 0.0, 0
        self._unadjusted_rad = 0.0
        self._lifted_mm: dict[str, float] = {}
        self._offset_mm = self._warmer_k = 0.0

    def reflectors(self) -> dict[str, Array]:
        return {
            name: transform_point(self._from_world, at_mm)
            for name, at_mm in self._reflectors().items()
        }

    def reflector(self, name: str) -> Array | None:
        """Return the position (3,) of a reflector, None where it is not visible."""
        at_mm = self._reflectors().get(name)
        return None if at_mm is None else transform_point(self._from_world, at_mm)

    def find(self, near_mm: Array, radius_mm: float) -> str | None:
        """Return the name of the reflector nearest to a point (3,), if within range and radius."""
        places, near = self._reflectors(), transform_point(self.pose_in_world, near_mm).tolist()
        off_mm = {name: math.dist(at_mm.tolist(), near) for name, at_mm in places.items()}
        order = sorted(off_mm, key=off_mm.__getitem__)
        to_tracker = partial(transform_point, self._from_world)
        in_range = (name for name in order if self._in_range(to_tracker(places[name])))
        best, next_best = next(in_range, None), next(in_range, None)
        if next_best is not None and self._faults.strikes("tracker.wrong_target"):
            return next_best
        return best if best is not None and off_mm[best] <= radius_mm else None

    def measure(self, name: str, *, back: bool = False) -> Measurement | None:
        """Return one measurement of a reflector, or None where it is out of range."""
        one = self.measurements(name, 1, back=back)
        return None if one is None else Measurement(one.xyz_mm[0], one.std_mm[0])

    def measurements(self, name: str, count: int, *, back: bool = False) -> Measurement | None:
        """Return consecutive measurements, (N, 3) each, or None where one is out of range.

        Those in the second face, ``back``, have separate noise and do not advance the drift: they
        do not change the others.
        """
        faults: dict[int, _MeasurementFaults] = {}  # by row
        xyz_mm = np.empty((count, 3))
        for row in range(count):
            at_mm = self.reflector(name)
            if at_mm is None or not self._in_range(at_mm):
                return None
            self.measured += not back
            if back:
                faults[row] = _MeasurementFaults(self._offset_mm, None, 0.0)
            elif self._faults.any_armed or self._offset_mm or self._unadjusted_rad:
                faults[row] = self._apply_faults(name)
            if name in self._lifted_mm:
                at_mm = at_mm + self._lifted_mm[name] / math.sqrt(3.0)
            xyz_mm[row] = self._scale * at_mm + self._bump_mm + self._slow_drift_mm()
        xyz_mm = self._sighted(xyz_mm, back=back)
        range_mm = np.sqrt(np.vecdot(xyz_mm, xyz_mm))[:, None]
        along = xyz_mm / range_mm
        for row, fault in faults.items():
            xyz_mm[row] += fault.offset_mm * along[row]
        noise = self._back if back else self._noise
        # Rounded, so that the slide's landing noise does not change the keys.
        keys = [",".join(f"{value / 10.0:.0f}" for value in each) for each in xyz_mm.tolist()]
        draws = np.array([noise.normal(key, 6) for key in keys])
        draws, std_draws = draws[:, :3], draws[:, 3:]
        radial_mm, across_mm = self._sigma_mm(range_mm)
        radial = np.vecdot(draws, along)[:, None] * along
        noise_mm = radial_mm * radial + across_mm * (draws - radial)
        sigma_mm = np.sqrt((radial_mm * along) ** 2 + across_mm**2 * (1 - along**2))
        for row, fault in faults.items():
            if fault.noisy_mm is not None:
                noise_mm[row] = fault.noisy_mm * draws[row]
                sigma_mm[row] = fault.noisy_mm / math.sqrt(3.0)
        xyz_mm += noise_mm
        for row, fault in faults.items():
            xyz_mm[row, 2] += fault.spike_mm
        return Measurement(xyz_mm, sigma_mm * (1.0 + 0.1 * np.tanh(std_draws)))

    def read(self, at_world_mm: Array, draws: Array) -> Array:
        """Return single readings (M, 3) of positions (N, 3) in {W}, with unit noise (N, 3).

        M < N where one is out of range: there the beam is lost. Drift and air do not advance.
        """
        at_mm = at_world_mm @ self._from_world[:3, :3].T + self._from_world[:3, 3]
        xyz_mm = self._sighted(self._scale * at_mm + self._bump_mm + self._slow_drift_mm())
        range_mm = np.linalg.norm(xyz_mm, axis=1)
        low_mm, high_mm = self._range_mm
        lost = np.flatnonzero(~((low_mm <= range_mm) & (range_mm <= high_mm)))
        along = xyz_mm / range_mm[:, None]
        radial = (draws * along).sum(axis=1, keepdims=True) * along
        radial_mm, across_mm = self._sigma_mm(range_mm[:, None])
        noise_mm = radial_mm * radial + across_mm * (draws - radial)
        readings_mm: Array = (xyz_mm + noise_mm)[: lost[0] if len(lost) else None]
        return readings_mm

    @property
    def warm_k(self) -> float:
        """Present deviation of the ambient temperature from its mean."""
        return self._temperature_c() - self._sizes.room_c

    def air(self) -> Air:
        return Air(
            temperature_c=self._temperature_c(),
            pressure_mbar=1009.0 + 2.0 * self._air_wave(1),
            humidity_percent=45.0 + 4.0 * self._air_wave(2),
        )

    def _temperature_c(self) -> float:
        swing_k = self._sizes.room_swing_k * self._air_wave(0)
        return self._sizes.room_c + swing_k + self._warmer_k

    def _air_wave(self, number: int) -> float:
        air_period_s = 3 * 3600.0
        age = self.measured * self.MEASUREMENT_S / air_period_s
        return math.sin(2 * math.pi * age + self._air_phases[number])

    def _apply_faults(self, name: str) -> _MeasurementFaults:
        number, amount = self._faults.number, self._faults.amount
        noisy_mm = number("tracker.noisy")
        self._bump_mm[0] += amount("tracker.drift_step")
        self._scale += 1e-6 * amount("tracker.scale_ppm")
        lifted_mm = amount("tracker.nest_lifted")
        self._lifted_mm[name] = self._lifted_mm.get(name, 0.0) + lifted_mm
        self._warmer_k += amount("tracker.warmer")
        self._offset_mm += amount("tracker.wrong_offset")
        for axis, fault in enumerate(("tracker.collimation", "tracker.transit", "tracker.index")):
            self._axes_rad[axis] += self.URAD * amount(fault)
        self._unadjusted_rad = self.URAD * amount("tracker.unadjusted")
        if (warming := number("tracker.warming")) is not None:
            self._warming_rad, self._warming_since = self.URAD * warming, self.measured
        if (turning := number("tracker.turning")) is not None:
            self._turning_rad, self._turning_since = self.URAD * turning, self.measured
        return _MeasurementFaults(self._offset_mm, noisy_mm, amount("tracker.spike"))

    def _sighted(self, xyz_mm: Array, *, back: bool = False) -> Array:
        """Return positions (N, 3) with the errors of the tracker's axes and its rotation drift.

        In the second face the errors of the axes have the opposite sign.
        """
        x, y, z = xyz_mm.T
        flat_mm, range_mm = np.hypot(x, y), np.sqrt(np.vecdot(xyz_mm, xyz_mm))
        around, down = np.zeros_like(xyz_mm), np.empty_like(xyz_mm)
        around[:, 0], around[:, 1] = -y, x
        down[:, 0], down[:, 1], down[:, 2] = x * z, y * z, -(flat_mm**2)
        down /= range_mm[:, None]
        axes_rad = self._axes_rad + self._unadjusted_rad
        collimation, transit, index = -axes_rad if back else axes_rad
        warm = 1.0 - math.exp((self._warming_since - self.measured) / self.WARM_UP)
        drift_rad = self._turning_rad * (self.measured - self._turning_since) / 1000.0
        drift_rad += self._warming_rad * warm
        across = (collimation * range_mm + transit * z) / flat_mm + drift_rad
        sighted_mm: Array = xyz_mm + across[:, None] * around
        sighted_mm += (index * range_mm / flat_mm)[:, None] * down
        return sighted_mm

    def _sigma_mm(self, range_mm: Array) -> tuple[float, Array]:
        return self._sizes.radial_um * 1e-3, self._sizes.across_um_m * 1e-6 * range_mm

    def _in_range(self, at_mm: Array) -> bool:
        return self._range_mm[0] <= math.sqrt(at_mm.dot(at_mm)) <= self._range_mm[1]

    def _slow_drift_mm(self) -> Array:
        drift_period_s = 4 * 3600.0
        angle = 2 * math.pi * self.measured * self.MEASUREMENT_S / drift_period_s
        there, back = self._drift
        drift: Array = there * math.sin(angle) + back * (1 - math.cos(angle))
        return drift


class ReplayTracker:
    """Measures the reflectors recorded for the robot's present pose."""

    def __init__(self, data: Path, robot: RobotMotion) -> None:
        self._rows = read_measurements(data)
        self._robot = robot

    def reflectors(self) -> dict[str, Array]:
        state = self._robot.state()
        if state.moving:
            return {}
        off_rad = np.abs(self._rows.joints_rad - state.joints_rad).max(axis=1)
        same_pose_rad = 2e-5  # joints are sent as decimals
        here = np.flatnonzero(off_rad <= same_pose_rad)
        return {self._rows.target[row]: self._rows.xyz_mm[row] for row in here}

    def reflector(self, name: str) -> Array | None:
        return self.reflectors().get(name)

    def find(self, near_mm: Array, radius_mm: float) -> str | None:
        """Return the reflector nearest to a point (3,) within the radius."""
        off_mm = {
            name: float(np.linalg.norm(at_mm - near_mm))
            for name, at_mm in self.reflectors().items()
        }
        best = min(off_mm, key=off_mm.__getitem__, default=None)
        return best if best is not None and off_mm[best] <= radius_mm else None

    def measure(self, name: str, *, back: bool = False) -> Measurement | None:
        at_mm = self.reflector(name)
        std_mm = 0.005  # the data contain no standard deviations
        return None if at_mm is None else Measurement(at_mm, np.full(3, std_mm))

    def air(self) -> Air:
        return Air(temperature_c=20.0, pressure_mbar=1013.25, humidity_percent=50.0)


class Followed(NamedTuple):
    """A reflector that is followed until `end`."""

    read: Callable[[Array], Array]  # device times (N,) -> readings (M, 3)
    end: Callable[[], None]


class StreamTruth:
    """The streams of one tracker."""

    def __init__(
        self,
        seed: int,
        robot: RobotMotion,
        tracker: TrackerTruth,
        path_in_world: Callable[[str, Array], Array],  # name, times (N,) -> (N, 3)
        run_seed: int | None,
    ) -> None:
        self._robot, self._tracker, self._path = robot, tracker, path_in_world
        self._noise = KeyedNoise(seed, "stream", run_seed)
        clock = KeyedNoise(seed).generator("tracker clock")
        power_on_s = (2_000.0, 400_000.0)  # since when the tracker is on
        self.offset_s = float(clock.uniform(*power_on_s))
        drift_ppm = 30.0
        self.drift = drift_ppm * 1e-6 * float(clock.uniform(-1.0, 1.0))

    def device_s(self, time_s: float) -> float:
        return self.offset_s + (1.0 + self.drift) * time_s

    def follow(self, name: str) -> Followed:
        """Follow a reflector. ``read`` takes device times (N,), returns readings (M, 3).

        M < N where the beam is lost; each time must be read once, in order.
        """
        noise = self._noise.next_generator(name)

        def read(device_s: Array) -> Array:
            cell_s: Array = (device_s - self.offset_s) / (1.0 + self.drift)
            at_mm = self._path(name, cell_s)
            draws = noise.standard_normal((len(device_s), 3))
            return self._tracker.read(at_mm, draws[: len(at_mm)])

        self._robot.record(on=True)
        return Followed(read, lambda: self._robot.record(on=False))
