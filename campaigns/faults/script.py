"""The script of one case: a run is brought to a phase, struck there, and resumed once healed."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from campaigns.faults.bed import RUN, Bed
from campaigns.faults.cell import ThreadedCell
from campaigns.faults.injections import Injection
from campaigns.faults.phases import MOMENTS, Event, Phase, begins, is_point
from hilcell.journal.journal import StorageError, read_journal
from hilcell.run.cell_lock import OVERRIDE

PAPER = Path(__file__).parents[2] / "hilcell/cells/paper.toml"
TO_RESUME = (2, 3, 4, 7)
PAIR = "base-frame"


@dataclass(frozen=True)
class Case:
    """One injection in one phase of a procedure."""

    number: int
    injection: Injection
    phase: Phase
    procedure: str = "base-frame"
    cell: str = "paper"
    seed: int = 1  # of the simulated machine


@dataclass
class Ran:
    """All that a case has shown: events of the whole journal, exit codes of its sessions."""

    events: list[Event]
    exits: list[int]
    errors: str
    notes: list[str]
    struck: bool
    session: int  # how many exits were there when the struck session had ended
    T_W_B: list[list[float]]  # true base frame when its last point was measured


@contextmanager
def limited(limit_s: int) -> Iterator[None]:
    """Raise `TimeoutError` in a case that hangs."""

    def give_up(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"hangs for {limit_s} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(limit_s)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def play(case: Case) -> Ran:
    injection = case.injection
    with _bed(case.procedure, (injection,), case.cell, case.seed) as bed:
        script = _Script(bed, case)
        script.perform()
        return _resumed(bed, (injection,), struck=script.struck)


def play_struck(
    procedure: str,
    injections: Sequence[Injection],
    moments: Sequence[int],
    values: Mapping[str, str],
) -> Ran:
    """Run a procedure that several injections strike, each after the record of its number."""
    waiting = list(zip(moments, injections, strict=True))
    with _bed(procedure, injections) as bed:
        bed.values = values

        def hear(event: Event) -> None:
            while waiting and waiting[0][0] <= event["seq"]:
                waiting.pop(0)[1].strike(bed)

        bed.start(hear)
        return _resumed(bed, injections, struck=not waiting)


@contextmanager
def _bed(
    procedure: str, injections: Sequence[Injection], name: str = "paper", seed: int = 1
) -> Iterator[Bed]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="faults-")))
        proxied = any(each.proxied for each in injections)
        cell = stack.enter_context(ThreadedCell(name, proxied=proxied, seed=seed))
        bed = Bed(folder, cell, procedure, apart=any(each.apart for each in injections))
        bed.cell_file = name
        if any(each.cell_file for each in injections):
            bed.cell_file = str(folder / "cell.toml")
            Path(bed.cell_file).write_text(PAPER.read_text("utf-8"), "utf-8")
        bed.attended = any(each.attended for each in injections)
        stack.enter_context(_locks_in(folder / "locks"))
        for each in injections:
            stack.callback(each.prepare(bed))
        yield bed


def _resumed(bed: Bed, injections: Sequence[Injection], *, struck: bool) -> Ran:
    """Put right what struck, resume where that is asked for, and return all that was seen."""
    ended = len(bed.exits)
    for each in injections:
        each.heal(bed)
    if bed.exits[-1] in TO_RESUME or bed.exits[-1] < 0:
        bed.resume()
    events = _journalled(bed)
    return Ran(events, bed.exits, bed.errors, bed.notes, struck, ended, bed.T_W_B)


def _journalled(bed: Bed) -> list[Event]:
    """Return the journal's events; where it cannot be read, those that were printed."""
    try:
        return [record.event(RUN) for record in read_journal(bed.journal)]
    except StorageError:
        return bed.events


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
