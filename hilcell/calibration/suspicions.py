"""Causes of errors that nothing else explains: how each moves the poses, and how much it leaves.

An axis that lost its zero moves them by its column of the Jacobian, a reflector that slipped by its
orientation, an arm that grew by its reach. A suspicion is a hint where to look, no proof: a
few poses cannot tell every cause from another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from hilcell.geometry.frames import motion_levers
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.kinematics import Arm, forward
from hilcell.ports import Array
from hilcell.typed import typed

LARGE_AXES = 5
LEAST_LEVER_MM = 20.0  # of a reflector beside axis 6: below, no turn of it is seen
ZEROS = slice(18, 24)  # of the links' parameters: the joints' offsets

Cause = Literal[
    "tracker moved", "mount slipped", "zero lost", "mount offset", "scale", "reversal",
    "temperature", "strip", "nest moved", "changed since", "repeatability", "drift", "instrument",
    "reflector", "base misplaced", "unknown",
]  # fmt: skip


class Suspicion(msgspec.Struct, frozen=True):
    """A cause that fits, its size, and the comparison by which it was noticed."""

    cause: Cause
    size: float
    unit: str
    noticed_by: str

    @property
    def facts(self) -> dict[str, Any]:
        """Return it as fields of an error that names it."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        return found

    @property
    def words(self) -> str:
        """Return cause and size."""
        return f"{self.cause} ({self.size:.4g} {self.unit})"

    @property
    def text(self) -> str:
        """Return it in words, with the comparison."""
        return f"{self.words}, noticed by {self.noticed_by}"


def blamed(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of a run that ended with an error of these facts: the cause, where its
    fields are those of a `Suspicion`.
    """
    try:
        found = typed(facts.get("fields", {}), Suspicion)
    except msgspec.ValidationError:  # it names no cause, or a size that is no number
        return {}
    return {"suspicions": [found.facts]}


def suspected_in(result: Mapping[str, Any]) -> list[Suspicion]:
    """Return the suspicions of a run's result."""
    return typed(result.get("suspicions", []), list[Suspicion])


class Pattern(NamedTuple):
    """How a cause moves N poses: columns (3N, K) of mm per unit, the factor to ``unit``."""

    cause: Cause
    columns: Array
    factor: float
    unit: str


def patterns(arm: Arm, joints_rad: Array) -> list[Pattern]:
    """Return the patterns at joints (N, 6) of the robot's causes, in {B}."""
    poses = forward(arm, joints_rad)
    J = parameter_jacobian(arm, joints_rad)[:, :3, ZEROS] * arm.sign
    found = [
        Pattern("mount slipped", poses[:, :3, :3].reshape(-1, 3), 1.0, "mm"),
        Pattern("temperature", motion_levers(poses[:, :3, 3])[:, :, 6].reshape(-1, 1), 1e6, "µm/m"),
    ]
    return [*found, *(_zero(J, n) for n in range(LARGE_AXES))]


def axis_6_pattern(arm: Arm, joints_rad: Array) -> list[Pattern]:
    """Return the pattern of axis 6 as in `patterns`; none where it hardly moves the reflector.

    It is that of a mount which slipped along the turn, and no reflector alone tells them apart. So
    it is no cause to test for, but the likelier one where a slip has this direction by itself.
    """
    J = parameter_jacobian(arm, joints_rad)[:, :3, ZEROS] * arm.sign
    lever_mm = float(np.sqrt(np.square(J[:, :, LARGE_AXES]).sum(axis=1).mean()))
    return [_zero(J, LARGE_AXES)] if lever_mm >= LEAST_LEVER_MM else []


def _zero(J: Array, axis: int) -> Pattern:
    """Return the pattern of a lost zero; ``J`` (N, 3, 6) are the joints' columns."""
    columns = J[:, :, axis].reshape(-1, 1)
    return Pattern("zero lost", columns, float(np.degrees(1.0)), f"deg of axis {axis + 1}")


def strip_pattern(rail: Sequence[float] | Array, count: int) -> Pattern:
    """Return the pattern of a slide that stands elsewhere along ``rail`` (3,) in {B}."""
    return Pattern("strip", np.tile(np.asarray(rail), count)[:, None], 1.0, "mm")


def weights_of(covariance_mm2: Array) -> Array:
    """Return the weights (3N, 3N) of errors with a covariance: its inverse."""
    return np.array(np.linalg.inv(covariance_mm2), dtype=float)


def left_by(
    errors_mm: Array, weights: Array, columns: Array, besides: Array | None = None
) -> tuple[float, float]:
    """Return the chi^2 of errors (N, 3) that columns (3N, K) leave, and the columns' size.

    ``weights`` (3N, 3N) are those of `weights_of`.
    ``besides`` (3N, M) may explain errors as well, and counts for no size. The size of a single
    column has its sign, that of three is their length.
    """
    own = columns.shape[1]
    J = columns if besides is None else np.hstack([columns, besides])
    e = errors_mm.reshape(-1)
    weighted = weights @ np.column_stack([J, e])
    chi2, pull = float(e @ weighted[:, -1]), J.T @ weighted[:, -1]
    information = J.T @ weighted[:, :-1]
    scale = 1.0 / np.sqrt(np.diag(information))  # columns differ in units
    inverse = np.ones((1, 1))  # of one column, scaled
    if len(scale) > 1:
        inverse = np.linalg.pinv(scale[:, None] * information * scale, hermitian=True)
    x = scale * (inverse @ (scale * pull))
    size = float(x[0]) if own == 1 else float(np.linalg.norm(x[:own]))
    return chi2 - float(x @ pull), size
