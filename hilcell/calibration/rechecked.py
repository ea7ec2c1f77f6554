"""A re-check as its journal proves it: errors as predicted and as found, and the verdict."""

from __future__ import annotations

from typing import Any

import numpy as np

from hilcell.calibration.budget import temperature
from hilcell.calibration.form import Calibration
from hilcell.calibration.in_use import NoCalibration, calibration_in
from hilcell.calibration.recheck import (
    RISK,
    Judgement,
    NotJudged,
    Rechecked,
    Verdict,
    in_tolerance,
    judged,
)
from hilcell.geometry.frames import apply, inverse
from hilcell.geometry.statistics import (
    bounds95_mm,
    figures_of,
    lengths_mm,
    reading_variances_mm2,
)
from hilcell.journal.log import Log, Point, positions_mm
from hilcell.ports import Array

KIND = "recheck"


def rechecked_run(log: Log) -> Judgement:
    """Return the judgement of a run that has measured its poses; raises `NotJudged`."""
    return judged(rechecked(log))


def rechecked(log: Log) -> Rechecked:
    """Return errors and covariance of the measured poses, in the calibration's {B}."""
    calibration, T_W_B = used(log), log.matrix("base")
    points = log.select(KIND)
    T_B_W = inverse(T_W_B)
    T_B_L = T_B_W @ log.matrix("world")
    nominal_mm = np.array([point.nominal_mm for point in points], dtype=float)
    targets_mm = apply(T_B_W, nominal_mm)
    errors_mm = apply(T_B_L, positions_mm(points)) - targets_mm
    model = calibration.error_model().predict(poses_at(calibration, targets_mm))
    alone_mm2, together_mm2 = _predicted_mm2(log, calibration, targets_mm)
    own_mm2 = model.covariance_mm2 + alone_mm2 + _readings_mm2(points, T_B_L[:3, :3])
    return Rechecked(targets_mm, errors_mm, own_mm2, together_mm2)


def used(log: Log) -> Calibration:
    """Return the calibration that the run uses; raises `NoCalibration` before it does."""
    calibration = calibration_in(log)
    if calibration is None:
        raise NoCalibration("the run has used no calibration yet")
    return calibration


def poses_at(calibration: Calibration, places_mm: Array) -> Array:
    """Return poses (N, 4, 4) in {B} at places (N, 3), in the calibrated orientation."""
    poses = np.tile(np.eye(4), (len(places_mm), 1, 1))
    poses[:, :3, :3] = np.array(calibration.validity.orientation)
    poses[:, :3, 3] = places_mm
    return poses


def final_verdict(log: Log, found: Judgement) -> Verdict:
    """Return the verdict: redo, where no update brings the errors into tolerance."""
    if found.verdict == "redo":
        return "redo"
    errors_mm = found.left_mm if found.verdict == "update" else rechecked(log).errors_mm
    limits = log.cell.validation
    kept = in_tolerance(errors_mm, limits.mean_tolerance_mm, limits.max_tolerance_mm)
    return found.verdict if kept else "redo"


def _readings_mm2(points: list[Point], R: Array) -> Array:
    """Return the covariances (N, 3, 3) of averaged readings, turned by ``R`` (3, 3)."""
    variances_mm2 = reading_variances_mm2([p.std_mm for p in points], [p.samples for p in points])
    turned: Array = np.einsum("ij,nj,kj->nik", R, variances_mm2, R)
    return turned


def _predicted_mm2(log: Log, calibration: Calibration, targets_mm: Array) -> tuple[Array, Array]:
    """Return the budget's covariances of each target by itself, (N, 3, 3), and of all together,
    (3N, 3N), both in {B}.

    The tracker was set up for the calibration and again for the re-check, so that the lines of
    {W} count twice. The drill is no part of the re-check.
    """
    stated = calibration.uncertainty
    if stated is None or stated.missing:
        reason = stated.missing if stated is not None else "its file states no uncertainty"
        raise NotJudged(f"re-check: {reason}; calibrate again")
    T_W_B, station = log.matrix("base"), log.cell.grid.station
    frames, at_mm = {"world": np.eye(4), "base": T_W_B}, apply(T_W_B, targets_mm)
    air_c = log.temperatures_c()
    now_c = float(np.mean(air_c)) if air_c and calibration.validity.temperature_c else None
    air = temperature(
        stated.growth_per_k, calibration.validity.temperature_c, stated.air_range_k, now_c
    )
    alone = np.zeros((len(targets_mm), 3, 3))
    together = np.zeros((3 * len(targets_mm), 3 * len(targets_mm)))
    set_up = [each for each in stated.lines if each.frame == "world" and not each.alone]
    for line in (*stated.lines, *set_up, *stated.stations[station], air):
        if line.frame == "tool" or line.counts == "in validation":
            continue
        if line.alone:
            alone += line.at(frames[line.frame], at_mm)
        else:
            together += line.together(frames[line.frame], at_mm)
    R = T_W_B[:3, :3]
    turn = np.kron(np.eye(len(targets_mm)), R.T)
    return R.T @ alone @ R, turn @ together @ turn.T


