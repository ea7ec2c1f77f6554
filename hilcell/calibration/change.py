"""Whether poses that were measured twice have changed in between, and which cause explains it.

The tracker is proven by its own nests, so a pose that comes out elsewhere the second time is the
robot's, its mount's or the slide's doing. Of N differences d with covariance C, ``d' C^-1 d`` is
judged as 3N F(3N, nu), nu the degrees of freedom by which the repeatability is known. A cause moves
the poses in a way of its own; it is named where it leaves what chance explains, the one of fewest
parameters first. One orientation of the tool cannot tell a reflector that slipped from a shift of
the base.
"""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np

from hilcell.geometry.frames import motion_levers
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.kinematics import Arm, Array, forward
from hilcell.geometry.statistics import f_quantile

RISK = 0.002  # that poses which have not changed are found to
PENALTY = 4.0  # of chi^2, that a parameter more must gain
LARGE_AXES = 5  # axis 6 hardly moves the reflector
ZEROS = slice(18, 24)  # of the links' parameters: the joints' offsets

Cause = Literal[
    "tracker moved", "mount slipped", "zero lost", "mount offset", "scale", "reversal",
    "temperature", "strip",
]  # fmt: skip


class Suspicion(msgspec.Struct, frozen=True):
    """A cause that fits, its size, and the comparison by which it was noticed."""

    cause: Cause
    size: float
    unit: str
    noticed_by: str

    @property
    def text(self) -> str:
        """Return it in words."""
        return f"{self.cause} ({self.size:.4g} {self.unit}), noticed by {self.noticed_by}"


class Differences(msgspec.Struct, frozen=True):
    """Differences (N, 3) in {B} at joints (N, 6), their covariance (3N, 3N), and the degrees of
    freedom of its estimate. ``rail`` (3,) is the rail's direction in {B}.

    Of poses in the order of their first visits the first ones may have changed, and the others
    been visited after the change: so many as one of ``firsts`` says.
    """

    difference_mm: Array
    covariance_mm2: Array
    joints_rad: Array
    freedom: float
    rail: Array
    firsts: range


class Change(msgspec.Struct, frozen=True):
    """The test, and the cause that explains best what it found."""

    ratio: float  # of chi^2 to its degrees of freedom
    limit: float
    suspicion: Suspicion | None

    @property
    def holds(self) -> bool:
        """Whether chance explains the differences."""
        return self.ratio <= self.limit


def changed(found: Differences, arm: Arm, noticed_by: str) -> Change:
    """Return what two visits of the same poses have shown."""
    count = found.difference_mm.size
    ratio = _chi2(found, np.zeros((count, 0)))[0] / count
    limit = f_quantile(1.0 - RISK, count, found.freedom)
    if ratio <= limit:
        return Change(ratio, limit, None)
    return Change(ratio, limit, likeliest(found, arm, noticed_by))


def likeliest(found: Differences, arm: Arm, noticed_by: str) -> Suspicion:
    """Return the cause that leaves least, each parameter having to gain its penalty."""
    scored = []
    for cause, all_columns, factor, unit in _causes(found, arm):
        for first in found.firsts:
            columns = all_columns.copy()
            columns[3 * first :] = 0.0
            chi2, size = _chi2(found, columns)
            score = chi2 + PENALTY * columns.shape[1]
            scored.append((score, Suspicion(cause, factor * size, unit, noticed_by)))
    return min(scored, key=lambda pair: pair[0])[1]


def _causes(found: Differences, arm: Arm) -> list[tuple[Cause, Array, float, str]]:
    """Return causes: columns (3N, K) of differences per unit, factor and name of the unit."""
    poses = forward(arm, found.joints_rad)
    J = parameter_jacobian(arm, found.joints_rad)[:, :3, ZEROS] * arm.sign
    causes: list[tuple[Cause, Array, float, str]] = [
        ("mount slipped", poses[:, :3, :3].reshape(-1, 3), 1.0, "mm"),
        ("strip", np.tile(found.rail, len(poses))[:, None], 1.0, "mm"),
        ("temperature", motion_levers(poses[:, :3, 3])[:, :, 6].reshape(-1, 1), 1e6, "µm/m"),
    ]
    causes += [
        ("zero lost", J[:, :, n].reshape(-1, 1), float(np.degrees(1.0)), f"deg of axis {n + 1}")
        for n in range(LARGE_AXES)
    ]
    return causes


def _chi2(found: Differences, columns: Array) -> tuple[float, float]:
    """Return the chi^2 that columns (3N, K) leave, and their size."""
    d = found.difference_mm.reshape(-1)
    weighted = np.linalg.solve(found.covariance_mm2, np.column_stack([columns, d]))
    chi2, pull = float(d @ weighted[:, -1]), columns.T @ weighted[:, -1]
    if not columns.shape[1]:
        return chi2, 0.0
    x = np.linalg.pinv(columns.T @ weighted[:, :-1], hermitian=True) @ pull
    size = float(abs(x[0])) if len(x) == 1 else float(np.linalg.norm(x))
    return chi2 - float(x @ pull), size
