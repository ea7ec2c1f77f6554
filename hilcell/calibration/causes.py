"""Causes of unexplained errors: how each moves the poses, and which explains best.

An axis that lost its zero moves poses by its column of the Jacobian, a slipped reflector by its
orientation, a grown arm by its reach. A suspicion is a hint, no verification. The tracker is
verified by its own nests, so a pose that differs is due to robot, mount or slide.

Of N differences d with covariance C, ``d' C^-1 d`` is judged as 3N F(3N, nu), nu the degrees of
freedom of the repeatability, known at a few places and widened by its spread over the others; the
share explained by a cause of k parameters as k F(k, nu), the risk divided among all. The cause that
leaves only chance is named, the fewest parameters first; none where the best leaves most. A slip
along a rotation of axis 6 alone is taken for its lost zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.geometry.frames import motion_levers
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.kinematics import Arm, forward
from hilcell.geometry.statistics import f_quantile
from hilcell.model.verdicts import Cause, Suspicion
from hilcell.ports import Array

LARGE_AXES = 5
RISK = 0.001  # of each of two tests: that poses which have not changed are found to
SPREAD = 1.5  # of the scatter's variance over a cube: a joint's own scatter acts by its reach
PENALTY = 4.0  # of chi^2, that a parameter more must gain


class Pattern(NamedTuple):
    """How a cause moves N poses: columns (3N, K) of mm per unit, the factor to ``unit``."""

    cause: Cause
    columns: Array
    factor: float
    unit: str


def zero_columns(arm: Arm, joints_rad: Array) -> Array:
    """Motion of the reflector (N, 3, 6) in {B} by lost zeros of the axes, mm / rad.

    At joints (N, 6).
    """
    offsets = slice(18, 24)  # of the links' parameters
    return np.asarray(parameter_jacobian(arm, joints_rad)[:, :3, offsets] * arm.sign)


def patterns(arm: Arm, joints_rad: Array) -> list[Pattern]:
    """Patterns of the robot's causes at joints (N, 6), in {B}."""
    poses = forward(arm, joints_rad)
    J = zero_columns(arm, joints_rad)
    grown = motion_levers(poses[:, :3, 3])[:, :, 6].reshape(-1, 1)
    return [
        Pattern(Cause.MOUNT_SLIPPED, poses[:, :3, :3].reshape(-1, 3), 1.0, "mm"),
        Pattern(Cause.TEMPERATURE, grown, 1e6, "µm/m"),
        *(_zero(J, n) for n in range(LARGE_AXES)),
    ]


def axis_6_pattern(arm: Arm, joints_rad: Array) -> list[Pattern]:
    """Pattern of axis 6 as in `patterns`; none where it hardly moves the reflector.

    A mount that slipped along the rotation has the same pattern, and no single reflector
    distinguishes them: not a cause to test, but the likelier one of a slip in exactly this
    direction.
    """
    J = zero_columns(arm, joints_rad)
    lever_mm = float(np.sqrt(np.square(J[:, :, LARGE_AXES]).sum(axis=1).mean()))
    least_lever_mm = 20.0  # of a reflector beside axis 6: below, no turn of it is seen
    return [_zero(J, LARGE_AXES)] if lever_mm >= least_lever_mm else []


def _zero(J: Array, axis: int) -> Pattern:
    columns = J[:, :, axis].reshape(-1, 1)
    return Pattern(Cause.ZERO_LOST, columns, float(np.degrees(1.0)), f"deg of axis {axis + 1}")


def inverse_covariance(covariance_mm2: Array) -> Array:
    """Weights (3N, 3N) of errors: the inverse of their covariance."""
    return np.array(np.linalg.inv(covariance_mm2), dtype=float)


