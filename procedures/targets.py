"""A pass over the drill targets: driven corrected, measured, folded into the calibration."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from hilcell.calibration.file import Calibration, compensate_targets
from hilcell.calibration.lookup import calibration_named
from hilcell.calibration.target_pass import KIND, MeasuredTargets, TargetsResult, listed_targets
from hilcell.cell.file import Cell, Station
from hilcell.compensation.targets import read_targets
from hilcell.decoding import typed
from hilcell.geometry.frames import inverse, poses_from_zyx
from hilcell.journal.log import Log
from hilcell.model.events import OutlierRemeasured, TargetsListed
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.ports import Array, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_poses
from hilcell.run.procedure import Procedure, Result
from procedures.plan import check_reach, closing, first_hold, flange_points
from procedures.recheck import adopt_calibration
from procedures.world_frame import Home, WorldFrame

TABLE = "targets"


class TargetPass:
    """Measures every target once and re-measures outliers."""

    name = "targets"
    needs = "a calibration of this cell, {W}, a list of targets"
    moves = "the slide to the station, the robot to every corrected target"
    measures = "the flange reflector at every target, and the floor nests at the end"
    yields = "the calibration with the targets' errors folded in by their share"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a missing calibration, and targets outside of its validity or out of reach."""
        names, values = self.targets(cell)
        station = self.station(cell)
        joints_rad = self._commands_rad(cell, calibration_named(cell, TABLE), names, values)
        check_poses(cell, station, joints_rad, "target")
        measured = flange_points(cell, joints_rad)
        proofs = closing(cell, carried=True, points=len(names))
        return PlannedStep.of_spans(
            self.name, len(names), [*first_hold(cell, station), measured, *proofs]
        )

    def perform(self, session: CellSession) -> None:
        cell, calibration = session.cell, adopt_calibration(session, TABLE)
        if listed_targets(session.log) is None:
            names, values = self.targets(cell)
            file = str(self._table(cell))
            session.add(TargetsListed(file=file, names=names, values=values.tolist()))
        names, values = listed_targets(session.log) or ([], np.zeros((0, 6)))
        joints_rad = self._commands_rad(cell, calibration, names, values)
        for name, joints, nominal_mm in zip(names, joints_rad, values[:, :3], strict=True):
            id = PointId(KIND, target=name)
            session.flange_point(id, self.station(cell), joints, nominal_mm=nominal_mm)
        for name in MeasuredTargets(session.log).gross:
            n, id = names.index(name), PointId(KIND, target=name)
            if not session.log.point(id).retaken:
                session.add(OutlierRemeasured(key=id.key))
                session.flange_point(
                    id, self.station(cell), joints_rad[n], nominal_mm=values[n, :3], retake=True
                )
        session.close_step(carried=True)
        targets = MeasuredTargets(session.log)
        found = targets.verdict()
        holds = found.holds and targets.common_motion() is None
        session.judge("targets", replace(found, holds=holds))

    def result(self, log: Log) -> Result:
        found = MeasuredTargets(log).result()
        return {KIND: msgspec.to_builtins(found) | {"text": found.text}}

    @staticmethod
    def table(result: Result) -> Table:
        found, most = typed(result[KIND], TargetsResult).targets, 20
        return Table(
            [
                Column("target", attrgetter("name")),
                Column("error", attrgetter("error_mm"), "mm", ".4f"),
            ],
            sorted(found, key=lambda each: -each.error_mm)[:most],
        )

    @staticmethod
    def _table(cell: Cell) -> Path:
        """Return the file of targets; raises `HilcellError` where the cell names none."""
        if cell.targets is None:
            raise HilcellError(
                "targets.file is missing: give a CSV with --set targets.file=FILE", code="HC-C13"
            )
        return Path(cell.targets.file)

    @staticmethod
    def targets(cell: Cell) -> tuple[list[str], Array]:
        """Return names and values (N, 6) in {W} of the file's targets."""
        names, values = read_targets(TargetPass._table(cell))
        if not len(names) <= (most := 1000):
            raise HilcellError(
                f"{len(names)} targets, at most {most} are measured in one pass", code="HC-C10"
            )
        return names, values

    @staticmethod
    def station(cell: Cell) -> Station:
        """Return the station of the pass: the grid's, where the table names none."""
        named = cell.targets.station if cell.targets is not None else ""
        return cell.station_named(named or cell.grid.station)

    @staticmethod
    def _commands_rad(
        cell: Cell, calibration: Calibration, names: list[str], values: Array
    ) -> Array:
        """Return the joints (N, 6) of the corrected targets; refuses as `compensate` does."""
        station = TargetPass.station(cell).name
        commands = compensate_targets(calibration, station, values, names)
        T_W_B = calibration.base(station)
        return check_reach(cell, inverse(T_W_B) @ poses_from_zyx(commands), "target")


TARGETS = Procedure(
    "targets",
    "measure targets with their correction, and fold them into the calibration",
    (Home(), WorldFrame(), TargetPass()),
    TargetPass.table,
    words=lambda result: typed(result[KIND], TargetsResult).text,
    uses=TABLE,
)
