"""The short-wave transmission error of one joint, as slow sweeps of that joint show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.kinematics import Array


@dataclass(frozen=True, eq=False)
class TransmissionCurve:
    """Joint error ``sum_k A_k cos(n_k q) + B_k sin(n_k q)`` (rad) at commanded angles q (rad).

    ``cycles`` (K,) are n_k, ``amplitude_rad`` (K, 2) are A_k and B_k, ``covariance_rad2``
    (2K, 2K) theirs in the order A_1, B_1, A_2, ... K may be 0. The sweep tells q only up to a
    constant, the lag between tracker and controller: the curve holds at ``q + shift_rad``, which is
    known to ``shift_sigma_rad``.
    """

    axis: int
    cycles: Array
    amplitude_rad: Array
    covariance_rad2: Array
    shift_rad: float
    shift_sigma_rad: float
    low_rad: float
    high_rad: float
    noise_rad: float

    def basis(self, joint_rad: Array) -> Array:
        """Return cosines and sines (..., 2K) at commanded angles (...)."""
        phase = self.cycles * (np.asarray(joint_rad, dtype=float)[..., None] + self.shift_rad)
        pairs = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        return pairs.reshape(*phase.shape[:-1], 2 * len(self.cycles))

    def slope(self, joint_rad: Array) -> Array:
        """Return d(basis)/dq (..., 2K) at commanded angles (...)."""
        pairs = self.basis(joint_rad).reshape(*np.shape(joint_rad), len(self.cycles), 2)
        turned = np.stack([-pairs[..., 1], pairs[..., 0]], axis=-1) * self.cycles[:, None]
        return turned.reshape(*np.shape(joint_rad), 2 * len(self.cycles))

    def evaluate(self, joint_rad: Array) -> Array:
        """Return the joint's error (...) in rad at commanded angles (...)."""
        return self.basis(joint_rad) @ self.amplitude_rad.ravel()
