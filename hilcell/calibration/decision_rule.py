"""Decision rule for mean and largest error, by `hilcell.model.outcome`.

U is that of the measurement (`measurement_budget`). To first order |e| changes by the measured
position's change along e, so u of one coordinate is that of a single 3D error, and of the largest
of many; in their mean the noise of readings averages, and what moves all targets together acts by
the directions of the errors. The largest orientation error (deg) is judged
likewise where the cell limits it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from hilcell.calibration.frames import nest_leverage
from hilcell.calibration.measurement_budget import common_motion_mm, expanded_mm, measurement_budget
from hilcell.cell.devices import tracker_accuracy
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.geometry.statistics import figures_of, lengths_mm, rectangular_variance
from hilcell.journal.log import Log
from hilcell.journal.previous_reference import FLOOR_NESTS
from hilcell.model.outcome import Outcome, gravest
from hilcell.model.results import Decided
from hilcell.model.verdicts import Judged, Limits, OrientationError
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import counted


class Guard(NamedTuple):
    """Expanded uncertainties of mean and largest 3D error, mm; 0 before anything is measured."""

    mean_mm: float = 0.0
    max_mm: float = 0.0

    def within(self, limits: Limits) -> Limits:
        """Acceptance limits: the limits less U, negative where U is larger."""
        return limits._replace(
            mean_mm=limits.mean_mm - self.mean_mm, max_mm=limits.max_mm - self.max_mm
        )


def tolerance_limits(cell: Cell) -> Limits:
    stated = cell.validation
    return Limits(stated.mean_tolerance_mm, stated.max_tolerance_mm, stated.max_tolerance_deg)


def check_limits(cell: Cell) -> None:
    """Raise `HilcellError` where the stated uncertainties alone consume a limit."""
    least_mm = expanded_mm(math.sqrt(stated_mm2(cell)))
    for name, limit_mm in (("mean", cell.validation.mean_tolerance_mm),
                           ("max", cell.validation.max_tolerance_mm)):  # fmt: skip
        if not limit_mm > least_mm:
            raise HilcellError(
                f"validation.{name}_tolerance_mm {limit_mm:g}: nothing could be accepted, the "
                f"tracker and the reflector's centring alone have U = {least_mm:.3f} mm (k = 2); "
                "state a larger one",
                code="HC-C10",
            )


def stated_mm2(cell: Cell) -> float:
    limits_mm = (cell.uncertainty.tracker_limit_mm, cell.uncertainty.smr_centring_limit_mm)
    return sum(map(rectangular_variance, limits_mm))


def class_warning(cell: Cell, range_mm: float) -> str:
    """Why hardly any largest error could be accepted with the tracker's class, or ""."""
    stated = tracker_accuracy(cell)
    if stated is None:
        return ""
    samples, limit_mm = cell.tracker.samples, cell.validation.max_tolerance_mm
    along_mm, across_rad = stated.accuracy(range_mm / 1000.0)
    single_mm2 = (along_mm**2 + 2.0 * (across_rad * range_mm) ** 2) / 3.0  # of one coordinate
    known_mm2 = stated_mm2(cell)
    least_mm = expanded_mm(math.sqrt(single_mm2 / samples + known_mm2))
    if limit_mm > least_mm:
        return ""
    left_mm2 = (limit_mm / expanded_mm(1.0)) ** 2 - known_mm2
    enough = math.floor(single_mm2 / left_mm2) + 1
    return (
        f"no result can be shown to be in tolerance: by its class the tracker has U = "
        f"{least_mm:.2f} mm (k = 2) with {counted(samples, 'reading')} a target at "
        f"{range_mm / 1000:.1f} m, expected less than validation.max_tolerance_mm {limit_mm:g}; "
        f'the run ends "undecided" or out of tolerance (exit 1). State tracker.samples {enough} or '
        f"more, a tolerance above {least_mm:.2f} mm with room for the robot's error, or a finer "
        "instrument"
    )


