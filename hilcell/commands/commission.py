"""``commission``: questions, runs and the cell file, in one terminal."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Queue

from hilcell.atomic_files import check_output, write_whole
from hilcell.cell.file import Cell
from hilcell.commands.console import print_message, print_table
from hilcell.commands.run_output import ProgressOutput, print_end
from hilcell.commands.signatures import Commission, Quickstart
from hilcell.commission.dialogue import TypedDialogue
from hilcell.commission.first_steps import carry_reflector
from hilcell.commission.page import CommissioningPage, page_html, page_path
from hilcell.commission.record import record_path
from hilcell.commission.sequence import Step
from hilcell.commission.steps import (
    Commissioning,
    StepEnded,
    refuse_built_in,
    standing,
    steps_to_perform,
)
from hilcell.decoding import Json
from hilcell.errors import EXIT_OK, EXIT_OUT_OF_TOLERANCE, HilcellError
from hilcell.journal.journal import Record
from hilcell.journal.log import Log
from hilcell.model.records import WAITING, StateChanged
from hilcell.present.table import Column, Table
from hilcell.report.pdf import find_browser, pdf_of
from hilcell.run.control import MEASURED_S, order
from hilcell.run.engine import NewEngine
from hilcell.run.order import Order
from hilcell.run.signals import signals_restored

ANSWER_S = 0.2
MOST_LINES = 1000  # typed ahead


def commission(args: Commission) -> int:
    refuse_built_in(args.cell)
    if args.list:
        return _list(args.cell)
    if args.report:
        return _report(args.cell, Path(args.report))
    proved = Terminal(args).commissions(steps_to_perform(args.cell, args.first, args.only))
    return EXIT_OK if proved else EXIT_OUT_OF_TOLERANCE


def _list(path: Path) -> int:
    page = CommissioningPage(path)
    print_table(
        Table(
            [
                Column[Step]("step", lambda step: step.name),
                Column[Step]("proves", lambda step: step.title),
                Column[Step]("status", page.status),
                Column("ended, UTC", page.ended),
                Column("operator", page.operator),
            ],
            page.sequence,
        )
    )
    return EXIT_OK


def _report(cell: Path, place: Path) -> int:
    """Write the page of the record as HTML or PDF."""
    inputs = (cell, record_path(cell))
    check_output(place, (".html", ".htm", ".pdf"), "a report", inputs=inputs)
    html = page_html(cell)
    content = pdf_of(html, find_browser()) if place.suffix.lower() == ".pdf" else html.encode()
    write_whole(place, content, inputs=inputs)
    print_message(f"{place} written")
    return EXIT_OK


class _AnsweringOutput(ProgressOutput):
    """Shows a run's progress; a line typed while it waits answers it."""

    def __init__(self, folder: Path, points: int, cell: Cell, dialogue: TypedDialogue) -> None:
        super().__init__(folder, points)
        self._run, self._cell, self._dialogue = folder, cell, dialogue
        self._prompt: Json | None = None  # that a line answers; None for a mere pause
        self._waits, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._answer, name="answers", daemon=True)
        self._thread.start()

    def print_record(self, record: Record) -> None:
        match record.fact:
            case StateChanged(machine="run", to=to, prompt=prompt) as change:
                alone = prompt is not None and prompt.get("by_itself", False)
                self._waits.clear()
                if to in WAITING:
                    asked = "" if prompt is None else f"{prompt['title']}. {prompt['text']}"
                    words = asked or change.reason
                    how = f"{words.removesuffix('.')}; {self._dialogue.how}, ctrl-C stops"
                    self._print(words if alone else how)
                    if not alone:
                        self._prompt = prompt
                        self._dialogue.drop_typed_ahead()
                        self._waits.set()
                    return
        super().print_record(record)

    def close(self, code: int, log: Log, fault: Exception | None) -> None:
        self._ended.set()
        self._thread.join()
        super().close(code, log, fault)

    def _answer(self) -> None:
        """Answer with each line that comes while the run waits."""
        while not self._ended.is_set():
            if not self._waits.wait(ANSWER_S):
                continue
            line = self._dialogue.waiting_line(ANSWER_S)
            if self._dialogue.over:
                print_message("the input has ended before this was answered; the run stops")
                with suppress(HilcellError):  # it has ended by itself
                    order(self._run, "stop")
                return
            if line is None or not self._dialogue.agrees(line):
                self._ended.wait(ANSWER_S)
                continue
            self._waits.clear()
            prompt = self._prompt
            try:
                if prompt is None:
                    order(self._run, "proceed")
                    continue
                if prompt["expected_mm"] is not None:
                    carry_reflector(self._cell, prompt["expected_mm"])
                order(self._run, "answer", timeout_s=MEASURED_S)
            except HilcellError as error:
                print_message(f"{error}; {self._dialogue.how}")
                if prompt is not None:  # it is still open
                    self._waits.set()


class Terminal:
    """A person at a terminal who answers questions and runs; lines typed ahead wait their turn."""

    def __init__(self, args: Commission | Quickstart) -> None:
        self._args = args
        self._lines: Queue[str | None] = Queue(MOST_LINES)
        threading.Thread(target=self._read, name="keyboard", daemon=True).start()
        self.dialogue = TypedDialogue(self._lines, print_message)

    def commissions(self, steps: Sequence[Step]) -> bool:
        """Perform steps of commissioning; return whether all of them proved."""
        cell, dialogue = self._args.cell, self.dialogue
        proved = Commissioning(cell, dialogue, self._args.operator, self.run).perform(steps)
        print_message(standing(cell))
        print_message(
            f"{dialogue.questions} questions; the record is {record_path(cell)}, to read and sign "
            f"{page_path(cell)}"
        )
        return proved

    def run(self, procedure: str) -> tuple[str, Log]:
        """Run a procedure on the cell file to its end; return the run's name and its log."""
        args = self._args
        ordered = Order(
            procedure=procedure, cell=str(args.cell), runs=args.runs, operator=args.operator
        )
        say: Callable[[str], object] = print_message
        plan = ordered.check(say)
        with signals_restored(), NewEngine(ordered, plan, say) as engine:
            output = _AnsweringOutput(plan.folder, plan.points, plan.cell, self.dialogue)
            code, fault, _ = engine.run(output)
            log: Log = engine.journal.log
            output.close(code, log, fault)
            if fault is not None:
                print_end(plan.folder, log, plan.procedure, output, fault)
                raise StepEnded(procedure, code)
            return plan.folder.name, log

    def _read(self) -> None:
        for line in sys.stdin:
            self._lines.put(line)
        self._lines.put(None)
