"""The script of one case: a run is brought to a phase, struck there, and resumed once healed."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from hilcell.run.cell_lock import OVERRIDE
from tests.torture.bed import Bed
from tests.torture.cell import ThreadedCell
from tests.torture.injections import Injection
from tests.torture.phases import MOMENTS, Event, Phase, begins, is_point

PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
TO_RESUME = (2, 3, 4, 7)


@dataclass(frozen=True)
class Case:
    """One injection in one phase of a procedure."""

    number: int
    injection: Injection
    phase: Phase
    procedure: str = "base-frame"


@dataclass
class Ran:
    """All that a case has shown: events of the whole journal, exit codes of its sessions."""

    events: list[Event]
    exits: list[int]
    errors: str
    notes: list[str]
    struck: bool
    session: int  # how many exits were there when the struck session had ended
    T_W_B: list[list[float]]  # true base frame where the slide stood at the end


def play(case: Case) -> Ran:
    """Run one case."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="torture-")))
        cell = stack.enter_context(ThreadedCell(proxied=case.injection.proxied))
        bed = Bed(folder, cell, case.procedure, apart=case.injection.apart)
        if case.injection.cell_file:
            bed.cell_file = str(folder / "cell.toml")
            Path(bed.cell_file).write_text(PAPER.read_text("utf-8"), "utf-8")
        bed.attended = case.injection.attended
        stack.callback(case.injection.prepare(bed))
        stack.enter_context(_locks_in(folder / "locks"))
        script = _Script(bed, case)
        script.perform()
        ended = len(bed.exits)
        case.injection.heal(bed)
        if bed.exits[-1] in TO_RESUME or bed.exits[-1] < 0:
            bed.resume()
        truth = cell.simulation.ask(do="truth")["T_W_B"]
        return Ran(bed.events, bed.exits, bed.errors, bed.notes, script.struck, ended, truth)


@contextmanager
def _locks_in(folder: Path) -> Iterator[None]:
    """Lock devices in this case alone: a port that is free again has another case's lock."""
    before = os.environ.get(OVERRIDE)
    os.environ[OVERRIDE] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(OVERRIDE)
        if before is not None:
            os.environ[OVERRIDE] = before


class _Script:
    def __init__(self, bed: Bed, case: Case) -> None:
        self._bed, self._case = bed, case
        self._phase, self._moments = case.phase, MOMENTS[case.procedure]
        self.struck = False

    def perform(self) -> None:
        if self._phase is Phase.RESUMING:
            self._bed.start(self._stop)
            self.struck = self._case.injection.cell_file
            self._case.injection.between(self._bed)
            self._bed.resume(self._hear)
        else:
            self._bed.start(self._hear)

    def _halted(self, event: Event) -> bool:
        return is_point(event, self._moments.halted)

    def _stop(self, event: Event) -> None:
        if self._halted(event):
            self._bed.order("stop")

    def _hear(self, event: Event) -> None:
        bed = self._bed
        if not self.struck and begins(self._phase, self._moments, bed.events):
            self.struck = True
            if self._phase is Phase.PAUSED:
                bed.order_soon("proceed")
            self._case.injection.strike(bed)
        elif not self.struck and self._halted(event):
            if self._phase is Phase.PAUSED:
                bed.order("pause")
            elif self._phase is Phase.TEARDOWN:
                bed.order("stop")
        elif event.get("to") == "suspended":
            bed.on_suspended()
