"""A new run: cell, procedure, operator and job; then the plan, and only then the start."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal
from textual.content import Content
from textual.widgets import Input, Label

from hilcell.errors import HilcellError
from hilcell.tui.engine import process
from hilcell.tui.engine.background import run_in_thread
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.screens.base import BaseScreen, Dialog, answer_keys
from hilcell.tui.text.run import NOT_E_STOP, duration, moves
from hilcell.tui.widgets import Choice, Column, Row, Table, TextField, TextPanel

FIELDS = (
    ("cell", "paper", "a built-in cell, or a path to a TOML file"),
    ("operator", "", "your name, kept in the journal"),
    ("job", "", "kept in the journal"),
    ("seed", "1", "of random targets; of a simulated cell's truth"),
)
WATCHED = ("yes, I am here", "no, unattended")
SPEEDS = ("max", "100", "10", "1")


class StartScreen(BaseScreen):
    """The form. Enter checks the plan; nothing moves before the plan was shown."""

    footer = ("history", "help", "theme", "quit")
    fixed = in_box = (("Enter", "check the plan"), ("Tab", "next field"))
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down", "turn(1)", show=False, priority=True),  # in the request typed
        Binding("up", "turn(-1)", show=False, priority=True),
        Binding("enter", "check", show=False),
    ]
    _checking = False

    def compose(self) -> ComposeResult:
        """Build the form."""
        yield TextPanel("title")
        for name, value, hint in FIELDS:
            with Horizontal(classes="field"):
                yield Label(name)
                start = self.application.options.cell if name == "cell" else value
                yield TextField(start, placeholder=hint, id=name)
        with Horizontal(classes="field"):
            yield Label("attended")
            yield Choice(WATCHED, id="attended")
        with Horizontal(classes="field"):
            yield Label("speed")
            yield Choice(SPEEDS, id="speed")
        yield Table(
            [Column("procedure", 24), Column("what it does", 52)],
            id="procedures",
            empty="no procedures are installed",
            plain=self.application.glyphs.plain,
        )
        yield TextPanel("notice")
        yield TextPanel("keys")

    def on_mount(self) -> None:
        """List the procedures; their summaries come when they are loaded."""
        self.panel("notice").display = False
        self.panel("title").show(
            Content.assemble(("New run", "bold"), (f"   {NOT_E_STOP}", "$label"))
        )
        rows = self.query_one(Table)
        names = sorted({entry.name for entry in entry_points(group="hilcell.procedures")})
        rows.show_rows([Row(name, (name, "")) for name in names])
        rows.action_to(names.index("calibrate") if "calibrate" in names else 0)
        rows.focus()
        super().on_mount()
        self.application.start_task(self._summaries(names))

    def show(self, view: RunView | None) -> None:
        """Show the keys; there is no run yet."""
        self.panel("keys").show(self.key_line())

    async def _summaries(self, names: list[str]) -> None:
        found = await run_in_thread(summaries, names)
        if self.is_shown:
            self.query_one(Table).show_rows([Row(name, (name, found[name])) for name in names])

    def request(self) -> process.RunRequest:
        """Return the entries of the form."""
        text = {name: self.query_one(f"#{name}", Input).value.strip() for name, _, _ in FIELDS}
        speed = self.query_one("#speed", Choice).value
        return process.RunRequest(
            cell=text["cell"],
            procedure=self.query_one(Table).key,
            operator=text["operator"],
            job=text["job"],
            seed=text["seed"] or "1",
            speed="" if speed == SPEEDS[0] else speed,
            attended=self.query_one("#attended", Choice).value == WATCHED[0],
            settings=self.application.options.settings,
        )

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave up and down to the list of procedures."""
        return action != "turn" or not isinstance(self.focused, Table)

    def action_turn(self, step: int) -> None:
        """Go to the next field, or to the one before."""
        self.focus_next() if step > 0 else self.focus_previous()

    def on_table_row_selected(self) -> None:
        """Check the plan."""
        self.action_check()

    def on_input_submitted(self) -> None:
        """Check the plan."""
        self.action_check()

    def action_check(self) -> None:
        """Check the plan, once at a time: keys may be held down."""
        if not self._checking:
            self._checking = True
            self.application.start_task(self._check())

    async def _check(self) -> None:
        request = self.request()
        self.show_notice("checking the plan; nothing is opened ...")
        try:
            plan = await process.dry_run(request)
        finally:
            self._checking = False
        if self.app.screen is not self:
            return  # left meanwhile
        self.show_notice("")
        self.app.push_screen(
            PlanSummary(request, plan),
            lambda yes: self.application.start_task(self._start(request)) if yes else None,
        )

    async def _start(self, request: process.RunRequest) -> None:
        from hilcell.journal.runs import new_run

        runs = self.application.options.runs
        run = new_run(request.procedure)
        arguments = [*request.arguments(), "--runs", str(runs), "--name", run]
        self.application.actions.start(runs / run, arguments)


class PlanSummary(Dialog[bool]):
    """The plan with its steps and its duration; Enter starts, q goes back."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter,y", "reply(True)", show=False, priority=True),
        Binding("q,n,backspace", "reply(False)", show=False, priority=True),
    ]

    def __init__(self, request: process.RunRequest, plan: dict[str, Any]) -> None:
        super().__init__()
        self._order, self._plan = request, plan

    def on_mount(self) -> None:
        """Show the plan."""
        self.show_texts(plan_lines(self._order, self._plan), warning(self._plan))

    def action_reply(self, yes: bool) -> None:
        """Close with the answer."""
        if self.deliberate or not yes:
            self.dismiss(yes)


def plan_lines(request: process.RunRequest, plan: dict[str, Any]) -> Content:
    """Return a plan as a table, with what starts it."""
    rows = [
        f"{step['name']:<26}{step['points']:>7}  {duration(step['duration_s']):>9}"
        for step in plan["steps"]
    ]
    rows += [f"  {step['note']}" for step in plan["steps"] if step.get("note")]
    rows.append(f"{'all':<26}{plan['points']:>7}  {duration(plan['duration_s']):>9}")
    who = (
        "somebody is here to be asked" if request.attended else "unattended: a question is a fault"
    )
    return Content.assemble(
        (f"{plan['procedure']} on cell {plan['cell']}", "bold $ask"),
        f"   job {request.job or '-'}, operator {request.operator or '-'}\n",
        (f"{'step':<26}{'points':>7}  {'cell time':>9}\n", "$label"),
        "\n".join(rows),
        f"\n\n{who}.",
    )


def warning(plan: dict[str, Any]) -> Content:
    """Return what will happen, and the keys."""
    simulated = bool(plan.get("simulated"))
    return Content.assemble(
        moves(has_rail=bool(plan.get("rail", True))),
        (", in simulation only: ", "bold") if simulated else "",
        (" SIMULATION ", "bold $on-sim on $sim-fill") if simulated else "",
        ".\n",
        answer_keys("start", "back"),
    )


def summaries(names: list[str]) -> dict[str, str]:
    """Return the summary of each procedure."""
    from hilcell.cell.devices import load_entry

    found: dict[str, str] = {}
    for name in names:
        try:
            found[name] = load_entry("procedures", name).summary
        except HilcellError as error:
            found[name] = str(error)
    return found
