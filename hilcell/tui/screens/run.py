"""The run: state, step, lamps, deviation, alarms, prompt and points on one screen of 80x24."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.widgets import Input

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.keys import shown
from hilcell.tui.plots.scale import Scale
from hilcell.tui.screens.pages import FilterScreen
from hilcell.tui.screens.plots import look_of
from hilcell.tui.text import run as run_text
from hilcell.tui.text.alarm_panel import alarm_panel, kept_words, newest_line, panel_is_due
from hilcell.tui.text.alarm_words import alarm_line
from hilcell.tui.text.deviation import deviation_lines, deviation_of
from hilcell.tui.text.points import PointRows, columns_for, filtered
from hilcell.tui.text.prompt import prompt_box
from hilcell.tui.text.side import side_lines
from hilcell.tui.widgets import Table, TextPanel

WIDE = 120  # columns, as in the style sheet
LINES = ("banner", "identity", "step", "progress", "lamps", "interlock")


@dataclass(frozen=True, slots=True)
class PointFilter:
    """The filter and order of the points: kept when a run is opened again."""

    bad_only: bool = False
    worst_first: bool = False
    key: str = ""


class RunScreen(FilterScreen):
    """One run, live or past."""

    footer = (
        "stop", "pause", "help", "acknowledge", "retake", "abort", "report", "sort", "plots",
        "history", "detach", "new", "bad", "find", "log", "interlocks", "alarms", "quit",
    )  # fmt: skip
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "enter", "answer", show=False),
        Binding("q,backspace", "show_background_run", show=False, priority=True),
    ]

    def __init__(self, point_filter: PointFilter | None = None) -> None:
        super().__init__()
        start = point_filter or PointFilter()
        self.bad_only, self.worst_first, self._chosen = start.bad_only, start.worst_first, start.key
        self._table = PointRows()
        self._points_seen: tuple[object, ...] = ()
        self._side_seen: tuple[object, ...] = ()
        self._side_scale: Scale | None = None

    def compose(self) -> ComposeResult:
        """Build the lines, the box of points and the panel beside it."""
        for name in LINES:
            yield TextPanel(name)
        yield TextPanel("deviation")
        yield TextPanel("alarm")
        yield TextPanel("prompt")
        with Horizontal(id="middle"):
            with Vertical():
                yield Table(
                    columns_for(80),
                    empty="no points yet",
                    id="points",
                    plain=self.application.glyphs.plain,
                )
                yield self.filter_box("filter: words of name, station or state")
            yield TextPanel("side")
        yield TextPanel("notice")
        yield TextPanel("keys")

    def on_mount(self) -> None:
        """Hide the panels that are empty."""
        for name in ("alarm", "prompt", "notice"):
            self.panel(name).display = False
        rows = self.query_one(Table)
        rows.follow = True
        rows.focus()
        super().on_mount()

    def show(self, view: RunView | None) -> None:
        """Show every line of the view."""
        super().show(view)
        if view is None:
            return
        glyphs, width = self.application.glyphs, self.line_width
        self.panel("identity").show(run_text.identity(view, width))
        self.panel("step").show(run_text.step(view, width))
        self.panel("progress").show(run_text.progress(view, glyphs, width))
        self.panel("lamps").show(run_text.lamps(view, glyphs, width))
        self.panel("interlock").show(run_text.interlocks(view, width))
        self._show_boxes(view)
        self._show_points(view)
        self._show_side(view)
        self._show_deviation(view)

    def _show_deviation(self, view: RunView) -> None:
        """Show the newest point of a live run, the chosen one of a past run."""
        key = self.query_one(Table).key
        point = view.newest_target if view.live or not key else view.log.points.get(key)
        found = None if point is None else deviation_of(view.log, point)
        none = f"{key}: no nominal place, so no deviation" if key else "no point measured yet"
        lines = deviation_lines(found, self.application.glyphs, self.line_width, none)
        self.panel("deviation").show(lines)

    def on_table_row_highlighted(self) -> None:
        """Show the point that is chosen now."""
        view = self.application.view
        if view is not None:
            self._show_deviation(view)

    def _show_boxes(self, view: RunView) -> None:
        alarm, prompt = self.panel("alarm"), self.panel("prompt")
        asked, standing, context = (
            view.prompt,
            self.application.latch.standing(),
            self.alarm_context(),
        )
        due, columns = panel_is_due(view, standing), self.line_width
        lines = [alarm_line(standing, context, columns, skip=int(due))]
        if due:
            kept, rows = kept_words(view.log), min(14, max(self.app.size.height - 10, 5))
            panel = alarm_panel(standing, kept, context, columns, rows)
            lines = [*panel, *lines, newest_line(view, columns)]
        alarm.display = bool(standing)
        alarm.show(Content("\n").join(lines))
        prompt.display = asked is not None
        self.panel("deviation").display = asked is None and not due
        if asked is not None:
            rows = min(15, max(self.app.size.height - 10, 5))
            box = prompt_box(asked, view, self.application.glyphs, columns, rows)
            prompt.show(Content("\n").join(box))

    @property
    def point_filter(self) -> PointFilter:
        """Return the filter and order of the points."""
        rows = self.query(Table)
        return PointFilter(self.bad_only, self.worst_first, rows.first().key if rows else "")

    def _show_points(self, view: RunView) -> None:
        rows = self.query_one(Table)
        waiting = frozenset(view.status.retakes) if view.status is not None else frozenset()
        wide = rows.size.width or self.line_width
        newest = view.records[-1].seq if view.records else 0
        state = (newest, self.filter_text, self.bad_only, self.worst_first, waiting, wide)
        if state == self._points_seen:
            return
        self._points_seen = state
        points = self._table.rows(view.log)
        found = filtered(points, self.filter_text, bad_only=self.bad_only, worst=self.worst_first)
        rows.empty = "no such point" if self.filter_text else "no points yet"
        if self.bad_only and view.log.points:
            all_key = shown(self.application.keymap["bad"][0])
            rows.empty = f"no such point is bad; {all_key} shows all"
        rows.follow = not self.worst_first
        rows.show_rows(
            [self._table.drawn(each, waiting, wide) for each in found],
            columns_for(wide, bad_only=self.bad_only, worst=self.worst_first),
        )
        if self._chosen in view.log.points:
            rows.choose(self._chosen)
            self._chosen = ""

    def _show_side(self, view: RunView) -> None:
        """Draw the panel beside the points, where there is room and something new."""
        side = self.panel("side")
        state = (len(view.log.points), side.size)
        if self.app.size.width < WIDE or not side.size.height or state == self._side_seen:
            return
        self._side_seen = state
        lines, self._side_scale = side_lines(
            view, self._table.rows(view.log), *side.size, look_of(self), self._side_scale
        )
        side.show(Content("\n").join(lines))

    def label(self, name: str) -> str:
        """Return what a key does now."""
        if name == "sort":
            return "as measured" if self.worst_first else "worst first"
        if name == "bad":
            return "all" if self.bad_only else "bad only"
        return super().label(name)

    def action_enter(self) -> None:
        """Answer the prompt, or open the chosen point."""
        self._enter(self.query_one(Table).key)

    def on_table_row_selected(self, message: Table.RowSelected) -> None:
        """Answer the prompt, or open the chosen point."""
        self._enter(message.key)

    def _enter(self, key: str) -> None:
        view = self.application.view
        if view is not None and view.prompt is not None:
            self.application.actions.answer()
        elif key:
            from hilcell.tui.screens.pages import DetailPage

            self.app.push_screen(DetailPage(key))

    # -- keys of this screen ------------------------------------------------------------------

    def do_bad(self) -> None:
        """Show bad points only, or all."""
        self.bad_only = not self.bad_only
        self.show(self.application.view)

    def do_sort(self) -> None:
        """RunRequest by |e|, or as measured."""
        self.worst_first = not self.worst_first
        self.show(self.application.view)
        if self.worst_first:
            self.query_one(Table).action_to(0)

    def filter_rows(self) -> None:
        """Show the points that match all words."""
        self.show(self.application.view)

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave letters to the filter; go back only where a run is in the background."""
        typing = isinstance(self.focused, Input)
        return action != "show_background_run" or (
            self.application.open_runs.background is not None and not typing
        )

    def action_show_background_run(self) -> None:
        """Show the background run again."""
        self.application.show_background_run()

    def do_retake(self) -> None:
        """Re-measure the chosen point."""
        self.application.actions.retake(self.query_one(Table).key)
