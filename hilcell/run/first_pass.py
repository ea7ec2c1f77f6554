"""The first pass: poses outside of the cube that were never driven in this cell.

Their volumes are only as right as the cell file. So the robot goes there slowly the first time,
and an attended run pauses before the first of them, unless the cell file says otherwise. A pose is
known once this run, or one of those finished before it, was driven there.
"""

from __future__ import annotations

from functools import cached_property

from hilcell.journal.driven import Driven
from hilcell.journal.journal import StorageError
from hilcell.journal.runs import read_log
from hilcell.ports import Array
from hilcell.run.coming_poses import ComingPoses
from hilcell.run.run_context import RunContext


class FirstPass:
    """Says how fast the robot may go to a pose, and who has to watch."""

    def __init__(self, run: RunContext, coming: ComingPoses) -> None:
        self._run, self._coming = run, coming
        self._announced = False

    def speed_percent(self, strip_mm: float, joints_rad: Array, what: str) -> float:
        """Return the speed to joints (6,) with the slide there.

        The first pose that is not known is announced; an attended run then pauses here.
        """
        cell = self._run.cell
        usual = cell.robot.speed_percent
        if cell.surroundings is None or not self._coming.leaves_cube(joints_rad):
            return usual
        if any(
            driven.has(strip_mm, joints_rad) for driven in (self._run.log.driven, *self._earlier)
        ):
            return usual
        slow = min(cell.robot.first_pass_percent, usual)
        if not self._announced:
            self._announced = True
            self._announce(what, slow)
        return slow

    def _announce(self, what: str, percent: float) -> None:
        self._run.event("first pass", key=what, speed_percent=percent)
        if self._run.cell.robot.first_pass_pause:
            self._run.pause(
                f"{what}: the robot leaves the grid's cube, to where it was never driven in this "
                f"cell, at {percent:g} %; clear the cell and stay at the E-stop"
            )

    @cached_property
    def _earlier(self) -> list[Driven]:
        """Return where the runs before this one were driven; a deleted one proves nothing."""
        found, plan = [], self._run.log.plan
        for name in plan.driven_by if plan else []:
            try:
                found.append(read_log(self._run.folder.parent / name).driven)
            except StorageError as error:
                self._run.event("earlier run unreadable", run=name, reason=str(error))
        return found
