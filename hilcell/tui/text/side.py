"""The right side of a wide terminal: the map of the volume, and |e| target by target.

All of it is made of the rows of the points table, which know each error already.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from textual.content import Content

from hilcell.calibration.iso9283 import ISO
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.journal.log import Log
from hilcell.journal.ways_sent import BOTH, Sent
from hilcell.ports import Array
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import section
from hilcell.tui.plots.draw import Look, Plot, draw
from hilcell.tui.plots.scale import Scale, log_scale
from hilcell.tui.text.deviation import PointRow
from hilcell.tui.text.map import NO_POINT, Volume, map_lines
from hilcell.tui.text.plot_figures import mark_of
from hilcell.tui.text.plots import (
    Errors3D,
    Measured,
    mean_of,
    poses_plot,
    recheck_plot,
    target_plot,
)

MAP_ROWS, LEAST_PLOT = 22, 9
KINDS = ("grid", "validate", ISO, RECHECK)
PLOTS = {ISO: poses_plot, RECHECK: recheck_plot}  # of procedures that have a plot of their own
TITLES = {ISO: "|e| of the poses", RECHECK: "|e| re-checked"}
NOTHING_YET = "the map and the errors appear with the first target"
Rows = list[PointRow]
Lines = list[Content]


def side_lines(
    view: RunView,
    rows: Iterable[PointRow],
    width: int,
    height: int,
    look: Look,
    before: Scale | None = None,
) -> tuple[Lines, Scale | None]:
    """Return the lines, at most ``height``, and the plot's scale, for the next time."""
    targets = [row for row in rows if row.point.id.kind in KINDS and row.deviation is not None]
    if not targets:
        return Content.styled(NOTHING_YET, "$label").wrap(width), before
    room = min(MAP_ROWS, height - LEAST_PLOT)
    above = map_lines(volume_of(view.log, targets), width, room, plain=look.plain)
    below, scale = _plot(view.log, targets, width, height - len(above), look, before)
    return [*above, *below], scale


def volume_of(log: Log, targets: Rows) -> Volume:
    """Return the map's data: corrected targets, before there are any the errors as sent."""
    after = [row for row in targets if row.point.id.how == Sent.CHOSEN]
    raw = [row for row in targets if row.point.id.how in ("", Sent.BEFORE)]
    shown = after or raw or targets
    last = max(range(len(shown)), key=lambda n: log.recorded(shown[n].point))
    newest = max(targets, key=lambda row: log.recorded(row.point))
    low_mm, high_mm, stations = _extent(log, targets)
    return Volume(
        np.array([row.point.nominal_mm for row in shown], dtype=float),
        np.array([row.norm_mm for row in shown]),
        low_mm,
        high_mm,
        log.cell.validation.max_tolerance_mm if after else None,
        _rail_axis(log),
        last if shown[last] is newest else NO_POINT,
        planned_targets(log) if after else 0,
        TITLES.get(newest.point.id.kind, "|e| after correction" if after else "|e| as sent"),
        stations,
        newest.point.station,
    )


def _rail_axis(log: Log) -> int:
    """Return the horizontal axis of {W} along which the rail runs; y where there is none."""
    if not log.cell.has_rail:
        return 1
    return int(np.argmax(np.abs(log.cell.layout.rail_direction[:2])))


