"""A robot that repeats worse than it should: its data sheet, or its visits of a few places, say so.

A brake that slips a little at each stop moves no mean and loses no zero: each target is somewhat
beside its place, every time otherwise. So the deviations e of the corrected targets from their
mean at each station are compared with their covariance C: all together by the mean of
``e' C^-1 e / 3``, and along the column a of each large axis by the mean of
``(a' C^-1 e)^2 / a' C^-1 a``. Both are 1 where the budget of the validation is true, and are judged
as F, the denominator's degrees of freedom those with which the run knows its visits and model.

If it slips from the first point on, the visits have it, too. They are compared with the stated RP.
"""

from __future__ import annotations

from itertools import chain
from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.bounds import validated_bounds, validation_points
from hilcell.calibration.causes import LARGE_AXES, RISK, SPREAD, ZEROS
from hilcell.calibration.errors import visit_scatter
from hilcell.calibration.file import learnt_so_far
from hilcell.calibration.influence import NoBound
from hilcell.geometry.jacobian import parameter_jacobian
from hilcell.geometry.statistics import (
    chi2_quantile,
    effective_freedom,
    f_quantile,
    rms,
    trace_freedom,
)
from hilcell.journal.log import Log, commanded_rad, repeated_visits, variances_mm2
from hilcell.model.suspicion import Cause, Suspicion
from hilcell.ports import Array


class Deviations(NamedTuple):
    """Deviations (N, 3) of targets from the mean of their station, in {W}, covariances (N, 3, 3),
    columns (N, 3, K) of axes in mm / rad, and the covariances' degrees of freedom.
    """

    off_mm: Array
    covariance_mm2: Array
    columns: Array
    freedom: float


class Scatter(msgspec.Struct, frozen=True):
    """A variance of the targets as a share of the expected one, its limit, and the excess."""

    ratio: float
    limit: float
    size: float
    unit: str

    @property
    def holds(self) -> bool:
        """Whether chance explains the scatter."""
        return self.ratio <= self.limit


def scattered(log: Log) -> Suspicion | None:
    """Return a repeatability worse than the run's own, where the corrected targets show it."""
    found = log.once_measured(_scatter)
    if found is None or found.holds:
        return None
    noticed_by = "scatter of the corrected targets"
    return Suspicion(Cause.REPEATABILITY, found.size, found.unit, noticed_by)


def worse_than_stated(log: Log) -> Suspicion | None:
    """Return a repeatability worse than the stated one, where repeated visits show it.

    The least ratio of RP to the rms distance is taken, and the readings' noise comes on top.
    """
    stated_mm, visits = log.cell.robot.rp_mm, repeated_visits(log)
    if stated_mm is None or not visits:
        return None
    covariance_mm2, count, places = visit_scatter(log, np.eye(3))
    noise_mm2 = float(variances_mm2([*chain(*visits)]).sum(axis=1).mean())
    freedom = trace_freedom(covariance_mm2, count - places)
    most = SPREAD * chi2_quantile(1.0 - RISK, freedom) / freedom
    seen_mm2 = float(np.trace(covariance_mm2))
    # RP = l + 3 S_l over rms distance, scatter alike in all directions; more else
    isotropic = 2.088
    if seen_mm2 <= most * ((stated_mm / isotropic) ** 2 + noise_mm2):
        return None
    size_mm = isotropic * float(np.sqrt(seen_mm2 - noise_mm2))
    noticed_by = f"repeated visits, RP {stated_mm:g} mm stated"
    return Suspicion(Cause.REPEATABILITY, size_mm, "mm", noticed_by)


def _scatter(log: Log) -> Scatter | None:
    deviations = deviations_of(log)
    return None if deviations is None else worst_scatter(deviations)


def deviations_of(log: Log) -> Deviations | None:
    """Return the corrected targets' deviations; None where none or no bound is known."""
    calibration = learnt_so_far(log)
    if calibration is None:
        return None
    parts, arm = [], log.cell.robot.arm()
    for name in (station.name for station in log.cell.station):
        try:
            found = validated_bounds(calibration, log, name)
        except NoBound:  # the report says why
            return None
        if found is None or len(found[0]) < 2:
            continue
        errors, bounds = found
        R = np.array(calibration.stations[name].T_W_B)[:3, :3]
        joints_rad = commanded_rad(validation_points(log, name))
        J = parameter_jacobian(arm, joints_rad)[:, :3, ZEROS] * arm.sign
        covariance_mm2 = bounds.covariance_mm2
        traces = [np.trace(each.covariance_mm2, axis1=1, axis2=2) for each in bounds.parts]
        freedom = effective_freedom(traces, [each.freedom for each in bounds.parts])
        off_mm = errors.error_mm - errors.error_mm.mean(axis=0)
        parts.append(Deviations(off_mm, covariance_mm2, R @ J[:, :, :LARGE_AXES], freedom.min()))
    if not parts:
        return None
    offs_mm, covariances_mm2, columns, freedoms = zip(*parts, strict=True)
    return Deviations(
        np.concatenate(offs_mm), np.concatenate(covariances_mm2), np.concatenate(columns),
        float(min(freedoms)),
    )  # fmt: skip


def worst_scatter(found: Deviations) -> Scatter:
    """Return the test that comes closest to its limit, or is farthest beyond it."""
    off_mm, columns = found.off_mm, found.columns
    weighted = np.linalg.solve(found.covariance_mm2, np.dstack([off_mm, columns]))
    count, axes = len(off_mm), columns.shape[2]
    limit = SPREAD * f_quantile(1.0 - RISK, 3 * count, found.freedom)
    ratio = float(np.einsum("ni,ni->", off_mm, weighted[:, :, 0])) / (3 * count)
    tests = [Scatter(ratio, limit, rms(np.linalg.norm(off_mm, axis=1)), "mm")]
    along = np.einsum("nik,ni->nk", columns, weighted[:, :, 0])
    information = np.einsum("nik,nik->nk", columns, weighted[:, :, 1:])
    directions = 3  # of a covariance: one of them has a third of its degrees of freedom
    limit = SPREAD * f_quantile(1.0 - RISK / axes, count, found.freedom / directions)
    for axis in range(axes):
        known = information[:, axis] > 0.0
        ratio = float(np.mean(along[known, axis] ** 2 / information[known, axis]))
        excess_rad = np.sqrt(max(0.0, ratio - 1.0) / information[known, axis].mean())
        tests.append(
            Scatter(ratio, limit, float(np.degrees(excess_rad)), f"deg of axis {axis + 1}")
        )
    return max(tests, key=lambda test: test.ratio / test.limit)
