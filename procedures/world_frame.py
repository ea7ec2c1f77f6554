"""The first steps of a run: the drive's reference, {W}, and checks of the tracker.

{W} is constructed from three floor nests (section 5.1). Certified lengths check the tracker's
scale, its second face the adjustment of its axes, at start and end.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from hilcell.calibration.instrument import TWO_FACES, known_lengths, two_faces
from hilcell.cell.devices import abilities
from hilcell.cell.file import Cell
from hilcell.cell.layout import Nest
from hilcell.cell.tables import Pose
from hilcell.decoding import typed
from hilcell.journal.log import Log, positions_mm, world_key
from hilcell.model.frame import Matrix
from hilcell.model.plan import PlannedStep, Span
from hilcell.model.point import BACK, LENGTH, PointId
from hilcell.model.results import StepResult
from hilcell.model.verdicts import FacesCompared, LengthsChecked
from hilcell.run.cell_session import CellSession
from hilcell.run.procedure import Result, Step
from hilcell.run.watch import check_reflector
from procedures import plan


class Home(Step):
    """Park and reference; a resumed run keeps a reference on which drive and strip agree."""

    name = "home"
    needs = "devices connected"
    moves = "the robot to its safe pose, then the slide to its reference switch"
    measures = "nothing"
    yields = "a referenced drive"

    def announced(self, cell: Cell) -> str:
        """Every question has the robot's way to its safe pose."""
        if not cell.has_rail:
            return "nothing"
        return f"the slide to its reference at {cell.rail.homing_mm_s:g} mm/s, if it has lost it"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        return PlannedStep(self.name, 0, plan.park_s(cell) + plan.homing_s(cell))

    def perform(self, session: CellSession) -> None:
        session.reach("connect")
        if not (session.reached("referenced") and session.rail_referenced()):
            self.home_rail(session)
        session.reach("reference")

    def home_rail(self, session: CellSession) -> None:
        session.home_rail()


class SetUps(StepResult, frozen=True, kw_only=True):
    """The tracker in {W} at its last set-up and at all of them; how often it moved.

    ``pose`` is the last as the cell file states it; ``off_mm`` and ``off_deg`` are from there.
    """

    T_W_L: Matrix
    pose: Pose
    off_mm: float
    off_deg: float
    moved: int
    set_ups: list[Matrix]


@dataclass(frozen=True)
class WorldFrame:
    """Measures the floor nests; on resume it first verifies that the tracker has not moved.

    ``verifies``: it does so at its end as well.
    """

    verifies: bool = False
    name = "world-frame"
    needs = "reflectors in the floor nests, and on bars of known length"
    moves = "nothing"
    measures = "three floor nests, averaged, and the nests of certified lengths"
    yields = "the tracker in {W}"

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Refuse nests out of the tracker's range."""
        plan.check_range(cell, np.array([nest.xyz_mm for nest in cell.layout.floor]), "floor nests")
        bar = cell.layout.bar  # floor nests are measured anyway
        plan.check_range(
            cell, np.array([nest.xyz_mm for nest in bar]).reshape(-1, 3), "bar's nests"
        )
        spans = [plan.floor_nest_points(cell)]
        spans += [plan.readings(cell, len(bar), cell.nest_samples)] if bar else []
        spans += plan.closing(cell) if self.verifies else []
        return PlannedStep.of_spans(self.name, len(cell.layout.floor), spans)

    def perform(self, session: CellSession) -> None:
        session.frame_world()
        self.check_lengths(session)
        if self.verifies and not session.cell.layout.by_hand:
            session.frame_world()
        session.reach("frame_world")

    def result(self, log: Log) -> Result:
        moved, checked = log.set_ups.number, log.verdict(LengthsChecked)
        set_ups = [log.matrix(world_key(number)) for number in range(moved + 1)]
        off_mm, off_deg = log.cell.tracker.pose.off(set_ups[-1])
        tracker = SetUps(
            T_W_L=set_ups[-1].tolist(),
            pose=Pose.of(set_ups[-1]),
            off_mm=off_mm,
            off_deg=off_deg,
            moved=moved,
            set_ups=[T.tolist() for T in set_ups],
        )
        lengths = [
            msgspec.to_builtins(each) | {"off_ppm": each.off_ppm, "holds": each.holds}
            for each in (() if checked is None else checked.lengths)
        ]
        return {"tracker": tracker} | ({"known_lengths": lengths} if lengths else {})

    @staticmethod
    def words(result: Result) -> str:
        found = typed(result["tracker"], SetUps)
        return (
            f"Tracker in {{W}}, {found.off_mm:.2f} mm and {found.off_deg:.3f} deg from the cell "
            f"file's:\ntracker.pose = {found.pose.toml}"
        )

    @staticmethod
    def check_lengths(session: CellSession) -> None:
        """Measure and judge the certified lengths, once; a wrong one pauses an attended run."""
        layout = session.cell.layout
        if not layout.length or session.log.verdict(LengthsChecked) is not None:
            return
        bar = [
            session.floor_nest_point(PointId(LENGTH, nest=nest.name), nest) for nest in layout.bar
        ]
        floor = [session.log.point(PointId("world", nest=nest.name)) for nest in layout.floor]
        check_reflector(session.cell, layout.fixed_nests, positions_mm([*floor, *bar]))
        found = known_lengths(session.cell, session.log)
        wrong = [each.text for each in found if not each.holds]
        session.judge("known-length", LengthsChecked(holds=not wrong, lengths=found, wrong=wrong))
        if wrong:
            session.pause(f"the tracker's scale is not the certificate's: {'; '.join(wrong)}")


