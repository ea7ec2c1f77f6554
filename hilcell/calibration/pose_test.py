"""The pose test of ISO 9283 from a run's log: characteristics, uncertainties, conditions.

AP compares with the commanded pose in {B}. Where {B} was measured in the run, its uncertainty is
AP's too; where a calibration gave it, that of {W} is, by which the tracker finds it again. RP, AD
and RD need no frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hilcell.calibration.contribution import combined_mm, expanded_mm
from hilcell.calibration.errors import Errors, errors_of
from hilcell.calibration.in_use import calibration_in
from hilcell.calibration.measurement_budget import NOISE, WORLD, budget_of
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply, inverse, motion_levers
from hilcell.geometry.pose_test import (
    CYCLE,
    ENDS,
    PLANE,
    DistanceFigures,
    PoseFigures,
    cube_poses_mm,
    cube_side_mm,
    distance_figures,
    pose_figures,
)
from hilcell.geometry.statistics import rms
from hilcell.journal.log import Log, Point, variances_mm2
from hilcell.ports import Array

ISO = "iso9283"  # kind of the points, key of result and verdict
STANDARD_CYCLES = 30
RATED_PERCENT = 100.0
NOT_MEASURED = ["AP_a", "AP_b", "AP_c", "RP_a", "RP_b", "RP_c"]
LIMITS = ("ap", "rp", "ad", "rd")
PAUSED = ("paused", "suspended")  # states of a run


def commanded_mm(cell: Cell) -> dict[str, Array]:
    """Return the test poses' positions (3,) in {B} by name."""
    centre_mm = cell.grid.centre.matrix()[:3, 3]
    return cube_poses_mm(centre_mm, cube_side_mm(cell.grid.size_mm))


def velocity_percent(cell: Cell) -> float:
    """Return the speed of the test, in percent of the rated one."""
    stated = cell.iso9283.velocity_percent
    return cell.robot.speed_percent if stated is None else stated


def attained(log: Log) -> dict[str, Errors]:
    """Return what was attained at each pose, in {B} and in order of the cycles, so far."""
    T_B_W = inverse(log.matrix("base"))
    found = {name: errors_of(log, points) for name, points in _visits(log).items() if points}
    return {
        name: Errors(apply(T_B_W, each.nominal_mm), each.error_mm @ T_B_W[:3, :3].T)
        for name, each in found.items()
    }


def _visits(log: Log) -> dict[str, list[Point]]:
    """Return the points of each pose."""
    visits: dict[str, list[Point]] = {name: [] for name in sorted(CYCLE)}
    for point in log.select(ISO):
        visits[point.id.pose].append(point)
    return visits


def pose_test(log: Log) -> dict[str, Any]:
    """Return the test's conditions and results; lengths in mm, U at 95 % (k = 2)."""
    cell, clouds, used = log.cell, attained(log), calibration_in(log)
    corrected_by = "" if used is None else used.provenance.latest
    poses = {
        name: _pose(log, name, _figures(each), corrected=bool(corrected_by))
        for name, each in clouds.items()
    }
    distance = _distance(log, clouds)
    worst = {key: max(poses, key=lambda name: poses[name][f"{key}_mm"]) for key in ("ap", "rp")}
    found = {
        **_conditions(log),
        "corrected_by": corrected_by,
        "cube": {
            "side_mm": cube_side_mm(cell.grid.size_mm),
            "centre_mm": cell.grid.centre.matrix()[:3, 3].tolist(),
            "plane": "-".join(PLANE),
        },
        "poses": poses,
        "distance": distance,
        "worst": {
            f"{key}_{what}": poses[name][f"{key}_{what}"] if what != "pose" else name
            for key, name in worst.items()
            for what in ("mm", "u95_mm", "pose")
        },
        "not_measured": NOT_MEASURED,
        "deviations": [*_deviations(cell, corrected=bool(corrected_by)), *interruptions(log)],
    }
    limits = {f"{key}_limit_mm": getattr(cell.iso9283, f"{key}_limit_mm") for key in LIMITS}
    return found | {"limits": {key: value for key, value in limits.items() if value is not None}}


def _figures(visits: Errors) -> PoseFigures:
    return pose_figures(visits.nominal_mm + visits.error_mm, visits.nominal_mm[0])


def _pose(log: Log, name: str, found: PoseFigures, *, corrected: bool) -> dict[str, Any]:
    at_mm = commanded_mm(log.cell)[name]
    known_mm2 = found.scatter_mm2 / found.count + _common_mm2(log, at_mm, corrected=corrected)
    x_mm, y_mm, z_mm = found.ap_mm.tolist()
    return {
        "commanded_mm": at_mm.tolist(),
        "count": found.count,
        "ap_mm": found.ap_p_mm,
        "ap_x_mm": x_mm,
        "ap_y_mm": y_mm,
        "ap_z_mm": z_mm,
        "ap_u95_mm": expanded_mm(found.along(known_mm2)),
        "rp_mm": found.rp_mm,
        "rp_u95_mm": expanded_mm(found.rp_u_mm),
        "rp_robot_mm": found.rp_without_mm(
            float(variances_mm2(_visits(log)[name]).sum(axis=1).mean())
        ),
        "l_mean_mm": found.l_mean_mm,
        "s_l_mm": found.s_l_mm,
    }


