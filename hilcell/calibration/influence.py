"""Influences that move a corrected target: each is a line of its budget (GUM).

An influence is a small random motion of a frame (shift, rotation about an origin, growth from it)
with one covariance: one form for constant scatter, frames whose rotation acts by its lever, a
growing arm, a beam that turns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from hilcell.geometry.frames import apply, cross_matrix, inverse, motion_levers
from hilcell.geometry.statistics import bounds95_mm, effective_freedom, trace_freedom
from hilcell.ports import Array, HilcellError

MEASURED, ASSUMED = "measured in this run", "stated assumption"
MODEL = "Error model"
SIZE = 7  # shift, rotation, growth

Frame = Literal["world", "base", "tool"]


class Influence(
    msgspec.Struct,
    frozen=True,
    rename={"applies": "counts", "per_visit": "alone", "in_model": "within_model"},
):
    """One line: name, source, method of evaluation and clause of the GUM.

    ``covariance`` (7, 7): shift (3,) in mm, rotation vector (3,) in rad and growth (ratio of
    lengths) about ``origin_mm``, axes of ``frame``: {W}, {B} of the station, or {T} of the target.
    ``freedom``: degrees of freedom of its estimate, None where it is known. It applies in use only,
    in the run's validation only, or in both. A ``per_visit`` line differs from visit to visit; the
    others move all targets together. ``in_model``: contained in the error model's covariance,
    because the model was learnt from single visits; only the excess over it is the model's.
    """

    name: str
    source: str
    how: str
    clause: str
    frame: Frame
    covariance: list[list[float]]
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    freedom: float | None = None
    applies: Literal["always", "in use", "in validation"] = "always"
    per_visit: bool = False
    in_model: bool = False

    def at(self, frames: Array, targets_mm: Array) -> Array:
        """Covariances (N, 3, 3) in {W} at targets (N, 3); ``frames`` are its own."""
        covariance = np.array(self.covariance)
        if frames.ndim == 2 and not covariance[3:].any():  # a shift, the same everywhere
            turned = frames[:3, :3] @ covariance[:3, :3] @ frames[:3, :3].T
            return np.broadcast_to(turned, (len(targets_mm), 3, 3))
        T = np.broadcast_to(frames, (len(targets_mm), 4, 4))
        R = T[:, :3, :3]
        levers = np.einsum("nji,nj->ni", R, targets_mm - T[:, :3, 3]) - np.array(self.origin_mm)
        J = R @ motion_levers(levers)
        return np.asarray(J @ covariance @ np.swapaxes(J, -1, -2))

    def about(self, own: Array, T: Array) -> Array:
        """Covariance (7, 7) about the origin of ``T``; ``own`` is its frame in {W}."""
        R = T[:3, :3].T @ own[:3, :3]
        origin_mm = apply(inverse(T) @ own, np.array([self.origin_mm]))[0]
        M = np.eye(SIZE)
        M[:3, :3] = M[3:6, 3:6] = R
        M[:3, 3:6] = cross_matrix(origin_mm) @ R
        M[:3, 6] = -origin_mm
        return np.asarray(M @ np.array(self.covariance) @ M.T)


def motion(
    shift_mm2: Array | float = 0.0, turn_rad2: Array | float = 0.0, growth: float = 0.0
) -> list[list[float]]:
    """Covariance (7, 7) of independent parts: (3, 3), or equal for each axis."""
    covariance = np.zeros((SIZE, SIZE))
    covariance[:3, :3] = shift_mm2 * np.eye(3) if np.ndim(shift_mm2) == 0 else shift_mm2
    covariance[3:6, 3:6] = turn_rad2 * np.eye(3) if np.ndim(turn_rad2) == 0 else turn_rad2
    covariance[6, 6] = growth
    return covariance.tolist()


def moved_frame(covariance: Array) -> list[list[float]]:
    """Covariance (7, 7) of a frame's (6, 6)."""
    whole = np.zeros((SIZE, SIZE))
    whole[:6, :6] = covariance
    return whole.tolist()


