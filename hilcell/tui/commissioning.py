"""Commissioning beside the screen: it works in a thread of its own, and waits there for answers.

Each step's run is an engine of its own, as every run that the screen starts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from queue import SimpleQueue

from hilcell.commission.cell_text import CellText
from hilcell.commission.dialogue import Dialogue, Question
from hilcell.commission.record import Check, Commissioned, StepRecord, StepStatus
from hilcell.commission.sequence import steps_of
from hilcell.commission.steps import (
    Commissioning,
    StepEnded,
    refuse_built_in,
    standing,
    steps_to_perform,
)
from hilcell.errors import HilcellError
from hilcell.journal.log import Log
from hilcell.journal.runs import new_run, read_log
from hilcell.language import tr
from hilcell.run.order import Order

Start = Callable[[Path, list[str]], Callable[[], str]]  # an engine; the function waits for its end
MOST_SAID = 200


class Progress:
    """A cell's steps by their status; read from its files."""

    def __init__(self, path: Path) -> None:
        """Raises `SettingsError` for a file that cannot be read."""
        text, record = CellText.read(path), Commissioned.read(path)
        names = [step.name for step in steps_of(text)]
        self.statuses: dict[str, StepStatus] = {name: record.status(name, text) for name in names}
        self.checks: dict[str, Sequence[Check]] = {
            name: last.checks for name in names if (last := record.last(name))
        }
        self.simulated = text.get("simulation") is not None
        self.standing = standing(path)
        self.next_step = ""  # that a start performs; "" where nothing is left
        if record.unproved(text):
            self.next_step = steps_to_perform(path, "", "")[0].name


class Work(Dialogue):
    """One go through steps of a cell; the screen shows its fields, answers, and may stop it.

    ``changed`` is called from any thread when a field has changed.
    """

    def __init__(
        self, path: Path, operator: str, runs: Path, start: Start, changed: Callable[[], object]
    ) -> None:
        super().__init__()
        self.path, self.operator = path, operator
        self.at_work, self.stopped = True, False
        self.progress: Progress | None = None
        self.step, self.number, self.title = "", "", ""  # in work, or the last that was
        self.question: Question | None = None
        self.motion = ""  # of the step, as agreed to
        self.checks: Sequence[Check] = ()  # of its last run
        self.said: list[str] = []
        self.outcome = ""
        self._runs, self._start, self._changed = runs, start, changed
        self._answers: SimpleQueue[str | None] = SimpleQueue()

    def perform(self, first: str, only: str) -> None:
        """Perform steps to their end; the outcome has each refusal."""
        try:
            refuse_built_in(self.path)
            steps = steps_to_perform(self.path, first, only)
            self.progress = Progress(self.path)
            Commissioning(self.path, self, self.operator, self._run).perform(steps)
            self.progress = Progress(self.path)
            self.outcome = tr("{questions} questions", questions=self.questions)
        except HilcellError as error:
            self.outcome = str(error)
        finally:
            self.at_work, self.question = False, None
            self._changed()

    def stop(self) -> bool:
        """Perform nothing more, from any thread; return whether it was at work."""
        was_at_work, self.stopped = self.at_work, True
        self._answers.put(None)  # its thread may end at once
        return was_at_work

    def answer(self, text: str) -> None:
        """Answer the question, once."""
        if self.question is not None:
            self.question = None
            self._answers.put(text)

    # -- as the steps see it, in their thread -----------------------------------------------------

    def say(self, text: str) -> None:
        self.said = [*self.said, text.strip()][-MOST_SAID:]
        self._changed()

    def begin(self, step: str, title: str, number: int, of: int) -> None:
        self.step, self.number, self.title = (
            step,
            tr("step {number} of {of}: {step}", number=number, of=of, step=step),
            title,
        )
        self.said, self.checks, self.motion = [], (), ""
        self._changed()

    def show(self, record: StepRecord, lines: Sequence[str], written: Sequence[str]) -> None:
        self.checks = record.checks
        self.progress = Progress(self.path)
        self.said = [*self.said, *written][-MOST_SAID:]
        self._changed()

    def answered(self, question: Question) -> str:
        self._refuse_stopped()
        if question.motion:
            self.motion = question.text
        self.question = question
        self._changed()
        answer = self._answers.get()
        self._refuse_stopped()
        assert answer is not None  # noqa: S101 - that is a stop
        return answer.strip()

    def _run(self, procedure: str) -> tuple[str, Log]:
        """Run a procedure in an engine of its own, to its end."""
        self._refuse_stopped()
        folder = self._runs / new_run(procedure)
        ordered = Order(
            procedure=procedure,
            cell=str(self.path),
            runs=self._runs,
            operator=self.operator,
            name=folder.name,
        )
        wait = self._start(folder, ["run", *ordered.command_line()])
        if reason := wait():
            raise HilcellError(reason)
        log = read_log(folder)
        if log.end is None or log.state != "finished":
            raise StepEnded(procedure, log.end.exit if log.end is not None else 0)
        return folder.name, log

    def _refuse_stopped(self) -> None:
        if self.stopped:
            raise HilcellError(
                "commissioning was stopped; continue with the first unproved step", code="HC-C40"
            )
