"""A new run: the fields, the plan that follows them, its checks, and the start.

The plan is computed again after every change, by the command that would start it. Enter starts
nothing by itself: it asks, and only for the plan of the fields as they stand.
"""

from __future__ import annotations

import asyncio
from argparse import ArgumentTypeError
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from importlib.metadata import entry_points
from pathlib import Path
from typing import ClassVar

from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widgets import Input, Label

from hilcell.arguments import parse_seed, parse_setting, parse_speed
from hilcell.cell.file import Cell, load_cell
from hilcell.errors import HilcellError
from hilcell.journal.labels import procedure_label, step_label, with_labels
from hilcell.journal.log import Log
from hilcell.language import marked, tr
from hilcell.run.order import Attendance, Order
from hilcell.sanitize import clean, harmless
from hilcell.tui import process
from hilcell.tui.keys import BY_NAME, shown
from hilcell.tui.layout import BLANK, Col, Drawing, Fitting, Grid, Lines, Stack, Text, ends, section
from hilcell.tui.process import DryRun, run_in_thread
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.base import BaseScreen, Confirm
from hilcell.tui.terminal import Glyphs
from hilcell.tui.text.actions import EVERY_ACTION, FULL_WIDTH, PALETTE_KEY, FooterKey, form_footer
from hilcell.tui.text.actions import WORDS as SHORT_LABELS
from hilcell.tui.text.run import badge, duration, moves, simulation_block
from hilcell.tui.widgets import Choice, TextField, TextPanel


@dataclass(frozen=True, slots=True)
class Entries:
    """The entries of the form, as they were typed."""

    cell: str
    procedure: str
    operator: str
    job: str
    seed: str
    speed: str
    attended: bool
    start: str = ""

    @property
    def planned(self) -> Entries:
        """Return the part on which the plan depends: not who runs it, and for what job."""
        return replace(self, operator="", job="")

    def order(self, settings: tuple[tuple[str, str], ...], runs: Path) -> Order:
        """Return the order that they are; raises `HilcellError` for one that is none."""
        try:
            return Order(
                cell=self.cell,
                procedure=self.procedure,
                operator=clean(self.operator),
                job=clean(self.job),
                seed=parse_seed(self.seed) if self.seed else None,
                start=clean(self.start) or None,
                speed=parse_speed(self.speed) if self.speed else None,
                attendance=Attendance(unattended=not self.attended),
                settings=settings,
                runs=runs,
            )
        except ArgumentTypeError as error:
            raise HilcellError(f"seed: {error}") from error