def _extent(log: Log, targets: Rows) -> tuple[Array, Array, tuple[tuple[str, float], ...]]:
    """Return the corners (3,) of what will be measured at all stations, and their middles.

    The targets known so far, moved along the rail: the map does not grow while a run goes on.
    """
    direction = np.array(log.cell.layout.rail_direction)
    strip_mm = {each.name: each.strip_mm for each in log.cell.station}
    kept = [row.point for row in targets if row.point.station in strip_mm]
    at_zero = np.array([point.nominal_mm for point in kept], dtype=float).reshape(-1, 3)
    at_zero -= np.outer([strip_mm[point.station] for point in kept], direction)
    low_mm, high_mm = at_zero.min(axis=0), at_zero.max(axis=0)
    shifts_mm = np.outer(list(strip_mm.values()), direction)
    middles_mm = ((low_mm + high_mm) / 2 + shifts_mm)[:, _rail_axis(log)]
    corners = low_mm + shifts_mm, high_mm + shifts_mm
    named = log.cell.has_rail
    stations = tuple(zip(strip_mm, middles_mm.tolist(), strict=True)) if named else ()
    return corners[0].min(axis=0), corners[1].max(axis=0), stations


def planned_targets(log: Log) -> int:
    """Return how many corrected targets a whole validation has; 0 where that is not stated."""
    cell, steps = log.cell, log.inputs.steps
    if cell.plan.quick or not any(step.get("name") == "validate" for step in steps):
        return 0
    others = len(cell.station) - 1
    at_others = cell.validation.others // others * others if others else 0
    return cell.validation.per_cell * math.prod(cell.grid.cells) + at_others


def _plot(
    log: Log, targets: Rows, width: int, height: int, look: Look, before: Scale | None
) -> tuple[Lines, Scale]:
    """Return |e| at the newest station, as sent and corrected, with its legend."""
    newest = max(targets, key=lambda row: log.recorded(row.point)).point
    if own := PLOTS.get(newest.id.kind):
        return _drawn(own(Measured(log), ""), width, height, look, before)
    station = newest.station
    found = _errors(log, [row for row in targets if row.point.station == station])
    limits = () if found.grid else (log.cell.validation.max_tolerance_mm,)
    plot = target_plot(found, limits, "limit")
    what = "grid point" if found.grid else "target"
    plot = replace(plot, title=f"|e| at {station}, {what} by {what}, mm")
    return _drawn(plot, width, height, look, before)


def _drawn(
    plot: Plot, width: int, height: int, look: Look, before: Scale | None
) -> tuple[Lines, Scale]:
    scale = log_scale(plot.values, plot.limits, before)
    head = section(plot.title).lines(width)[0]
    drawn = draw(plot, scale, width, max(height - 2, 5), look, named=False)
    return [head, _legend(plot, look, width), *drawn], scale


def _legend(plot: Plot, look: Look, width: int) -> Content:
    """Return the means and the limit's mark, as far as there is room; no mean is cut."""
    limit = [(" ─ limit", "$foreground")] if plot.limits else []
    for series, named, rest in (
        (plot.series, True, limit), (plot.series, True, []),
        (plot.series[-1:], True, []), (plot.series[-1:], False, []),
    ):  # fmt: skip
        line = Content("")
        for each in series:
            name = f"{each.name}: " if named else ""
            words = f" {name}mean {mean_of(each.y):.3f} "
            line = Content.assemble(line, " ", mark_of(look, each.ink), (words, "$label"))
        line = Content.assemble(line, *rest)
        if line.rstrip().cell_length <= width:
            return line.truncate(width)
    return Content("")


def _errors(log: Log, rows: Rows) -> Errors3D:
    """Return |e| of one station as sent and corrected, by target."""
    grid = all(row.point.id.kind == "grid" for row in rows)
    mine = [row for row in rows if grid or row.point.id.kind == "validate"]
    order: dict[int, int] = {}
    where = [
        order.setdefault(n if grid else row.point.id.number or 0, len(order))
        for n, row in enumerate(mine)
    ]
    by_how: dict[Sent, Array] = {}
    for how in BOTH:
        at = [n for n, row in enumerate(mine) if (row.point.id.how or Sent.BEFORE) == how]
        if at:
            by_how[how] = np.full(len(order), np.nan)
            by_how[how][[where[n] for n in at]] = [mine[n].norm_mm for n in at]
    targets = tuple((mine[0].point.station, number) for number in order)
    return Errors3D(targets, by_how, grid)
