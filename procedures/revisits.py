"""Vertices are visited again: a robot, a mount or a slide that has changed shows there."""

from __future__ import annotations

from typing import Any

import msgspec

from hilcell.calibration.frames import grid_of, vertex_ids
from hilcell.calibration.noticed import REVISIT, revisits, suspicions_of
from hilcell.calibration.suspicions import Suspicion
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.journal.point_id import PointId
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Step
from procedures.durations import closing, flange_points, step
from procedures.plan import joints_for

COUNT, QUICK_COUNT = 6, 2


class Revisits:
    """Takes vertices that are spread over the time in which the grid was measured."""

    name = "revisits"
    needs = "the grid, the robot's repeatability"
    moves = "the robot to a few vertices of the grid"
    measures = "the flange reflector there, a second time"
    yields = "whether zero, mount and slide are as they were, and which cause fits if not"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step: the grid's own has refused vertices out of reach."""
        joints_rad = joints_for(cell, grid_of(cell).serpentine_mm()[chosen(cell)])
        return step(self.name, len(joints_rad), [flange_points(cell, joints_rad), *closing(cell)])

    def perform(self, session: CellSession) -> None:
        """Visit, judge, and pause an attended run where something has changed."""
        cell, numbers = session.cell, chosen(session.cell)
        station, grid = cell.station_named(cell.grid.station), grid_of(cell)
        vertices_mm = grid.serpentine_mm()[numbers]
        world_mm = apply(session.frames.base_in_world(station), vertices_mm)
        joints_rad, ids = joints_for(cell, vertices_mm), vertex_ids(grid)
        for n, joints, nominal_mm in zip(numbers, joints_rad, world_mm, strict=True):
            again = PointId(REVISIT, vertex=ids[n].vertex)
            session.flange_point(again, station, joints, nominal_mm=nominal_mm)
        session.close_step()
        if "revisits" in session.log.verdicts:
            return
        found = revisits(session.log)
        suspected = [] if found.suspicion is None else [found.suspicion.text]
        session.verdict(
            "revisits", holds=found.holds, ratio=found.ratio, limit=found.limit, suspected=suspected
        )
        if found.suspicion is not None:
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
