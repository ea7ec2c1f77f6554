"""The calibration that a run ends with: a new one, or one of before with what the run has changed.

A re-check that found the base moved keeps model and volume of the old calibration and turns its
base frames. The motion was found at one station; the robot stands rigidly on the slide, so it is
the same in {B} at every station.
"""

from __future__ import annotations

import msgspec
import numpy as np

from hilcell.calibration.budget import touched
from hilcell.calibration.file import calibration_of
from hilcell.calibration.form import Calibration, written_now
from hilcell.calibration.in_use import used
from hilcell.calibration.influence import MEASURED, Influence, moved_frame
from hilcell.calibration.recheck import Judgement, rechecked_run
from hilcell.calibration.target_pass import folded, target_points
from hilcell.journal.log import Log
from hilcell.model.calibration import Update
from hilcell.model.frame import TouchedBase
from hilcell.model.verdicts import Fitted, Judged, Touched


def calibration_after(log: Log, run: str) -> Calibration:
    """Return the calibration of a log for which `Log.calibrates` holds."""
    if log.verdict(Fitted) is not None:
        return calibration_of(log, run)
    if (touched := log.verdict(Touched)) is not None:
        return _touched(used(log), log, run, touched.station)
    if log.verdict(Judged, "targets") is not None:
        after = folded(log, run)
        return _updated(after, Update(run, "targets", written_now(), len(target_points(log))))
    return _rebased(used(log), rechecked_run(log), run)


def _rebased(calibration: Calibration, found: Judgement, run: str) -> Calibration:
    """Return the calibration with its base frames where the re-check found the base."""
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
    return _updated(calibration, update, stations=stations, uncertainty=uncertainty)


def _touched(calibration: Calibration, log: Log, run: str, name: str) -> Calibration:
    """Return the calibration with the base of a station as touched on the run's visit."""
    frame, entry = log.frame(TouchedBase, f"touch.{name}"), calibration.stations[name]
    entry = msgspec.structs.replace(entry, T_W_B=frame.matrix)
    update = Update(run, "touch", written_now(), frame.poses)
    stations = calibration.stations | {name: entry}
    uncertainty, line = calibration.uncertainty, touched(log, log.cell.station_named(name))
    if not uncertainty.missing and line is not None:
        placed = uncertainty.stations | {name: [msgspec.structs.replace(line, counts="always")]}
        uncertainty = msgspec.structs.replace(uncertainty, stations=placed)
    return _updated(calibration, update, stations=stations, uncertainty=uncertainty)


def _updated(calibration: Calibration, update: Update, **changes: object) -> Calibration:
    made, replace = calibration.provenance, msgspec.structs.replace
    after = replace(made, written=update.written, updates=[*made.updates, update])
    return replace(calibration, provenance=after, **changes)
