"""A re-check as its journal proves it: errors as predicted and as found, and the verdict."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from hilcell.calibration.bounds import driven_poses
from hilcell.calibration.causes import Suspicion
from hilcell.calibration.decision import judged_errors
from hilcell.calibration.influence import no_less_than_nought
from hilcell.calibration.recheck import (
    RISK,
    Judgement,
    Rechecked,
    Verdict,
    judged,
    suspicions,
)
from hilcell.calibration.visit import used, visited
from hilcell.geometry.frames import motion_levers
from hilcell.geometry.statistics import bounds95_mm
from hilcell.journal.log import Log, Point, commanded_rad

KIND = "recheck"


def rechecked_run(log: Log) -> Judgement:
    """Return the judgement of a run that has measured its poses; raises `HilcellError`."""
    return judged(rechecked(log))


def rechecked(log: Log) -> Rechecked:
    """Return errors and covariance of the measured poses, in the calibration's {B}."""
    return as_predicted(log, log.select(KIND), log.cell.grid.station)


def as_predicted(log: Log, points: list[Point], station: str) -> Rechecked:
    """Return errors of points at a station, with the covariance that the calibration predicts."""
    calibration, found = used(log), visited(log, points, station)
    poses = driven_poses(calibration, log, points, found.nominal_mm)
    model = calibration.error_model().predict(poses)
    J = motion_levers(found.nominal_mm).reshape(-1, 7)
    return Rechecked(
        found.nominal_mm,
        found.actual_mm - found.nominal_mm,
        no_less_than_nought(model.covariance_mm2 - found.within_mm2) + found.own_mm2,
        J @ found.common @ J.T,
        poses[:, :3, :3],
    )


def final_verdict(log: Log, found: Judgement) -> Verdict:
    """Return the verdict: redo, where no update brings the errors into tolerance."""
    if found.verdict == "redo":
        return "redo"
    errors_mm = found.left_mm if found.verdict == "update" else rechecked(log).errors_mm
    return found.verdict if judged_errors(log, errors_mm).holds else "redo"


def recheck_result(log: Log) -> dict[str, Any]:
    """Return the verdict, its figures in mm, and the sentence for people; nothing before it."""
    found, judgement = rechecked(log), rechecked_run(log)
    calibration, as_found = used(log), judged_errors(log, found.errors_mm)
    air_c = log.temperatures_c()
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
        "tests": {
            "motion": judgement.moved._asdict(),
            "rest": judgement.rest._asdict(),
            "slip": judgement.slipped._asdict(),
        },
        "risk": RISK,
        "mean_mm": as_found.mean_mm,
        "max_mm": as_found.max_mm,
        "mean_tolerance_mm": as_found.mean_tolerance_mm,
        "max_tolerance_mm": as_found.max_tolerance_mm,
        "mean_U_mm": as_found.mean_U_mm,
        "max_U_mm": as_found.max_U_mm,
        "in_tolerance": as_found.holds,
        "temperature_c": float(np.mean(air_c)) if air_c else None,
        "calibrated_c": calibration.validity.temperature_c,
        "poses": _poses(log, found, judgement),
    }
    arm, joints_rad = log.cell.robot.arm(), commanded_rad(log.select(KIND))
    causes = suspicions(found, judgement, arm, joints_rad)
    result["suspicions"] = [msgspec.to_builtins(cause) for cause in causes]
    return {"recheck": result | {"text": _words(result, judgement.worst, causes)}}


def doubt(result: dict[str, Any]) -> str:
    """Return what explains an update as well as a base that moved; "" is nothing."""
    slips = [each["size"] for each in result["suspicions"] if result["verdict"] == "update"]
    return (
        f"a reflector that slipped by {slips[0]:.3f} mm on its mount explains it as well; see that "
        "it sits; if it had slipped, seat it, revoke this run and re-check"
        if slips
        else ""
    )


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


def _words(result: dict[str, Any], worst: int, causes: list[Suspicion]) -> str:
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
                f"{result['turn_urad']:.0f} µrad, {_instead(causes)} This run's calibration has "
                "the base where it seems to stand now: take its base frames over on the controller "
                "and compensate the programs again."
            )
        case _:
            begin = _redo(result, worst, causes)
    kept = "within" if result["in_tolerance"] else "out of"
    return (
        f"{begin} As found, {result['points']} corrected poses are {result['mean_mm']:.3f} mm off "
        f"in the mean and {result['max_mm']:.3f} mm at most, {kept} tolerance "
        f"({result['mean_tolerance_mm']:g} and {result['max_tolerance_mm']:g} mm; U "
        f"{result['mean_U_mm']:.3f} and {result['max_U_mm']:.3f} mm added)."
    )


def _instead(causes: list[Suspicion]) -> str:
    """Say what may have happened where the base seems to have moved."""
    if causes:
        return (
            f"or the reflector has slipped on its mount by {causes[0].size:.3f} mm, or an axis's "
            "zero is lost: the poses do not tell them apart. See first that the reflector sits on "
            "its mount and that the mastering is right."
        )
    return (
        "or an axis's zero is lost; a reflector that slipped on its mount does not explain it. See "
        "first that the mastering is right."
    )


def _redo(result: dict[str, Any], worst: int, causes: list[Suspicion]) -> str:
    rest = result["tests"]["rest"]
    if rest["chi2"] <= rest["limit"]:
        return "Calibrate again: the errors are as predicted, but out of tolerance."
    pose = result["poses"][worst]
    at = ", ".join(f"{value:.0f}" for value in pose["at_mm"])
    return (
        f"Calibrate again: no motion of the base explains the errors; worst is {pose['pose']} at "
        f"({at}) mm: {pose['error_mm']:.3f} mm, predicted {pose['bound_mm']:.3f} mm (95 %), and "
        f"{pose['left_mm']:.3f} mm after the best motion. {_hint(causes)}"
    )


def _hint(causes: list[Suspicion]) -> str:
    if not causes:
        return "Look for a lost zero of an axis, a loose tool or reflector, another temperature."
    explained = f"It would be explained by: {'; or '.join(cause.words for cause in causes[:3])}."
    if causes[0].cause != "mount slipped":
        return explained
    return (
        f"{explained} Seat the reflector again, take this re-check back with `hilcell revoke`, and "
        "re-check."
    )
