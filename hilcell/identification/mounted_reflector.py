"""Base and reflector of an arm from a few poses, without a guess of either; mm, rad.

For a given reflector on the flange the base is a rigid fit in closed form, so only the reflector's
three coordinates are searched: Gauss-Newton with damping from several starts, for many arms at
once (variable projection; Golub, Pereyra 1973).

From there a base is fitted together with the errors of a robot as built. Poses near one another
exchange zeros and lengths for a shift of the base; priors of these errors decide between them, and
what they leave open is the base's uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hilcell.geometry.frames import apply_each, cross_matrix, matrix
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.geometry.statistics import expanded, lengths_mm, rms
from hilcell.identification.estimate import solve
from hilcell.identification.kinematics import BASE, Kinematics, Placed
from hilcell.identification.measured_poses import Noise, Readings

MODEL_SHARE = 0.004  # of a displacement: zeros and lengths of a real arm change it

START_MM = 250.0  # from the assumed place, along each axis of the flange: the reach of a bracket
STARTS = START_MM * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])


@dataclass(frozen=True, slots=True)
class Placements:
    """Of H arms: ``T_L_B`` (H, 4, 4), reflectors ``smr_mm`` (H, 3) on the flange, residuals
    (H, N, 3) in {L}, ``chi2`` (H,) of residuals and of the reflector's assumed place.

    ``information`` (H, 9, 9): inverse covariance of shift and rotation of {B} about its origin,
    axes of {L}, and of the reflector.
    """

    T_L_B: Array
    smr_mm: Array
    residuals_mm: Array
    chi2: Array
    information: Array


def placements(
    flanges: Array, seen_mm: Array, sigma_mm: Array, smr_mm: Array, u_smr_mm: float
) -> Placements:
    """Best base and reflector of each arm for a reflector seen at (N, 3), {L}.

    ``flanges`` (H, N, 4, 4) in {B}; ``sigma_mm`` (N,) of a coordinate; the reflector is assumed at
    ``smr_mm`` (3,), with the standard uncertainty ``u_smr_mm`` of each coordinate.
    """
    count, starts = len(flanges), smr_mm + STARTS
    search = _Search(flanges, seen_mm, 1.0 / sigma_mm**2, smr_mm, 1.0 / u_smr_mm**2)
    found = [search.from_start(np.tile(start, (count, 1))) for start in starts]
    chi2 = np.array([each.chi2 for each in found])
    best = np.argmin(np.where(np.isfinite(chi2), chi2, np.inf), axis=0)
    rows = np.arange(count)
    parts = (
        np.array([getattr(each, name) for each in found])[best, rows]
        for name in ("T_L_B", "smr_mm", "residuals_mm", "chi2", "information")
    )
    return Placements(*parts)


@dataclass(frozen=True, slots=True)
class _Search:
    flanges: Array
    seen_mm: Array
    weights: Array
    smr_mm: Array
    smr_weight: float

    def from_start(self, smr_mm: Array) -> Placements:
        """Return the nearest minimum from reflectors (H, 3)."""
        here, damping = self.at(smr_mm), np.full(len(smr_mm), 1e-3)
        steps, settled_mm = 40, 1e-7
        for _ in range(steps):
            step = self._step(here, damping)
            there = self.at(here.smr_mm + step)
            better = there.chi2 < here.chi2
            damping = np.where(better, damping / 10.0, damping * 10.0)
            here = Placements(
                *(
                    np.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                    for new, old in (
                        (getattr(there, name), getattr(here, name))
                        for name in Placements.__dataclass_fields__
                    )
                )
            )
            if not (np.linalg.norm(step, axis=1) > settled_mm).any():
                break
        return here

    def at(self, smr_mm: Array) -> Placements:
        """Return the best bases for reflectors (H, 3)."""
        in_base = apply_each(self.flanges, smr_mm[:, None])
        T = self._bases(in_base)
        residuals = self.seen_mm - apply_each(T[:, None], in_base)
        chi2 = np.einsum("n,hni,hni->h", self.weights, residuals, residuals)
        off_mm = smr_mm - self.smr_mm
        chi2 = chi2 + self.smr_weight * np.einsum("hi,hi->h", off_mm, off_mm)
        J = self._jacobian(T, in_base)
        information = np.einsum("n,hnip,hniq->hpq", self.weights, J, J)
        information[:, 6:, 6:] += self.smr_weight * np.eye(3)
        return Placements(T, smr_mm, residuals, chi2, information)

    def _bases(self, in_base_mm: Array) -> Array:
        """Return the rigid fits (H, 4, 4) of points (H, N, 3) to those seen (Arun 1987)."""
        share = self.weights / self.weights.sum()
        centre, seen = np.einsum("n,hni->hi", share, in_base_mm), share @ self.seen_mm
        cross = np.einsum("n,hni,nj->hij", share, in_base_mm - centre[:, None], self.seen_mm - seen)
        U, _, Vt = np.linalg.svd(cross)
        proper = np.tile(np.eye(3), (len(U), 1, 1))
        proper[:, 2, 2] = np.sign(np.linalg.det(U @ Vt))
        R = np.swapaxes(U @ proper @ Vt, -1, -2)
        return matrix(R, seen - np.einsum("hij,hj->hi", R, centre))

    def _jacobian(self, T: Array, in_base_mm: Array) -> Array:
        turned = T[:, None, :3, :3] @ self.flanges[..., :3, :3]
        levers = np.einsum("hij,hnj->hni", T[:, :3, :3], in_base_mm)
        shifts = np.broadcast_to(np.eye(3), turned.shape)
        return np.concatenate([shifts, -cross_matrix(levers), turned], axis=-1)

    def _step(self, here: Placements, damping: Array) -> Array:
        """Return the reflector's part (H, 3) of a damped Gauss-Newton step."""
        in_base = apply_each(self.flanges, here.smr_mm[:, None])
        J = self._jacobian(here.T_L_B, in_base)
        pull = np.einsum("n,hnip,hni->hp", self.weights, J, here.residuals_mm)
        pull[:, 6:] += self.smr_weight * (self.smr_mm - here.smr_mm)
        scale = np.einsum("hpp->hp", here.information)
        damped = here.information + (damping[:, None] * scale)[:, None] * np.eye(9)
        step: Array = np.linalg.solve(damped, pull[..., None])[:, 6:, 0]
        return step


