"""A few corrected poses, re-measured: is the calibration still valid?

For use after weeks, a crash or a change of temperature. {W} comes from the floor nests, so the
tracker may have another position; poses are commanded with the correction, at the calibration's
station.
"""

from __future__ import annotations

from operator import attrgetter

import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.calibration.from_run import ORIENTATION_TOLERANCE_DEG
from hilcell.calibration.lookup import calibration_in, calibration_named, record_of
from hilcell.calibration.recheck import KIND, CheckedPose, RecheckErrors, RecheckResult
from hilcell.cell.file import Cell
from hilcell.compensation.correction import corrected
from hilcell.decoding import typed
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.model.events import CalibrationUsed, OutlierRemeasured
from hilcell.model.frame import Frame
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.model.verdicts import Rechecked
from hilcell.ports import Array
from hilcell.present.table import Column, Table, vector
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_poses
from hilcell.run.procedure import Procedure, Result
from procedures.plan import check_reach, closing, drivable, flange_points, reoriented
from procedures.rail import HoldStation
from procedures.world_frame import Home, WorldFrame

TABLE = "recheck"


class Recheck:
    """Measures the poses; an outlier is re-measured before it counts."""

    name = "recheck"
    needs = "a calibration of this cell, {W}, its station held"
    moves = "the robot to corrected poses spread over the calibrated volume"
    measures = "the flange reflector at every pose"
    yields = "whether the calibration is still valid, is updated, or is to be made again"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a calibration that is missing, and poses out of reach."""
        joints_rad = self.commands_rad(cell, calibration_named(cell, TABLE), seed)
        check_poses(cell, cell.reference, joints_rad, "re-check pose")
        return PlannedStep.of_spans(
            self.name,
            len(joints_rad),
            [flange_points(cell, joints_rad), *closing(cell, carried=True)],
        )

    def perform(self, session: CellSession) -> None:
        cell = session.cell
        calibration = adopt_calibration(session, TABLE)
        station = cell.reference
        targets_mm = self.places_mm(calibration, cell.recheck.poses, session.seed)
        nominal_mm = apply(session.log.matrix("base"), targets_mm)
        joints_rad = self.commands_rad(cell, calibration, session.seed)
        ids = [PointId("recheck", number=n) for n in range(len(targets_mm))]
        for n, id in enumerate(ids):
            session.flange_point(id, station, joints_rad[n], nominal_mm=nominal_mm[n])
        found = RecheckErrors.of_run(session.log).judgement()
        if found.verdict == "redo" and not session.log.point(ids[found.worst]).retaken:
            n = found.worst
            session.add(OutlierRemeasured(key=ids[n].key))
            again = joints_rad[n], nominal_mm[n]
            session.flange_point(ids[n], station, again[0], nominal_mm=again[1], retake=True)
        session.close_step(carried=True)
        result = RecheckResult.of(session.log)
        session.judge(
            "recheck",
            Rechecked(
                holds=result.verdict == "valid",
                verdict=result.verdict,
                drift_mm=result.drift_mm,
                drift_u_mm=result.drift_u_mm,
                doubt=result.doubt,
            ),
        )

    def result(self, log: Log) -> Result:
        return {KIND: RecheckResult.of(log)}

    @staticmethod
    def places_mm(calibration: Calibration, count: int, seed: int) -> Array:
        """Return targets (N, 3) in {B}, evenly spread over the volume, different for each seed."""
        low_mm = np.array(calibration.validity.low_mm)
        high_mm = np.array(calibration.validity.high_mm)
        begin = np.random.default_rng([seed, 230]).uniform(size=3)
        root = 1.2207440846057596  # of x^4 = x + 1: its powers spread points evenly in space
        steps = root ** -np.arange(1.0, 4.0)
        margin = 0.05  # of the volume's sides
        share = (begin + np.outer(np.arange(count), steps)) % 1.0
        places: Array = low_mm + (margin + (1 - 2 * margin) * share) * (high_mm - low_mm)
        return places

    @staticmethod
    def _turned(cell: Cell, calibration: Calibration, poses: Array) -> Array:
        """Poses (N, 4, 4), every other one reoriented where other orientations are calibrated.

        They distinguish a slipped reflector from a moved base. A pose that would be out of reach
        keeps its orientation.
        """
        tilt_deg = calibration.validity.orientation_tolerance_deg
        if not tilt_deg > ORIENTATION_TOLERANCE_DEG:
            return poses
        axes = np.vstack([np.eye(3), -np.eye(3)])
        station, tilt_share = cell.reference, 0.9  # of the angle by which targets may turn
        for n in range(1, len(poses), 2):
            turns = np.radians(tilt_share * tilt_deg) * np.roll(axes, -n, axis=0)
            tried = reoriented(np.tile(poses[n], (len(turns), 1, 1)), turns)
            possible = np.flatnonzero(drivable(cell, station, tried))
            if len(possible):
                poses[n] = tried[possible[0]]
        return poses

    @staticmethod
    def commands_rad(cell: Cell, calibration: Calibration, seed: int) -> Array:
        """Return the joints (N, 6) of the corrected poses; raises `HilcellError` out of reach."""
        poses = calibration.poses_at(Recheck.places_mm(calibration, cell.recheck.poses, seed))
        poses = Recheck._turned(cell, calibration, poses)
        poses[:, :3, 3] = corrected(calibration.grid(), poses, calibration.error_model())
        return check_reach(cell, poses, "re-check pose")


def adopt_calibration(session: CellSession, table: str) -> Calibration:
    """Return the calibration that this run uses; journal it and its base frame."""
    calibration = calibration_in(session.log)
    if calibration is None:
        calibration = calibration_named(session.cell, table)
        path = getattr(session.cell, table).calibration
        session.add(CalibrationUsed(**record_of(calibration, path)))
    if "base" not in session.log.frames:
        entry = calibration.stations[session.cell.grid.station]
        run = calibration.provenance.latest
        session.frame("base", Frame(matrix=entry.T_W_B, calibration=run))
    return calibration


COLUMNS: tuple[Column[CheckedPose], ...] = (
    Column("pose", attrgetter("pose")),
    *vector("", "xyz", "mm", "at_mm", ".0f"),
    Column("error", attrgetter("error_mm"), "mm", ".4f"),
    Column("predicted mm (95 %)", attrgetter("bound_mm"), form=".4f"),
    Column("left after best motion", attrgetter("left_mm"), "mm", ".4f"),
)


RECHECK = Procedure(
    "recheck",
    "a few corrected poses: does the calibration still hold?",
    (Home(), WorldFrame(), HoldStation(), Recheck()),
    lambda result: Table(COLUMNS, typed(result[KIND], RecheckResult).poses),
    words=lambda result: typed(result[KIND], RecheckResult).text,
    uses=TABLE,
)
