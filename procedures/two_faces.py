"""The tracker turns over and sees nests in its second face: its own axes, at start and end."""

from __future__ import annotations

from hilcell.calibration.instrument import TWO_FACES, two_faces
from hilcell.cell.devices import abilities
from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.journal.log import Log
from hilcell.model.plan import Span, Step
from hilcell.model.point import BACK, PointId
from hilcell.model.verdicts import FacesCompared
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result
from procedures.durations import measure_s, step

FACE_S = 4.0  # until a tracker has turned over and looks where it looked before
SAMPLES = 5
UNSEEN = "what its axes are off (collimation, transit tilt, index) is not seen"


class TwoFaces:
    """Readings in the second face, compared with the newest ones in the first."""

    needs = "the world frame; a tracker that turns over"
    moves = "nothing but the tracker's head"
    measures = "floor nests, at the start those of certified lengths too, in the second face"
    yields = "whether the tracker's axes are adjusted: collimation, transit tilt, index"

    def __init__(self, *, at_end: bool = False) -> None:
        self._number, self.name = (1, "two-face-closing") if at_end else (0, "two-face")
        self._verdict = TWO_FACES[self._number]

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step; leave it out where it cannot be, or where time is short."""
        if reason := left_out(cell):
            return Step(self.name, 0, 0.0, note=reason)
        count = len(self._nests(cell))
        each_s = 2.0 * FACE_S + measure_s(cell, SAMPLES)
        return step(self.name, 0, [Span("second face", count, count * each_s)])

    def perform(self, session: CellSession) -> None:
        """Measure and judge, once; an axis that is off pauses an attended run."""
        cell, log = session.cell, session.log
        if left_out(cell) or self._verdict in log.verdicts:
            return
        for nest in self._nests(cell):
            session.back_point(PointId(BACK, number=self._number, nest=nest.name), nest, SAMPLES)
        found = two_faces(log, self._number)
        if found is None:  # the tracker was moved meanwhile: no front of this set-up
            return
        wrong = [] if found.holds else [found.text]
        judged = FacesCompared(holds=found.holds, nests=found.nests, found=found.text, wrong=wrong)
        session.judge(self._verdict, judged)
        if wrong:
            session.pause(f"the tracker's axes are off: {found.text}")

    def _nests(self, cell: Cell) -> list[Nest]:
        return cell.layout.floor if self._number else cell.layout.standing

    def result(self, log: Log) -> Result:
        """Return both faces as found, where there are any."""
        found = two_faces(log, self._number)
        key = self._verdict.replace("-", "_").replace(".", "_")
        return {} if found is None else {key: found}


def left_out(cell: Cell) -> str:
    """Return why the tracker is not turned over; "" where it is."""
    if not abilities(cell)["tracker_turns_over"]:
        return f"this tracker's driver does not turn it over: {UNSEEN}"
    if cell.layout.by_hand:
        return f"the reflector is carried by hand: {UNSEEN}"
    if cell.plan.quick:
        return f"a quick plan has no time for it: {UNSEEN}"
    return ""
