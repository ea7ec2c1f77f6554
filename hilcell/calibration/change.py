"""Whether poses that were measured twice have changed in between, and which cause explains it.

The tracker is proven by its own nests, so a pose that comes out elsewhere the second time is the
robot's, its mount's or the slide's doing. Of N differences d with covariance C, ``d' C^-1 d`` is
judged as 3N F(3N, nu), nu the degrees of freedom by which the repeatability is known at a few
places and wider by its spread over the others, and what a cause of k parameters explains of it as
k F(k, nu), the risk shared by all causes. The cause is named that leaves what chance explains, the
one of fewest parameters first; none where the best of them leaves most. One orientation of the tool
cannot tell a reflector that slipped from a shift of the base. A slip that has the direction of a
turn of axis 6 by itself is taken for its lost zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.suspicions import (
    Pattern,
    Suspicion,
    axis_6_pattern,
    left_by,
    patterns,
    strip_pattern,
    weights_of,
)
from hilcell.geometry.kinematics import Arm
from hilcell.geometry.statistics import f_quantile
from hilcell.ports import Array

RISK = 0.001  # of each of two tests: that poses which have not changed are found to
SPREAD = 1.5  # of the scatter's variance over a cube: a joint's own scatter acts by its reach
PENALTY = 4.0  # of chi^2, that a parameter more must gain
MOST_LEFT = 0.5  # of chi^2, by a cause that is named


class Differences(msgspec.Struct, frozen=True):
    """Differences (N, 3) in {B} at joints (N, 6), their covariance (3N, 3N), and the degrees of
    freedom of its estimate. ``rail`` (3,) is the rail's direction in {B}, 0 without one.

    Of poses in the order of their first visits the first ones may have changed, and the others
    been visited after the change: so many as one of ``firsts`` says.
    """

    difference_mm: Array
    covariance_mm2: Array
    joints_rad: Array
    freedom: float
    rail: Array
    firsts: Sequence[int]


class Change(msgspec.Struct, frozen=True):
    """The test that comes closest to its limit, and the cause that explains best what it found."""

    ratio: float  # of chi^2, or of what a cause explains of it, to its degrees of freedom
    limit: float
    suspicion: Suspicion | None

    @property
    def holds(self) -> bool:
        """Whether chance explains the differences."""
        return self.ratio <= self.limit


def changed(found: Differences, arm: Arm, noticed_by: str) -> Change:
    """Return what two visits of the same poses have shown.

    Two tests: whether chance explains all differences together, and whether one cause explains
    them better than chance would make it. The second finds a change that each pose hides.
    """
    d = found.difference_mm.reshape(-1)
    chi2 = float(d @ np.linalg.solve(found.covariance_mm2, d))
    explained = _explained(found, arm, noticed_by)
    risk = RISK / len(explained)
    limits = {
        k: f_quantile(1.0 - risk, k, found.freedom) for k in {each.parameters for each in explained}
    }
    tests = [(chi2 / len(d), SPREAD * f_quantile(1.0 - RISK, len(d), found.freedom))]
    tests += [((chi2 - e.left) / e.parameters, limits[e.parameters]) for e in explained]
    ratio, limit = max(tests, key=lambda test: test[0] / test[1])
    if ratio <= limit:
        return Change(ratio, limit, None)
    return Change(ratio, limit, _named(found, arm, explained, noticed_by))


def likeliest(found: Differences, arm: Arm, noticed_by: str) -> Suspicion:
    """Return the cause that leaves least, each parameter having to gain its penalty."""
    return _named(found, arm, _explained(found, arm, noticed_by), noticed_by)


def _named(found: Differences, arm: Arm, explained: list[_Explained], noticed_by: str) -> Suspicion:
    best = min(explained, key=_penalised)
    if best.suspicion.cause == "mount slipped":
        turns = _by_patterns(found, axis_6_pattern(arm, found.joints_rad), noticed_by)
        best = min([best, *turns], key=_penalised)
    d = found.difference_mm.reshape(-1)
    if best.left <= MOST_LEFT * float(d @ np.linalg.solve(found.covariance_mm2, d)):
        return best.suspicion
    rms_mm = float(np.sqrt(np.square(found.difference_mm).sum(axis=1).mean()))
    return Suspicion("unknown", rms_mm, "mm", noticed_by)


def _penalised(each: _Explained) -> float:
    return each.left + PENALTY * each.parameters


class _Explained(NamedTuple):
    """A cause, the chi^2 that it leaves, and its number of parameters."""

    suspicion: Suspicion
    left: float
    parameters: int


def _explained(found: Differences, arm: Arm, noticed_by: str) -> list[_Explained]:
    """Return every cause at every moment at which it may have come."""
    strip = [strip_pattern(found.rail, len(found.joints_rad))] if found.rail.any() else []
    return _by_patterns(found, [*patterns(arm, found.joints_rad), *strip], noticed_by)


def _by_patterns(
    found: Differences, causes: Sequence[Pattern], noticed_by: str
) -> list[_Explained]:
    explained, weights = [], weights_of(found.covariance_mm2)
    for cause, all_columns, factor, unit in causes:
        for first in found.firsts:
            columns = all_columns.copy()
            columns[3 * first :] = 0.0
            left, size = left_by(found.difference_mm, weights, columns)
            suspicion = Suspicion(cause, factor * size, unit, noticed_by)
            explained.append(_Explained(suspicion, left, columns.shape[1]))
    return explained
