"""The most probable kinematics of measured poses, robust against outliers.

Levenberg-Marquardt with the analytic Jacobian and priors, first with a Cauchy loss; outliers are
then rejected and named, and the noise is estimated from the rest by marginal likelihood.

Each Gauss-Newton step is a linear-Gaussian system, r = A x + v, x ~ N(m, Q) and v ~ N(0, C), block
by block of a pose, solved by one factorisation of the whitened rows. P is the inverse of A Q A' +
C; it also gives every pose's prediction by all others: r_F less its prediction is (P_FF)^-1 (P r)_F
for poses F left out together.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hilcell.geometry.frames import rotation_levers
from hilcell.geometry.kinematics import Array, Bools, Ints, forward
from hilcell.identification.kinematics import Kinematics, Linearised, State
from hilcell.identification.measured_poses import (
    IdentificationError,
    ManyContradict,
    Noise,
    Readings,
)
from hilcell.sanitize import counted

AT_ONCE = 4096  # poses, so that their derivatives stay in the processor's cache
LEAST_POSES = 20
GROSS = 8.0  # scales, and standard deviations of its prediction, that no good reading misses by
UNEXPLAINED_MM = 5.0  # scatter that is no robot's and no tracker's
DETERMINED = 0.5  # of the prior's standard deviation: below, the data say more than the prior


def predict(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Positions (M, K, 3) at commanded joints (M, n) and their covariances (M, K, 3, 3).

    Of the parameters' ``covariance`` (P, P) and one visit's scatter as identified (repeatability,
    and what no parameter describes); without the reading.
    """
    count = len(joints_rad)
    positions = np.empty((count, kinematics.reflectors, 3))
    covariances = np.empty((count, kinematics.reflectors, 3, 3))
    size = len(covariance)
    for first in range(0, count, AT_ONCE):
        part = slice(first, first + AT_ONCE)
        linearised = kinematics.linearised(state, joints_rad[part])
        J = linearised.by_parameter
        carried = (J.reshape(-1, size) @ covariance).reshape(J.shape)
        positions[part] = linearised.positions_mm
        covariances[part] = carried @ np.swapaxes(J, -1, -2) + noise.scatter(linearised.by_joint)
    return positions, covariances


