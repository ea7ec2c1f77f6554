"""Before work at a station: its base frame as it stands on this visit, for corrected programs.

{W} comes from the floor nests, so the tracker may stand elsewhere than it did when the
calibration was made. The calibration is written again with the touched base of the station;
`hilcell compensate` takes it like any other. It holds until the slide moves.
"""

from __future__ import annotations

from operator import itemgetter

import numpy as np

from hilcell.calibration.form import Calibration
from hilcell.calibration.in_use import NoCalibration, calibration_named
from hilcell.calibration.visit import used
from hilcell.cell.file import Cell, Station
from hilcell.journal.log import Log
from hilcell.model.calibration import StationEntry
from hilcell.model.frame import Frame
from hilcell.model.plan import Step
from hilcell.model.results import ActResult
from hilcell.model.verdicts import Touched
from hilcell.ports import HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from hilcell.typed import typed
from procedures.durations import closing, first_hold, step
from procedures.home import Home
from procedures.recheck import use
from procedures.touch import TouchFound, touch_once, touch_spans, touches
from procedures.world_frame import WorldFrame

TABLE = "touch"


class Touching(ActResult, frozen=True, kw_only=True):
    """The station that was touched, and the run of the calibration that was used."""

    station: str
    calibration: str


class TouchStation:
    """Holds the station, touches, keeps the base; the calibration is written when the run ends."""

    name = "touch"
    needs = "a calibration of this cell, {W}"
    moves = "the slide to the station, the robot to corrected poses spread over the cube"
    measures = "the flange reflector at every pose"
    yields = "the station's base frame on this visit, in a calibration of its own"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse a station that is not calibrated, and poses out of reach."""
        station = station_of(cell)
        _entry(calibration_named(cell, TABLE), station)
        touches = touch_spans(cell, station)
        if not touches:
            raise HilcellError(
                "touch.poses is 0: nothing would be touched; give --set touch.poses=8",
                code="HC-C10",
            )
        spans = [*first_hold(cell, station), *touches, *closing(cell, carried=True)]
        return step(self.name, touches[0].measured, spans)

    def perform(self, session: CellSession) -> None:
        """Adopt the calibration's frames, touch, and journal that it is done."""
        calibration, station = use(session, TABLE), station_of(session.cell)
        reference = session.cell.station_named(session.cell.grid.station)
        for each in (reference, station):
            key, entry = f"station.{each.name}", _entry(calibration, each)
            if key not in session.log.frames:
                run = calibration.provenance.latest
                taken = Frame(matrix=entry.T_W_S, covariance=entry.covariance, calibration=run)
                session.frame(key, taken)
        touch_once(session, station, calibration.error_model())
        session.close_step(carried=True)
        if "touch" not in session.log.verdicts:
            session.judge("touch", Touched(holds=True, station=station.name))

    def result(self, log: Log) -> Result:
        """Return what the touch poses found, where, and with which calibration."""
        found = touches(log)
        if not found:
            return {}
        station = station_of(log.cell).name
        touched = Touching(station=station, calibration=used(log).provenance.latest)
        return {"touch": found, "touched": touched}


def station_of(cell: Cell) -> Station:
    """Return the station that is touched; raises `SettingsError` for one that is unknown."""
    return cell.station_named(cell.touch.station or cell.grid.station)


def _entry(calibration: Calibration, station: Station) -> StationEntry:
    if station.name not in calibration.stations:
        known = ", ".join(calibration.stations)
        raise NoCalibration(
            f"station {station.name} is not calibrated by run {calibration.provenance.latest}; "
            f"calibrated: {known}"
        )
    return calibration.stations[station.name]


def touch_table(result: Result) -> Table:
    """Return by how much the base was moved, and its uncertainty before and after."""
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


def touch_words(result: Result) -> str:
    """Return what the run's calibration is good for, and until when."""
    if "touched" not in result:
        return ""
    found = typed(result["touched"], Touching)
    return (
        f"Calibration {found.calibration} was used; this run's own has the base of {found.station} "
        "on this visit: `hilcell compensate` with this run's name and --station "
        f"{found.station} holds until "
        "the slide moves."
    )


TOUCH = Procedure(
    "touch",
    "before work at a station: its base frame on this visit, for corrected programs",
    (Home(), WorldFrame(), TouchStation()),
    touch_table,
    words=touch_words,
    uses=TABLE,
    of_rail=True,
)
