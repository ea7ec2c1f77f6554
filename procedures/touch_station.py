"""Before work at a station: its base frame on this visit, for corrected programs.

{W} comes from the floor nests, so the tracker may have another position than in the calibration.
The calibration is written again with the touched base, for `hilcell compensate`, and is valid until
the slide moves.

The robot moves its reflector to a few corrected targets, which measure the strip's slip of this
visit. Later commands on this visit use that base; the targets' positions in {W} stay as defined
before. A validation touches its stations, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import itemgetter

import numpy as np

from hilcell.calibration.file import Calibration
from hilcell.calibration.grid import grid_of
from hilcell.calibration.lookup import (
    NoCalibration,
    calibration_in,
    calibration_named,
    used_calibration,
)
from hilcell.calibration.touch import FrameUpdate, TouchPoses, touch_ids, touch_targets_mm
from hilcell.cell.file import Cell, Station
from hilcell.compensation.correction import corrected
from hilcell.compensation.model import ErrorModel
from hilcell.decoding import typed
from hilcell.geometry.frames import apply, point_variance_mm2, to_rotvec
from hilcell.journal.log import Log
from hilcell.model.calibration import StationEntry
from hilcell.model.events import Three
from hilcell.model.frame import Frame, TouchedBase
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.results import StepResult
from hilcell.model.verdicts import Suspicion, Touched
from hilcell.ports import DeviceError, HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from procedures import plan
from procedures.recheck import adopt_calibration
from procedures.world_frame import Home, WorldFrame

MOST_MISFIT = 5.0  # sigmas


class TouchFound(StepResult, frozen=True, kw_only=True):
    """The touch poses of a station's last visit, as in `TouchedBase`."""

    poses: int
    shift_mm: Three
    along_rail_mm: float
    turn_urad: Three
    growth_um_m: float
    u_before_mm: float
    u_after_mm: float
    pull: float
    misfit: float
    left_out: list[str]


def touch_spans(cell: Cell, station: Station) -> list[Span]:
    """Return the span of one visit's touch poses, if there are any; refuse any out of reach."""
    if not cell.touch.poses:
        return []
    poses = plan.poses_at(cell, touch_targets_mm(cell, station))
    joints_rad = plan.check_targets(cell, station, poses, f"touch pose at {station.name}")
    return [plan.flange_points(cell, joints_rad[plan.nearest_next(cell, joints_rad)])]


def touch_once(session: CellSession, station: Station, model: ErrorModel) -> None:
    if not session.cell.touch.poses:
        return
    session.retake_waiting()
    session.hold_station(station)
    if not session.frames.is_touched(station):
        _touch(session, station, model)


def _touch(session: CellSession, station: Station, model: ErrorModel) -> None:
    cell, log = session.cell, session.log
    targets_mm, T_W_B = touch_targets_mm(cell, station), session.frames.base_in_world(station)
    targets_mm = targets_mm[plan.nearest_next(cell, plan.joints_for(cell, targets_mm))]
    poses = plan.poses_at(cell, targets_mm)
    joints_rad = plan.joints_for(cell, corrected(grid_of(cell), poses, model))
    nominal_mm = apply(T_W_B, targets_mm)
    points, visit = [], -1
    while log.visit != visit:  # a retake at another station ends the visit
        visit = log.visit
        session.expect(station, joints_rad)
        points = [
            session.flange_point(id, station, joint_rad, nominal_mm=at_mm)
            for id, joint_rad, at_mm in zip(
                touch_ids(cell, station, visit), joints_rad, nominal_mm, strict=True
            )
        ]
    touched, model_mm2 = TouchPoses(log, station, points), model.predict(poses).covariance_mm2
    found = touched.base(model_mm2)
    # In a later run, without re-visits: 80 undisturbed ones pull <= 2.3 sigmas.
    most_pull = 6.0 if calibration_in(log) is None else 3.5
    check_agreement(station, found, most_pull, lambda: touched.suspicion(model_mm2))
    centre_mm = cell.grid.centre.matrix()[None, :3, 3]
    shift_mm = (apply(found.T, centre_mm) - apply(T_W_B, centre_mm))[0]
    u_mm = [
        math.sqrt(point_variance_mm2(T_W_B, each, centre_mm[0]))
        for each in (touched.prior[:6, :6], found.covariance)
    ]
    session.frame(
        f"touch.{station.name}",
        TouchedBase(
            matrix=found.T.tolist(),
            points=[point.key for point in points],
            covariance=found.covariance.tolist(),
            visit=visit,
            growth=found.growth,
            poses=len(points),
            left_out=[points[n].key for n in found.left_out],
            pull=found.pull,
            misfit=found.misfit,
            shift_mm=tuple(shift_mm.tolist()),
            along_rail_mm=float(shift_mm @ cell.layout.rail_direction),
            turn_urad=tuple((1e6 * to_rotvec(found.T[:3, :3] @ T_W_B[:3, :3].T)).tolist()),
            growth_um_m=1e6 * found.growth,
            u_before_mm=u_mm[0],
            u_after_mm=u_mm[1],
        ),
    )


