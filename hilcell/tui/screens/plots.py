"""The page of plots (element 11): one plot at a time, turned by keys."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.content import Content

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.plots import Look
from hilcell.tui.screens.base import BaseScreen, Page
from hilcell.tui.terminal.themes import SIXTEEN
from hilcell.tui.text.plots import MOST_TABS, Choice, Measured, plot_lines, tab_line, tabs_of
from hilcell.tui.widgets import TextPanel


def plot_look(screen: BaseScreen) -> Look:
    """Return what the terminal shows of a plot: letters where colours tell nothing."""
    plain = screen.application.glyphs.plain
    few = screen.app.theme == SIXTEEN or bool(screen.app.no_color)
    return Look(letters=plain or few, plain=plain)


class PlotPage(Page):
    """Draws twice a second at most, and only what is new."""

    REDRAW_S = 0.5
    TALL = 28  # rows, from which tabs and title stand apart

    footer = ("stop", "pause", "alarms", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (
        ("◄ ►", "other plot"),
        (f"1-{MOST_TABS}", "choose"),
        ("S", "station"),
        ("g", "log or even scale"),
        ("v", "series on or off"),
        *Page.fixed,
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False),
        Binding("right", "turn(1)", show=False),
        *[Binding(str(n + 1), f"choose({n})", show=False) for n in range(MOST_TABS)],
        Binding("S,s", "change('pick')", show=False),
        Binding("g", "change('scale')", show=False),
        Binding("v", "change('series')", show=False),
    ]

    def __init__(self) -> None:
        super().__init__()
        self._choice = Choice()
        self._drawn_s = -self.REDRAW_S
        self._seen: tuple[object, ...] = ()

    def fixed_keys(self) -> Sequence[tuple[str, str]]:
        """Return the keys with as many numbers as there are plots."""
        first, _, *others = self.fixed
        numbers = [(f"1-{self._count}", "choose")] if self._count > 1 else []
        return (first, *numbers, *others)

    def body(self) -> ComposeResult:
        yield TextPanel("plot")

    def show(self, view: RunView | None) -> None:
        """Draw the chosen plot, if there is anything new to draw and room for it."""
        super().show(view)
        self.panel("title").display = False
        if view is None or view.log.plan is None:
            return
        size, now_s = self.panel("plot").size, time.monotonic()
        turned = (size, self.app.theme)
        state = (len(view.log.points), len(view.log.curves), *turned)
        early = self._seen[2:] == turned and now_s - self._drawn_s < self.REDRAW_S
        if state == self._seen or early or not size.height:
            return
        self._seen, self._drawn_s = state, now_s
        self.panel("plot").show(self._lines(Measured(view.log), size.width, size.height))

    def _lines(self, of: Measured, width: int, height: int) -> Content:
        look, gap = plot_look(self), [Content("")] if height >= self.TALL else []
        tabs = [*gap, tab_line(of, self._choice, width, look), *gap]
        lines = plot_lines(of, self._choice, width, height - len(tabs) - len(gap), look)
        return Content("\n").join([*tabs, *lines])

    def action_turn(self, step: int) -> None:
        if count := self._count:
            self.action_choose((self._choice.tab + step) % count)

    def action_choose(self, index: int) -> None:
        if index < self._count:
            self._choice.tab, self._choice.series = index, 0
            self._draw_again()

    def action_change(self, part: str) -> None:
        view = self.application.view
        if view is None or view.log.plan is None:
            return
        tab = tabs_of(view.log)[self._choice.tab]
        if part == "pick":
            self._choice.picks[self._choice.tab] += 1
        elif part == "series":
            self._choice.turn_series(len(tab.make(Measured(view.log), "").series))
        elif tab.is_log is not None:
            self._choice.turned[self._choice.tab] += 1
        else:
            why = "its values are not all above zero"
            self.show_notice(f"this plot has an even scale only: {why}")
        self._draw_again()

    def _draw_again(self) -> None:
        self._seen = ()
        self.show_again()

    @property
    def _count(self) -> int:
        view = self.application.view
        return len(tabs_of(view.log)) if view is not None and view.log.plan is not None else 0
