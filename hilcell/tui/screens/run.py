"""The run: state, step, lamps, deviation, alarms, prompt and points on one screen of 80x24."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widgets import Input

from hilcell.alarms import Latched
from hilcell.language import marked, tr
from hilcell.tui.keys import CHOICE_KEYS, shown
from hilcell.tui.layout import Drawing, Lines, Stack, ends
from hilcell.tui.plots import Scale
from hilcell.tui.process import run_in_thread
from hilcell.tui.run_view import RunView
from hilcell.tui.screens.pages import DetailPage, FilterScreen, Pace, plot_style
from hilcell.tui.text.actions import WORDS as SHORT_LABELS
from hilcell.tui.text.actions import FooterKey, footer_lines
from hilcell.tui.text.alarms import AlarmBox, newest_line, panel_is_due, saved_text
from hilcell.tui.text.devices import DeviceText
from hilcell.tui.text.finished import Result, finished_verdict, result_of
from hilcell.tui.text.points import PointRow, PointRows, filtered, point_columns
from hilcell.tui.text.prompt import PromptBox
from hilcell.tui.text.run import RunText, Shown, block_rows
from hilcell.tui.text.side import side_lines
from hilcell.tui.widgets import Table, TextPanel


@dataclass(frozen=True, slots=True)
class PointFilter:
    """The filter and order of the points: kept when a run is opened again."""

    bad_only: bool = False
    worst_first: bool = False
    key: str = ""


class RunScreen(FilterScreen):
    """One run, live or past."""

    LINES = ("identity", "step", "progress", "lamps", "interlock")
    HIDE_POINTS = ("verdict", "alarm")
    BOXES = ("deviation", "prompt", *HIDE_POINTS)  # of which one is shown
    LOW = 20  # rows, below which boxes leave out what matters least
    FULL = 24  # rows of a terminal, of which boxes leave none to the table

    footer = ("stop", "quit")  # while a filter is typed
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (
        ("▲▼", marked("choose a point")),
        ("Enter", marked("open the point, or answer the question")),
        *((key, marked("this answer of the question, where it has some")) for key in CHOICE_KEYS),
        ("q", marked("back from the points to the verdict or the alarm, or to the run behind")),
    )
    HORIZONTAL_BREAKPOINTS = [  # noqa: RUF012 - as Textual has it
        (100, "-beside"),  # the map is beside the points
        (120, "-table"),  # the table has nominal and measured places in its stead
        (138, "-wide"),  # the map in three views
    ]
    VERTICAL_BREAKPOINTS = [  # noqa: RUF012 - as Textual has it
        (0, "-low"),
        (22, "-fair"),
        (24, "-full"),
        (32, "-tall"),
    ]
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", "answer", show=False),
        *(Binding(key, f"choice({key})", show=False) for key in CHOICE_KEYS),
        Binding("q,backspace", "back", show=False, priority=True),
    ]

    def __init__(self, point_filter: PointFilter | None = None) -> None:
        super().__init__()
        start = point_filter or PointFilter()
        self.bad_only, self.worst_first, self._chosen = start.bad_only, start.worst_first, start.key
        self._table = PointRows()
        self._rows: list[PointRow] = []  # of all points
        self._points_seen: tuple[object, ...] = ()
        self._side_pace, self._below_pace = Pace(), Pace()
        self._room = 0  # rows under the points
        self._scale: Scale | None = None  # of the plot at the side
        self._result: tuple[object, Result | None] = (None, None)  # of which end record
        self.points_open = False  # over the verdict of a run that is done

    def compose(self) -> ComposeResult:
        yield TextPanel("banner")
        with Horizontal(id="middle"):
            with Vertical(id="left"):
                for name in (*self.LINES, "deviation", "verdict"):
                    yield TextPanel(name)
                yield PromptBox(id="prompt")
                yield AlarmBox(id="alarm")
                yield Table(
                    point_columns(), attrgetter("key"), empty=tr("no points yet"), id="points"
                )
                yield self.filter_box(tr("filter: words of name, station or state"))
                yield TextPanel("status")
                yield TextPanel("below")
            yield TextPanel("side")
        yield TextPanel("notice")
        yield TextPanel("keys")

    def begin(self) -> None:
        for name in ("alarm", "prompt", "verdict", "notice", "below"):
            self.query_one(f"#{name}").display = False
        rows = self.query_one(Table)
        rows.follow = True
        rows.focus()
        super().begin()

    def show(self, view: RunView | None) -> None:
        super().show(view)
        if view is None:
            return
        self.points_open &= not view.live
        run = RunText(view, self.application.glyphs)
        devices = DeviceText(view, self.application.glyphs)
        for name, text in {
            "identity": run.identity,
            "step": run.step,
            "progress": run.progress,
            "lamps": devices.lamps,
            "interlock": devices.interlocks,
        }.items():
            self.panel(name).show(text())
        self._show_points(view)
        self._show_wide(view)
        self._show_middle(view)

    @property
    def _latched(self) -> list[Latched]:
        return self.application.shown_session.latch.standing()

    @property
    def instead(self) -> str:
        """Return which panel is in the place of the points: prompt, verdict, alarm, or none."""
        view = self.application.view
        if view is None or view.prompt is not None:
            return "prompt" if view is not None else ""
        if self.points_open:
            return ""
        if panel_is_due(view, self._latched):
            return "alarm"
        known = finished_verdict(view) is not None or self._result_of(view) is not None
        return "verdict" if known else ""

    def _result_of(self, view: RunView) -> Result | None:
        end = view.log.end
        if self._result[0] is not end:
            self._result = (end, None)
            if end is not None and finished_verdict(view) is None:
                self.application.start_task(self._read_result(view))
        return self._result[1]

    async def _read_result(self, view: RunView) -> None:
        """Read the result off the thread that takes keys: its procedure is imported."""
        end = view.log.end
        result = await run_in_thread(result_of, view)
        if view.log.end is end:
            self._result = (end, result)
            self.show_again()

    def _show_middle(self, view: RunView) -> None:
        instead, standing = self.instead, self._latched
        glyphs, height = self.application.glyphs, self.app.size.height
        for name in self.BOXES:
            self.query_one(f"#{name}").display = name == (instead or "deviation")
        match instead:
            case "prompt":
                if view.prompt is not None:
                    self.query_one(PromptBox).show(view.prompt, view, glyphs, low=height < self.LOW)
            case "alarm":
                kept, context = saved_text(view.log), self.alarm_context()
                self.query_one(AlarmBox).show(standing, kept, context, low=height < self.LOW)
            case "verdict":
                self._show_verdict(view)
            case _:
                self._show_deviation(view, Shown.rows_for(height))
        shown = view.state == "intolerant" and finished_verdict(view) is not None  # by the verdict
        said = instead == "verdict" and len(standing) <= shown
        self.panel("status").display = not said and (bool(standing) or height >= self.FULL - 1)
        self.panel("status").show(self._status(view))
        # A table has a row at least, and would push the status out.
        rows = height - block_rows(height, live=view.live)
        self.query_one(Table).styles.height = 0 if instead and rows <= self.FULL else "1fr"

    def _status(self, view: RunView) -> Lines:
        """Return the worst alarm that is not shown, or that there is none and what comes next."""
        standing, context = self._latched, self.alarm_context()
        if self.instead == "alarm":
            return Stack(context.line(standing, skip=1), newest_line(view))
        if standing:
            return context.line(standing)
        return ends(
            (f"{context.glyphs.stale} {tr('no alarms')}", "$label"),
            RunText(view).following(),
        )

    def _show_deviation(self, view: RunView, rows: int) -> None:
        table, known = self.query_one(Table), self._table.deviation
        last = table.follow and table.cursor >= len(table.rows) - 1
        if not table.rows or (view.live and last):
            point = Shown.newest(view, known)
        else:
            point = Shown.chosen(view, table.key, known, chosen=not last)
        self.panel("deviation").show(point.lines(self.application.glyphs, rows))

    def _show_verdict(self, view: RunView) -> None:
        glyphs, verdict, result = (
            self.application.glyphs,
            finished_verdict(view),
            self._result_of(view),
        )
        if verdict is not None:
            lines = verdict.lines(view, glyphs, len(self._latched))
            self.panel("verdict").show(lines)
        elif result is not None:
            self.panel("verdict").show(result.lines(view, glyphs))

    def on_table_row_highlighted(self) -> None:
        view = self.application.view
        if self.instead in self.HIDE_POINTS:
            self._open_points()
        elif view is not None:
            self._show_middle(view)

    def _open_points(self) -> None:
        self.points_open = True
        self.show(self.application.view)

    @property
    def point_filter(self) -> PointFilter:
        rows = self.query(Table)
        return PointFilter(self.bad_only, self.worst_first, rows.first().key if rows else "")

    def _show_points(self, view: RunView) -> None:
        rows = self.query_one(Table)
        waiting = frozenset(view.status.retakes) if view.status is not None else frozenset()
        newest = view.records[-1].seq if view.records else 0
        state = (newest, self.filter_text, self.bad_only, self.worst_first, waiting)
        if state == self._points_seen:
            return
        self._points_seen = state
        self._rows = self._table.rows(view.log)
        order = {"bad_only": self.bad_only, "worst": self.worst_first}
        matching = filtered(self._rows, self.filter_text, **order)
        rows.empty = tr("no such point") if self.filter_text else tr("no points yet")
        if self.bad_only and view.log.points:
            all_key = shown(self.application.keymap["bad"][0])
            rows.empty = tr("no such point is bad; {all_key} shows all", all_key=all_key)
        rows.follow = not self.worst_first
        shown_rows = [
            replace(each, state="waits") if each.key in waiting else each for each in matching
        ]
        rows.show_rows(shown_rows, point_columns(**order))
        if self._chosen in view.log.points:
            rows.choose(self._chosen)
            self._chosen = ""

    def _show_wide(self, view: RunView) -> None:
        """Show map and plot, and interlocks, next steps and events, where there is room."""
        side, below = self.panel("side"), self.panel("below")
        style = plot_style(self)

        def draw(width: int, height: int) -> list[Content]:
            lines, self._scale = side_lines(view, self._rows, width, height, style, self._scale)
            return lines

        if side.display and self._side_pace.is_due():
            side.show(Drawing(draw))
        room = block_rows(self.app.size.height, live=view.live)
        below.display = room > 0 and view.log.plan is not None
        if below.display and (room != self._room or self._below_pace.is_due()):
            self._room = room
            errors_mm = {e.point.key: e.norm_mm for e in self._rows if e.deviation is not None}
            below.show(RunText(view, self.application.glyphs).below(errors_mm, room))

    def label(self, name: str) -> str:
        if name == "sort":
            return marked("as measured") if self.worst_first else marked("worst first")
        if name == "bad":
            return marked("all") if self.bad_only else marked("bad only")
        return super().label(name)

    def key_line(self) -> Content:
        """Return the footer: slots that keep their places; in a text box, its own keys."""
        if isinstance(self.focused, Input):
            return super().key_line()
        return footer_lines(self.footer_key, self.line_width)

    def footer_key(self, name: str) -> FooterKey:
        if name == "detach" and not self.application.allowed(name):
            name = "new"
        key = shown(self.application.keymap[name][0])
        label = self.label(name)
        return FooterKey(key, SHORT_LABELS.get(label, label), self.application.allowed(name))

    def action_enter(self) -> None:
        self._enter(self.query_one(Table).key)

    def action_choice(self, number: int) -> None:
        self.application.answer_prompt(number)

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        self._enter(message.key)

    def _enter(self, key: str) -> None:
        view = self.application.view
        if view is not None and view.prompt is not None:
            self.application.answer_prompt()
        elif self.instead in self.HIDE_POINTS:
            self._open_points()
        elif key:
            self.app.push_screen(DetailPage(key))

    # -- keys of this screen ------------------------------------------------------------------

    def do_bad(self) -> None:
        self.bad_only, self.points_open = not self.bad_only, True
        self.show(self.application.view)

    def do_sort(self) -> None:
        self.worst_first, self.points_open = not self.worst_first, True
        self.show(self.application.view)
        if self.worst_first:
            self.query_one(Table).action_to(0)

    def do_find(self) -> None:
        self.points_open = True
        self.show(self.application.view)
        super().do_find()

    def filter_rows(self) -> None:
        self.show(self.application.view)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to the filter; go back only where there is something to go back to."""
        if action != "back":
            return True
        behind = self.application.open_runs.background is not None
        return (behind or self.points_open) and not isinstance(self.focused, Input)

    def action_back(self) -> None:
        """Show the verdict or the alarm again, else the background run."""
        if self.points_open:
            self.points_open = False
            self.show(self.application.view)
        else:
            self.application.show_background_run()

    def do_retake(self) -> None:
        self.application.retake(self.query_one(Table).key)
