"""The robot goes to its safe pose and the drive finds its reference."""

from __future__ import annotations

from hilcell.cell.file import Cell
from hilcell.journal.log import Log
from hilcell.model.plan import Step
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.durations import homing_s, park_s


class Home:
    """Park and reference; a resumed run keeps a reference that drive and strip still prove."""

    name = "home"
    needs = "devices connected"
    moves = "the robot to its safe pose, then the slide to its reference switch"
    measures = "nothing"
    yields = "a referenced drive"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step."""
        return Step(self.name, 0, park_s(cell) + homing_s(cell))

    def perform(self, session: CellSession) -> None:
        """Reference the drive."""
        session.reach("connect")
        if not (session.reached("referenced") and session.rail_referenced()):
            self.home_rail(session)
        session.reach("reference")

    def home_rail(self, session: CellSession) -> None:
        """Bring the robot to its safe pose and the slide to its reference."""
        session.home_rail()

    def result(self, log: Log) -> Result:
        """Return nothing: homing has no figure."""
        return {}
