"""Vertices are visited again: a robot, a mount or a slide that has changed shows there.

After the grid, so that nothing rests on a robot that changed meanwhile, and at the end of the run,
so that the robot is still the one that was calibrated.
"""

from __future__ import annotations

from typing import Any

import msgspec

from hilcell.calibration.frames import grid_of, vertex_ids
from hilcell.calibration.noticed import CLOSING, REVISIT, revisits, suspicions_of
from hilcell.calibration.suspicions import Suspicion
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Step
from procedures.durations import closing, flange_points, leg, step
from procedures.plan import joints_for, other_stations

COUNT, QUICK_COUNT = 6, 2


class Revisits:
    """Takes vertices that are spread over the time in which the grid was measured."""

    needs = "the grid, the robot's repeatability"
    moves = "the robot to a few vertices of the grid"
    measures = "the flange reflector there, once more"
    yields = "whether zero, mount and slide are as they were, and which cause fits if not"

    def __init__(self, *, at_end: bool = False) -> None:
        """``at_end``: the slide comes from the last station, back to the grid's."""
        self._kind, self.name = (CLOSING, "closing") if at_end else (REVISIT, "revisits")

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step: the grid's own has refused vertices out of reach."""
        joints_rad = joints_for(cell, grid_of(cell).serpentine_mm()[chosen(cell)])
        spans = [flange_points(cell, joints_rad), *closing(cell)]
        if self._kind == CLOSING:
            station = cell.station_named(cell.grid.station)
            spans = [*leg(cell, [station, *other_stations(cell)][-1], station), *spans]
        return step(self.name, len(joints_rad), spans)

    def perform(self, session: CellSession) -> None:
        """Visit, judge, and pause an attended run where something has changed."""
        cell, numbers = session.cell, chosen(session.cell)
        station, grid = cell.station_named(cell.grid.station), grid_of(cell)
        vertices_mm = grid.serpentine_mm()[numbers]
        world_mm = apply(session.frames.base_in_world(station), vertices_mm)
        joints_rad, ids = joints_for(cell, vertices_mm), vertex_ids(grid)
        for n, joints, nominal_mm in zip(numbers, joints_rad, world_mm, strict=True):
            again = PointId(self._kind, vertex=ids[n].vertex)
            if not session.log.find(again):
                session.hold_station(station)
            session.flange_point(again, station, joints, nominal_mm=nominal_mm)
        session.close_step()
        if self.name not in session.log.verdicts:
            self._judge(session)

    def _judge(self, session: CellSession) -> None:
        found = revisits(session.log, self._kind)
        suspected = [] if found.suspicion is None else [found.suspicion.text]
        session.verdict(
            self.name, holds=found.holds, ratio=found.ratio, limit=found.limit, suspected=suspected
        )
        if self._kind == CLOSING:
            suspected = [each.text for each in suspicions_of(session.log)]
            session.verdict("suspicions", holds=not suspected, suspected=suspected)
        elif found.suspicion is not None:
            session.pause(f"re-visited vertices have moved: {found.suspicion.text}")

    def result(self, log: Log) -> dict[str, Any]:
        """Return what is suspected in the whole run; nothing where all is well."""
        return {"suspicions": [msgspec.to_builtins(each) for each in suspicions_of(log)]}


def chosen(cell: Cell) -> list[int]:
    """Return the numbers of the vertices in their order of visit: the first, and evenly on."""
    count = len(grid_of(cell).serpentine_mm())
    wanted = min(QUICK_COUNT if cell.plan.quick else COUNT, count)
    return [n * count // wanted for n in range(wanted)]


def suspicion_words(result: dict[str, Any]) -> str:
    """Return what is suspected, in words."""
    found = [msgspec.convert(each, Suspicion) for each in result.get("suspicions", [])]
    return "\n".join(f"Suspected: {each.text}. Do not use this calibration." for each in found)
