"""The pose test of ISO 9283 from a run's log: characteristics, uncertainties, conditions.

AP compares with the commanded pose in {B}. Where {B} was measured in the run, its uncertainty is
AP's too; where a calibration gave it, that of {W} is, by which the tracker finds it again. RP, AD
and RD need no frame.

With several reflectors on the flange the orientation is measured as well. RP of its angles needs no
more; AP needs to know where the reflectors are on the flange, and only a calibration does.
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
from hilcell.calibration.orientation import Turned, turned_of, turned_rad2
from hilcell.cell.file import Cell
from hilcell.compensation.kinematic import Kinematic
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
    turn_figures,
)
from hilcell.geometry.statistics import rms
from hilcell.journal.log import Log, Point, variances_mm2
from hilcell.ports import Array

ISO = "iso9283"  # kind of the points, key of result and verdict
STANDARD_CYCLES = 30
RATED_PERCENT = 100.0
ANGLES = ("a", "b", "c")
LIMITS = ("ap", "rp", "ad", "rd")
TURN_LIMITS = ("ap", "rp")  # of angles
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
    visits: dict[str, list[Point]] = {name: [] for name in sorted(CYCLE)}
    for point in log.select(ISO):
        visits[point.id.pose].append(point)
    return visits


def pose_test(log: Log) -> dict[str, Any]:
    """Return the test's conditions and results; lengths in mm, U at 95 % (k = 2)."""
    cell, clouds, used = log.cell, attained(log), calibration_in(log)
    corrected_by = "" if used is None else used.provenance.latest
    poses = {
        name: _pose(log, name, pose_figures(at.nominal_mm + at.error_mm, at.nominal_mm[0]),
                    corrected=bool(corrected_by))
        for name, at in clouds.items()
    }  # fmt: skip
    distance, turns = _distance(log, clouds), _turns(log)
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
        "orientation": turns,
        "not_measured": _not_measured(turns),
        "deviations": [
            *_deviations(cell, corrected=bool(corrected_by), turns=turns),
            *interruptions(log),
        ],
    }
    names = [f"{key}_limit_mm" for key in LIMITS] + [f"{key}_limit_deg" for key in TURN_LIMITS]
    limits = {name: getattr(cell.iso9283, name) for name in names}
    return found | {"limits": {key: value for key, value in limits.items() if value is not None}}


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


def _turns(log: Log) -> dict[str, dict[str, Any]]:
    """Return AP and RP of the angles a, b, c (deg) by pose; nothing with one reflector."""
    if not log.cell.robot.more_smr_mm:
        return {}
    known, found = _known_seats(log), {}
    seats = log.cell.robot.seats_mm if known is None else known
    for name, points in _visits(log).items():
        turned = turned_of(log, points, seats)
        if len(turned) > 1:
            found[name] = _angles(log, turned, known=known is not None)
    return found


def _known_seats(log: Log) -> Array | None:
    """Return where the reflectors (K, 3) are on the flange, by the calibration that is tested."""
    used = calibration_in(log)
    model = None if used is None else used.learnt_model()
    seats = model.state.smr_mm if isinstance(model, Kinematic) else np.zeros((0, 3))
    return seats if len(seats) == len(log.cell.robot.seats_mm) else None


def _angles(log: Log, turned: Turned, *, known: bool) -> dict[str, Any]:
    """Return the angles' characteristics, axes of {B}.

    Reflectors that are elsewhere on the flange than stated turn every attainment alike: in RP that
    cancels, in AP it does not.
    """
    R = log.matrix("base")[:3, :3]
    found = turn_figures(turned.error_rad @ R)
    rp_deg, rp_u_deg = np.degrees(found.rp_rad), np.degrees(found.rp_u_rad)
    figures = {
        "count": found.count,
        "rp_deg": dict(zip(ANGLES, rp_deg.tolist(), strict=True)),
        "rp_u95_deg": dict(zip(ANGLES, (2.0 * rp_u_deg).tolist(), strict=True)),
    }
    if not known:
        return figures
    shared_rad2 = R.T @ turned_rad2(log, turned, readings=False).mean(axis=0) @ R
    u_rad = np.sqrt(found.s_rad**2 / found.count + np.diag(shared_rad2))
    ap_deg, ap_u_deg = np.degrees(found.ap_rad), np.degrees(u_rad)
    return figures | {
        "ap_deg": dict(zip(ANGLES, ap_deg.tolist(), strict=True)),
        "ap_u95_deg": dict(zip(ANGLES, (2.0 * ap_u_deg).tolist(), strict=True)),
    }


def worst_turn(turns: Mapping[str, Any], key: str) -> tuple[str, str, float, float] | None:
    """Return pose, angle, AP or RP by ``key`` and its U, deg, where figure and U are most; None
    where it was not measured.
    """
    found = [
        (pose, angle, abs(value), each[f"{key}_u95_deg"][angle])
        for pose, each in turns.items()
        for angle, value in each.get(f"{key}_deg", {}).items()
    ]
    return max(found, key=lambda each: np.nan_to_num(each[2] + each[3], nan=np.inf), default=None)


def turn_words(turns: Mapping[str, Any]) -> str:
    """Return the worst AP and RP of angles in a sentence; "" where none was measured."""
    worst = [(key, worst_turn(turns, key)) for key in TURN_LIMITS]
    said = [
        f"{key.upper()}_{each[1]} {'±' if key == 'rp' else ''}{each[2]:.4f}° (U {each[3]:.4f}, "
        f"{each[0]})"
        for key, each in worst if each is not None
    ]  # fmt: skip
    return f" Worst of the angles: {', '.join(said)}." if said else ""


def _not_measured(turns: Mapping[str, Any]) -> list[str]:
    """Return the characteristics that the test leaves out."""
    return [
        f"{key.upper()}_{angle}"
        for key in TURN_LIMITS
        for angle in ANGLES
        if worst_turn(turns, key) is None
    ]


def _deviations(cell: Cell, *, corrected: bool, turns: Mapping[str, Any]) -> Iterator[str]:
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
    if not turns:
        yield "orientations were not measured: the test takes the position of one reflector"
    elif worst_turn(turns, "ap") is None:
        yield "AP_a, AP_b and AP_c were not measured: no calibration says where the reflectors are"


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
        ("ap", "mm"): (result["worst"]["ap_mm"], result["worst"]["ap_u95_mm"]),
        ("rp", "mm"): (result["worst"]["rp_mm"], result["worst"]["rp_u95_mm"]),
        ("ad", "mm"): (abs(result["distance"]["ad_mm"]), result["distance"]["ad_u95_mm"]),
        ("rd", "mm"): (result["distance"]["rd_mm"], result["distance"]["rd_u95_mm"]),
    }
    for key in TURN_LIMITS:
        worst = worst_turn(result.get("orientation", {}), key)
        found[key, "deg"] = (math.nan, math.nan) if worst is None else worst[2:]
    facts: dict[str, Any] = {}
    for (key, unit), (figure, u95) in found.items():
        limit = result["limits"].get(f"{key}_limit_{unit}")
        if limit is None:
            continue
        facts |= {f"{key}_{unit}": figure, f"{key}_u95_{unit}": u95, f"{key}_limit_{unit}": limit}
        facts["holds"] = facts.get("holds", True) and figure + u95 <= limit
    return facts
