"""{W} is constructed from three nests on the floor (section 5.1), the tracker's anchor."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from hilcell.calibration.instrument import known_lengths
from hilcell.cell.file import Cell
from hilcell.journal.log import Log
from hilcell.journal.set_ups import world_key
from hilcell.model.frame import Matrix
from hilcell.model.plan import Span, Step
from hilcell.model.point import LENGTH, PointId
from hilcell.model.results import ActResult
from hilcell.model.verdicts import LengthsChecked
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.durations import closing, floor_points, readings, step
from procedures.plan import check_range


def length_spans(cell: Cell) -> list[Span]:
    """Return the span of the bars' nests; those on the floor are measured anyway."""
    count = len(cell.layout.bar)
    return [readings(cell, count, cell.nest_samples)] if count else []


def check_lengths(session: CellSession) -> None:
    """Measure and judge the certified lengths, once; a wrong one pauses an attended run."""
    layout = session.cell.layout
    if not layout.length or session.log.verdict(LengthsChecked) is not None:
        return
    for nest in layout.bar:
        session.floor_point(PointId(LENGTH, nest=nest.name), nest)
    found = known_lengths(session.cell, session.log)
    wrong = [each.text for each in found if not each.holds]
    session.judge("known-length", LengthsChecked(holds=not wrong, lengths=found, wrong=wrong))
    if wrong:
        session.pause(f"the tracker's scale is not the certificate's: {'; '.join(wrong)}")


class SetUps(ActResult, frozen=True, kw_only=True):
    """The tracker in {W} at its last set-up and at all of them; how often it moved."""

    T_W_L: Matrix
    moved: int
    set_ups: list[Matrix]


@dataclass(frozen=True)
class WorldFrame:
    """Measures the floor nests; on resume it proves first that the tracker has not moved.

    ``proves``: it does so at its end as well, where no other step will.
    """

    proves: bool = False
    name = "world-frame"
    needs = "reflectors in the floor nests, and on bars of known length"
    moves = "nothing"
    measures = "three floor nests, averaged, and the nests of certified lengths"
    yields = "the tracker in {W}"

    def plan(self, cell: Cell, seed: int) -> Step:
        """Refuse nests out of the tracker's range."""
        check_range(cell, np.array([nest.xyz_mm for nest in cell.layout.floor]), "floor nests")
        nests_mm = np.array([nest.xyz_mm for nest in cell.layout.bar]).reshape(-1, 3)
        check_range(cell, nests_mm, "bar's nests")
        spans = [floor_points(cell), *length_spans(cell), *(closing(cell) if self.proves else [])]
        return step(self.name, len(cell.layout.floor), spans)

    def perform(self, session: CellSession) -> None:
        """Measure the nests and build the frame, or check the frame that the journal holds."""
        session.frame_world()
        check_lengths(session)
        if self.proves and not session.cell.layout.by_hand:
            session.frame_world()
        session.reach("frame_world")

    def result(self, log: Log) -> Result:
        """Return the tracker's set-ups, and the certified lengths as found, if there are any."""
        moved, checked = log.set_ups.number, log.verdict(LengthsChecked)
        set_ups = [log.matrix(world_key(number)).tolist() for number in range(moved + 1)]
        tracker = SetUps(T_W_L=set_ups[-1], moved=moved, set_ups=set_ups)
        lengths = [
            msgspec.to_builtins(each) | {"off_ppm": each.off_ppm, "holds": each.holds}
            for each in (() if checked is None else checked.lengths)
        ]
        return {"tracker": tracker} | ({"known_lengths": lengths} if lengths else {})