def least_mean_mm(cell: Cell) -> float:
    """Least mean tolerance that could be proven with the cell's plan (mm): an error that is the
    robot's stated repeatability alone, and its U by what is stated before anything is measured.

    {W} as the floor nests span it, at the middle of the cube at the grid's station. No noise, drift
    or thermal expansion: a real run needs more.
    """
    centring_mm2 = rectangular_variance(cell.uncertainty.smr_centring_limit_mm)
    nests_mm = np.array([nest.xyz_mm for nest in cell.layout.floor[:FLOOR_NESTS]])
    T_W_B = cell.layout.nominal_base(cell.reference.strip_mm)
    at_mm = apply(T_W_B, cell.grid.centre.matrix()[None, :3, 3])[0]
    world_mm2 = centring_mm2 * nest_leverage(nests_mm, at_mm)
    count = cell.plan.most_targets if cell.plan.quick else cell.validation.others
    rp_over_sigma = 3.615  # RP = mean + 3 s, of distances whose coordinates are normal
    errors_mm = np.random.default_rng(9283).standard_normal((count, 3))
    errors_mm *= (cell.robot.rp_mm or 0.0) / rp_over_sigma
    guard_mm = common_motion_mm(errors_mm, math.sqrt(stated_mm2(cell) + world_mm2))
    return float(lengths_mm(errors_mm).mean()) + guard_mm


def mean_warning(cell: Cell) -> str:
    """Why no mean could be proven to be in tolerance with the cell's plan, or ""."""
    limit_mm, least_mm = cell.validation.mean_tolerance_mm, least_mean_mm(cell)
    if limit_mm > least_mm:
        return ""
    stated = cell.uncertainty
    return (
        f"no mean can be proven to be within validation.mean_tolerance_mm {limit_mm:g}: the least "
        f"that can is {least_mm:.3f} mm, by the robot's repeatability and the U of the mean (k = "
        f"2) of the tracker's limit {stated.tracker_limit_mm:g} mm and the reflector's centring "
        f"{stated.smr_centring_limit_mm:g} mm, at the target and in the floor nests; more targets "
        "do not help. State a larger tolerance, or smaller limits by certificates"
    )


def guard_band(log: Log, errors_mm: Array) -> Guard:
    """U of mean and largest of 3D errors (N, 3); raises `HilcellError` without {W}."""
    budget = measurement_budget(log)
    if budget is None:
        raise HilcellError("no error is judged: no position was measured in {W}", code="HC-C21")
    return Guard(budget.of_mean(errors_mm), budget.U_mm)


def decide(
    mean_mm: float,
    max_mm: float,
    limits: Limits,
    guard: Guard,
    *,
    orientation: OrientationError | None = None,
    sequential: Decided | None = None,
) -> Judged:
    """Decide on mean and largest error, on ``orientation`` by its limit, and accept only what the
    ``sequential`` test of a quick plan accepts as well.
    """
    stated = Judged(
        holds=False,
        mean_mm=mean_mm,
        mean_tolerance_mm=limits.mean_mm,
        max_mm=max_mm,
        max_tolerance_mm=limits.max_mm,
        mean_U_mm=guard.mean_mm,
        max_U_mm=guard.max_mm,
        decided=Outcome.REJECTED,
        decision="",
    )
    if orientation is not None and limits.max_deg is not None:
        stated = replace(
            stated,
            max_deg=orientation.max_deg,
            max_tolerance_deg=limits.max_deg,
            max_U_deg=orientation.U_deg,
        )
    outcome = gravest(each.outcome for each in stated.figures)
    text = outcome.decision
    if sequential is not None:
        outcome = gravest([sequential.outcome, outcome])
        text = sequential.text if outcome is sequential.outcome else outcome.decision
    return replace(stated, holds=outcome is Outcome.ACCEPTED, decided=outcome, decision=text)


def decide_errors(log: Log, errors_mm: Array) -> Judged:
    """Decide on 3D errors (N, 3) of a run, by its cell's limits."""
    found = figures_of(lengths_mm(errors_mm))
    return decide(found.mean, found.max, tolerance_limits(log.cell), guard_band(log, errors_mm))
