"""Noise of the tracker on the floor nests."""

from operator import attrgetter

from hilcell.cell.file import Cell
from hilcell.decoding import typed
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.model.results import StepResult
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from procedures.plan import floor_nest_points
from procedures.world_frame import Home, WorldFrame


class Noise(StepResult, frozen=True, kw_only=True):
    """The largest standard deviation of all nests; the fields are the keys of its JSON."""

    largest_mm: float


class FloorNoise:
    """Measures every floor nest once more."""

    name = "floor-noise"
    needs = "{W}"
    moves = "nothing"
    measures = "the floor nests"
    yields = "the largest standard deviation"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the step; raises `HilcellError` for points that cannot be measured."""
        return PlannedStep.of_spans(self.name, len(cell.layout.floor), [floor_nest_points(cell)])

    def perform(self, session: CellSession) -> None:
        """Measure; the session skips points that the journal holds."""
        for nest in session.cell.layout.floor:
            session.floor_nest_point(PointId("noise", nest=nest.name), nest)

    def result(self, log: Log) -> Result:
        """Compute this act's share of the result from the log alone."""
        largest_mm = max(max(point.std_mm) for point in log.select("noise"))
        return {"floor_noise": Noise(largest_mm=largest_mm)}


def table(result: Result) -> Table:
    """Return the result for the terminal, the screen and the report."""
    found = typed(result["floor_noise"], Noise)
    return Table([Column("floor noise", attrgetter("largest_mm"), "mm", ".4f")], [found])


FLOOR_NOISE = Procedure(
    "floor-noise", "noise of the floor nests", (Home(), WorldFrame(), FloorNoise()), table
)
