"""Each reflector of the cell once in the same nest: radius and prism against the others."""

from __future__ import annotations

from operator import attrgetter

import msgspec

from hilcell.calibration.instrument import compared_reflectors
from hilcell.cell.file import Cell
from hilcell.decoding import typed
from hilcell.journal.log import Log
from hilcell.model.plan import PlannedStep
from hilcell.model.point import REFLECTOR, PointId
from hilcell.model.verdicts import MeasuredReflector, ReflectorsCompared
from hilcell.ports import HilcellError
from hilcell.present.table import Column, Table
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Procedure, Result
from hilcell.run.prompts import FLANGE
from procedures.plan import closing, readings
from procedures.world_frame import Home, WorldFrame


class Reflectors:
    """The operator carries one after the other to the first floor nest."""

    name = "reflectors"
    needs = "the world frame, an operator who carries the reflectors"
    moves = "nothing"
    measures = "every reflector of floor, bars and flange in the first floor nest"
    yields = "which reflector's ball or prism differs from the others'"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        if cell.layout.by_hand:
            raise HilcellError(
                "the cell has one reflector, which is carried by hand (layout.reflectors): there "
                "is none to compare it with",
                code="HC-C10",
            )
        measured = readings(cell, len(self._places_of(cell)), cell.nest_samples)
        return PlannedStep.of_spans(self.name, 0, [measured, *closing(cell)])

    def perform(self, session: CellSession) -> None:
        cell, nest = session.cell, session.cell.layout.floor[0]
        for place in self._places_of(cell):
            session.swapped_point(PointId(REFLECTOR, nest=place), place, nest)
        session.return_reflectors(nest)
        session.frame_world()
        if self.name not in session.log.verdicts:
            found = compared_reflectors(session.log)
            wrong = [each.text for each in found if not each.holds]
            judged = ReflectorsCompared(holds=not wrong, reflectors=found, wrong=wrong)
            session.judge(self.name, judged)

    def result(self, log: Log) -> Result:
        rows = [
            msgspec.to_builtins(each) | {"holds": each.holds} for each in compared_reflectors(log)
        ]
        return {"reflectors": rows}

    @staticmethod
    def _places_of(cell: Cell) -> list[str]:
        seats = [f"{FLANGE} {n}" for n in range(2, len(cell.robot.seats_mm) + 1)]
        return [*(nest.name for nest in cell.layout.fixed_nests), FLANGE, *seats]

    @staticmethod
    def table(result: Result) -> Table:
        return Table(
            [
                Column("reflector of", attrgetter("place")),
                Column("along the beam", attrgetter("along_mm"), "mm", "+.4f"),
                Column("across", attrgetter("across_mm"), "mm", ".4f"),
                Column("limit", attrgetter("limit_mm"), "mm", ".4f"),
                Column("", lambda row: "" if row.holds else "differs"),
            ],
            typed(result["reflectors"], list[MeasuredReflector]),
        )


REFLECTORS = Procedure(
    "reflectors",
    "each reflector once in the same nest, against the others; attended",
    (Home(), WorldFrame(), Reflectors()),
    Reflectors.table,
    by_hand="carry each reflector to the first floor nest",
)
