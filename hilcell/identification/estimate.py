"""The most probable kinematics of measured poses, robust against gross readings.

Levenberg-Marquardt with the analytic Jacobian and priors. First under a loss whose pull fades with
distance (Cauchy), which a few gross readings do not move; those are then struck out and named,
and the noise is estimated from the rest by marginal likelihood.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from hilcell.geometry.frames import turn_levers
from hilcell.geometry.kinematics import Array, Bools, Ints, forward
from hilcell.identification.kinematics import Kinematics, State
from hilcell.identification.noise import Noise
from hilcell.identification.readings import IdentificationError, ManyContradict, Readings
from hilcell.identification.system import System

AT_ONCE = 4096  # poses, so that their derivatives stay in the processor's cache


def predict(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Return positions (M, K, 3) at commanded joints (M, 6) and their covariances (M, K, 3, 3).

    Covered are the parameters' ``covariance`` (P, P), and one visit's scatter as the identification
    met it: repeatability, and what no parameter describes. The reading is not.
    """
    count = len(joints_rad)
    positions = np.empty((count, kinematics.reflectors, 3))
    covariances = np.empty((count, kinematics.reflectors, 3, 3))
    size = len(covariance)
    for first in range(0, count, AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found = kinematics.linearised(state, joints_rad[part])
        J = found.by_parameter
        carried = (J.reshape(-1, size) @ covariance).reshape(J.shape)
        positions[part] = found.positions_mm
        covariances[part] = carried @ np.swapaxes(J, -1, -2) + noise.scatter(found.by_joint)
    return positions, covariances


def predict_orientations(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Return orientations (M, 3, 3) of the flange at commanded joints (M, 6), and the covariances
    (M, 3, 3) of their rotation vectors.

    The reflectors define the orientation. A turn of them on the flange that a turn of the last link
    takes back moves none: no reading tells it, and it counts for nothing.
    """
    true_rad = kinematics.joints_of(state, joints_rad)
    R = (state.T @ forward(kinematics.arm_of(state), true_rad))[:, :3, :3]
    covariances = np.empty((len(joints_rad), 3, 3))
    for first in range(0, len(joints_rad), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found = kinematics.linearised(state, joints_rad[part])
        levers = turn_levers(state.smr_mm, R[part])
        J = np.sum(levers @ found.by_parameter, axis=1)
        by_joint = np.sum(levers @ found.by_joint, axis=1) * noise.joint_rad
        own = np.sum(levers @ np.swapaxes(levers, -1, -2), axis=1) * noise.reading_mm**2
        scatter = by_joint @ np.swapaxes(by_joint, 1, 2) + own
        covariances[part] = J @ covariance @ np.swapaxes(J, 1, 2) + scatter
    return R, covariances


LEAST_POSES = 20
GROSS = 8.0  # scales, and standard deviations of its prediction, that no good reading misses by


@dataclass(frozen=True, eq=False)
class Estimate:
    """The state and noise found, the system at the solution, and ``outliers`` (M, K)."""

    kinematics: Kinematics
    readings: Readings
    state: State
    noise: Noise
    system: System
    outliers: Bools

    def predict(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return positions (M, K, 3) and covariances (M, K, 3, 3) of readings there."""
        return predict(self.kinematics, self.state, self.system.covariance, self.noise, joints_rad)

    def left_out_mm(self, folds: Iterable[Ints]) -> Array:
        """Return measured less predicted (M, K, 3), by folds of poses left out together."""
        return self.system.left_out_mm(folds)


def identify(
    kinematics: Kinematics, readings: Readings, start: State, noise: Noise | None = None
) -> Estimate:
    """Return the most probable kinematics from `LEAST_POSES` poses or more.

    The sources of ``noise`` are estimated, those of readings and poses where none are given.

    Raises `IdentificationError` where there are fewer, where the steps do not settle, and where
    too many readings are gross.
    """
    _refuse_too_few(readings)
    state, outliers = _robust(kinematics, readings, start)
    rounds = 4  # of noise and outliers
    for _ in range(rounds):
        _refuse_too_many(outliers, readings)
        found = identify_trusted(kinematics, readings.without(outliers), state, noise)
        more = _gross(found.system)
        if not more.any():
            break
        state, outliers = found.state, outliers | more
    _refuse_too_many(outliers, readings)
    return replace(found, outliers=outliers)


def identify_trusted(
    kinematics: Kinematics, readings: Readings, start: State, noise: Noise | None = None
) -> Estimate:
    """Return the same from readings of which none is gross."""
    _refuse_too_few(readings)
    noise = noise or Noise.of_poses(kinematics.reflectors)
    state, _ = solve(kinematics, readings, start, noise)
    # the noise of greatest marginal likelihood, linearised at this state
    found = kinematics.linearised(state, readings.joints_rad)
    noise_steps, noise_settled = 40, 0.01
    for _ in range(noise_steps):
        system = System.of(kinematics, state, readings, noise, found)
        before = noise
        noise = noise.improved(system.weighted, system.precision, found.by_joint, system.known)
        if noise.changed(before) <= noise_settled:
            break
    state, system = solve(kinematics, readings, state, noise)
    return Estimate(kinematics, readings, state, noise, system, np.zeros_like(readings.known))


def solve(
    kinematics: Kinematics, readings: Readings, state: State, noise: Noise
) -> tuple[State, System]:
    """Return the most probable state under a noise, and the system there; raises
    `IdentificationError`.

    What the readings do not determine (with one orientation, where the reflector is) lies along
    curved valleys. Steps across them are held back, and creeping along them ends by itself.
    """
    system, damping, gain = System.at(kinematics, state, readings, noise), 0.0, np.inf
    iterations = 100
    settled, creeping = 1e-6, 1.0  # gains of chi^2: nothing is left to gain; nothing that matters
    first_damping, held, eased = 1e-3, 10.0, 5.0
    for _ in range(iterations):
        if gain <= settled:
            break
        further = kinematics.moved(state, system.damped(damping) if damping else system.step)
        other = System.at(kinematics, further, readings, noise)
        if other.cost <= system.cost + settled:
            gain = system.cost - other.cost
            state, system, damping = further, other, damping / eased
        else:
            damping = max(held * damping, first_damping)
    if not gain <= creeping:
        raise IdentificationError(
            f"kinematics do not settle: the last of {iterations} steps improves chi^2 by "
            f"{gain:.3g}, wanted <= {creeping:g}; check robot, units and joint signs"
        )
    return state, system


def _robust(kinematics: Kinematics, readings: Readings, state: State) -> tuple[State, Bools]:
    """Return a state that gross readings did not move, and these readings (M, K)."""
    first_scale_mm, least_scale_mm = 0.5, 0.005
    scale_mm = first_scale_mm
    known = readings.known
    lengths_mm = np.zeros(known.shape)
    found = kinematics.linearised(state, readings.joints_rad)
    robust_steps = 12
    cauchy = 2.5  # scales from which on a reading's pull fades
    median_length = 1.5382  # of a 3-D normal vector of unit variance
    for _ in range(robust_steps):
        excess = scale_mm**2 * (lengths_mm / (cauchy * scale_mm)) ** 2
        weighted = replace(
            readings,
            covariance_mm2=readings.covariance_mm2 + excess[..., None, None] * np.eye(3),
        )
        system = System.of(kinematics, state, weighted, Noise.independent(scale_mm), found)
        state = kinematics.moved(state, system.step)
        found = kinematics.linearised(state, readings.joints_rad)
        missed = readings.xyz_mm - found.positions_mm
        lengths_mm = np.linalg.norm(np.where(known[..., None], missed, 0.0), axis=-1)
        spent = float(np.sum(1.0 - np.einsum("mii->mi", system.precision * system.noise_mm2)))
        rows = 3 * np.count_nonzero(known)
        share = max(1.0 - spent / rows, 0.1)
        middle_mm = float(np.median(lengths_mm[known]))
        scale_mm = max(middle_mm / median_length / share**0.5, least_scale_mm)
    return state, lengths_mm > GROSS * scale_mm


def _gross(system: System) -> Bools:
    """Return the readings (M, K) that all others contradict: single ones, or else whole poses."""
    readings, poses = system.distances()
    single: Bools = system.known & (readings > GROSS**2)
    if single.any():
        return single
    coordinates = 3 * system.known.sum(axis=1)
    pose_gross = 4.0  # the same for all of a pose, by the root of its coordinates' mean square
    whole = poses > (GROSS**2 + pose_gross**2 * np.maximum(coordinates - 3, 0))
    bad: Bools = system.known & whole[:, None]
    return bad


def _refuse_too_few(readings: Readings) -> None:
    poses = int(np.count_nonzero(readings.known.any(axis=1)))
    if poses < LEAST_POSES:
        raise IdentificationError(
            f"kinematics: {poses} poses, wanted at least {LEAST_POSES}; measure more"
        )


def _refuse_too_many(outliers: Bools, readings: Readings) -> None:
    bad, all_ = int(np.count_nonzero(outliers)), int(np.count_nonzero(readings.known))
    most_outliers = 0.2  # share beyond which the good readings are not known
    if not bad <= most_outliers * all_:
        raise ManyContradict(
            f"kinematics: {bad} of {all_} readings contradict the others, expected at most "
            f"{most_outliers:.0%}; check that poses and readings belong together"
        )
