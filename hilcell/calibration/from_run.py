"""The calibration that a run makes: of its own grid, or an update of the one that it used.

A re-check that measured a moved base changes the base frames only. The robot is bolted to the
slide, so the motion in {B} is the same at each station.
"""

from __future__ import annotations

import msgspec
import numpy as np

from hilcell import __version__
from hilcell.calibration.budget import ValidatedTargets, target_uncertainty, touch_influence
from hilcell.calibration.file import SCHEMA, Calibration, ModelEntry, Validity, written_now
from hilcell.calibration.frames import Frames
from hilcell.calibration.grid import learnt_points, measured_errors, measured_grid
from hilcell.calibration.influence import MEASURED, Influence, moved_frame
from hilcell.calibration.known_arm import base_circles, carried_calibration
from hilcell.calibration.lookup import used_calibration
from hilcell.calibration.lost_motion import lost_motion
from hilcell.calibration.recheck import Judgement, RecheckErrors
from hilcell.calibration.target_pass import MeasuredTargets
from hilcell.cell.file import Cell
from hilcell.compensation.model_choice import MODELS
from hilcell.decoding import typed
from hilcell.geometry.frames import from_zyx
from hilcell.journal.log import Log
from hilcell.model.calibration import Device, Provenance, StationEntry, Update
from hilcell.model.frame import MeasuredStation, TouchedBase
from hilcell.model.verdicts import VALIDATION, Fitted, Judged, SignChecked, Touched
from hilcell.ports import Array

ORIENTATION_TOLERANCE_DEG = 2.0


def calibration_from_log(log: Log, run: str) -> Calibration:
    cell, frames, measured = log.cell, Frames(log.cell, log), measured_errors(log)
    lattice, sign, fit = measured_grid(log), log.verdict(SignChecked), log.verdict(Fitted)
    grid = lattice.grid
    if fit is None:
        raise LookupError("the run has not reached the fit")
    method, carried = fit.method, carried_calibration(log)
    devices = [
        Device(each.device, each.model, each.serial, each.kind, each.maker, each.firmware)
        for each in log.assets
    ]
    points = learnt_points(log)
    celsius = [point.temperature_c for point in points if point.temperature_c is not None]
    high_mm = grid.origin_mm + np.array(cell.grid.size_mm)
    # Some models are valid at more orientations than the grid's.
    others = cell.plan.grid_orientations if MODELS[method].any_orientation else []
    further = [from_zyx(angles).tolist() for angles in others]
    values = {
        "schema": SCHEMA,
        "provenance": Provenance(
            run, cell.name, log.inputs.digest, log.inputs.simulated, log.inputs.operator,
            log.inputs.job, f"hilcell {__version__}", written_now(),
            sign is not None and sign.holds,
            log.inputs.versions, devices, [point.key for point in points], fit.loocv,
            arm_from="" if carried is None else carried.provenance.latest,
            links="factory" if log.by_factory_links else "cell file",
        ),
        "validity": Validity(
            tuple(grid.origin_mm.tolist()), tuple(high_mm.tolist()),
            cell.grid.centre.matrix()[:3, :3].tolist(),
            orientation_tolerance_deg(cell, method),
            (min(celsius), max(celsius)) if celsius else None,
            further,
        ),
        "stations": {
            station.name: _entry(log, frames.base_in_world(station), station.name)
            for station in cell.station
        },
        "pitch_mm": grid.pitch_mm,
        "grid_errors_mm": lattice.errors_mm.tolist(),
        "model": ModelEntry(method, MODELS[method].learn(measured).parameters()),
        "uncertainty": target_uncertainty(log),
        "lost_motion": lost_motion(log),
        "verdicts": validation_verdicts(log),
        "failed": other_failed_verdicts(log),
        "circles": base_circles(log),
    }  # fmt: skip
    return typed(msgspec.to_builtins(values), Calibration)


def validation_verdicts(log: Log) -> dict[str, Judged]:
    """Verdicts of a run's validation by place; none without validation."""
    return {
        key.removeprefix(VALIDATION): verdict
        for key, verdict in log.verdicts.items()
        if isinstance(verdict, Judged) and key.startswith(VALIDATION)
    }


def other_failed_verdicts(log: Log) -> dict[str, str]:
    return {
        key: verdict.why
        for key, verdict in log.verdicts.items()
        if not (verdict.holds or key.startswith(VALIDATION))
    }