def recheck_result(log: Log) -> dict[str, Any]:
    """Return the verdict, its figures in mm, and the sentence for people; nothing before it."""
    found, judgement = rechecked(log), rechecked_run(log)
    limits, calibration = log.cell.validation, used(log)
    errors = figures_of(lengths_mm(found.errors_mm))
    kept = errors.mean <= limits.mean_tolerance_mm and errors.max <= limits.max_tolerance_mm
    result = {
        "verdict": final_verdict(log, judgement),
        "calibration": calibration.provenance.latest,
        "station": log.cell.grid.station,
        "points": len(found.errors_mm),
        "drift_mm": judgement.drift_mm,
        "drift_u_mm": judgement.drift_u_mm,
        "shift_mm": judgement.shift_mm,
        "u_mm": judgement.u_mm,
        "turn_urad": judgement.turn_urad,
        "turn_u_urad": judgement.turn_u_urad,
        "chi2": judgement.chi2,
        "tests": {"motion": judgement.moved._asdict(), "rest": judgement.rest._asdict()},
        "risk": RISK,
        "mean_mm": errors.mean,
        "max_mm": errors.max,
        "mean_tolerance_mm": limits.mean_tolerance_mm,
        "max_tolerance_mm": limits.max_tolerance_mm,
        "in_tolerance": kept,
        "temperature_c": _mean_c(log),
        "calibrated_c": calibration.validity.temperature_c,
        "poses": _poses(log, found, judgement),
    }
    return {"recheck": result | {"text": _words(result, judgement.worst)}}


def _mean_c(log: Log) -> float | None:
    air_c = log.temperatures_c()
    return float(np.mean(air_c)) if air_c else None


def _poses(log: Log, found: Rechecked, judgement: Judgement) -> list[dict[str, Any]]:
    bounds = bounds95_mm(found.each_mm2)
    return [
        {
            "pose": point.key,
            "at_mm": found.targets_mm[n].tolist(),
            "error_mm": float(np.linalg.norm(found.errors_mm[n])),
            "bound_mm": float(bounds[n]),
            "left_mm": float(np.linalg.norm(judgement.left_mm[n])),
            "sigmas": float(judgement.sigmas[n]),
        }
        for n, point in enumerate(log.select(KIND))
    ]


def _words(result: dict[str, Any], worst: int) -> str:
    """Return the verdict as a technician reads it."""
    spread = 2.0 * result["u_mm"]
    match result["verdict"]:
        case "valid":
            begin = (
                f"Still valid: the errors are as calibration {result['calibration']} predicts; "
                f"drift {result['drift_mm']:.3f} mm, uncertainty {result['drift_u_mm']:.3f} mm."
            )
        case "update":
            begin = (
                f"Update: the robot's base has moved by {result['shift_mm']:.3f} mm ± "
                f"{spread:.3f} mm (k = 2) at the volume's middle and turned by "
                f"{result['turn_urad']:.0f} µrad; this run's calibration has the base where it "
                "stands now: take its base frames over on the controller and compensate the "
                "programs again."
            )
        case _:
            begin = _redo(result, worst)
    kept = "within" if result["in_tolerance"] else "out of"
    return (
        f"{begin} As found, {result['points']} corrected poses are {result['mean_mm']:.3f} mm off "
        f"in the mean and {result['max_mm']:.3f} mm at most, {kept} tolerance "
        f"({result['mean_tolerance_mm']:g} and {result['max_tolerance_mm']:g} mm)."
    )


def _redo(result: dict[str, Any], worst: int) -> str:
    rest = result["tests"]["rest"]
    if rest["chi2"] <= rest["limit"]:
        return "Calibrate again: the errors are as predicted, but out of tolerance."
    pose = result["poses"][worst]
    at = ", ".join(f"{value:.0f}" for value in pose["at_mm"])
    return (
        f"Calibrate again: no motion of the base explains the errors; worst is {pose['pose']} at "
        f"({at}) mm: {pose['error_mm']:.3f} mm, predicted {pose['bound_mm']:.3f} mm (95 %), and "
        f"{pose['left_mm']:.3f} mm after the best motion. Look for a lost zero of an axis, a loose "
        "tool or reflector, another temperature."
    )
