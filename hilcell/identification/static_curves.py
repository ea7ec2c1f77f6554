"""Smooth errors of joints that were not swept, as far as static poses show them.

Each is a Gaussian process of the joint's angle, as that of a sweep. Their sizes and the noise are
those of greatest marginal likelihood; the length, which few poses tell, is given. Curves of no
amplitude with that prior are handed to the identification.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array
from hilcell.identification.estimate import Estimate
from hilcell.identification.kinematics import TransmissionCurve
from hilcell.identification.smooth_error import HIGHEST, Matern

LENGTH_RAD = 0.12
TYPICAL_RAD = 30e-6  # size of such an error, and what few data lean on


@dataclass(frozen=True, eq=False)
class _Process:
    """One axis's waves, and the motion of the readings (N, 2K) by each of unit size."""

    axis: int
    cycles: Array
    sigma: Array  # (2K,) of unit size
    moved: Array

    @classmethod
    def of(cls, estimate: Estimate, axis: int) -> _Process:
        angle = estimate.kinematics.arm.angles(estimate.readings.joints_rad)[:, axis]
        spacing = np.pi / max(float(np.ptp(angle)), 1e-9)  # it repeats after two ranges
        cycles = np.arange(spacing, HIGHEST, spacing)
        sigma = np.repeat(Matern(1.0, LENGTH_RAD).sigma_rad(cycles), 2)
        waves = _curve(axis, cycles, sigma, angle).basis(angle) * sigma
        known = estimate.system.known[..., None]
        levers = np.where(known, estimate.system.by_joint[..., axis], 0.0)
        moved = levers.reshape(len(angle), -1, 1) * waves[:, None]
        return cls(axis, cycles, sigma, moved.reshape(-1, len(sigma)))


def _curve(axis: int, cycles: Array, sigma_rad: Array, angle_rad: Array) -> TransmissionCurve:
    none = np.zeros((len(cycles), 2))
    low, high = float(angle_rad.min()), float(angle_rad.max())
    return TransmissionCurve(axis, cycles, none, np.diag(sigma_rad**2), 0.0, 0.0, low, high, 0.0)


def static_curves(estimate: Estimate, axes: Iterable[int]) -> tuple[TransmissionCurve, ...]:
    """Return curves of ``axes``, to be identified, that move far enough to have a wave."""
    angles = estimate.kinematics.arm.angles(estimate.readings.joints_rad)
    least_rad = 2.0 * np.pi / HIGHEST
    moving = [axis for axis in axes if np.ptp(angles[:, axis]) > least_rad]
    processes = [_Process.of(estimate, axis) for axis in moving]
    return tuple(
        _curve(each.axis, each.cycles, size_rad * each.sigma, angles[:, each.axis])
        for each, size_rad in zip(processes, _sizes_rad(estimate, processes), strict=True)
    )


def _sizes_rad(estimate: Estimate, processes: list[_Process]) -> Array:
    """Return the most probable sizes (J,) by steps of the MM algorithm, as those of the noise."""
    kinematics, system, readings = estimate.kinematics, estimate.system, estimate.readings
    mean, prior = kinematics.prior
    count, rows, size = system.design.shape
    design = system.design.reshape(-1, size)
    residual = system.residual_mm.ravel() - design @ (mean - kinematics.flat(estimate.state))
    by_parameters = design @ prior @ design.T
    noise, sizes = estimate.noise, np.full(len(processes), TYPICAL_RAD)
    doubt = 4.0  # coefficients that the typical size counts for
    for _ in range(12):
        K = by_parameters.copy()
        blocks = noise.covariance(system.by_joint, readings.covariance_mm2, system.known)
        for pose, block in enumerate(blocks):
            at = slice(pose * rows, (pose + 1) * rows)
            K[at, at] += block
        for process, size_rad in zip(processes, sizes, strict=True):
            K += size_rad**2 * process.moved @ process.moved.T
        P: Array = np.asarray(np.linalg.inv(K), dtype=float)
        weighted = P @ residual
        own = np.arange(count * rows).reshape(count, rows)
        noise = noise.improved(
            weighted.reshape(count, rows), P[own[:, :, None], own[:, None]], system.by_joint,
            system.known,
        )  # fmt: skip
        for n, process in enumerate(processes):
            found = float(np.sum((process.moved.T @ weighted) ** 2))
            expected = float(np.sum(process.moved * (P @ process.moved)))
            found += doubt * TYPICAL_RAD**2 / sizes[n] ** 4
            expected += doubt / sizes[n] ** 2
            sizes[n] *= (found / expected) ** 0.5
    return sizes