class NoBound(HilcellError):
    """No bound can be stated; ``reason`` says why."""

    code = "HC-C21"

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"no 95 % bounds of corrected targets: {reason}")


class UncertaintyBudget(msgspec.Struct, frozen=True):
    """Budget as stored in a calibration file: lines for all stations and for each.

    ``growth_per_k``: of the arm, whose temperature is known only in use; ``air_range_k``: used
    without a weather station; ``model_samples``: number of different poses of the model's residual;
    ``missing``: why no bound can be stated; there are no lines then.
    """

    lines: list[Influence] = []
    stations: dict[str, list[Influence]] = {}
    growth_per_k: float = 0.0
    air_range_k: float = 0.0
    model_samples: int | None = None
    missing: str = ""


@dataclass(frozen=True, eq=False)
class Part:
    """One contribution to N targets: covariances (N, 3, 3) in {W}, freedom of the estimate."""

    name: str
    source: str
    how: str
    clause: str
    covariance_mm2: Array
    freedom: float

    @property
    def u_mm(self) -> float:
        """Standard uncertainty of one coordinate, root mean square of all targets."""
        return math.sqrt(float(np.trace(self.covariance_mm2, axis1=1, axis2=2).mean()) / 3)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Independent contributions to N targets, and their 95 % bounds."""

    parts: Sequence[Part]

    @property
    def covariance_mm2(self) -> Array:
        """Combined covariances (N, 3, 3) in {W} (GUM 5.1.2)."""
        return np.asarray(np.sum([part.covariance_mm2 for part in self.parts], axis=0))

    @property
    def freedom(self) -> Array:
        """Effective degrees of freedom (N,)."""
        traces = [np.trace(part.covariance_mm2, axis1=1, axis2=2) for part in self.parts]
        return effective_freedom(traces, [part.freedom for part in self.parts])

    @property
    def radii_mm(self) -> Array:
        """95 % bounds (N,) of 3D errors."""
        return bounds95_mm(self.covariance_mm2, self.freedom)


def combined_bounds(
    model_mm2: Array,
    influences: Sequence[Influence],
    T_W_B: Array,
    poses: Array,
    model_samples: int | None = None,
    drill_mm: Array | None = None,
) -> Bounds:
    """Bounds of targets at poses (N, 4, 4) of the reflector in {W}.

    ``drill_mm`` (3,): working point in {T}, None: the reflector. A rotation of a frame of {W} acts
    at its lever to the working point; that of the arm is the drill's own line, and the arm's growth
    lengthens no tool.
    ``model_mm2`` (N, 3, 3): the error model's covariance in {B}, which is at ``T_W_B``; its
    residual was estimated from ``model_samples`` different poses, None: known.
    """
    R = T_W_B[:3, :3]
    frames = {"world": np.eye(4), "base": T_W_B, "tool": poses}
    places_mm = dict.fromkeys(frames, poses[:, :3, 3])
    if drill_mm is not None:
        places_mm["world"] = poses[:, :3, 3] + poses[:, :3, :3] @ drill_mm
    parts = [
        Part(
            each.name, each.source, each.how, each.clause,
            each.at(frames[each.frame], places_mm[each.frame]),
            math.inf if each.freedom is None else each.freedom,
        )
        for each in influences
    ]  # fmt: skip
    model_mm2 = R @ model_mm2 @ R.T
    for each, part in zip(influences, parts, strict=True):
        if each.in_model:
            model_mm2 = nearest_semidefinite(model_mm2 - part.covariance_mm2)
    freedom = math.inf
    if model_samples is not None:
        freedom = trace_freedom(model_mm2.mean(axis=0), model_samples)
    model = Part(
        MODEL, MEASURED, "parameters and residual, as its covariance states them", "5.2.2",
        model_mm2, freedom,
    )  # fmt: skip
    return Bounds([model, *parts])


def nearest_semidefinite(covariances: Array) -> Array:
    """Nearest positive semidefinite matrices to (..., 3, 3): negative variances become 0."""
    values, axes = np.linalg.eigh(covariances)
    return np.asarray((axes * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(axes, -1, -2))
