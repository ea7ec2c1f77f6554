"""Draws a plot as text, by plotext; series are told apart by letter and name, not by colour."""

from __future__ import annotations

import math

import plotext
from textual.content import Content

from hilcell.tui.text.series import Plot

MARKS = ("o", "+", "x")
TICKS = 5


def draw(plot: Plot, width: int, height: int) -> Content:
    """Return a plot of this size in columns and rows."""
    shown = [line for line in plot.lines if any(map(math.isfinite, line.values))]
    if not shown:
        return Content.styled("nothing measured for this plot yet", "$dim")
    longest = max(len(line.values) for line in shown)
    plotext.clear_figure()
    plotext.theme("clear")
    plotext.plotsize(width, height)
    for mark, line in zip(MARKS, shown, strict=False):
        numbers = [(at, y) for at, y in enumerate(line.values, start=1) if math.isfinite(y)]
        plotext.scatter(*zip(*numbers, strict=True), marker=mark, label=line.name)
    if plot.limit is not None:
        plotext.hline(plot.limit)
    plotext.ylim(*plot.y_limits)
    plotext.xticks(sorted({1 + round(n * (longest - 1) / (TICKS - 1)) for n in range(TICKS)}))
    plotext.xlabel(plot.x_label)
    plotext.ylabel(plot.y_label)
    return Content(plotext.uncolorize(plotext.build()))
