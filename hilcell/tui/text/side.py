"""The right side of a wide terminal: the map of the volume, and |e| target by target.

All of it is made of the rows of the points table, which know each error already. The map shows |e|
from above, from the side and along the rail; the views share their axes as in a drawing. A cell
shows its worst point; blank is not measured. Size and brightness of the shapes grow with |e|, so
that the map is read in grey, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from textual.content import Content

from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.journal.log import Log
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import ISO
from hilcell.ports import Array
from hilcell.tui.engine.run_view import RunView
from hilcell.tui.layout import Col, Grid, Text, section
from hilcell.tui.plots.draw import Look, Plot, draw
from hilcell.tui.plots.scale import Scale, log_scale
from hilcell.tui.text.deviation import PointRow
from hilcell.tui.text.plots import (
    Errors3D,
    Measured,
    mark_of,
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
    if cell.plan.quick or not any(step.name == "validate" for step in steps):
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
    return [head, _means(plot, look, width), *drawn], scale


def _means(plot: Plot, look: Look, width: int) -> Content:
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


AXES, UP = "xyz", 2
ACROSS, ALONG, ROWS = 38, 13, 8  # cells of a view: along the rail's axis, across it, and high
LEAST_COLUMNS, LEAST_ROWS = 8, 2
LEGEND = 15  # columns
FRAME = 2
GAP = 2
RULED = 4  # columns of a heading's rule beside its words, twice with a remark
NO_POINT = -1
CORRECTED, RAW = (0.05, 0.1, 0.2), (0.2, 0.5, 1.0, 2.0)  # mm, upper bounds of the grades
SHAPES, LETTERS = "·•○●■", ".:o*#"
STYLES = ("$live 70%", "$live", "$label", "bold $foreground", "bold $fault")
NEWEST, NEWEST_LETTER = "◄", "<"
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Grades:
    """Upper bounds (mm) of the grades but the last, which is beyond them all."""

    bounds: tuple[float, ...]
    limited: bool  # whether the last bound is the limit

    @classmethod
    def of(cls, limit_mm: float | None) -> Grades:
        """Return the grades below a limit, or those of errors that have none."""
        if limit_mm is None:
            return cls(RAW, limited=False)
        return cls((*(each for each in CORRECTED if each < limit_mm), limit_mm), limited=True)

    def grade(self, errors: Array) -> Ints:
        """Return the grade (N,) of errors (N,); NaN is beyond every bound."""
        found: Ints = np.sum(~(errors[:, None] <= np.array(self.bounds)), axis=1)
        return found

    def shape(self, grade: int, *, plain: bool) -> str:
        """Return the shape of a grade: the last two are those of the limit."""
        return (LETTERS if plain else SHAPES)[self._at(grade)]

    def style(self, grade: int) -> str:
        """Return its style; only what is over a limit has the colour of a fault."""
        at = self._at(grade)
        return STYLES[at - (at == len(STYLES) - 1 and not self.limited)]

    def _at(self, grade: int) -> int:
        return grade if grade < len(self.bounds) - 1 else grade + len(CORRECTED) + 1 - len(
            self.bounds)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """Targets (N, 3) in {W} with |e| (N,), the newest's number or -1, and the map's corners."""

    targets_mm: Array
    errors_mm: Array
    low_mm: Array
    high_mm: Array
    limit_mm: float | None
    rail: int = 1  # the axis of {W} along which the rail runs: x or y
    newest: int = NO_POINT
    planned: int = 0
    title: str = "|e|"
    stations: tuple[tuple[str, float], ...] = ()  # their middle along the rail, mm
    station: str = ""  # the current one
    counts: Ints = field(init=False)

    def __post_init__(self) -> None:
        """Count the targets of each grade."""
        grades = Grades.of(self.limit_mm)
        found = np.bincount(grades.grade(self.errors_mm), minlength=len(grades.bounds) + 1)
        object.__setattr__(self, "counts", found)


def map_lines(of: Volume, width: int, height: int, *, plain: bool) -> Lines:
    """Return the map in at most so many rows; the views that have no room are left out."""
    beside = width >= ACROSS + FRAME + GAP + LEGEND
    columns = ACROSS if beside else width - FRAME
    legend = _legend(of, plain=plain)
    lines = [_heading(of, width), *([] if beside else _flowing(legend, width))]
    room = height - len(lines)
    both = room >= 2 * (FRAME + 3) + 1
    rows = min(ROWS, (room - 1) // 2 - FRAME if both else room - FRAME - 1)
    if columns >= LEAST_COLUMNS and rows >= LEAST_ROWS:
        first = _above(of, columns, rows, plain=plain)
        key: list[Text] = [
            ("|e| in mm", "$label"),
            *legend,
            ("blank: not yet", "$label"),
            *[""] * len(first),
        ]
        grid = Grid(zip(first, key, strict=False), Col(), Col(), gap=GAP)
        lines += grid.lines(width) if beside else first
        lines.append(_stations(of, columns))
        if both:
            lines += _sides(of, columns, rows, plain=plain, along=beside)
    return [line.truncate(width) for line in lines[: max(height, 1)]]


def _above(of: Volume, columns: int, rows: int, *, plain: bool) -> Lines:
    along, across = of.rail, 1 - of.rail
    size_m = float(of.high_mm[along] - of.low_mm[along]) / 1000.0
    cells = _view(of, (along, across), columns, rows, plain=plain)
    return _framed(cells, f"from above: {AXES[across]} up", f"{size_m:.2f} m, {_rail(of)}")


def _sides(of: Volume, columns: int, rows: int, *, plain: bool, along: bool) -> Lines:
    """Return the view from the side, and beside it that along the rail."""
    cells = _view(of, (of.rail, UP), columns, rows, plain=plain)
    side = _framed(cells, "from the side: z up", _rail(of))
    if not along:
        return side
    end = _view(of, (1 - of.rail, UP), ALONG, rows, plain=plain)
    third = _framed(end, "z up", f"{AXES[1 - of.rail]} ►")
    return Grid(zip(side, third, strict=True), Col(), Col(), gap=GAP).lines(
        columns + FRAME + GAP + ALONG + FRAME
    )


def _rail(of: Volume) -> str:
    return f"{'rail ' * bool(of.stations)}{AXES[of.rail]} ►"


def _heading(of: Volume, width: int) -> Content:
    count = f"{len(of.errors_mm)} of {of.planned}" if of.planned else str(len(of.errors_mm))
    for title, remark in ((f"map: {of.title}", f"{count} targets"), (f"map: {count}", "")):
        if len(title) + len(remark) + RULED * (1 + bool(remark)) <= width:
            return section(title, remark).lines(width)[0]
    return section("map").lines(width)[0]


def _legend(of: Volume, *, plain: bool) -> Lines:
    """Return a line for each grade with its count."""
    grades = Grades.of(of.limit_mm)
    lines = []
    for grade, count in enumerate(of.counts.tolist()):
        last = grade == len(grades.bounds)
        bound = f"{'>' if last else '≤'} {grades.bounds[grade - last]:.2f}"
        shape = grades.shape(grade, plain=plain)
        lines.append(
            Content.assemble((shape, grades.style(grade)), (f" {bound} ", "$label"), f"{count:>4}")
        )
    newest = NEWEST_LETTER if plain else NEWEST
    return [*lines, Content.assemble((newest, "bold $live"), (" newest", "$label"))]


def _flowing(legend: Lines, width: int) -> Lines:
    """Return the legend in rows of as many entries as fit."""
    rows: Lines = []
    for each in legend:
        if rows and rows[-1].cell_length + GAP + each.cell_length <= width:
            rows[-1] = rows[-1].append(" " * GAP).append(each)
        else:
            rows.append(each)
    return rows


def _view(of: Volume, axes: tuple[int, int], columns: int, rows: int, *, plain: bool) -> Lines:
    """Return the cells of a view: ``axes`` are those to the right and up."""
    right, up = axes
    grades = Grades.of(of.limit_mm)
    size_mm = np.maximum(of.high_mm - of.low_mm, 1e-9)
    share = np.clip((of.targets_mm - of.low_mm) / size_mm, 0.0, 1.0 - 1e-9)
    column = np.floor(share[:, right] * columns).astype(int)
    row = np.floor((1.0 - 1e-9 - share[:, up]) * rows).astype(int)
    cells = np.full((rows, columns), NO_POINT)
    np.maximum.at(cells, (row, column), grades.grade(of.errors_mm))
    at = (int(row[of.newest]), int(column[of.newest])) if of.newest != NO_POINT else None
    return [
        Content.assemble(
            *(
                (NEWEST_LETTER if plain else NEWEST, "bold $live")
                if (n, m) == at
                else (" ", "")
                if grade == NO_POINT
                else (grades.shape(grade, plain=plain), grades.style(grade))
                for m, grade in enumerate(line)
            )
        )
        for n, line in enumerate(cells.tolist())
    ]


def _framed(cells: Lines, top: str, bottom: str) -> Lines:
    width = cells[0].cell_length
    head = f"┌─ {top} "
    foot = f" {bottom} ─┘"
    lines = [_edge(f"{head}{'─' * (width + 1 - len(head))}┐", top, width + FRAME)]
    lines += [Content.assemble(("│", "$stale"), each, ("│", "$stale")) for each in cells]
    lines.append(_edge(f"└{'─' * (width + 1 - len(foot))}{foot}", bottom, width + FRAME))
    return lines


def _edge(text: str, words: str, width: int) -> Content:
    """Return an edge of a frame with words in it; without them, where they do not fit."""
    if len(text) > width:
        inner = "─" * (width - FRAME)
        return Content.styled(f"{text[0]}{inner}{text[-1]}", "$stale")
    before, _, after = text.partition(words)
    return Content.assemble((before, "$stale"), (words, "$label"), (after, "$stale"))


def _stations(of: Volume, columns: int) -> Content:
    """Return the stations' names under their middle."""
    low_mm, high_mm = float(of.low_mm[of.rail]), float(of.high_mm[of.rail])
    line = Content("")
    for name, at_mm in of.stations:
        share = (at_mm - low_mm) / max(high_mm - low_mm, 1e-9)
        text = f"─ {name} ─"
        start = FRAME // 2 + round(share * columns) - len(text) // 2
        start = max(min(start, columns + FRAME - len(text)), 0)
        style = "bold $foreground" if name == of.station else "$label"
        if line.cell_length <= start:
            line = line.truncate(start, pad=True).append(Content.styled(text, style))
    return line