ONE_FACE = "this tracker's driver does not turn it over"
UNSEEN = "errors of its axes (collimation, transit tilt, index) are not seen"


class TwoFaces:
    """Readings in the second face, compared with the newest ones in the first."""

    SAMPLES = 5

    needs = "the world frame; a tracker that turns over"
    moves = "nothing but the tracker's head"
    measures = "floor nests, at the start those of certified lengths too, in the second face"
    yields = "whether the tracker's axes are adjusted: collimation, transit tilt, index"

    def __init__(self, *, at_end: bool = False) -> None:
        self._number, self.name = (1, "two-face-closing") if at_end else (0, "two-face")
        self._verdict = TWO_FACES[self._number]

    def announced(self, cell: Cell) -> str:
        return "nothing" if self.left_out(cell) else self.moves

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the step; skipped where the tracker or the plan does not allow it."""
        if reason := self.left_out(cell):
            return PlannedStep(self.name, 0, 0.0, note=reason)
        count, face_s = len(self._nests(cell)), 4.0  # to turn over and point
        each_s = 2.0 * face_s + plan.measure_s(cell, self.SAMPLES)
        return PlannedStep.of_spans(self.name, 0, [Span("second face", count, count * each_s)])

    def perform(self, session: CellSession) -> None:
        """Measure and judge, once; an axis that is off pauses an attended run."""
        cell, log = session.cell, session.log
        if self.left_out(cell) or self._verdict in log.verdicts:
            return
        for nest in self._nests(cell):
            id = PointId(BACK, number=self._number, nest=nest.name)
            session.fixed_nest_point(id, nest, self.SAMPLES, back=True)
        found = two_faces(log, self._number)
        if found is None:  # the tracker was moved: no first face at this set-up
            return
        wrong = [] if found.holds else [found.text]
        judged = FacesCompared(
            holds=found.holds, nests=found.nests, summary=found.text, wrong=wrong
        )
        session.judge(self._verdict, judged)
        if wrong:
            session.pause(f"the tracker's axes are off: {found.text}")

    def _nests(self, cell: Cell) -> list[Nest]:
        return cell.layout.floor if self._number else cell.layout.fixed_nests

    def result(self, log: Log) -> Result:
        found = two_faces(log, self._number)
        key = self._verdict.replace("-", "_").replace(".", "_")
        return {} if found is None else {key: found}

    @staticmethod
    def left_out(cell: Cell) -> str:
        """Return why the tracker is not turned over; "" where it is."""
        if not abilities(cell)["tracker_turns_over"]:
            reason = ONE_FACE
        elif cell.layout.by_hand:
            reason = "the reflector is carried by hand"
        elif cell.plan.quick:
            reason = "a quick plan has no time for it"
        else:
            return ""
        return f"{reason}: {UNSEEN}"
