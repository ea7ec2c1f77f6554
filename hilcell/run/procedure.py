"""A procedure: its texts, its plan before anything moves, its steps and its result.

`run_in_process` performs one on a simulated cell in this thread, for studies: without a runner,
wires and an operator, and with the journal in memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Protocol, TypeAlias, runtime_checkable

import msgspec

from hilcell import __version__
from hilcell.cell.devices import Devices, connect_all, in_process_cell
from hilcell.cell.file import Cell
from hilcell.decoding import Json
from hilcell.journal.journal import Body, Record, plain_body
from hilcell.journal.log import Log
from hilcell.model.events import Connected, StepBegun
from hilcell.model.plan import PlannedStep
from hilcell.model.records import Kind
from hilcell.ports import HilcellError, InProcessCell, NoReading, StripLost
from hilcell.present.table import Table
from hilcell.run.cell_session import CellSession
from hilcell.run.collision import check_slide_travel
from hilcell.run.prompts import NO_CHOICES, Prompt, Verification
from hilcell.run.watch import RemeasureStep

Result: TypeAlias = Mapping[str, object]  # by their keys in JSON: Structs, or what they are made of


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps of a run. Building it has checked reach, limits and sight of every target."""

    steps: list[PlannedStep]

    @property
    def points(self) -> int:
        return sum(step.points for step in self.steps)

    @property
    def duration_s(self) -> float:
        return sum(step.duration_s for step in self.steps)

    @property
    def notes(self) -> list[str]:
        """Return which steps do nothing, and why."""
        return [f"{step.name} does nothing: {step.note}" for step in self.steps if step.note]

    @property
    def warnings(self) -> list[str]:
        """Return which results can hardly be accepted, and what to do."""
        return [f"{step.name}: {step.warning}" for step in self.steps if step.warning]


class Step(Protocol):
    """One step of a procedure; its texts state its needs, motions, measurements and yield."""

    name: str
    needs: str
    moves: str
    measures: str
    yields: str

    def plan(self, cell: Cell, seed: int) -> PlannedStep:
        """Return the planned step; raises `HilcellError` for unreachable or hidden targets."""

    def perform(self, session: CellSession) -> None:
        """Perform it. Called again on resume: the session skips what the journal already has."""

    def result(self, log: Log) -> Result:
        """Compute this step's share of the result from the log alone."""
        return {}


@runtime_checkable
class Announces(Protocol):
    """A step that states its motions in a cell: how far, and where to."""

    def announced(self, cell: Cell) -> str:
        """Return the motions as the text ``moves`` has them."""


def announced(step: Step, cell: Cell) -> str:
    """Return what a step moves in a cell, "nothing" for nothing."""
    return step.announced(cell) if isinstance(step, Announces) else step.moves