def left_by(
    errors_mm: Array, weights: Array, columns: Array, besides: Array | None = None
) -> tuple[float, float]:
    """Chi^2 of errors (N, 3) after fitting columns (3N, K), and the columns' size.

    ``besides`` (3N, M) are fitted as well and add no size. The size of a single column has its
    sign, that of three is their length.
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


class Change(msgspec.Struct, frozen=True):
    """The test closest to its limit, and the cause that explains best what it detected."""

    ratio: float  # of chi^2, or of what a cause explains of it, to its degrees of freedom
    limit: float
    suspicion: Suspicion | None

    @property
    def holds(self) -> bool:
        return self.ratio <= self.limit


class Explained(NamedTuple):
    """A cause of N differences, and the chi^2 that it leaves of them."""

    suspicion: Suspicion
    left: float
    parameters: int

    @property
    def penalised(self) -> float:
        return self.left + PENALTY * self.parameters


class Differences(msgspec.Struct, frozen=True):
    """Differences (N, 3) in {B} at joints (N, 6), and their covariance (3N, 3N).

    ``freedom``: degrees of freedom of its estimate; ``rail`` (3,): the rail's direction in {B}, 0
    without one. ``firsts``: candidate numbers of poses, in order of their first visits, that may
    have changed while the others were visited after the change.
    """

    difference_mm: Array
    covariance_mm2: Array
    joints_rad: Array
    freedom: float
    rail: Array
    firsts: Sequence[int]

    def change(self, arm: Arm, noticed_by: str) -> Change:
        """Judge two visits of the same poses.

        Two tests: whether chance explains all differences together, and whether one cause explains
        them better than by chance. The second detects a change that each single pose hides.
        """
        count, explained = self.difference_mm.size, self._explained(arm, noticed_by)
        risk = RISK / len(explained)
        limits = {
            k: SPREAD * f_quantile(1.0 - risk, k, self.freedom)
            for k in {each.parameters for each in explained}
        }
        tests = [(self._chi2 / count, SPREAD * f_quantile(1.0 - RISK, count, self.freedom))]
        tests += [((self._chi2 - e.left) / e.parameters, limits[e.parameters]) for e in explained]
        ratio, limit = max(tests, key=lambda test: test[0] / test[1])
        holds = ratio <= limit
        return Change(ratio, limit, None if holds else self._named(arm, explained, noticed_by))

    def likeliest(self, arm: Arm, noticed_by: str) -> Suspicion:
        """The cause that leaves least, with a penalty for each parameter."""
        return self._named(arm, self._explained(arm, noticed_by), noticed_by)

    @property
    def _chi2(self) -> float:
        d = self.difference_mm.reshape(-1)
        return float(d @ np.linalg.solve(self.covariance_mm2, d))

    def _named(self, arm: Arm, explained: list[Explained], noticed_by: str) -> Suspicion:
        best = min(explained, key=lambda each: each.penalised)
        if best.suspicion.cause is Cause.MOUNT_SLIPPED:
            turns = self._by_patterns(axis_6_pattern(arm, self.joints_rad), noticed_by)
            best = min([best, *turns], key=lambda each: each.penalised)
        most_left = 0.5  # of chi^2, by a cause that is named
        if best.left <= most_left * self._chi2:
            return best.suspicion
        rms_mm = float(np.sqrt(np.square(self.difference_mm).sum(axis=1).mean()))
        return Suspicion(Cause.UNKNOWN, rms_mm, "mm", noticed_by)

    def _explained(self, arm: Arm, noticed_by: str) -> list[Explained]:
        causes = patterns(arm, self.joints_rad)
        if self.rail.any():  # a slide at another place along it
            column = np.tile(self.rail, len(self.joints_rad))[:, None]
            causes = [*causes, Pattern(Cause.STRIP, column, 1.0, "mm")]
        return self._by_patterns(causes, noticed_by)

    def _by_patterns(self, causes: Sequence[Pattern], noticed_by: str) -> list[Explained]:
        explained, weights = [], inverse_covariance(self.covariance_mm2)
        for cause, all_columns, factor, unit in causes:
            for first in self.firsts:
                columns = all_columns.copy()
                columns[3 * first :] = 0.0
                left, size = left_by(self.difference_mm, weights, columns)
                suspicion = Suspicion(cause, factor * size, unit, noticed_by)
                explained.append(Explained(suspicion, left, columns.shape[1]))
        return explained
