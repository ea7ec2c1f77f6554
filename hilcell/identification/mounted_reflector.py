"""Base and reflector of an arm from a few poses, without a guess of either; mm, rad.

For a given reflector on the flange the base is a rigid fit in closed form, so only the reflector's
three coordinates are searched: Gauss-Newton with damping from several starts, for many arms at
once (variable projection; Golub, Pereyra 1973).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilcell.geometry.frames import apply_each, cross_matrix, matrix
from hilcell.geometry.kinematics import Array

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