def check_agreement(
    station: Station, found: FrameUpdate, most_pull: float, cause: Callable[[], Suspicion]
) -> None:
    """Refuse touch poses that contradict the station frame; name the likeliest cause."""
    if found.pull <= most_pull and found.misfit <= MOST_MISFIT:
        return
    suspicion = cause()
    raise DeviceError(
        "HC-T63",
        "Cell",
        f"touch poses at {station.name}",
        f"they move the base by {found.pull:.1f} sigma of the station frame and leave "
        f"{found.misfit:.1f} sigma of their own",
        expected=f"<= {most_pull:g} and <= {MOST_MISFIT:g} sigma",
        act="a nest, the strip, the tool or an axis' zero has changed; check them, then start a "
        "new run",
        fields=suspicion.facts
        | {
            "station": station.name,
            "pull": found.pull,
            "most_pull": most_pull,
            "misfit": found.misfit,
            "most_misfit": MOST_MISFIT,
        },
    )


def touches(log: Log) -> dict[str, TouchFound]:
    return {
        station.name: typed(log.frames[key], TouchFound, from_attributes=True)
        for station in log.cell.station
        if (key := f"touch.{station.name}") in log.frames
    }


TABLE = "touch"


class Touching(StepResult, frozen=True, kw_only=True):
    """The station that was touched, and the run of the calibration that was used."""

    station: str
    calibration: str


class TouchStation:
    """Holds the station and touches it; the calibration is written at the run's end."""

    name = "touch"
    needs = "a calibration of this cell, {W}"
    moves = "the slide to the station, the robot to corrected poses spread over the cube"
    measures = "the flange reflector at every pose"
    yields = "the station's base frame on this visit, in a calibration of its own"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse a station that is not calibrated, and poses out of reach."""
        station = self.station(cell)
        self._entry(calibration_named(cell, TABLE), station)
        touch = touch_spans(cell, station)
        if not touch:
            raise HilcellError(
                "touch.poses is 0: nothing would be touched; give --set touch.poses=8",
                code="HC-C10",
            )
        spans = [*plan.first_hold(cell, station), *touch, *plan.closing(cell, carried=True)]
        return PlannedStep.of_spans(self.name, touch[0].measured, spans)

    def perform(self, session: CellSession) -> None:
        calibration, station = adopt_calibration(session, TABLE), self.station(session.cell)
        reference = session.cell.reference
        for each in (reference, station):
            key, entry = f"station.{each.name}", self._entry(calibration, each)
            if key not in session.log.frames:
                run = calibration.provenance.latest
                taken = Frame(matrix=entry.T_W_S, covariance=entry.covariance, calibration=run)
                session.frame(key, taken)
        touch_once(session, station, calibration.error_model())
        session.close_step(carried=True)
        if "touch" not in session.log.verdicts:
            session.judge("touch", Touched(holds=True, station=station.name))

    def result(self, log: Log) -> Result:
        found = touches(log)
        if not found:
            return {}
        station = self.station(log.cell).name
        touched = Touching(station=station, calibration=used_calibration(log).provenance.latest)
        return {"touch": found, "touched": touched}

    @staticmethod
    def _entry(calibration: Calibration, station: Station) -> StationEntry:
        if station.name not in calibration.stations:
            known = ", ".join(calibration.stations)
            raise NoCalibration(
                f"station {station.name} is not calibrated by run {calibration.provenance.latest}; "
                f"calibrated: {known}"
            )
        return calibration.stations[station.name]

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("station", itemgetter(0)),
                Column("poses", lambda row: row[1].poses, form="d"),
                Column("along rail", lambda row: row[1].along_rail_mm, "mm", "+z.4f"),
                Column("shift", lambda row: float(np.linalg.norm(row[1].shift_mm)), "mm", ".4f"),
                Column("turn", lambda row: float(np.linalg.norm(row[1].turn_urad)), "µrad", ".1f"),
                Column("u before", lambda row: row[1].u_before_mm, "mm", ".4f"),
                Column("u", lambda row: row[1].u_after_mm, "mm", ".4f"),
            ],
            typed(result.get("touch", {}), dict[str, TouchFound]).items(),
        )

    @staticmethod
    def words(result: Result) -> str:
        if "touched" not in result:
            return ""
        found = typed(result["touched"], Touching)
        return (
            f"Calibration {found.calibration} was used; this run's own has the base of "
            f"{found.station} on this visit: `hilcell compensate` with this run's name and "
            f"--station {found.station} holds until the slide moves."
        )

    @staticmethod
    def station(cell: Cell) -> Station:
        """Return the station that is touched; raises `SettingsError` for one that is unknown."""
        return cell.station_named(cell.touch.station or cell.grid.station)


TOUCH = Procedure(
    "touch",
    "before work at a station: its base frame on this visit, for corrected programs",
    (Home(), WorldFrame(), TouchStation()),
    TouchStation.table,
    words=TouchStation.words,
    uses=TABLE,
    of_rail=True,
)
