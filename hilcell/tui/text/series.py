"""What the plots show, as plain numbers: errors, sorted errors, repeatability, strip."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hilcell.journal.log import Log, Point
from hilcell.tui.text.deviation import deviation_of

HOWS = (("validate_before", "before"), ("validate_idw", "idw"), ("validate_chosen", "chosen"))


@dataclass(frozen=True, slots=True)
class Line:
    """One series over 1, 2, 3 ..."""

    name: str
    values: list[float]


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot: its words, its lines, and a limit to draw across, where one stands."""

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


def _norms(log: Log, points: Sequence[Point]) -> list[float]:
    found = [deviation_of(log, point) for point in points]
    return [each.norm_mm for each in found if each is not None]


def errors_plot(log: Log) -> Plot:
    """Return |e| at the targets before and after correction, in their order."""
    lines = [Line(name, _norms(log, log.group(group))) for group, name in HOWS]
    lines = [line for line in lines if line.values]
    if not lines:
        lines = [Line("grid", _norms(log, log.group("grid")))]
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
        if point.group.startswith("repeat"):
            place = point.key.rsplit("/", 1)[0]
            groups.setdefault(place, []).append(point)
    lines = [
        Line(name.removeprefix("repeat/"), _from_mean(points)) for name, points in groups.items()
    ]
    merged = [value for line in lines for value in line.values]
    if len(lines) > 3:
        lines = [Line("repeat visits", merged)]
    return Plot("repeatability: distance from the mean", "visit", "mm", lines)


def _from_mean(points: Sequence[Point]) -> list[float]:
    mean = [sum(point.xyz_mm[axis] for point in points) / len(points) for axis in range(3)]
    return [
        sum((point.xyz_mm[axis] - mean[axis]) ** 2 for axis in range(3)) ** 0.5 for point in points
    ]


def strip_plot(log: Log) -> Plot:
    """Return the strip's reading less the station's value at every point."""
    wanted = {station.name: station.strip_mm for station in log.cell.station}
    values = [
        point.strip_mm - wanted[point.station]
        for point in log.points.values()
        if point.strip_mm is not None and point.station in wanted
    ]
    limit = 2.0 * log.cell.rail.strip_tolerance_mm
    return Plot("strip: reading less station", "point", "mm", [Line("strip", values)], limit)


PLOTS: tuple[Callable[[Log], Plot], ...] = (errors_plot, sorted_plot, repeat_plot, strip_plot)