@dataclass(frozen=True, slots=True)
class Procedure:
    """Steps in sequence, registered as an entry point of the group ``hilcell.procedures``.

    ``table`` shows the result and ``words`` summarize it in a sentence ("" for none); both decode
    what they need of it, which may be plain JSON.
    ``uses``: the table of the cell file whose ``calibration`` the procedure starts from, such as
    "recheck"; "" for none. ``may_use``: the same, where the calibration may be left out.
    ``of_rail``: needs a cell with a rail. ``by_hand``: work of an operator during the run, such as
    "carry each reflector", so that it never runs unattended; "" for none.
    ``figures``: ``module:class`` of the figures that only its own report has.
    ``quick``: its plan is quick unless the order or the cell file states `plan.quick`.
    """

    name: str
    summary: str
    steps: tuple[Step, ...]
    table: Callable[[Result], Table]
    words: Callable[[Result], str] = lambda result: ""
    uses: str = ""
    may_use: str = ""
    of_rail: bool = False
    by_hand: str = ""
    figures: str = ""
    quick: bool = False

    def used_in(self, cell: Cell) -> str:
        """Return the cell's table that names the calibration to start from, "" for none."""
        given = self.may_use and getattr(cell, self.may_use).calibration
        return self.uses or (self.may_use if given else "")

    def check(self, cell: Cell) -> None:
        """Raise `HilcellError` where this procedure needs a rail and the cell has none."""
        if self.of_rail and not cell.has_rail:
            raise HilcellError(
                f"{self.name} refused before anything moves: cell {cell.name} has no rail, its "
                "robot stands on the floor; choose a procedure of robot and tracker, such as "
                "calibrate or iso9283",
                code="HC-C10",
            )

    def check_attended(self, cell: Cell, *, unattended: bool) -> None:
        """Raise `HilcellError` where an unattended run would need an operator."""
        if not unattended:
            return
        if self.by_hand:
            raise HilcellError(
                f"{self.name} refused before anything moves: an operator must {self.by_hand}; "
                "leave out --unattended",
                code="HC-C16",
            )
        if cell.layout.by_hand:
            raise HilcellError(
                f"cell {cell.name}: layout.reflectors is by_hand: an operator must carry the "
                "reflector; leave out --unattended, or mount reflectors in all nests",
                code="HC-C16",
            )

    def plan(self, cell: Cell, seed: int) -> Plan:
        """Return the plan; raises one `HilcellError` with the refusals of all steps."""
        self.check(cell)
        planned, refusals = [], []
        try:
            check_slide_travel(cell)
        except HilcellError as error:
            refusals.append(f"slide: {error}")
        for step in self.steps:
            try:
                planned.append(step.plan(cell, seed))
            except HilcellError as error:
                refusals.append(f"{step.name}: {error}")
        if refusals:
            raise HilcellError(
                f"{self.name} refused before anything moves\n" + "\n".join(refusals), code="HC-C10"
            )
        return Plan(planned)

    def inputs(self, cell: Cell, plan: Plan) -> Json:
        """Return the fields of the run's `PlanRecord` that follow from the plan."""
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
        """Perform all steps; repeat them while points are re-measured after the last one."""
        self._perform_steps(session)
        while self._remeasured(session):
            self._perform_steps(session)

    def _remeasured(self, session: CellSession) -> bool:
        waiting = bool(session.log.retakes)
        return not self._performed(session.retake_waiting, session) or waiting

    def _perform_steps(self, session: CellSession) -> None:
        for number, step in enumerate(self.steps, start=1):
            session.add(StepBegun(name=step.name, number=number, of=len(self.steps)))
            while not self._performed(partial(step.perform, session), session):
                pass

    def result(self, log: Log) -> Json:
        """Compute the result from the log alone; return it as plain JSON."""
        counts = Counter(point.group for point in log.points.values())
        result: dict[str, object] = {"points": dict(sorted(counts.items()))}
        result["simulated"] = log.inputs.simulated
        for step in self.steps:
            result |= step.result(log)
        plain: Json = msgspec.to_builtins(result, enc_hook=lambda value: value.tolist())
        return plain

    @staticmethod
    def _performed(perform: Callable[[], object], session: CellSession) -> bool:
        """Return whether it ended, rather than having to be performed again."""
        try:
            perform()
        except RemeasureStep:
            return False
        except StripLost as lost:
            session.await_strip(lost)
            return False
        return True


# -- in this process -------------------------------------------------------------------------------


class MemoryJournal:
    """Satisfies `hilcell.journal.log.Records`."""

    def __init__(self, folder: Path, moment: str) -> None:
        """``folder`` takes the streams; every record has the one time ``moment``, ISO 8601."""
        self.log = Log(packed=False)  # a study reads them all
        self.path = folder / "journal"
        self._moment, self._seq = moment, 0

    def append(self, kind: Kind, key: str, body: Body) -> Record:
        """Apply one record to the log and return it; raises `NotFinite`."""
        plain, _ = plain_body(body, f"record {self._seq + 1} ({kind} {key or '-'})")
        self._seq += 1
        record = Record(self._seq, self._moment, kind, key, plain)
        self.log.take(record)
        return record


def run_in_process(
    cell: Cell,
    procedure: Procedure,
    *,
    seed: int,
    machine_seed: int,
    folder: Path,
    plan: Plan | None = None,
    simulated: InProcessCell | None = None,
) -> Log:
    """Perform a procedure on a simulated cell; return its log, without an end.

    ``seed`` draws the random targets, ``machine_seed`` the machine; ``folder`` is that of streams.
    ``plan`` is the procedure's for this cell and seed, ``simulated`` the cell of these seeds, if
    known. Raises `HilcellError`.
    """
    plan = plan or procedure.plan(cell, seed)
    simulated = simulated or in_process_cell(cell, machine_seed, seed)
    journal = MemoryJournal(folder, datetime.now(UTC).isoformat(timespec="milliseconds"))
    journal.append(
        "plan",
        "",
        procedure.inputs(cell, plan)
        | {
            "cell_file": cell.name,
            "seed": seed,
            "machine_seed": machine_seed,
            "speed": None,
            "unattended": True,
            "operator": "",
            "job": "",
            "versions": {"hilcell": __version__},
            "settings": {},
        },
    )
    devices = Devices(simulated.rail, simulated.robot, simulated.tracker)
    identities = connect_all(devices, lambda _: None)
    journal.append("event", "", Connected(devices=identities))
    session = CellSession(
        cell, devices, simulated.clock, journal, checkpoint=lambda: None, ask=_no_operator
    )
    procedure.perform(session)
    return journal.log


def _no_operator(
    prompt: Prompt,
    verify: Callable[[], Verification],
    cause: NoReading | None,
    choices: Mapping[str, Callable[[], Verification]] = NO_CHOICES,
) -> Verification:
    raise prompt.unanswered(cause) from cause
