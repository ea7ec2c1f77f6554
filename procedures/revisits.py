"""Poses are visited again: a robot, a mount or a slide that has changed shows there.

After the grid, so that nothing rests on a robot that changed meanwhile: vertices, and the base
frame's outermost poses, since which the mount must not have slipped. At the end of the run, so that
the robot is still the one that was calibrated. After the grid a few vertices are approached from
above as well, which shows the joints' lost motion.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from hilcell.calibration.diagnosis import (
    CLOSING,
    REVISIT,
    VERDICTS,
    established,
    overtaken,
    revisits,
    suspected_causes,
)
from hilcell.calibration.grid import grid_of, vertex_ids
from hilcell.calibration.lost_motion import REVERSAL, reversal
from hilcell.cell.file import Cell
from hilcell.geometry.frames import apply
from hilcell.journal.log import Log
from hilcell.model.events import VisitedOnceMore
from hilcell.model.plan import PlannedStep
from hilcell.model.point import PointId
from hilcell.model.suspicion import suspected_in
from hilcell.model.verdicts import Revisited
from hilcell.ports import Array
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.base_frame import points_on_arc, sweep
from procedures.plan import closing, flange_points, joints_for, leg, stations_in_order
from procedures.validate import judge_suspicions


class Visit(NamedTuple):
    """A pose that is visited again, by joints (6,) in rad: a vertex (3,) in {B}, or of a circle."""

    id: PointId
    joints_rad: Array
    vertex_mm: Array | None = None


class Revisits:
    """Takes poses that are spread over the time since the robot's first point."""

    needs = "the grid, the robot's repeatability"
    moves = "the robot to a few poses of base frame and grid"
    measures = "the flange reflector there, once more; at a few from above as well"
    yields = "whether zero, mount and slide are as they were, which cause fits if not, lost motion"

    def __init__(self, *, at_end: bool = False) -> None:
        """``at_end``: the slide comes from the last station, back to the grid's."""
        self._kind, self.name = (CLOSING, "closing") if at_end else (REVISIT, "revisits")
        self._verdict = VERDICTS[self._kind]

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the step: the grid's own has refused vertices out of reach."""
        joints_rad = np.array([visit.joints_rad for visit in visits(cell, self._kind)])
        spans = [flange_points(cell, joints_rad), *closing(cell)]
        if self._kind == CLOSING:
            spans = [*leg(cell, stations_in_order(cell)[-1], cell.reference), *spans]
        return PlannedStep.of_spans(self.name, len(joints_rad), spans)

    def perform(self, session: CellSession) -> None:
        """Visit, judge, and pause an attended run where something has changed.

        Once more where something was measured since that the visits are to prove.
        """
        cell, log = session.cell, session.log
        station, poses = cell.reference, visits(cell, self._kind)
        T_W_B = session.frames.base_in_world(station)
        while waiting := [visit for visit in poses if self._waits(log, visit.id)]:
            session.expect(station, np.array([visit.joints_rad for visit in waiting]))
            for id, joints_rad, vertex_mm in waiting:
                session.hold_station(station)
                if again := log.find(id) is not None:
                    session.add(VisitedOnceMore(key=id.key))
                nominal_mm = None if vertex_mm is None else apply(T_W_B, vertex_mm)
                session.flange_point(id, station, joints_rad, nominal_mm=nominal_mm, retake=again)
        session.close_step()
        newest = max(log.recorded(log.point(visit.id)) for visit in poses)
        judged = log.judged.get(self._verdict)
        if judged is None or judged.seq < newest:
            self._judge(session)

    def _judge(self, session: CellSession) -> None:
        lost_motion = reversal(session.log) if self._kind == REVISIT else None
        found = revisits(session.log, self._kind)
        if lost_motion is not None:
            session.judge("reversal", lost_motion)
        suspicion = established(session.log, self._kind) or found.suspicion
        judged = Revisited(
            holds=found.holds and suspicion is None,
            ratio=found.ratio,
            limit=found.limit,
            suspicion=suspicion,
            suspected=[] if suspicion is None else [suspicion.text],
        )
        session.judge(self._verdict, judged)
        if self._kind == CLOSING:
            judge_suspicions(session)
        elif found.suspicion is not None:
            session.pause(f"re-visited poses have moved: {found.suspicion.text}")

    def result(self, log: Log) -> Result:
        """Return the lost motion, after the grid; at the end all that is suspected in the run."""
        if self._kind == CLOSING:
            return {"suspicions": suspected_causes(log)}
        lost_motion = reversal(log)
        if lost_motion is None:
            return {}
        figures: dict[str, object] = msgspec.to_builtins(lost_motion)
        del figures["holds"]
        return {"reversal": figures}

    @staticmethod
    def _waits(log: Log, id: PointId) -> bool:
        """Whether a pose waits to be visited, or to be visited once more."""
        point = log.find(id)
        return point is None or overtaken(log, point)


def visits(cell: Cell, kind: str) -> list[Visit]:
    """Return the poses in their order.

    After the grid, the base frame's come first, and the first few vertices are approached from
    above next, where the joints' limits let them.
    """
    vertices_mm = grid_of(cell).serpentine_mm()
    joints_rad = joints_for(cell, vertices_mm)
    beyond_rad = joints_rad + np.radians(cell.robot.approach_deg)
    free = (beyond_rad <= cell.robot.margin_limits_rad[1]).all(axis=1)
    count, ids = len(vertices_mm), vertex_ids(grid_of(cell))
    wanted = min(3 if cell.plan.quick else 12, count)
    numbers = [n * count // wanted for n in range(wanted)]  # the first, and evenly on
    sides = [n for n in numbers if free[n] and kind == REVISIT][:4]
    found = list[Visit]()
    if kind == REVISIT:  # ends of the base frame's sweeps; in a quick plan where it began
        last = points_on_arc(cell) - 1
        ends = [(1, 0)] if cell.plan.quick else [(1, 0), (1, last), (6, 0), (6, last)]
        found = [
            Visit(PointId(REVISIT, axis=axis, number=n), sweep(cell, axis)[n]) for axis, n in ends
        ]
    for n in numbers:
        below = PointId(kind, vertex=ids[n].vertex)
        above = PointId(REVERSAL, vertex=ids[n].vertex, side=1)
        sent = [below, above] if n in sides else [below]
        found += [Visit(id, joints_rad[n], vertices_mm[n]) for id in sent]
    return found


def suspicion_words(result: Result) -> str:
    found = suspected_in(result)
    return "\n".join(f"Suspected: {each.text}. {each.cause.advice}" for each in found)
