"""Errors of the joints against their command: gravity, harmonics, gear ripple, elasticity.

All depend on the joint angles alone. Loads follow from how the links lie against gravity, not from
the angles as the maker counts them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fakes.truth.machine import Errors, Transmission
from fakes.truth.screws import Chain
from fakes.truth.transforms import Array

URAD = 1e-6

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Slopes:
    """The angles of upper arm and forearm against the horizontal at joints zero."""

    upper_rad: float
    fore_rad: float

    def angles(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return the angles (...) of upper arm and forearm at joints (..., 6)."""
        upper = joints_rad[..., 1]
        return upper + self.upper_rad, upper + joints_rad[..., 2] + self.fore_rad


def slopes(design: Chain) -> Slopes:
    """Return the slopes of an arm whose axes 2 and 3 are level, parallel and turn alike."""
    shoulder_mm, elbow_mm, wrist_mm = design.points_mm[[1, 2, 4]]
    axis = design.axes[1]
    ahead = np.cross(axis, UP)
    links_mm = (elbow_mm - shoulder_mm, wrist_mm - elbow_mm)
    upper, fore = (np.arctan2(axis @ np.cross(ahead, link), ahead @ link) for link in links_mm)
    return Slopes(float(upper), float(fore))


class Ripple:
    """Gear ripple of six joints: one to three harmonics each, whose size may follow the load."""

    def __init__(self, sizes: Transmission, rng: np.random.Generator) -> None:
        most_harmonics = 3
        amplitude, cycles = np.zeros((6, most_harmonics + 1)), np.ones((6, most_harmonics + 1))
        for joint in range(6):
            pins = rng.integers(*sizes.pins, endpoint=True)
            ratio = rng.integers(*sizes.ratios, endpoint=True)
            count = int(rng.integers(1, most_harmonics + 1))
            listed = rng.permutation([pins, 2 * pins, ratio, 2 * ratio])[:count]
            share = rng.uniform(0.3, 1.0, count)
            cycles[joint, :count] = listed
            amplitude[joint, :count] = sizes.ripple_urad * URAD * share / np.linalg.norm(share)
        amplitude[:, -1] = sizes.unlisted_urad * URAD
        unlisted_cycles = (52.0, 149.0)  # between pins and ratios, never a whole number
        cycles[:, -1] = rng.uniform(*unlisted_cycles, 6)
        self.amplitude_rad, self.cycles = amplitude, cycles
        self.phase_rad = rng.uniform(0.0, 2 * np.pi, amplitude.shape)

    def __call__(self, joints_rad: Array) -> Array:
        """Return the ripple (..., 6) at joints (..., 6)."""
        waves = np.sin(self.cycles * joints_rad[..., None] + self.phase_rad)
        ripple: Array = (self.amplitude_rad * waves).sum(axis=-1)
        return ripple


class Loads:
    """How heavily each joint is loaded, -1 to 1: by the level lever of the reflector about it.

    The ends of that range are the lightest and the heaviest load over the poses given.
    """

    def __init__(self, design: Chain, poses_rad: Array) -> None:
        self._design = design
        levers_mm = self._levers_mm(poses_rad)
        low, high = levers_mm.min(axis=0), levers_mm.max(axis=0)
        least_mm = 1.0  # a lever that changes by less counts as one that does not change
        self._middle_mm, self._half_mm = (low + high) / 2, np.maximum((high - low) / 2, least_mm)

    def __call__(self, joints_rad: Array) -> Array:
        """Return the loads (..., 6) at joints (..., 6)."""
        loads: Array = (self._levers_mm(joints_rad) - self._middle_mm) / self._half_mm
        return np.clip(loads, -1.0, 1.0)

    def _levers_mm(self, joints_rad: Array) -> Array:
        levers: Array = np.linalg.norm(self._design.levers(joints_rad)[..., :2], axis=-1)
        return levers


@dataclass(frozen=True, slots=True)
class Deflection:
    """Gravity (6,), harmonics (6, 2 n: cosines and sines) and elasticity, as drawn."""

    gravity_rad: Array
    harmonics_rad: Array
    elastic_rad: float

    @classmethod
    def drawn(cls, sizes: Errors, rng: np.random.Generator) -> Deflection:
        """Draw one arm's; gravity mostly pulls down."""
        main = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0])
        gravity = main * rng.uniform(0.5, 1.5, 6) * sizes.gravity_urad
        gravity += (1.0 - main) * rng.standard_normal(6) * sizes.gravity_side_urad
        waves = np.repeat(sizes.harmonics_urad, 2)
        harmonics = rng.standard_normal((6, len(waves))) * waves
        elastic = sizes.elastic_urad * float(rng.uniform(0.5, 1.5))
        return cls(gravity * URAD, harmonics * URAD, elastic * URAD)

    def scaled(self, factor: float) -> Deflection:
        """Return the same, larger by a factor."""
        return Deflection(
            self.gravity_rad * factor, self.harmonics_rad * factor, self.elastic_rad * factor
        )

    def __call__(self, joints_rad: Array, slopes: Slopes) -> Array:
        """Return the deflection (..., 6) at joints (..., 6)."""
        orders = np.arange(1, self.harmonics_rad.shape[1] // 2 + 1)
        angles = joints_rad[..., None] * orders
        waves = np.empty((*angles.shape, 2))
        np.cos(angles, out=waves[..., 0])
        np.sin(angles, out=waves[..., 1])
        bent: Array = (self.harmonics_rad * waves.reshape(*joints_rad.shape, -1)).sum(axis=-1)
        g = self.gravity_rad
        upper, fore = slopes.angles(joints_rad)
        level, fore_level, fore_sine = np.cos(upper), np.cos(fore), np.sin(fore)
        second = bent[..., 1] + (g[0] * level + g[1] * np.sin(upper))
        second = second + (g[2] * fore_level + g[3] * fore_sine)
        bent[..., 1] = second + self.elastic_rad * level * fore_level
        bent[..., 2] += g[4] * fore_level + g[5] * fore_sine
        return bent