class StartScreen(BaseScreen):
    """The fields on the left, the plan on the right; nothing moves before a yes."""

    FIELDS = (  # name, first entry, hint; the procedure comes after the cell
        (marked("cell"), "paper", marked("a built-in cell, or a TOML file")),
        (marked("operator"), "", marked("recorded in the journal")),
        (marked("job"), "", marked("recorded in the journal")),
        (marked("seed"), "", marked("of random targets")),
        (marked("from"), "", marked("re-calibrate: RUN or current")),
    )
    WATCHED = (marked("yes, I am here"), marked("no, unattended"))
    SPEEDS = ("max", "100", "10", "1")
    VIEWS = ("history", "commission", "theme", "help", "quit")  # in the footer's second row
    QUIET_S = 0.4  # without a change, before the plan is computed

    footer = ("help", "history", "commission", "theme", "quit")
    fixed = in_text_box = (
        ("Enter", marked("start")),
        ("Tab", marked("next field")),
        ("▲▼", marked("choose")),
    )
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (77, "-planned")]  # noqa: RUF012 - as Textual has it
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down", "turn(1)", show=False, priority=True),  # in the order typed
        Binding("up", "turn(-1)", show=False, priority=True),
        Binding("enter", "enter", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._names = sorted({entry.name for entry in entry_points(group="hilcell.procedures")})
        self._summaries: dict[str, str] = {}
        self._checked = Checked()
        self._changes = 0  # a check of earlier fields is dropped
        self._request: Entries | None = None  # of which `_checked` tells
        self._planned: Entries | None = None  # of which a plan was asked for
        self._asking = False

    def compose(self) -> ComposeResult:
        yield TextPanel("banner")
        with Horizontal(id="form"):
            with Vertical(id="fields"):
                yield TextPanel("who")
                yield from self._fields(self.FIELDS[:1])
                names = self._names or [tr("none is installed")]
                yield from self._choice(marked("procedure"), names, [*map(procedure_label, names)])
                yield from self._fields(self.FIELDS[1:])
                yield from self._choice(marked("attended"), self.WATCHED, [*map(tr, self.WATCHED)])
                yield from self._choice(marked("speed"), self.SPEEDS)
                yield TextPanel("checks")
            yield TextPanel("plan")
        yield TextPanel("before")
        yield TextPanel("start")
        yield TextPanel("end")
        yield TextPanel("summary")
        yield TextPanel("notice")
        yield TextPanel("keys")

    def _fields(self, fields: tuple[tuple[str, str, str], ...]) -> ComposeResult:
        for name, value, hint in fields:
            with Horizontal(classes="field"):
                yield Label(tr(name))
                begin = self.application.options.cell if name == "cell" else value
                yield TextField(begin, placeholder=tr(hint), id=name)

    def begin(self) -> None:
        self.panel("notice").display = False
        procedure = self.query_one("#procedure", Choice)
        if "calibrate" in self._names:
            procedure.action_choose(self._names.index("calibrate"))
        procedure.focus()
        super().begin()
        self.application.start_task(self._read_summaries())
        self._change()

    def show(self, view: RunView | None) -> None:
        self.mark_simulated(simulated=self._checked.simulated)
        checked, glyphs = self._checked, self.application.glyphs
        attended = self.query_one("#attended", Choice).value == self.WATCHED[0]
        before = checked.before_lines(attended=attended)
        taken = len(before.lines(self.line_width)) + 6 if self._is_roomy else 4
        rows = self.app.size.height - taken
        self.panel("banner").show(checked.banner(glyphs))
        self.panel("who").show(section(tr("what and who")))
        self.panel("checks").styles.max_height = max(rows - len(self.FIELDS) - 4, 1)
        self.panel("checks").show(checked.check_lines(glyphs))
        self.panel("plan").styles.max_height = rows
        self.panel("plan").show(checked.plan_lines(glyphs))
        self.panel("before").show(before)
        self.panel("before").display = self._is_roomy
        self.panel("start").show(checked.start_line)
        speed = self.query_one("#speed", Choice).value
        self.panel("end").show(checked.end_line(speed))
        summary = self._summaries.get(self.query_one("#procedure", Choice).value, "")
        self.panel("summary").show(ends((tr(summary), "$label"), ""))
        self._show_summary()
        self.panel("keys").show(self.key_line())

    @property
    def _is_roomy(self) -> bool:
        """Whether there is room for what to do before, a summary and a footer of two rows."""
        return self.app.size.height >= 22 and self.line_width >= FULL_WIDTH

    def _show_summary(self) -> None:
        self.panel("summary").display = self._is_roomy and not self.panel("notice").display

    def show_notice(self, text: str, *, for_now: bool = False, over: bool = True) -> None:
        super().show_notice(text, for_now=for_now, over=over)
        if self.is_shown:
            self._show_summary()

    def key_line(self) -> Content:
        """Return the form's keys, then the actions; a letter does nothing in a text field."""
        if not self._is_roomy:
            return super().key_line()
        acts = [
            FooterKey(key, label, works=True)
            for key, label in (*self.fixed, (PALETTE_KEY, EVERY_ACTION))
        ]
        views = []
        typing = isinstance(self.focused, Input)
        for name in self.VIEWS:
            label = self.label(name)
            works = self.application.allowed(name) and (BY_NAME[name].everywhere or not typing)
            key = shown(self.application.keymap[name][0])
            views.append(FooterKey(key, SHORT_LABELS.get(label, label), works))
        return form_footer(acts, views, self.line_width)

    async def _read_summaries(self) -> None:
        self._summaries = await run_in_thread(summaries, self._names)
        self.show_again()

    # -- fields ---------------------------------------------------------------------------------

    def entries(self) -> Entries:
        texts = {
            name: self.query_one(f"#{name}", Input).value.strip() for name, _, _ in self.FIELDS
        }
        speed = self.query_one("#speed", Choice).value
        return Entries(
            cell=texts["cell"],
            procedure=self.query_one("#procedure", Choice).value,
            operator=texts["operator"],
            job=texts["job"],
            seed=texts["seed"],
            speed="" if speed == self.SPEEDS[0] else speed,
            attended=self.query_one("#attended", Choice).value == self.WATCHED[0],
            start=texts["from"],
        )

    def order(self, entries: Entries) -> Order:
        options = self.application.options
        return entries.order(tuple(map(parse_setting, options.settings)), options.runs)

    def action_turn(self, step: int) -> None:
        """Choose in a choice; from a text field go to the next one, or to the one before."""
        if isinstance(self.focused, Choice):
            self.focused.action_turn(step)
        elif step > 0:
            self.focus_next()
        else:
            self.focus_previous()

    @on(Input.Changed)
    @on(Choice.Turned)
    def _change(self) -> None:
        """Compute the plan of the new fields, once they have been left alone for a moment."""
        if not self.is_shown or self._planned == self.entries().planned:
            return
        self._planned = self.entries().planned
        self._changes += 1
        self._request, self._checked = None, Checked()
        self.show(None)
        self.application.start_task(self._check_later(self._changes))

    async def _check_later(self, change: int) -> None:
        await asyncio.sleep(self.QUIET_S)
        if change == self._changes and self.is_shown:
            await self._check()

    # -- the plan -------------------------------------------------------------------------------

    async def _check(self) -> None:
        change, entries = self._changes, self.entries()
        plan, refused = None, ""
        try:
            plan = await process.dry_run(self.order(entries))
        except HilcellError as error:
            refused = str(error) or tr("refused without a reason")
        cell = await run_in_thread(self._cell_of, entries.cell, self.application.options.settings)
        if change != self._changes or not self.is_shown:
            return  # of earlier fields
        self._request = entries
        self._checked = Checked(plan, refused, cell, now())
        self.show(None)

    @on(Input.Submitted)
    def action_enter(self) -> None:
        """Ask whether to start, once at a time: keys may be held down."""
        if not self._asking:
            self._asking = True
            self.application.start_task(self._ask())

    async def _ask(self) -> None:
        try:
            self._changes += 1  # no check is needed that still waits
            while self._request is None or self._request.planned != self.entries().planned:
                await self._check()
        finally:
            self._asking = False
        entries, plan = self.entries(), self._checked.plan
        if self.app.screen is not self:
            return  # left meanwhile
        if plan is None:
            self.show_notice(tr("not started: see the checks"))
            return
        order = self.order(entries)
        self.app.push_screen(
            PlanSummary(order, plan),
            lambda yes: self.application.start_task(self._start(order)) if yes else None,
        )

    async def _start(self, order: Order) -> None:
        from hilcell.journal.runs import new_run

        runs = self.application.options.runs
        run = new_run(order.procedure)
        self.application.start_engine(runs / run, ["run", *order.replace(name=run).command_line()])

    @staticmethod
    def _choice(name: str, words: Sequence[str], labels: Sequence[str] = ()) -> ComposeResult:
        with Horizontal(classes="field"):
            yield Label(tr(name))
            yield Choice(words, name, labels)

    @staticmethod
    def _cell_of(name: str, settings: Sequence[str]) -> Cell | None:
        with suppress(HilcellError):
            return load_cell(name, dict(map(parse_setting, settings)))
        return None


def now() -> datetime:
    return datetime.now().astimezone()


class PlanSummary(Confirm):
    """The question before the start: the plan in short."""

    def __init__(self, order: Order, plan: process.DryRun) -> None:
        mark = (tr(" SIMULATION "), "bold $on-sim on $sim-fill") if plan.simulated else ""
        moved = Content.assemble("\n", mark, " " * plan.simulated, moves(has_rail=plan.rail))
        super().__init__(self.text(order, plan), tr("start"), tr("back"), moved)

    @staticmethod
    def text(order: Order, plan: process.DryRun) -> Content:
        unattended = order.attendance.unattended
        who = (
            tr("unattended: a question is a fault")
            if unattended
            else tr("attended: an operator answers questions")
        )
        notes = [
            f"{step_label(step.name, has_rail=plan.rail)}: {words}\n"
            for step in plan.steps
            for words in (step.note, step.warning)
            if words
        ]
        return Content.assemble(
            (
                tr(
                    "Start {procedure} on cell {cell}?\n",
                    procedure=procedure_label(plan.procedure),
                    cell=plan.cell,
                ),
                "bold $ask",
            ),
            tr(
                "job {job}, operator {operator}\n",
                job=order.job or "-",
                operator=order.operator or "-",
            ),
            tr(
                "{n} steps, {points} points, {time} of the cell's time\n",
                n=len(plan.steps),
                points=plan.points,
                time=duration(plan.duration_s),
            ),
            *notes,
            f"{who}.\n",
        )


def summaries(names: list[str]) -> dict[str, str]:
    from hilcell.cell.devices import load_entry

    texts: dict[str, str] = {}
    for name in names:
        try:
            texts[name] = load_entry("procedures", name).summary
        except HilcellError as error:
            texts[name] = str(error)
    return texts


@dataclass(frozen=True, slots=True)
class Checked:
    """The plan of the fields as they stand, or why it is refused, or nothing yet."""

    plan: DryRun | None = None
    refused: str = ""
    cell: Cell | None = None
    at: datetime | None = None

    @property
    def simulated(self) -> bool:
        if self.plan is None:
            return self.cell is not None and self.cell.simulation is not None
        return self.plan.simulated

    @property
    def has_rail(self) -> bool:
        return self.plan is None or self.plan.rail

    def banner(self, glyphs: Glyphs) -> Lines:
        blocks = [badge(f"{glyphs.stale} {tr('NEW RUN')}"), badge(tr("NOTHING OPENED"))]
        left = Content(" ").join([*blocks, *([simulation_block()] if self.simulated else [])])
        nothing = Fitting((Content.styled(tr("nothing moves before you start"), "$label"),))
        return Grid([(left, nothing)], Col(), Col(right=True, grows=True))

    def plan_lines(self, glyphs: Glyphs) -> Lines:
        """Return the steps with their points and durations, numbered as in the run.

        Where room is short, steps that do nothing are left out first.
        """
        plan = self.plan
        if plan is None:
            return self._without_plan(tr("plan"), glyphs)
        whole = [*enumerate(plan.steps, start=1)]

        def draw(width: int, height: int) -> list[Content]:
            steps, most = whole, (height or len(whole) + 2) - 2
            if len(steps) > most:
                steps = [(n, step) for n, step in steps if step.points or step.duration_s]
            shown = steps if len(steps) <= most else steps[: max(most - 1, 0)]
            rows: list[list[Text]] = []
            for n, step in shown:
                name = harmless(step_label(step.name, has_rail=self.has_rail))
                takes = duration(step.duration_s) if step.duration_s else "-"
                rows.append([f"{n:>2} {name}", str(step.points or "-"), takes, ""])
            if len(shown) < len(steps):
                rows.append([tr("   {n} more steps", n=len(steps) - len(shown)), "", "", ""])
            total = str(plan.points), duration(plan.duration_s)
            rows.append(
                [
                    (tr("   all {n} steps", n=len(whole)), "bold"),
                    *((each, "bold") for each in total),
                    "",
                ]
            )
            columns = Col(grows=True), Col(8, right=True), Col(8, right=True), Col(1)
            heading = section(tr("plan"), tr("points    takes")).lines(width)
            return [*heading, *Grid(rows, *columns).lines(width)]

        return Drawing(draw)

    def check_lines(self, glyphs: Glyphs) -> Lines:
        if self.plan is None:
            return self._without_plan(tr("checks"), glyphs)
        checks = [tr("cell file and options are valid")]
        checks += [tr("poses in reach, in limits, in sight")] if self.plan.points else []
        checks += [tr("the slide's path is clear")] if self.has_rail else []
        done = [Content.assemble((f"{glyphs.fresh} ", "$passed"), words) for words in checks]
        at = "" if self.at is None else tr(" at {at:%H:%M}", at=self.at)
        return Stack(section(tr("checks"), tr("{n} of {n}", n=len(checks)) + at), *done)

    def _without_plan(self, title: str, glyphs: Glyphs) -> Lines:
        """Return each line of a refusal whole, where there are rows enough; else its beginning."""
        if not self.refused:
            return Stack(section(title), (tr("  being checked ..."), "$label"))
        rows = [
            ((glyphs.warned, "bold $ask"), harmless(text)) for text in self.refusal_lines if text
        ]
        whole, cut = (Grid(rows, Col(), Col(grows=True, wraps=wraps)) for wraps in (True, False))

        def draw(width: int, height: int) -> list[Content]:
            lines = whole.lines(width)
            return lines if not height or len(lines) < height else cut.lines(width)

        return Stack(section(title, tr("refused")), Drawing(draw))

    @property
    def refusal_lines(self) -> list[str]:
        """Return the lines of a refusal, with procedure, steps and points in words."""
        first, *rest = map(str.strip, self.refused.splitlines() or [""])
        name, refused, why = first.partition(marked(" refused before anything moves"))
        if not refused:
            return [first, *rest]
        lines = [f"{procedure_label(name)}{tr(refused)}{why}"]
        for line in rest:
            step, colon, reason = line.partition(": ")
            words = step_label(step, has_rail=self.has_rail) if colon else step
            lines.append(f"{words}{colon}{with_labels(reason, Log())}")
        return lines

    def before_lines(self, *, attended: bool) -> Lines:
        words = [tr("Cell empty, guard closed, E-stop in reach.")]
        if self.cell is not None and self.cell.layout.by_hand:
            words.append(tr("One reflector, clean: you are asked when to carry it, and where."))
        elif self.cell is not None:
            layout = self.cell.layout
            few: list[str] = []
            for group in filter(None, (layout.floor, layout.bar, layout.slide)):
                names = [nest.name for nest in group]
                few.append(
                    " ".join(names)
                    if len(names) <= 4
                    else tr("{first} to {last}", first=names[0], last=names[-1])
                )
            words.append(tr("Reflectors in {few}, clean; one on the tool.", few=", ".join(few)))
        words.append(tr("Tracker on for two hours at least; doors closed."))
        if not attended:
            words.append(tr("Unattended: a question waits for an answer, then ends the run."))
        rows = ((("•", "$label"), each) for each in words)
        return Stack(section(tr("before you start")), Grid(rows, Col(), Col(grows=True)))

    @property
    def start_line(self) -> Lines:
        """Return the key that starts, grey while it would not, and what will move."""
        if self.plan is None:
            why = (
                tr("does nothing: the plan is refused")
                if self.refused
                else tr("asks once it is checked")
            )
            grey = Content.assemble((" Enter ", "$stale on $badge"), (f" {why}", "$stale"))
            return ends(grey, "")
        words = tr("robot and rail will move") if self.has_rail else tr("robot will move")
        key = Content.styled(" Enter ", "bold $on-ask on $ask-fill")
        line = key.append(Content.styled(tr(" start: {words}", words=words), "bold"))
        if not self.simulated:
            return ends(line, "")
        only = Content.styled(tr(" in simulation only: "), "$sim")
        whole = Content("").join([line, only, simulation_block()])
        short = Content("").join([key, Content.styled(tr(" start: "), "bold"), simulation_block()])
        return Grid([[Fitting((whole, short))]], Col(grows=True))

    def end_line(self, speed: str) -> Content:
        """Return when the run will end; of a simulation that is not paced, how long it takes."""
        if self.plan is None or self.at is None:
            return BLANK
        duration_s = self.plan.duration_s
        if self.simulated and speed != "1":
            return Content.styled(
                tr("takes {time} of the cell's time", time=duration(duration_s)),
                "$label",
            )
        end = self.at + timedelta(seconds=duration_s)
        return Content.styled(
            tr("ends about {end:%H:%M}, if nothing has to wait", end=end), "$label"
        )