def orientation_tolerance_deg(cell: Cell, method: str) -> float:
    tilt_deg = cell.plan.tilt_deg if MODELS[method].any_orientation else 0.0
    return max(ORIENTATION_TOLERANCE_DEG, tilt_deg)


def calibration_so_far(log: Log, run: str) -> Calibration | None:
    return log.once(calibration_from_log, run) if _has_model(log) else None


def learnt_so_far(log: Log) -> Calibration | None:
    """Return the calibration of no run yet, for what it predicts: of the verdicts it has only those
    when it was first asked for since the last measurement.
    """
    return _since_fit(log)[0] if _has_model(log) else None


def learnt_targets(log: Log) -> list[ValidatedTargets]:
    """Return the corrected targets of each station, with the bounds of `learnt_so_far`."""
    return _since_fit(log)[1] if _has_model(log) else []


def _since_fit(log: Log) -> tuple[Calibration, list[ValidatedTargets]]:
    return log.once_measured(_learnt, log.verdict_records["fit"].seq)


def _learnt(log: Log, _: int) -> tuple[Calibration, list[ValidatedTargets]]:
    calibration = calibration_from_log(log, "")
    return calibration, [ValidatedTargets(calibration, log, s.name) for s in log.cell.station]


def _has_model(log: Log) -> bool:
    expected = {"base", *(f"station.{station.name}" for station in log.cell.station)}
    return expected <= log.frames.keys() and "fit" in log.verdicts


def _entry(log: Log, base: Array, station: str) -> StationEntry:
    frame = log.frame(MeasuredStation, f"station.{station}")
    tool_mm, strip_mm = frame.tool_uncertainty_mm, frame.strip_mm
    return StationEntry(base.tolist(), frame.matrix, frame.covariance, tool_mm, strip_mm)


def calibration_after(log: Log, run: str) -> Calibration:
    """Calibration from a log for which `Log.calibrates` holds."""
    if log.verdict(Fitted) is not None:
        return calibration_from_log(log, run)
    if (touched := log.verdict(Touched)) is not None:
        return _with_touched_base(used_calibration(log), log, run, touched.station)
    if log.verdict(Judged, "targets") is not None:
        targets = MeasuredTargets(log)
        update = Update(run, "targets", written_now(), len(targets.points))
        return _with_update(targets.updated(run), update)
    return _with_moved_base(used_calibration(log), RecheckErrors.of_run(log).judgement(), run)


def _with_moved_base(calibration: Calibration, found: Judgement, run: str) -> Calibration:
    stations = {
        name: msgspec.structs.replace(entry, T_W_B=(np.array(entry.T_W_B) @ found.base).tolist())
        for name, entry in calibration.stations.items()
    }
    motion, covariance = found.motion.tolist(), found.covariance.tolist()
    update = Update(run, "base", written_now(), len(found.left_mm), motion, covariance)
    uncertainty = calibration.uncertainty
    base_update = "Base frame, updated"
    if not uncertainty.missing:
        how = f"{len(found.left_mm)} poses of the re-check, less what its frames are uncertain by"
        line = Influence(base_update, MEASURED, how, "4.2.2", "base", moved_frame(found.covariance))
        lines = [each for each in uncertainty.lines if each.name != base_update]
        uncertainty = msgspec.structs.replace(uncertainty, lines=[*lines, line])
    return _with_update(calibration, update, stations=stations, uncertainty=uncertainty)


def _with_touched_base(calibration: Calibration, log: Log, run: str, name: str) -> Calibration:
    frame, entry = log.frame(TouchedBase, f"touch.{name}"), calibration.stations[name]
    entry = msgspec.structs.replace(entry, T_W_B=frame.matrix)
    update = Update(run, "touch", written_now(), frame.poses)
    stations = calibration.stations | {name: entry}
    uncertainty, line = calibration.uncertainty, touch_influence(log, log.cell.station_named(name))
    if not uncertainty.missing and line is not None:
        placed = uncertainty.stations | {name: [msgspec.structs.replace(line, applies="always")]}
        uncertainty = msgspec.structs.replace(uncertainty, stations=placed)
    return _with_update(calibration, update, stations=stations, uncertainty=uncertainty)


def _with_update(calibration: Calibration, update: Update, **changes: object) -> Calibration:
    made, replace = calibration.provenance, msgspec.structs.replace
    after = replace(made, written=update.written, updates=[*made.updates, update])
    return replace(calibration, provenance=after, **changes)
