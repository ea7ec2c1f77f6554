"""Plots as text: errors, sorted errors, repeatability, strip; drawn by plotext.

Series differ by letter and name, not by colour.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import plotext
from textual.content import Content

from hilcell.calibration.errors import errors_of
from hilcell.geometry.statistics import from_mean_mm
from hilcell.journal.log import Log, Point, positions_mm
from hilcell.journal.point_id import PointId
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.text.tables import record_words

HOWS = ("before", "idw", "chosen")


@dataclass(frozen=True, slots=True)
class Line:
    """One series over 1, 2, 3 ..."""

    name: str
    values: list[float]


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot: title, labels, lines, and a limit to draw across."""

    title: str
    x_label: str
    y_label: str
    lines: list[Line]
    limit: float | None = None

    @property
    def y_limits(self) -> tuple[float, float]:
        """Return limits that hold every value and the limit off the plot's edge."""
        values = [value for line in self.lines for value in line.values if math.isfinite(value)]
        values += [] if self.limit is None else [self.limit]
        low, high = min([0.0, *values]), max([1e-6, *values])
        return low * 1.08, high * 1.08


def _norms(log: Log, kind: str, how: str = "") -> list[float]:
    points = log.select(kind, how=how)
    return errors_of(log, points).norms_mm.tolist() if "world" in log.frames else []


def errors_plot(log: Log) -> Plot:
    """Return |e| at the targets before and after correction, in their order."""
    lines = [Line(how, _norms(log, "validate", how)) for how in HOWS]
    lines = [line for line in lines if line.values]
    if not lines:
        lines = [Line("grid", _norms(log, "grid"))]
    return Plot("|e| at each target", "target", "mm", lines)


def sorted_plot(log: Log) -> Plot:
    """Return the same errors in rising order."""
    plot = errors_plot(log)
    lines = [Line(line.name, sorted(line.values)) for line in plot.lines]
    return Plot("|e| in rising order", "rank", "mm", lines)


def repeat_plot(log: Log) -> Plot:
    """Return how far repeated readings of a place lie from their mean."""
    groups: dict[str, list[Point]] = {}
    for point in log.points.values():
        if point.id.kind in ("repeat", "repeatability"):
            groups.setdefault(_place(point.id), []).append(point)
    lines = [
        Line(name, from_mean_mm(positions_mm(points)).tolist()) for name, points in groups.items()
    ]
    merged = [value for line in lines for value in line.values]
    if len(lines) > 3:
        lines = [Line("repeat visits", merged)]
    return Plot("repeatability: distance from the mean", "visit", "mm", lines)


def _place(id: PointId) -> str:
    return f"{id.how}/{id.way}" if id.kind == "repeat" else f"repeatability/{id.place}"


def strip_plot(log: Log) -> Plot:
    """Return the strip's reading less the station's value at every point."""
    wanted = {station.name: station.strip_mm for station in log.cell.station}
    values = [
        point.strip_mm - wanted[point.station]
        for point in log.points.values()
        if point.strip_mm is not None and point.station in wanted
    ]
    limit = log.cell.rail.held_within_mm
    return Plot("strip: reading less station", "point", "mm", [Line("strip", values)], limit)


def curves_plot(log: Log) -> Plot:
    """Return each axis's short-wave error over its sweep."""
    lines = [
        Line(f"A{axis}", [measured for _, measured, _ in record.shown])
        for axis, record in log.curves.items()
    ]
    return Plot("short-wave error of the swept axes", "0.1 deg", "urad", lines)


PLOTS: tuple[Callable[[Log], Plot], ...] = (errors_plot, sorted_plot, repeat_plot, strip_plot)
OF_ROBOT = PLOTS[:-1]
MOST_PLOTS = len(PLOTS) + 1


def plots_of(log: Log) -> tuple[Callable[[Log], Plot], ...]:
    """Return the plots of a run: the strip's where there is a rail, the curves' after sweeps."""
    plots = PLOTS if log.plan is None or log.cell.has_rail else OF_ROBOT
    return (*plots, curves_plot) if log.curves else plots


MARKS = ("o", "+", "x", "*", "#", "@")
TICKS = 5


def draw(plot: Plot, width: int, height: int) -> Content:
    """Return a plot of this size in columns and rows."""
    shown = [line for line in plot.lines if any(map(math.isfinite, line.values))]
    if not shown:
        return Content.styled("nothing measured for this plot yet", "$label")
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


LEAST_PLOT = 8


def side_lines(view: RunView, width: int, height: int) -> Content:
    """Return a plot over the newest records, in a space of this size."""
    plot_height = max(LEAST_PLOT, height // 2)
    plot = sorted_plot(view.log)
    lines = [Content.styled(plot.title, "bold"), draw(plot, width, plot_height)]
    newest = view.records[-max(height - plot_height - 2, 1) :]
    lines.append(Content.styled("newest records", "bold"))
    lines += [
        Content.assemble((f"{record.t[11:19]} ", "$label"), record_words(record)).truncate(
            width, ellipsis=True
        )
        for record in newest
    ]
    return Content("\n").join(lines)