@dataclass(frozen=True, eq=False)
class NominalBase:
    """Where nominal kinematics meet the positions best: ``T_L_B`` (4, 4), ``smr_mm`` (3,) on the
    flange, and by how much they miss them, ``rms_mm`` (3D).
    """

    arm: Arm
    T_L_B: Array
    smr_mm: Array
    rms_mm: float

    def predict_mm(self, joints_rad: Array) -> Array:
        """Return where the tracker sees the reflector (3,) at joints (6,)."""
        seen: Array = (self.T_L_B @ flanges_of(self.arm, joints_rad) @ [*self.smr_mm, 1.0])[:3]
        return seen


@dataclass(frozen=True, eq=False)
class BaseFit:
    """``T_L_B`` (4, 4) and ``smr_mm`` (3,) on the flange, of a robot with the errors of one as
    built; U (k = 2) are of one coordinate in the worst direction.
    """

    T_L_B: Array
    smr_mm: Array
    base_U_mm: float
    base_U_deg: float
    smr_U_mm: float


def nominal_base(
    arm: Arm, joints_rad: Array, seen_mm: Array, noise_mm: float, smr_mm: Array, u_smr_mm: float
) -> NominalBase:
    """Fit base and reflector to three poses or more: joints (N, 6), the reflector (N, 3) in {L}.

    ``noise_mm``: 1 sigma of a coordinate seen. The reflector is assumed at ``smr_mm`` (3,), with
    the standard uncertainty ``u_smr_mm`` of each coordinate: it decides what few poses cannot.
    """
    flanges, sigma_mm = flanges_of(arm, joints_rad)[None], sigma_of(seen_mm, noise_mm)
    found = placements(flanges, seen_mm, sigma_mm, smr_mm, u_smr_mm)
    rms_mm = rms(lengths_mm(found.residuals_mm[0]))
    return NominalBase(arm, found.T_L_B[0], found.smr_mm[0], rms_mm)


def fit_base(
    arm: Arm, joints_rad: Array, seen_mm: Array, noise_mm: float, smr_mm: Array, u_smr_mm: float
) -> BaseFit:
    """Fit base, reflector and the errors of the arm as `nominal_base`, from where that is.

    Raises `IdentificationError` for an arm that is not the nominal one.
    """
    nominal = nominal_base(arm, joints_rad, seen_mm, noise_mm, smr_mm, u_smr_mm)
    robot = Kinematics(arm, assumed=Placed(reflector_mm=u_smr_mm))
    start = robot.start(nominal.T_L_B, nominal.smr_mm[None])
    start.moved[BASE:] = nominal.smr_mm - smr_mm
    readings = Readings(joints_rad, seen_mm[:, None], np.zeros((len(seen_mm), 1, 3, 3)))
    state, system = solve(robot, readings, start, Noise.independent(noise_mm))
    shift, turn, reflector = (
        expanded(system.covariance[at, at])
        for at in (slice(3), slice(3, BASE), slice(BASE, robot.placed))
    )
    return BaseFit(state.T, state.smr_mm[0], shift, float(np.degrees(turn)), reflector)


def flanges_of(arm: Arm, joints_rad: Array) -> Array:
    """Return the flange (..., 4, 4) in {B} at joints (..., 6)."""
    return forward(replace(arm, tool=np.eye(4)), joints_rad)


def sigma_of(seen_mm: Array, noise_mm: float) -> Array:
    """Return 1 sigma (N,) of a coordinate of positions (N, 3) against a nominal arm's, which are
    right where it begins.
    """
    moved_mm = np.linalg.norm(seen_mm - seen_mm[0], axis=1)
    return np.asarray(np.hypot(noise_mm, MODEL_SHARE * moved_mm))
