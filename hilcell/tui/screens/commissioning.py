"""Commissioning: the steps at the left; at the right the question, the motion and the checks.

The work goes on while another page is shown; a step's run is a live run like any other. To a
question of a motion no key counts that was pressed before it was shown, and none in a burst.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.events import Key, Paste
from textual.widget import Widget
from textual.widgets import Input, Label

from hilcell.cell.source import built_in_cells
from hilcell.commission.dialogue import Question
from hilcell.commission.record import Check
from hilcell.commission.sequence import STEPS
from hilcell.commission.steps import checks_of
from hilcell.errors import HilcellError
from hilcell.language import marked, tr
from hilcell.sanitize import clean
from hilcell.tui.commissioning import Progress, Work
from hilcell.tui.keys import CHOICE_KEYS
from hilcell.tui.layout import Lines, section
from hilcell.tui.process import run_in_thread
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.base import BACK, Page
from hilcell.tui.screens.start import StartScreen
from hilcell.tui.text import commissioning as text
from hilcell.tui.text.actions import ONE_AT_A_TIME
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.prompt import PromptBox
from hilcell.tui.text.run import RunText
from hilcell.tui.widgets import Column, Table, TextField, TextPanel

Option = tuple[str, str]  # an answer and its text


class AnswerField(TextField):
    """Takes the answer; keys pressed before ``since_s`` are no part of it."""

    since_s = 0.0

    async def on_key(self, event: Key) -> None:
        self._refuse_early(event)

    def on_paste(self, event: Paste) -> None:
        self._refuse_early(event)

    def _refuse_early(self, event: Key | Paste) -> None:
        """Keep an event from the handlers of the base classes, which Textual calls next."""
        if event.time <= self.since_s:
            event.stop()
            event.prevent_default()


class CommissionScreen(Page):
    """One cell's commissioning: to be begun, in work, or at its end."""

    LINES = ("step", "progress", "lamps", "interlock")  # of a live run
    COURSE = 26  # columns of the steps and their edge
    TALL = 32  # rows, from which a check is shown in full beside a live run
    FIRST = 2  # screens, where it was opened at once: Textual's own, and this
    FEW_ROWS = 5  # of checks, at least

    footer = ("stop", "pause", "abort", "again", "onward", "alarms", "interlocks", "log", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (
        ("q", BACK),
        ("▲▼", marked("choose")),
        ("Enter", marked("start, choose an answer, or answer a live run's question")),
        *((key, marked("this answer of a live run's question")) for key in CHOICE_KEYS),
    )
    in_text_box = (("Enter", marked("answer, or start")), ("Tab", marked("next field")))
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", show=False),
        *(Binding(key, f"choice({key})", show=False) for key in CHOICE_KEYS),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._progress: Progress | None = None  # of the file in the form
        self._problem = ""  # why it has none
        self._go_on: Question | None = None  # of a run that waits
        self._waits_since = 0  # the record of which it was asked
        self._known = 0  # the newest record at that time
        self._asked: Question | None = None  # as shown
        self._in_full = True  # whether all of it is
        self._mode: tuple[object, ...] = ()

    def body(self) -> ComposeResult:
        with Horizontal(id="middle"):
            with Vertical(id="course"):
                yield Table(
                    text.STEP_COLUMNS, attrgetter("name"), empty="", tone=attrgetter("tone"),
                    id="steps",
                )  # fmt: skip
            with Vertical(id="matter"):
                yield TextPanel("subject")
                yield from self._field("cell_file", tr("cell file"), tr("a new file, or one begun"))
                yield from self._field("who_field", tr("operator"), tr("recorded"))
                yield TextPanel("words")
                yield Table(
                    (
                        Column[Option]("answer", 16, lambda each: each[0]),
                        Column[Option]("", 10, lambda each: each[1], grows=True),
                    ),
                    lambda each: each[0],
                    empty="",
                    id="choices",
                )
                yield AnswerField(id="answer")
                yield TextPanel("said")
                yield Table(
                    text.CHECK_COLUMNS, attrgetter("what"), empty="", tone=text.check_tone,
                    id="verified",
                )  # fmt: skip
                yield TextPanel("check")
        yield PromptBox(id="prompt")
        for name in self.LINES:
            yield TextPanel(name)
        yield TextPanel("status")

    @staticmethod
    def _field(name: str, label: str, hint: str) -> ComposeResult:
        with Horizontal(classes="field"):
            yield Label(label)
            yield TextField(placeholder=hint, id=name)

    def begin(self) -> None:
        self._enter_defaults()
        super().begin()
        self.panel("title").display = False
        self.app.call_later(self._focus_again)  # after that of every page
        self._read_progress()

    def _focus_again(self) -> None:
        self._mode = ()
        self.show_again()

    def _enter_defaults(self) -> None:
        """Take cell and operator from the work, else from the form of a new run."""
        work = self.work
        forms = [each for each in self.app.screen_stack if isinstance(each, StartScreen)]
        cell, operator = self.application.options.cell, ""
        if work is not None:
            cell, operator = str(work.path), work.operator
        elif forms and forms[0].is_shown:
            cell, operator = forms[0].entries().cell, forms[0].entries().operator
        self.query_one("#cell_file", Input).value = "" if cell in built_in_cells() else cell
        self.query_one("#who_field", Input).value = operator

    @property
    def work(self) -> Work | None:
        return self.application.commissioning

    @property
    def _works(self) -> Work | None:
        """Return the work, unless it is over."""
        work = self.work
        return work if work is not None and work.at_work else None

    # -- what is shown ----------------------------------------------------------------------------

    def show(self, view: RunView | None) -> None:
        run = view if view is not None and view.live else None
        super().show(run)
        work = self._works
        question = self._question_of(run) or (work.question if work is not None else None)
        self._show_banner(run, asks=question is not None)
        self._show_steps()
        self._show_run(run)
        self._show_matter(run, question)
        prompts = run is not None and run.prompt is not None
        mode = (work is not None, prompts, question)
        if mode != self._mode:
            was_work = bool(self._mode) and self._mode[0]
            self._mode = mode
            self._focus_for(question, idle=work is None)
            if was_work and work is None:
                self._read_progress()

    def _question_of(self, run: RunView | None) -> Question | None:
        """Return the question whether a run that is paused may go on, once for each pause."""
        if run is None or run.state != "paused":
            self._go_on = None
        elif self._waits_since != run.log.life[-1].seq:
            self._waits_since = run.log.life[-1].seq
            self._known = run.records[-1].seq
            reason = run.log.life[-1].change.reason or tr("paused")
            self._go_on = Question(
                tr("the run waits: {reason}\nmay it go on?", reason=reason), motion=True
            )
        return self._go_on

    def _show_banner(self, run: RunView | None, *, asks: bool) -> None:
        work = self._works
        simulated = self._progress is not None and self._progress.simulated
        if work is not None:
            simulated = not work.real
        self.mark_simulated(simulated=simulated)
        if run is None:
            lines = text.banner(
                self.application.glyphs, asks=asks, at_work=work is not None, simulated=simulated
            )
            self.panel("banner").show(lines)

    def _show_steps(self) -> None:
        work, progress = self._works, self._progress
        running = work.step if work is not None else ""
        if work is not None and work.progress is not None:
            progress = work.progress
        rows = text.step_rows(progress, running, self.application.glyphs)
        table = self._table("steps")
        table.show_rows(rows)
        if running not in ("", table.key) and self.focused is not table:
            table.choose(running)

    def _show_run(self, run: RunView | None) -> None:
        """Show the live run's progress and readings, and its prompt in place of the rest."""
        prompt = run.prompt if run is not None else None
        box = self.query_one(PromptBox)
        box.display = prompt is not None
        self.query_one("#middle").display = prompt is None
        standing = self.application.session.latch.standing() if self.application.session else []
        for name in self.LINES:
            self.panel(name).display = run is not None
        self.panel("status").display = bool(standing)
        if standing:
            self.panel("status").show(self.alarm_context().line(standing))
        if run is None:
            return
        glyphs = self.application.glyphs
        lines, devices = RunText(run, glyphs), DeviceText(run, glyphs)
        shown = (lines.step(), lines.progress(), devices.lamps(), devices.interlocks())
        for name, each in zip(self.LINES, shown, strict=True):
            self.panel(name).show(each)
        if prompt is not None:
            box.show(prompt, run, glyphs, low=False)

    def _show_matter(self, run: RunView | None, question: Question | None) -> None:
        work = self._works
        for row in self.query(".field").results(Widget):
            row.display = work is None
        self._show_answer(question)
        subject = text.subject_lines(work.number, work.title) if work else section(tr("cell"))
        chosen = dict(question.choices).get(self._table("choices").key, "") if question else ""
        said = text.said_lines(chosen, self.work.said if self.work is not None else [])
        words, checks = self._words(work, question), self._checks(run, work)
        for name, lines in {"subject": subject, "words": words, "said": said}.items():
            self.panel(name).show(lines)
        self.panel("said").display = bool(said.lines(self.line_width))
        asks, room, beside = question is not None, self._room(run), self.line_width - self.COURSE
        narrow = self._rows([subject, words, said], beside) >= room
        self.query_one("#course").display = not (asks and narrow)
        self._in_full = (
            self._rows([subject, words], self.line_width - 2 if narrow else beside) < room
        )
        few = min(len(checks) + 1, self.FEW_ROWS) if not asks else 0
        most = max(room - few - self._rows([subject, said], beside), 2)
        self.panel("words").styles.max_height = most if few else None
        self._show_checks([] if asks else checks, in_full=run is None or room >= self.TALL)

    @staticmethod
    def _rows(shown: Sequence[Lines], width: int) -> int:
        return sum(len(each.lines(max(width, 1))) for each in shown)

    def _room(self, run: RunView | None) -> int:
        """Return the rows between banner and keys, or what is above these."""
        below = sum(self.panel(name).display for name in (*self.LINES, "status", "notice"))
        return self.app.size.height - 2 - below

    def _words(self, work: Work | None, question: Question | None) -> Lines:
        if work is not None:
            shown = question or Question(work.motion or tr("nothing moves"))
            return text.question_lines(shown, work.how if question else "")
        outcome = self.work.outcome if self.work is not None else ""
        return text.outcome_lines(self._problem or outcome, self._progress)

    def _checks(self, run: RunView | None, work: Work | None) -> Sequence[Check]:
        """Return those of the run so far, else of the step's last run."""
        if work is None:
            chosen = self._table("steps").key
            return self._progress.checks.get(chosen, ()) if self._progress is not None else ()
        return checks_of(run.log) if run is not None else work.checks

    def _show_answer(self, question: Question | None) -> None:
        """Show what takes the answer; a new question begins with an empty field."""
        field, choices = self.query_one("#answer", AnswerField), self._table("choices")
        field.display = question is not None and not question.choices
        choices.display = question is not None and bool(question.choices)
        if question is self._asked:
            return
        self._asked = question
        if question is not None:
            field.value, field.since_s = "", time.monotonic()
            choices.show_rows([*question.choices.items()])
            choices.action_to(0)
            choices.choose(question.default)

    def _show_checks(self, checks: Sequence[Check], *, in_full: bool) -> None:
        """Show the checks; ``in_full``: the one under the cursor also in all its words."""
        table, one = self._table("verified"), self.panel("check")
        table.display, one.display = bool(checks), bool(checks) and in_full
        if checks:
            table.show_rows(text.worst_first(checks))
            one.show(text.check_lines(table.rows[table.cursor]))

    def _focus_for(self, question: Question | None, *, idle: bool) -> None:
        name = "steps"
        if question is not None:
            name = "choices" if question.choices else "answer"
        elif idle and not self.query_one("#cell_file", Input).value:
            name = "cell_file"
        self.set_focus(self.query_one(f"#{name}"))

    def _table(self, name: str) -> Table:  # type: ignore[type-arg]
        return self.query_one(f"#{name}", Table)

    def on_table_row_highlighted(self) -> None:
        self.show_again()

    # -- the form ---------------------------------------------------------------------------------

    @on(Input.Changed, "#cell_file")
    def _read_progress(self) -> None:
        self.application.start_task(self._read(self.query_one("#cell_file", Input).value.strip()))

    async def _read(self, cell: str) -> None:
        progress, problem = None, ""
        try:
            progress = await run_in_thread(Progress, Path(cell)) if cell else None
        except HilcellError as error:
            problem = str(error)
        if self.is_shown and cell == self.query_one("#cell_file", Input).value.strip():
            self._progress, self._problem = progress, problem
            self.show_again()

    def _begin_work(self, first: str = "", only: str = "") -> None:
        cell = self.query_one("#cell_file", Input).value.strip()
        if self._works is not None:
            return
        if not cell:
            self.show_notice(tr("enter the cell file first: a new one, or one begun"))
        elif self.application.open_runs.live:
            self.show_notice(ONE_AT_A_TIME)
        elif not (first or only) and self._progress is not None and not self._progress.next_step:
            self.show_notice(tr("nothing is left to prove; repeat a step where it is in doubt"))
        else:
            operator = clean(self.query_one("#who_field", Input).value)
            self.application.begin_commissioning(Path(cell), operator, first, only)

    # -- keys -------------------------------------------------------------------------------------

    def action_enter(self) -> None:
        view = self.application.view
        if view is not None and view.prompt is not None:
            self.application.answer_prompt()
        else:
            self._begin_work()

    def action_choice(self, number: int) -> None:
        self.application.answer_prompt(number)

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        if self.focused is self._table("choices"):
            self._answer(message.key)
        else:
            self.action_enter()

    def on_input_submitted(self, message: Input.Submitted) -> None:
        if message.input.id == "answer":
            self._answer(message.value)
        else:
            self._begin_work()

    def _answer(self, answer: str) -> None:
        question, work = self._asked, self._works
        if question is None or work is None:
            return
        if question.motion and not self.application.key_is_deliberate:
            self.show_notice(tr("the key was ignored, as part of a burst of keys: press it alone"))
        elif question.motion and not self._in_full:
            self.show_notice(tr("the terminal is too small for all that moves: enlarge it, or Esc"))
        elif question is not self._go_on:
            work.answer(answer)
            self.show_again()
        elif work.agrees(answer):
            self._go_on = None
            self.application.proceed(self._known)
            self.show_again()
        else:
            self.query_one("#answer", Input).value = ""
            self.show_notice(tr("nothing moves: {how}", how=work.how))

    def do_pause(self) -> None:
        """Pause; ask whether a paused run may go on; without a live run, start."""
        view = self.application.view
        if view is None or not view.live:
            self._begin_work()
        elif view.state == "paused":
            self._waits_since = 0  # asks once more
            self.show_again()
        else:
            self.application.do_pause()

    def do_again(self) -> None:
        """Perform the chosen step alone."""
        self._begin_work(only=self._table("steps").key or STEPS[0].name)

    def do_onward(self) -> None:
        """Perform the chosen step and all after it."""
        self._begin_work(first=self._table("steps").key or STEPS[0].name)

    def fixed_keys(self) -> Sequence[tuple[str, str]]:
        starts = ("Enter", marked("start")), *self.fixed[:2]
        return self.fixed[:2] if self._works is not None else starts

    def label(self, name: str) -> str:
        if name == "pause" and not self.application.live:
            return marked("start")
        return super().label(name)

    def action_back(self) -> None:
        if self.application.live and self._works is not None:
            self.show_notice(tr("a step's run is live: Esc stops it"))
        elif len(self.app.screen_stack) > self.FIRST:
            super().action_back()
        else:
            self.application.do_new()
