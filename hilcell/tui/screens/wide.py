"""The panels that a wide or a tall terminal adds to the run's screen: beside it, and under it."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from textual.content import Content

from hilcell.tui.engine.run_view import RunView
from hilcell.tui.plots.draw import Look
from hilcell.tui.plots.scale import Scale
from hilcell.tui.terminal.capabilities import Glyphs
from hilcell.tui.text.below import below_lines, block_rows
from hilcell.tui.text.deviation import PointRow
from hilcell.tui.text.side import side_lines
from hilcell.tui.widgets import TextPanel

REDRAW_S = 0.5


class WidePanels:
    """Draws each panel twice a second at most; ``rows`` are those of the points table."""

    def __init__(self) -> None:
        self._scale: Scale | None = None
        self._side_seen: tuple[object, ...] = ()
        self._below_place = (0, 0)  # columns and rows
        self._drawn_s = {"side": -math.inf, "below": -math.inf}

    def show_side(
        self, panel: TextPanel, view: RunView, rows: Sequence[PointRow], look: Look, theme: str
    ) -> None:
        """Show map and plot, where the panel has room and there is something new."""
        size = panel.size
        state = (size, theme, look, len(view.log.points), view.last)
        same_place = self._side_seen[:3] == state[:3]
        if not size.height or state == self._side_seen or (same_place and self._early("side")):
            return
        self._side_seen = state
        lines, self._scale = side_lines(view, rows, *size, look, self._scale)
        panel.show(Content("\n").join(lines))

    def show_below(
        self, panel: TextPanel, view: RunView, rows: Sequence[PointRow], glyphs: Glyphs, height: int
    ) -> None:
        """Show interlocks, next steps and events on a terminal of this height."""
        room = block_rows(height, live=view.live)
        panel.display = room > 0 and view.log.plan is not None
        width = panel.size.width or 79
        place = (width, room)
        if not panel.display or (place == self._below_place and self._early("below")):
            return
        self._below_place = place
        errors_mm = {row.point.key: row.norm_mm for row in rows if row.deviation is not None}
        panel.show(Content("\n").join(below_lines(view, errors_mm, glyphs, width, room)))

    def _early(self, name: str) -> bool:
        """Whether a panel was drawn just now; else it is drawn now."""
        now_s = time.monotonic()
        if now_s - self._drawn_s[name] < REDRAW_S:
            return True
        self._drawn_s[name] = now_s
        return False
