"""The calibration file: a finished calibration for others, one JSON schema with a version.

All lengths mm, frames as homogeneous matrices; the errors of the grid stand in {B}, so that they
hold at every station. One changed digit corrects every target wrongly, so the file is sealed, and
judged by `hilcell.calibration.checks`, before it is used.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from hilcell import __version__
from hilcell.calibration.budget import uncertainty_of
from hilcell.calibration.checks import MOST_MM, problems_of
from hilcell.calibration.form import (
    Calibration,
    Device,
    ModelEntry,
    Provenance,
    StationEntry,
    Validity,
    written_now,
)
from hilcell.calibration.frames import Frames, measured_of
from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError, unreadable
from hilcell.compensation.choice import MODELS
from hilcell.compensation.correction import corrected_poses
from hilcell.geometry.frames import apply, inverse, poses_from_zyx, zyx_from_pose
from hilcell.geometry.rotations import from_zyx
from hilcell.journal.calibration_facts import VALIDATION
from hilcell.journal.log import NO_READINGS, Log
from hilcell.ports import Array, HilcellError
from hilcell.writing import write_whole

SCHEMA = 4  # to be raised whenever `Calibration` changes, or what its fields mean
SEAL = "seal"
ORIENTATION_TOLERANCE_DEG = 2.0
NAMED = 5  # targets that one message names


def calibration_of(log: Log, run: str) -> Calibration:
    """Compute the calibration from the log of a run that reached the fit."""
    cell, frames, measured = log.cell, Frames(log.cell, log), measured_of(log)
    grid, fit = measured.grid.grid, log.verdicts["fit"]
    method = str(fit["method"])
    points = log.select("grid")
    celsius = [point.temperature_c for point in points if point.temperature_c is not None]
    high_mm = grid.origin_mm + np.array(cell.grid.size_mm)
    values = {
        "schema": SCHEMA,
        "provenance": Provenance(
            run, cell.name, log.inputs.digest, log.inputs.simulated, log.inputs.operator,
            log.inputs.job, f"hilcell {__version__}", written_now(),
            bool(log.verdicts.get("sign", {}).get("holds", False)),
            log.inputs.versions, devices_of(log), [point.key for point in points], fit["loocv"],
        ),
        "validity": Validity(
            tuple(grid.origin_mm.tolist()), tuple(high_mm.tolist()),
            cell.grid.centre.matrix()[:3, :3].tolist(),
            orientation_tolerance_deg(cell, method),
            (min(celsius), max(celsius)) if celsius else None,
            _more_orientations(cell, method),
        ),
        "stations": {
            station.name: _entry(log, frames.base_in_world(station), station.name)
            for station in cell.station
        },
        "pitch_mm": grid.pitch_mm,
        "grid_errors_mm": measured.grid.errors_mm.tolist(),
        "model": ModelEntry(method, MODELS[method].learn(measured).parameters()),
        "uncertainty": uncertainty_of(log),
        "verdicts": verdicts_of(log),
        "failed": failed_of(log),
    }  # fmt: skip
    return msgspec.convert(msgspec.to_builtins(values), Calibration)


def verdicts_of(log: Log) -> dict[str, dict[str, Any]]:
    """Return the verdicts of a run's validation by place; none where it was not made."""
    return {
        key.removeprefix(VALIDATION): verdict
        for key, verdict in log.verdicts.items()
        if key.startswith(VALIDATION)
    }


def failed_of(log: Log) -> dict[str, str]:
    """Return the verdicts besides the validation's that do not hold, in words."""
    return {
        key: ", ".join(
            f"{name} {_figure(value)}" for name, value in body.items() if name != "holds"
        )
        for key, body in log.verdicts.items()
        if not body["holds"] and not key.startswith(VALIDATION)
    }


