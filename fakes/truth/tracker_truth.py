"""The truth of the tracker: its place, the reflectors it finds, its readings, and the air.

Noise along the beam is a length, across it an angle. All positions are in the tracker's frame, mm.
The plant time between two measurements depends a little on the machine's speed, so slow drift and
air follow the number of measurements, each counted as 5 s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fakes.faults import Faults
from fakes.truth.machine import machine_of
from fakes.truth.noise import KeyedNoise
from fakes.truth.transforms import Array, carried, frame, inverse, rigid, rotation
from hilcell.cell.file import Cell

DRIFT_PERIOD_S = 4 * 3600.0
AIR_PERIOD_S = 3 * 3600.0
MEASUREMENT_S = 5.0

Scene = Callable[[], dict[str, Array]]  # reflectors (3,) by name


@dataclass(frozen=True, slots=True)
class Air:
    """The air at the tracker."""

    temperature_c: float
    pressure_mbar: float
    humidity_percent: float


@dataclass(frozen=True, slots=True)
class Measurement:
    """One stationary measurement: position (3,) and 1-sigma (3,), mm, tracker's frame."""

    xyz_mm: Array
    std_mm: Array


class TrackerTruth:
    """A tracker that sees reflectors given in {W}.

    It takes the faults ``tracker.drift_step``, ``tracker.scale_ppm``, ``tracker.nest_lifted``,
    ``tracker.noisy``, ``tracker.spike``, ``tracker.warmer``, ``tracker.wrong_offset`` and
    ``tracker.wrong_target`` itself; all others are the server's.
    """

    def __init__(
        self,
        cell: Cell,
        seed: int,
        faults: Faults,
        reflectors_in_world: Scene,
    ) -> None:
        rng = KeyedNoise(seed).generator("tracker")
        self._noise = KeyedNoise(seed, "tracker")
        self._faults, self._reflectors = faults, reflectors_in_world
        self._measured = 0
        self._range_mm = (cell.tracker.min_range_mm, cell.tracker.max_range_mm)
        machine = machine_of(cell)
        self._sizes = machine.tracker
        turn = machine.mounting.tracker_urad * 1e-6 * rng.standard_normal(3)
        placed = rigid(rotation(turn), machine.mounting.tracker_mm * rng.standard_normal(3))
        self.pose_in_world = frame(cell.tracker.pose) @ placed
        self._from_world = inverse(self.pose_in_world)
        self._drift = rng.standard_normal((2, 3)) * self._sizes.drift_mm
        self._air_phases: list[float] = rng.uniform(0.0, 2 * math.pi, 3).tolist()
        self._bump_mm, self._scale = np.zeros(3), 1.0
        self._lifted_mm: dict[str, float] = {}
        self._offset_mm = self._warmer_k = 0.0

    def reflectors(self) -> dict[str, Array]:
        """Return where every reflector is."""
        return {
            name: carried(self._from_world, at_mm) for name, at_mm in self._reflectors().items()
        }

    def reflector(self, name: str) -> Array | None:
        """Return where one reflector is, None where it is not to be seen."""
        at_mm = self._reflectors().get(name)
        return None if at_mm is None else carried(self._from_world, at_mm)

    def find(self, near_mm: Array, radius_mm: float) -> str | None:
        """Return the name of the reflector nearest to a point (3,), if within range and radius."""
        places = self._reflectors()
        if not places:
            return None
        at_mm = np.array([*places.values()]) @ self._from_world[:3, :3].T + self._from_world[:3, 3]
        off_mm = np.linalg.norm(at_mm - near_mm, axis=1)
        names = [*places]
        order: list[int] = off_mm.argsort(kind="stable").tolist()
        seen = (n for n in order if self._in_range(at_mm[n]))
        best, next_best = next(seen, None), next(seen, None)
        if next_best is not None and self._faults.take("tracker.wrong_target") is not None:
            return names[next_best]
        return names[best] if best is not None and off_mm[best] <= radius_mm else None

    def measure(self, name: str) -> Measurement | None:
        """Return one measurement of a reflector, or None where it is out of range."""
        at_mm = self.reflector(name)
        if at_mm is None or not self._in_range(at_mm):
            return None
        self._measured += 1
        std_mm = self._faults.number("tracker.noisy")
        self._bump_mm[0] += self._faults.number("tracker.drift_step") or 0.0
        self._scale += 1e-6 * (self._faults.number("tracker.scale_ppm") or 0.0)
        lifted_mm = self._faults.number("tracker.nest_lifted") or 0.0
        self._lifted_mm[name] = self._lifted_mm.get(name, 0.0) + lifted_mm
        at_mm = at_mm + self._lifted_mm[name] / math.sqrt(3.0)
        xyz_mm = self._scale * at_mm + self._bump_mm + self._slow_drift_mm()
        range_mm = _length(xyz_mm)
        along = xyz_mm / range_mm
        self._warmer_k += self._faults.number("tracker.warmer") or 0.0
        self._offset_mm += self._faults.number("tracker.wrong_offset") or 0.0
        xyz_mm = xyz_mm + self._offset_mm * along
        # Coarse: a slide that lands a few micrometres off meets the same noise.
        key = ",".join(f"{value / 10.0:.0f}" for value in xyz_mm.tolist())
        draws = self._noise.normal(key, 6)
        radial = draws[:3].dot(along) * along
        radial_mm = self._sizes.radial_um * 1e-3
        across_mm = self._sizes.across_um_m * 1e-6 * range_mm
        if std_mm is None:
            noise_mm = radial_mm * radial + across_mm * (draws[:3] - radial)
            sigma_mm = np.sqrt((radial_mm * along) ** 2 + across_mm**2 * (1 - along**2))
        else:
            noise_mm, sigma_mm = std_mm * draws[:3], np.full(3, std_mm / math.sqrt(3.0))
        xyz_mm = xyz_mm + noise_mm
        xyz_mm[2] += self._faults.number("tracker.spike") or 0.0
        return Measurement(xyz_mm, sigma_mm * (1.0 + 0.1 * np.tanh(draws[3:])))

    def read(self, at_world_mm: Array, draws: Array) -> Array:
        """Return single readings (M, 3) of positions (N, 3) in {W}, with unit noise (N, 3).

        M < N where one is out of range: the beam is lost there. Drift and air stand still.
        """
        at_mm = at_world_mm @ self._from_world[:3, :3].T + self._from_world[:3, 3]
        xyz_mm = self._scale * at_mm + self._bump_mm + self._slow_drift_mm()
        range_mm = np.linalg.norm(xyz_mm, axis=1)
        low_mm, high_mm = self._range_mm
        lost = np.flatnonzero(~((low_mm <= range_mm) & (range_mm <= high_mm)))
        along = xyz_mm / range_mm[:, None]
        radial = (draws * along).sum(axis=1, keepdims=True) * along
        across_mm = self._sizes.across_um_m * 1e-6 * range_mm[:, None]
        noise_mm = self._sizes.radial_um * 1e-3 * radial + across_mm * (draws - radial)
        found: Array = (xyz_mm + noise_mm)[: lost[0] if len(lost) else None]
        return found

    @property
    def warm_k(self) -> float:
        """How much warmer the room is now than its mean."""
        return self.air().temperature_c - self._sizes.room_c

    def air(self) -> Air:
        """Return the air now."""
        age = self._measured * MEASUREMENT_S / AIR_PERIOD_S
        waves = [math.sin(2 * math.pi * age + phase) for phase in self._air_phases]
        return Air(
            temperature_c=self._sizes.room_c + self._sizes.room_swing_k * waves[0] + self._warmer_k,
            pressure_mbar=1009.0 + 2.0 * waves[1],
            humidity_percent=45.0 + 4.0 * waves[2],
        )

    def _in_range(self, at_mm: Array) -> bool:
        return self._range_mm[0] <= _length(at_mm) <= self._range_mm[1]

    def _slow_drift_mm(self) -> Array:
        angle = 2 * math.pi * self._measured * MEASUREMENT_S / DRIFT_PERIOD_S
        drift: Array = self._drift[0] * math.sin(angle) + self._drift[1] * (1 - math.cos(angle))
        return drift


def _length(vector_mm: Array) -> float:
    """Return the length of a vector (3,)."""
    return math.sqrt(vector_mm.dot(vector_mm))