def predict_orientations(
    kinematics: Kinematics, state: State, covariance: Array, noise: Noise, joints_rad: Array
) -> tuple[Array, Array]:
    """Orientations (M, 3, 3) of the flange at commanded joints (M, n), and their covariances.

    (M, 3, 3), of rotation vectors. The reflectors define the orientation: their rotation on the
    flange that a rotation of the last link compensates is unobservable, and does not count.
    """
    true_rad = kinematics.joints_of(state, joints_rad)
    R = (state.T @ forward(kinematics.arm_of(state), true_rad))[:, :3, :3]
    covariances = np.empty((len(joints_rad), 3, 3))
    for first in range(0, len(joints_rad), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        found = kinematics.linearised(state, joints_rad[part])
        levers = rotation_levers(state.smr_mm, R[part])
        J = np.sum(levers @ found.by_parameter, axis=1)
        by_joint = np.sum(levers @ found.by_joint, axis=1) * noise.joint_rad
        own = np.sum(levers @ np.swapaxes(levers, -1, -2), axis=1) * noise.reading_mm**2
        scatter = by_joint @ np.swapaxes(by_joint, 1, 2) + own
        covariances[part] = J @ covariance @ np.swapaxes(J, 1, 2) + scatter
    return R, covariances


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated state and noise, the system at the solution, and ``outliers`` (M, K)."""

    kinematics: Kinematics
    readings: Readings
    state: State
    noise: Noise
    system: System
    outliers: Bools

    def predict(self, joints_rad: Array) -> tuple[Array, Array]:
        """Return positions (M, K, 3) and covariances (M, K, 3, 3) of readings there."""
        return predict(self.kinematics, self.state, self.system.covariance, self.noise, joints_rad)

    @property
    def covariance(self) -> Array:
        """Return the parameters' covariance (P, P)."""
        return self.system.covariance

    def left_out(self, folds: Iterable[Ints]) -> tuple[Array, Array]:
        """As `System.left_out`."""
        return self.system.left_out(folds)


def identify(
    kinematics: Kinematics, readings: Readings, start: State, noise: Noise | None = None
) -> Estimate:
    """Most probable kinematics from `LEAST_POSES` poses or more.

    The sources of ``noise`` are estimated, those of readings and poses where none are given. Raises
    `IdentificationError` for fewer poses, no convergence, or too many outliers.
    """
    _refuse_too_few(readings)
    state, outliers = robust(kinematics, readings, start)
    for _ in range(4):  # rounds of noise and outliers
        _refuse_too_many(outliers, readings)
        estimate = identify_trusted(kinematics, readings.without(outliers), state, noise)
        more = gross(estimate.system)
        if not more.any():
            break
        state, outliers = estimate.state, outliers | more
    _refuse_too_many(outliers, readings)
    return replace(estimate, outliers=outliers)


def identify_trusted(
    kinematics: Kinematics, readings: Readings, start: State, noise: Noise | None = None
) -> Estimate:
    """The same from readings without outliers."""
    _refuse_too_few(readings)
    noise = noise or Noise.of_poses(kinematics.reflectors, len(kinematics.arm))
    state, _ = solve(kinematics, readings, start, noise)
    # the noise of greatest marginal likelihood, linearised at this state
    linearised = kinematics.linearised(state, readings.joints_rad)
    for _ in range(40):
        system = System.of(kinematics, state, readings, noise, linearised)
        before = noise
        noise = noise.improved(system.weighted, system.precision, linearised.by_joint, system.known)
        if noise.changed(before) <= 0.01:
            break
    _refuse_unexplained(noise.reading_mm)
    state, system = solve(kinematics, readings, state, noise)
    return Estimate(kinematics, readings, state, noise, system, np.zeros_like(readings.known))


def solve(
    kinematics: Kinematics, readings: Readings, state: State, noise: Noise
) -> tuple[State, System]:
    """Most probable state under a noise, and the system there; raises `IdentificationError`.

    What the readings do not determine (with one orientation, the reflector's position) lies along
    curved valleys: steps there are damped and bent (Transtrum, Sethna: geodesic acceleration).
    """
    system, damping, gain = System.at(kinematics, state, readings, noise), 0.0, np.inf
    settled, creeping = 1e-6, 1e-2  # gains of chi^2: none; of a step by a tenth of a sigma
    first_damping, held, eased, patience, most = 1e-3, 10.0, 5.0, 10, 1000
    count, crept, steps = 3 * np.count_nonzero(readings.known), 0, 0
    while gain > settled and crept < patience and steps < most:
        steps += 1
        scatter = max(1.0, system.cost / count)  # over the assumed noise: sigma is as much larger
        step = system.step
        if damping:
            step = _bent(kinematics, state, readings, system, *system.damped(damping))
        further = kinematics.moved(state, step)
        other = System.at(kinematics, further, readings, noise)
        if other.cost <= system.cost + settled:
            gain = system.cost - other.cost
            crept = crept + 1 if gain <= creeping * scatter else 0
            state, system, damping = further, other, damping / eased
        else:
            damping = max(held * damping, first_damping)
    if steps == most:
        raise IdentificationError(
            f"kinematics do not settle: step {most} improves chi^2 by {gain:.3g}; check robot, "
            "units and joint signs"
        )
    return state, system


def _bent(
    kinematics: Kinematics, state: State, readings: Readings, system: System, root: Array,
    step: Array,
) -> Array:  # fmt: skip
    """A damped step (P,) bent along the valley by the positions' second derivative there."""
    share, most_bent = 0.1, 0.75  # of the step: the curvature is taken there; the bend's largest
    ahead = kinematics.moved(state, share * step)
    moved_mm = kinematics.positions_mm(ahead, readings.joints_rad) - readings.xyz_mm
    moved_mm = np.where(readings.known[..., None], moved_mm, 0.0).reshape(system.residual_mm.shape)
    second_mm = (moved_mm + system.residual_mm) / share - system.design @ step
    bend = system.towards(root, -second_mm / share)
    size, added = (np.linalg.norm(kinematics.prior_root @ each) for each in (step, bend))
    return step + bend if added <= most_bent * size else step


def robust(kinematics: Kinematics, readings: Readings, state: State) -> tuple[State, Bools]:
    """Return a state that is robust against outliers, and these (M, K)."""
    least_scale_mm, first_scale_mm = 0.005, 0.5
    own_mm2 = np.where(readings.known[..., None, None], readings.covariance_mm2, 0.0)
    cauchy = 2.5  # scales from which on a reading's pull fades
    linearised = kinematics.linearised(state, readings.joints_rad)
    misses = _Misses(readings, linearised, own_mm2, first_scale_mm)
    scale_mm = max(misses.scale_mm, least_scale_mm)
    rounds, most_held, damping = 12, 1e3, 0.0
    while rounds and damping <= most_held:
        fading = (misses.lengths_mm / (cauchy * scale_mm)) ** 2
        covariance_mm2 = own_mm2 + fading[..., None, None] * (own_mm2 + scale_mm**2 * np.eye(3))
        weighted = replace(readings, covariance_mm2=covariance_mm2)
        noise = Noise.independent(scale_mm, len(kinematics.arm))
        system = System.of(kinematics, state, weighted, noise, linearised)
        further = kinematics.moved(state, system.damped(damping)[1] if damping else system.step)
        there = kinematics.linearised(further, readings.joints_rad)
        if not System.of(kinematics, further, weighted, noise, there).cost <= system.cost + 1e-6:
            damping = max(10.0 * damping, 1e-3)
            continue
        state, linearised, damping, rounds = further, there, damping / 5.0, rounds - 1
        misses = _Misses(readings, linearised, own_mm2, scale_mm)
        shown, telling = misses.shown, misses.telling
        left = diagonal_blocks(system.precision) @ diagonal_blocks(system.noise_mm2) @ shown
        share = float(np.einsum("rii->", left[telling]) / misses.count[telling].sum())
        scale_mm = max(misses.scale_mm / max(share, 0.1) ** 0.5, least_scale_mm)
    _refuse_unexplained(scale_mm)
    return state, misses.lengths_mm > GROSS * scale_mm


class _Misses:
    """Misses at a scale: ``lengths_mm`` (M, K) by it and the readings' own covariance.

    ``telling``: readings with most coordinates whose own covariance does not hide the scale,
    ``shown`` (M, K, 3, 3), ``count`` (M, K) in number; ``scale_mm``: the scale that they have.
    """

    def __init__(
        self, readings: Readings, linearised: Linearised, own_mm2: Array, scale_mm: float
    ) -> None:
        known = readings.known
        missed = np.where(known[..., None], readings.xyz_mm - linearised.positions_mm, 0.0)
        total_mm2 = own_mm2 + scale_mm**2 * np.eye(3)
        whitened = np.linalg.solve(np.linalg.cholesky(total_mm2), missed[..., None])[..., 0]
        self.lengths_mm = scale_mm * np.linalg.norm(whitened, axis=-1)
        self.shown = scale_mm**2 * np.linalg.inv(total_mm2)
        self.count = np.einsum("mkii->mk", self.shown)
        self.telling = known & (self.count > 0.5 * self.count[known].max())
        count = self.count[self.telling]
        usual = np.sqrt(count * (1.0 - 2.0 / (9.0 * count)) ** 3)  # median length (Wilson-Hilferty)
        self.scale_mm = float(np.median(self.lengths_mm[self.telling] / usual))


def gross(system: System) -> Bools:
    """Readings (M, K) that all others contradict: single ones, or else whole poses."""
    readings, poses = system.distances()
    single: Bools = system.known & (readings > GROSS**2)
    if single.any():
        return single
    coordinates = 3 * system.known.sum(axis=1)
    pose_gross = 4.0  # the same for all of a pose, by the root of its coordinates' mean square
    whole = poses > (GROSS**2 + pose_gross**2 * np.maximum(coordinates - 3, 0))
    return np.asarray(system.known & whole[:, None])


def _refuse_too_few(readings: Readings) -> None:
    poses = int(np.count_nonzero(readings.known.any(axis=1)))
    if poses < LEAST_POSES:
        raise IdentificationError(
            f"kinematics: {counted(poses, 'pose')}, expected at least {LEAST_POSES}; measure more"
        )


def _refuse_unexplained(scatter_mm: float) -> None:
    if not scatter_mm <= UNEXPLAINED_MM:
        raise IdentificationError(
            f"kinematics leave {scatter_mm:.3g} mm of scatter, expected <= {UNEXPLAINED_MM:g} mm; "
            "check robot, units, joint signs, and that poses and readings belong together"
        )


def _refuse_too_many(outliers: Bools, readings: Readings) -> None:
    bad, all_ = int(np.count_nonzero(outliers)), int(np.count_nonzero(readings.known))
    most_outliers = 0.2  # share beyond which the good readings are not known
    if not bad <= most_outliers * all_:
        raise ManyContradict(
            f"kinematics: {bad} of {all_} readings contradict the others, expected at most "
            f"{most_outliers:.0%}; check that poses and readings belong together"
        )


@dataclass(frozen=True, eq=False)
class System:
    """Rows of M poses with N = 3 K readings each; rows of unknown readings are zero.

    ``design`` (M, N, P), ``residual_mm`` (M, N), ``noise_mm2`` (M, N, N) with variance 1 in unknown
    rows; ``prior_root`` (P, P) whitens the prior, ``pull`` (P,) is its whitened residual.
    """

    design: Array
    residual_mm: Array
    noise_mm2: Array
    prior_root: Array
    pull: Array
    by_joint: Array
    known: Bools

    @classmethod
    def at(cls, kinematics: Kinematics, state: State, readings: Readings, noise: Noise) -> System:
        linearised = kinematics.linearised(state, readings.joints_rad)
        return cls.of(kinematics, state, readings, noise, linearised)

    @classmethod
    def of(
        cls, kinematics: Kinematics, state: State, readings: Readings, noise: Noise,
        linearised: Linearised,
    ) -> System:  # fmt: skip
        known, count = readings.known, len(readings)
        residual = np.where(known[..., None], readings.xyz_mm - linearised.positions_mm, 0.0)
        design = linearised.by_parameter.copy()
        design[~known] = 0.0
        return cls(
            design.reshape(count, -1, design.shape[-1]),
            residual.reshape(count, -1),
            noise.covariance(linearised.by_joint, readings.covariance_mm2, known),
            kinematics.prior_root,
            kinematics.prior_root @ (kinematics.prior[0] - kinematics.flat(state)),
            linearised.by_joint,
            known,
        )

    @cached_property
    def _whitener(self) -> Array:
        """Return W (M, N, N) with W'W the inverse of the noise's covariance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.noise_mm2)), dtype=float)

    @cached_property
    def _factor(self) -> tuple[Array, Array]:
        """Return the posterior's root R (P, P) and the step (P,)."""
        size = self.design.shape[2]
        rows = (self._whitener @ self.design).reshape(-1, size)
        missed = (self._whitener @ self.residual_mm[..., None]).ravel()
        R = triangle(rows, self.prior_root)
        pull = rows.T @ missed + self.prior_root.T @ self.pull
        return R, np.asarray(np.linalg.solve(R, np.linalg.solve(R.T, pull)), dtype=float)

    @property
    def step(self) -> Array:
        """Return the step (P,) to the most probable parameters."""
        return self._factor[1]

    def damped(self, damping: float) -> tuple[Array, Array]:
        """Return a root R (P, P) and the step (P,), held back by so many times the prior's
        information.
        """
        R, step = self._factor
        size = len(step)
        held = np.column_stack([damping**0.5 * self.prior_root, np.zeros(size)])
        rows = np.concatenate([np.column_stack([R, R @ step]), held])
        both = np.asarray(np.linalg.qr(rows, mode="r"))
        root = both[:size, :size]
        return root, np.asarray(np.linalg.solve(root, both[:size, size]))

    def towards(self, root: Array, missed_mm: Array) -> Array:
        """Return the step (P,) by a root (P, P) that makes up for residuals (M, N) alone."""
        W = self._whitener
        whitened = (W @ missed_mm[..., None]).ravel()
        pull = (W @ self.design).reshape(-1, len(root)).T @ whitened
        return np.asarray(np.linalg.solve(root, np.linalg.solve(root.T, pull)), dtype=float)

    @cached_property
    def cost(self) -> float:
        """Return chi^2 of readings and prior before the step."""
        whitened = self._whitener @ self.residual_mm[..., None]
        return float(np.sum(whitened**2) + np.sum(self.pull**2))

    @cached_property
    def covariance(self) -> Array:
        inverse = np.linalg.inv(self._factor[0])
        return inverse @ inverse.T

    @cached_property
    def _precision_parts(self) -> tuple[Array, Array]:
        """Return C^-1 (M, N, N), and S (M, N, P) with P = C^-1 - S S'."""
        inverse = np.swapaxes(self._whitener, 1, 2) @ self._whitener
        size = self.design.shape[2]
        S = (inverse @ self.design).reshape(-1, size) @ np.linalg.inv(self._factor[0])
        return np.asarray(inverse), S.reshape(self.design.shape)

    @cached_property
    def weighted(self) -> Array:
        """Return P r (M, N)."""
        left = self.residual_mm - self.design @ self.step
        return np.asarray(np.einsum("mij,mj->mi", self._precision_parts[0], left))

    @cached_property
    def precision(self) -> Array:
        """Return the blocks of P (M, N, N)."""
        inverse, S = self._precision_parts
        return inverse - S @ np.swapaxes(S, 1, 2)

    @property
    def evidence(self) -> float:
        """Return the log marginal likelihood of the readings, but for a constant of their count."""
        R, step = self._factor
        left = self.residual_mm - self.design @ step
        chi2 = float(np.sum(left * self.weighted))
        chi2 += float(np.sum((self.pull - self.prior_root @ step) ** 2))
        log_noise = -2.0 * float(np.log(np.einsum("mii->mi", self._whitener)).sum())
        log_posterior = 2.0 * float(np.log(np.abs(np.diag(R))).sum())
        log_prior = 2.0 * float(np.linalg.slogdet(self.prior_root)[1])
        return -0.5 * (chi2 + log_noise + log_posterior - log_prior)

    def left_out(self, folds: Iterable[Ints]) -> tuple[Array, Array]:
        """Return measured less predicted (M, K, 3) and its covariance (M, K, 3, 3), by folds (F,)
        of poses left out together. NaN for unknown readings and poses of no fold.
        """
        missed: Array = np.full((*self.known.shape, 3), np.nan)
        covariance: Array = np.full((*self.known.shape, 3, 3), np.nan)
        for fold in folds:
            C: Array = np.asarray(np.linalg.inv(self._fold_precision(fold)), dtype=float)
            shape = (len(fold), -1, 3)
            missed[fold] = (C @ self.weighted[fold].ravel()).reshape(shape)
            covariance[fold] = diagonal_blocks(C).reshape(*shape, 3)
        missed[~self.known], covariance[~self.known] = np.nan, np.nan
        return missed, covariance

    def excess(self, folds: Iterable[Ints]) -> float:
        """Mean square of left-out errors by folds of poses, over its expectation. About 1 where
        poses err independently; more where those of a fold err alike.
        """
        found = expected = 0.0
        for fold in folds:
            covariance = np.linalg.inv(self._fold_precision(fold))
            known = np.repeat(self.known[fold].ravel(), 3)
            missed = covariance @ self.weighted[fold].ravel()
            found += float(np.sum(missed[known] ** 2))
            expected += float(np.sum(np.diag(covariance)[known]))
        return found / expected

    def _fold_precision(self, fold: Ints) -> Array:
        """Return the block of P (F N, F N) of the poses (F,) of a fold."""
        inverse, S = self._precision_parts
        rows = self.residual_mm.shape[1]
        own = S[fold].reshape(len(fold) * rows, -1)
        P: Array = -(own @ own.T)
        for n, pose in enumerate(fold):
            at = slice(n * rows, (n + 1) * rows)
            P[at, at] += inverse[pose]
        return P

    def distances(self) -> tuple[Array, Array]:
        """Squared Mahalanobis distances of readings (M, K) and whole poses (M,) from the prediction
        by all others.
        """
        g = self.weighted
        poses = np.einsum("mi,mi->m", g, np.linalg.solve(self.precision, g[..., None])[..., 0])
        readings = np.empty(self.known.shape)
        for k in range(self.known.shape[1]):
            at = slice(3 * k, 3 * k + 3)
            own = np.linalg.solve(self.precision[:, at, at], g[:, at, None])[..., 0]
            readings[:, k] = np.einsum("mi,mi->m", g[:, at], own)
        return readings, poses


@dataclass(frozen=True, eq=False)
class Observability:
    """``ratio`` (P,): posterior over prior standard deviation of each parameter.

    ``directions``: number of combinations of parameters that the data determine better than the
    prior; ``condition``: ratio of the best to the worst determined of them.
    """

    ratio: Array
    directions: int
    condition: float


def observability(kinematics: Kinematics, covariance: Array) -> Observability:
    """Return which errors of a robot readings determine, and which only the prior.

    ``covariance`` (P, P): of the parameters after the readings.
    """
    W = kinematics.prior_root
    whitened = W @ covariance @ W.T
    prior = np.linalg.inv(W.T @ W)
    ratio = np.sqrt(np.diag(covariance) / np.diag(prior))
    left = np.clip(np.linalg.eigvalsh((whitened + whitened.T) / 2), 1e-30, 1.0)
    gains = np.sqrt(1.0 / left - 1.0)  # standard deviations of the prior over the data's
    known = gains[gains > 1.0]
    condition = float(known.max() / known.min()) if len(known) else 1.0
    return Observability(ratio, len(known), condition)


def diagonal_blocks(matrix: Array) -> Array:
    """Return the blocks (..., N, 3, 3) on the diagonals of matrices (..., 3 N, 3 N)."""
    at = np.arange(matrix.shape[-1]).reshape(-1, 3)
    return np.asarray(matrix[..., at[:, :, None], at[:, None]])


def triangle(*blocks: Array) -> Array:
    """R (P, P), upper triangular, with R'R = A'A of rows A (N, P), given in blocks.

    By A'A, which has half of A's digits, where its columns differ enough; else by an orthogonal
    factorisation, three times slower.
    """
    squares = np.sum([rows.T @ rows for rows in blocks], axis=0)
    scale = np.sqrt(np.diag(squares))
    least_pivot = 1e-4  # of columns of unit length: their squares keep 8 digits
    with suppress(np.linalg.LinAlgError):
        R: Array = np.linalg.cholesky(squares / np.outer(scale, scale)).T
        if np.diag(R).min() >= least_pivot:
            return R * scale
    return np.asarray(np.linalg.qr(np.concatenate(blocks), mode="r"))