def _figure(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def orientation_tolerance_deg(cell: Cell, method: str) -> float:
    """Return by how much targets may turn away from the grid's orientation."""
    tilt_deg = cell.plan.tilt_deg if MODELS[method].turns else 0.0
    return max(ORIENTATION_TOLERANCE_DEG, tilt_deg)


def _more_orientations(cell: Cell, method: str) -> list[list[list[float]]]:
    """Return the orientations that hold besides the grid's: those of a model that knows them."""
    if not MODELS[method].turns:
        return []
    return [from_zyx(angles).tolist() for angles in cell.plan.grid_orientations]


def calibration_so_far(log: Log, run: str) -> Calibration | None:
    """Return the calibration of a log that has reached the fit, nothing before."""
    return log.once(calibration_of, run) if _fitted(log) else None


def learnt_so_far(log: Log) -> Calibration | None:
    """Return the same for what it was learnt from; verdicts that came since may be missing."""
    if not _fitted(log):
        return None
    return log.once(_learnt, log.judged["fit"].seq, besides=NO_READINGS)


def _learnt(log: Log, fit: int) -> Calibration:
    return calibration_of(log, "")


def _fitted(log: Log) -> bool:
    wanted = {"base", *(f"station.{station.name}" for station in log.cell.station)}
    return wanted <= log.frames.keys() and "fit" in log.verdicts


def devices_of(log: Log) -> list[Device]:
    """Return the devices that answered when they were last connected."""
    return [
        Device(each.device, each.model, each.serial, each.kind, each.maker, each.firmware)
        for each in log.assets
    ]


def _entry(log: Log, base: Array, station: str) -> StationEntry:
    frame = log.frames[f"station.{station}"]
    return StationEntry(
        base.tolist(),
        frame["matrix"],
        frame["covariance"],
        frame["tool_uncertainty_mm"],
        frame["strip_mm"],
    )


def write_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole, with its seal; raises `NotWritten`."""
    content = msgspec.json.decode(msgspec.json.encode(calibration))
    text = msgspec.json.encode(content | {SEAL: _seal(content)})
    write_whole(path, msgspec.json.format(text, indent=1) + b"\n")


def read_calibration(path: Path) -> Calibration:
    """Read the file; raises `SettingsError` for anything that is not one, whole and of sense."""
    try:
        data = path.read_bytes()
        schema = msgspec.json.decode(data, type=_Head).schema
        if schema != SCHEMA:
            found = f"schema {schema:.6g}, expected {SCHEMA}; calibrate again"
            raise SettingsError(str(path), [found])
        content = msgspec.json.decode(data)
        problems = seal_problems(content)
        calibration = msgspec.convert(content, Calibration)
    except OSError as error:
        raise unreadable(str(path), error) from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, OverflowError) as error:
        raise SettingsError(str(path), [f"not a calibration file: {error}"]) from error
    problems += problems_of(calibration)
    if problems:
        raise SettingsError(str(path), problems)
    return calibration


def _seal(content: dict[str, Any]) -> str:
    """Return SHA-256 over the canonical JSON of everything but the seal.

    It shows damage and edits by hand; it does not prove who wrote the file.
    """
    rest = {key: value for key, value in content.items() if key != SEAL}
    return hashlib.sha256(msgspec.json.encode(rest, order="sorted")).hexdigest()


def seal_problems(content: dict[str, Any]) -> list[str]:
    """Return what is wrong with the seal of a calibration file's content, if anything is."""
    if content.get(SEAL) == _seal(content):
        return []
    return ["was changed after it was written: its seal does not hold; take the run's own file"]


class _Head(msgspec.Struct):
    schema: int


def compensate_targets(
    calibration: Calibration, station: str, targets: Array, names: list[str]
) -> Array:
    """Return what to command, (N, 6) x, y, z, a, b, c in {W}, for nominal ``targets`` (N, 6).

    The angles are the targets', or corrected where the calibration has measured orientation.
    Raises `HilcellError` naming every target outside the calibrated volume or orientation.
    """
    if station not in calibration.stations:
        known = ", ".join(calibration.stations)
        raise HilcellError(f"station {station!r} is not calibrated; calibrated: {known}")
    far = np.flatnonzero(~(np.abs(targets).max(axis=1) <= MOST_MM))
    if len(far):
        named = ", ".join(names[n] for n in far[:NAMED])
        raise HilcellError(
            f"{len(far)} targets are not in the cell, wanted within +-{MOST_MM:g} mm and deg: "
            f"{named}"
        )
    T_W_B = np.array(calibration.stations[station].T_W_B)
    poses = poses_from_zyx(targets)
    in_base = inverse(T_W_B) @ poses
    _refuse_turned(calibration, in_base, names)
    model = calibration.error_model()
    command = corrected_poses(calibration.grid(), in_base, model, names=names)
    poses[:, :3, 3] = apply(T_W_B, command[:, :3, 3])
    if not calibration.orients:
        return zyx_from_pose(poses)
    poses[:, :3, :3] = T_W_B[:3, :3] @ command[:, :3, :3]
    return _beside(targets, zyx_from_pose(poses))


def _beside(targets: Array, commands: Array) -> Array:
    """Return commands (N, 6) with angles within half a turn of the targets' (N, 6)."""
    beside = commands.copy()
    beside[:, 3:] += 360.0 * np.round((targets[:, 3:] - commands[:, 3:]) / 360.0)
    return beside


def _refuse_turned(calibration: Calibration, poses: Array, names: list[str]) -> None:
    found_deg = calibration.validity.turned_deg(poses)
    limit_deg = calibration.validity.orientation_tolerance_deg
    far = np.flatnonzero(~(found_deg <= limit_deg))
    if len(far):
        named = ", ".join(f"{names[n]} by {found_deg[n]:.2f} deg" for n in far[:NAMED])
        raise HilcellError(
            f"{len(far)} of {len(names)} targets turned away from the calibrated orientation, "
            f"wanted <= {limit_deg} deg: {named}; calibrate with their orientation, or for more "
            "than one with plan.tilt_deg or plan.grid_orientations"
        )
