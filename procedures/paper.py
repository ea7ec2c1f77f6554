"""The whole paper in one run: every system and experiment, its figure beside ours."""

from __future__ import annotations

from operator import attrgetter

from hilcell.cell.file import Cell
from hilcell.journal.log import Log
from hilcell.model.plan import Step
from hilcell.model.results import PaperRow
from hilcell.ports import HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Part, Procedure, Result
from hilcell.typed import typed
from procedures.axis_sweeps import AxisSweeps
from procedures.base_frame import BaseFrame
from procedures.fit import Fit
from procedures.frame_repeatability import FrameRepeatability
from procedures.home import Home
from procedures.paper_figures import Experiments
from procedures.paper_rows import ROWS, Row
from procedures.rail_survey import RailSurvey
from procedures.repeatability import Repeatability
from procedures.robot_grid import RobotGrid
from procedures.sign_check import SignCheck
from procedures.station import HoldStation, StationRepeatability
from procedures.station_frames import StationFrames
from procedures.validate import Validate
from procedures.world_frame import WorldFrame

EXPERIMENTS: tuple[Part, ...] = (
    Home(),
    WorldFrame(),
    RailSurvey(),
    StationRepeatability(),
    HoldStation(),
    BaseFrame(),
    RobotGrid(),
    AxisSweeps(),
    Repeatability(),
    StationFrames(),
    FrameRepeatability(),
    Fit(),
    SignCheck(),
    Validate(),
)


class PaperRows:
    """Compares the run's figures with the paper's."""

    name = "paper-rows"
    needs = "all experiments"
    moves = "nothing"
    measures = "nothing"
    yields = "the paper's figures beside ours"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse a quick plan: the paper's figures are of the paper's own."""
        if cell.plan.quick:
            raise HilcellError(
                "plan.quick: the paper's rows need every target; leave it out, or run calibrate",
                code="HC-C10",
            )
        return Step(self.name, 0, 0.0)

    def perform(self, session: CellSession) -> None:
        """Do nothing: the rows are computed from the journal."""

    def result(self, log: Log) -> Result:
        """Return the rows."""
        found = experiments(log)
        return {"rows": [row.judged(log, found) for row in rows_for(log)]}


def experiments(log: Log) -> Experiments:
    """Return the results of all experiments."""
    return typed(Procedure("experiments", "", EXPERIMENTS, paper_table).result(log), Experiments)


def rows_for(log: Log) -> list[Row]:
    """Return the rows that the run can answer: those of the air only where it was measured."""
    return [row for row in ROWS if row.unit != "C" or log.temperatures_c()]


def paper_table(result: Result) -> Table:
    """Return the rows for a person to read."""
    return Table(
        [
            Column("row", attrgetter("row")),
            Column("paper", attrgetter("paper"), form="g"),
            Column("here", attrgetter("here"), form=".4g"),
            Column("chosen", attrgetter("chosen"), form=".4g"),
            Column("unit", attrgetter("unit")),
            Column("criterion", attrgetter("criterion")),
            Column("", attrgetter("verdict")),
        ],
        typed(result["rows"], list[PaperRow]),
    )


PAPER = Procedure(
    "paper",
    "every system and experiment of the paper, its figures beside ours",
    (*EXPERIMENTS, PaperRows()),
    paper_table,
    of_rail=True,
)
