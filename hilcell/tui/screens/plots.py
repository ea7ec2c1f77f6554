"""Four plots of the run, one at a time; left and right choose."""

from __future__ import annotations

import time
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.content import Content

from hilcell.tui.engine.scene import Scene
from hilcell.tui.screens.base import Page
from hilcell.tui.widgets.panel import Panel

REDRAW_S = 0.5


class PlotPage(Page):
    """Element 11. Drawn twice a second at most: a drawing costs as much as twenty lines."""

    footer = ("stop", "pause", "alarms", "quit")
    fixed: ClassVar[tuple[tuple[str, str], ...]] = (*Page.fixed, ("left right", "other plot"))
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left", "turn(-1)", show=False),
        Binding("right", "turn(1)", show=False),
        *[Binding(str(n), f"choose({n - 1})", show=False) for n in range(1, 5)],
    ]

    def __init__(self) -> None:
        super().__init__()
        self._chosen = 0
        self._drawn_s = -REDRAW_S
        self._seen: tuple[object, ...] = ()

    def body(self) -> ComposeResult:
        """Build the plot's place."""
        yield Panel("plot")

    def show(self, scene: Scene | None) -> None:
        """Draw the chosen plot, if there is anything new to draw."""
        super().show(scene)
        if scene is None or scene.log.plan is None:
            return
        now_s = time.monotonic()
        state = (len(scene.log.points), self._chosen, self.app.size, self.app.theme)
        if state == self._seen or now_s - self._drawn_s < REDRAW_S:
            return
        from hilcell.tui.text.plot import draw
        from hilcell.tui.text.series import PLOTS

        self._seen, self._drawn_s = state, now_s
        plot = PLOTS[self._chosen](scene.log)
        title = f"Plot {self._chosen + 1} of {len(PLOTS)}: {plot.title}"
        self.panel("title").show(Content.styled(title, "bold"))
        height = max(self.app.size.height - 4, 6)
        self.panel("plot").show(draw(plot, self.wide, height))

    def action_turn(self, step: int) -> None:
        """Choose the next plot."""
        self.action_choose((self._chosen + step) % 4)

    def action_choose(self, index: int) -> None:
        """Choose a plot."""
        self._chosen, self._drawn_s = index, -REDRAW_S
        self.show(self.cell.scene)
