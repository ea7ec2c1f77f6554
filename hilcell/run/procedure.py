"""A procedure: its words, its plan before anything moves, its acts and its result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeAlias

import msgspec

from hilcell.cell.file import Cell
from hilcell.decoding import Json
from hilcell.journal.log import Log
from hilcell.model.events import StepBegun
from hilcell.model.plan import Step
from hilcell.ports import HilcellError, StripLost
from hilcell.present.table import Table
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_rides
from hilcell.run.watch import BlockLost

Result: TypeAlias = Mapping[str, object]  # by their keys in JSON: Structs, or what they are made of


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps of a run. Building it has checked reach, limits and sight of every target."""

    steps: list[Step]

    @property
    def points(self) -> int:
        return sum(step.points for step in self.steps)

    @property
    def duration_s(self) -> float:
        """Return how long the run takes in the cell's time."""
        return sum(step.duration_s for step in self.steps)

    @property
    def notes(self) -> list[str]:
        """Return in words which steps do nothing, and why."""
        return [f"{step.name} does nothing: {step.note}" for step in self.steps if step.note]

    @property
    def warnings(self) -> list[str]:
        """Return in words what the run can hardly end with, and the next act."""
        return [f"{step.name}: {step.warning}" for step in self.steps if step.warning]


class Part(Protocol):
    """One act of a procedure: its needs, motions, measurements and yield, and how it is done."""

    name: str
    needs: str
    moves: str
    measures: str
    yields: str

    def plan(self, cell: Cell, seed: int) -> Step:
        """Return the step; raises `HilcellError` for what cannot be reached or seen."""

    def perform(self, session: CellSession) -> None:
        """Do it. Called again on resume: the session skips what the journal already holds."""

    def result(self, log: Log) -> Result:
        """Compute this act's share of the result from the log alone, if it has any."""
        return {}


@dataclass(frozen=True, slots=True)
class Procedure:
    """Acts in their order, found by name through the entry points ``hilcell.procedures``.

    ``table`` shows the result and ``words`` say it in a sentence, if one can; both decode what they
    need of it, which may be plain JSON. ``uses`` is the cell's table that names the calibration
    which the procedure starts from, if it does; ``may_use`` the one that names it if the operator
    wants one. ``of_rail``: it measures a rail, or what only a rail makes necessary. ``by_hand`` is
    what somebody does for it, "" for nothing.
    """

    name: str
    summary: str
    parts: tuple[Part, ...]
    table: Callable[[Result], Table]
    words: Callable[[Result], str] = lambda result: ""
    uses: str = ""
    may_use: str = ""
    of_rail: bool = False
    by_hand: str = ""

    def used_in(self, cell: Cell) -> str:
        """Return the cell's table that names the calibration to start from, "" for none."""
        wanted = self.may_use and getattr(cell, self.may_use).calibration
        return self.uses or (self.may_use if wanted else "")

    def check(self, cell: Cell) -> None:
        """Refuse a cell without the rail that this procedure is about; raises `HilcellError`."""
        if self.of_rail and not cell.has_rail:
            raise HilcellError(
                f"{self.name} refused before anything moves: cell {cell.name} has no rail, its "
                "robot stands on the floor; choose a procedure of robot and tracker, such as "
                "calibrate or iso9283",
                code="HC-C10",
            )

    def plan(self, cell: Cell, seed: int) -> Plan:
        """Return the plan; raises one `HilcellError` with every refusal of every act."""
        self.check(cell)
        steps, refusals = [], []
        try:
            check_rides(cell)
        except HilcellError as error:
            refusals.append(f"slide: {error}")
        for part in self.parts:
            try:
                steps.append(part.plan(cell, seed))
            except HilcellError as error:
                refusals.append(f"{part.name}: {error}")
        if refusals:
            raise HilcellError(
                f"{self.name} refused before anything moves\n" + "\n".join(refusals), code="HC-C10"
            )
        return Plan(steps)

    def inputs(self, cell: Cell, plan: Plan) -> Json:
        """Return what every run of a plan freezes; its command adds who ordered it, and how."""
        return {
            "procedure": self.name,
            "cell": msgspec.to_builtins(cell),
            "digest": cell.digest,
            "simulated": cell.simulation is not None,
            "steps": msgspec.to_builtins(plan.steps),
            "points": plan.points,
            "duration_s": plan.duration_s,
        }

    def perform(self, session: CellSession) -> None:
        """Perform all acts, and all again where a point is re-measured behind the last one."""
        self._acts(session)
        while self._retaken(session):
            self._acts(session)

    def _retaken(self, session: CellSession) -> bool:
        waiting = bool(session.log.retakes)
        return not self._performed(session.retake_waiting, session) or waiting

    def _acts(self, session: CellSession) -> None:
        for number, part in enumerate(self.parts, start=1):
            session.add(StepBegun(name=part.name, number=number, of=len(self.parts)))
            while not self._performed(partial(part.perform, session), session):
                pass

    def result(self, log: Log) -> Json:
        """Compute the result from the log alone; return it as plain JSON."""
        counts = Counter(point.group for point in log.points.values())
        found: dict[str, object] = {"points": dict(sorted(counts.items()))}
        found["simulated"] = log.inputs.simulated
        for part in self.parts:
            found |= part.result(log)
        plain: Json = msgspec.to_builtins(found, enc_hook=lambda value: value.tolist())
        return plain

    @staticmethod
    def _performed(act: Callable[[], object], session: CellSession) -> bool:
        """Perform an act; return whether it came to its end, and what it measured counts."""
        try:
            act()
        except BlockLost:
            return False
        except StripLost as lost:
            session.await_strip(lost)
            return False
        return True