def _distance(log: Log, clouds: Mapping[str, Errors]) -> dict[str, Any]:
    ends = [clouds[name] for name in ENDS]
    found: DistanceFigures = distance_figures(
        (ends[0].nominal_mm + ends[0].error_mm, ends[1].nominal_mm + ends[1].error_mm),
        np.array([each.nominal_mm[0] for each in ends]),
    )
    both_mm = math.hypot(found.ad_u_mm, math.sqrt(2.0) * _system_mm(log, framed=False))
    x_mm, y_mm, z_mm = found.ad_xyz_mm.tolist()
    return {
        "from": ENDS[0],
        "to": ENDS[1],
        "commanded_mm": found.commanded_mm,
        "ad_mm": found.ad_mm,
        "ad_x_mm": x_mm,
        "ad_y_mm": y_mm,
        "ad_z_mm": z_mm,
        "ad_u95_mm": expanded_mm(both_mm),
        "rd_mm": found.rd_mm,
        "rd_u95_mm": expanded_mm(found.rd_u_mm),
    }


def _common_mm2(log: Log, at_mm: Array, *, corrected: bool) -> Array:
    """Return the covariance (3, 3) in {B}, at ``at_mm`` (3,), that all attainments share."""
    covariance: Array = _system_mm(log, framed=corrected) ** 2 * np.eye(3)
    if not corrected:
        T = log.matrix("base")
        base = np.array(log.frames["base"]["covariance"], dtype=float)
        J = motion_levers((T[:3, :3] @ at_mm)[None])[0, :, :6]
        covariance += T[:3, :3].T @ (J @ base @ J.T) @ T[:3, :3]
    return covariance


def _system_mm(log: Log, *, framed: bool) -> float:
    """Return u of one coordinate but for the readings' noise, which the scatter has; with that of
    {W} where results are ``framed`` by it.
    """
    budget = budget_of(log)
    without = (NOISE,) if framed else (NOISE, WORLD)
    lines = [] if budget is None else [each for each in budget.lines if each.name not in without]
    return combined_mm(lines)


def _conditions(log: Log) -> dict[str, Any]:
    """Return the test conditions (clause 6) as far as the run or the cell file knows them."""
    cell, table, celsius = log.cell, log.cell.iso9283, log.temperatures_c()
    return {
        "cycles": table.cycles,
        "velocity_percent": velocity_percent(cell),
        "load_kg": table.load_kg,
        "rated_load_kg": table.rated_load_kg,
        "warm_up_min": table.warm_up_min,
        "stabilisation_s": cell.settle.robot_s,
        "temperature_c": [min(celsius), max(celsius)] if celsius else None,
        "tracker_noise_mm": rms([point.std_mm for point in log.select(ISO)]),
    }


def _deviations(cell: Cell, *, corrected: bool) -> Iterator[str]:
    """Yield in what the test departs from the standard's own conditions."""
    table, speed_percent = cell.iso9283, velocity_percent(cell)
    if table.cycles != STANDARD_CYCLES:
        yield f"{table.cycles} cycles, the standard has {STANDARD_CYCLES}"
    if speed_percent != RATED_PERCENT:
        yield f"{speed_percent:g} % of the rated velocity, the standard asks for 100 %"
    if table.load_kg is None or table.rated_load_kg is None:
        yield "the load is not stated (iso9283.load_kg, iso9283.rated_load_kg)"
    elif table.load_kg != table.rated_load_kg:
        yield f"{table.load_kg:g} kg of {table.rated_load_kg:g} kg rated load, wanted 100 %"
    if table.warm_up_min is None:
        yield "the warm-up is not stated (iso9283.warm_up_min)"
    if corrected:
        yield "the commanded poses carry a correction: the robot with its calibration is tested"
    yield "distances are taken from the pose cycle, not from a cycle of their own"
    yield "orientations were not measured: the test takes the position of one reflector"


def interruptions(log: Log) -> Iterator[str]:
    """Yield in what the cycles were no steady course: stops and pauses between two visits."""
    visits = log.select(ISO)
    sessions = len({point.session for point in visits})
    if sessions > 1:
        held = "; the slide was held again, its slip is in RP" if log.cell.has_rail else ""
        yield f"the cycles were interrupted {_times(sessions - 1)} and resumed{held}"
    places = [log.recorded(point) for point in visits]
    pauses = sum(
        record.body["to"] in PAUSED and min(places) < record.seq < max(places)
        for record in log.life
    )
    if pauses:
        yield f"the cycles were paused {_times(pauses)}, the robot at rest meanwhile"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def judgement(result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the verdict on the stated limits, {} without any: a figure and its U keep a limit."""
    found = {
        "ap": (result["worst"]["ap_mm"], result["worst"]["ap_u95_mm"]),
        "rp": (result["worst"]["rp_mm"], result["worst"]["rp_u95_mm"]),
        "ad": (abs(result["distance"]["ad_mm"]), result["distance"]["ad_u95_mm"]),
        "rd": (result["distance"]["rd_mm"], result["distance"]["rd_u95_mm"]),
    }
    facts: dict[str, Any] = {}
    for key, (figure_mm, u95_mm) in found.items():
        limit_mm = result["limits"].get(f"{key}_limit_mm")
        if limit_mm is None:
            continue
        facts |= {f"{key}_mm": figure_mm, f"{key}_u95_mm": u95_mm, f"{key}_limit_mm": limit_mm}
        facts["holds"] = facts.get("holds", True) and figure_mm + u95_mm <= limit_mm
    return facts
