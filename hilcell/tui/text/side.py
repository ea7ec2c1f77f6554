"""The right side of a wide terminal: the map of the volume, and |e| target by target.

All of it is made of the rows of the points table, which know each error already. The map shows |e|
from above, from the side and along the rail; the views share their axes as in a drawing. A cell
shows its worst point; blank is not measured. Size and brightness of the shapes grow with |e|, so
that the map is read in grey, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from textual.content import Content

from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.journal.log import Log
from hilcell.language import marked, tr
from hilcell.model.point import BOTH, Sent
from hilcell.model.verdicts import ISO
from hilcell.ports import Array
from hilcell.tui.layout import Col, Grid, Text, section
from hilcell.tui.plots import Ints, Plot, PlotStyle, Scale, draw
from hilcell.tui.run_view import RunView
from hilcell.tui.text.plots import Errors3D, Measured, finite_mean, legend_mark, target_plot
from hilcell.tui.text.points import PointRow

MAP_ROWS, LEAST_PLOT = 22, 9
OWN = {
    ISO: (marked("|e| of the poses"), Measured.poses_plot),
    RECHECK: (marked("|e| re-checked"), Measured.recheck_plot),
}
KINDS = ("grid", "validate", *OWN)
Rows = list[PointRow]
Lines = list[Content]


def side_lines(
    view: RunView,
    rows: Iterable[PointRow],
    width: int,
    height: int,
    style: PlotStyle,
    before: Scale | None = None,
) -> tuple[Lines, Scale | None]:
    """Return the lines, at most ``height``, and the plot's scale, for the next time."""
    targets = [row for row in rows if row.point.id.kind in KINDS and row.deviation is not None]
    if not targets:
        nothing = tr("the map and the errors appear with the first target")
        return Content.styled(nothing, "$label").wrap(width), before
    room = min(MAP_ROWS, height - LEAST_PLOT)
    above = Volume.of(view.log, targets).lines(width, room, plain=style.plain)
    plot = _plot(view.log, targets)
    scale = Scale.log(plot.values, plot.limits, before)
    heading = section(plot.title).lines(width)
    drawn = draw(plot, scale, width, max(height - len(above) - 2, 5), style, named=False)
    return [*above, *heading, _means(plot, style, width), *drawn], scale


def _plot(log: Log, targets: Rows) -> Plot:
    """Return |e| at the newest station, as sent and corrected, or the procedure's own plot."""
    newest = max(targets, key=lambda row: log.recorded(row.point)).point
    if newest.id.kind in OWN:
        return OWN[newest.id.kind][1](Measured(log), "")
    rows = [row for row in targets if row.point.station == newest.station]
    grid = all(row.point.id.kind == "grid" for row in rows)
    rows = [row for row in rows if grid or row.point.id.kind == "validate"]
    norms_mm = np.array([row.norm_mm for row in rows])
    errors = Errors3D.of([row.point for row in rows], norms_mm, grid=grid)
    errors = replace(errors, by_how={how: e for how, e in errors.by_how.items() if how in BOTH})
    limits = () if grid else (log.cell.validation.max_tolerance_mm,)
    plot = target_plot(errors, limits, tr("limit"))
    what = plot.x_title
    return replace(
        plot, title=tr("|e| at {station}, {what} by {what}, mm", station=newest.station, what=what)
    )


def _means(plot: Plot, style: PlotStyle, width: int) -> Content:
    """Return the means and the limit's mark, as far as there is room; no mean is cut."""
    limit = [(tr(" ─ limit"), "$foreground")] if plot.limits else []
    for series, named, rest in (
        (plot.series, True, limit), (plot.series, True, []),
        (plot.series[-1:], True, []), (plot.series[-1:], False, []),
    ):  # fmt: skip
        line = Content("")
        for each in series:
            name = f"{tr(each.name)}: " if named else ""
            words = tr(" {name}mean {mean_mm:.3f} ", name=name, mean_mm=finite_mean(each.y))
            line = Content.assemble(line, " ", legend_mark(style, each.ink), (words, "$label"))
        line = Content.assemble(line, *rest)
        if line.rstrip().cell_length <= width:
            return line.truncate(width)
    return Content("")


NO_POINT = -1


@dataclass(frozen=True, slots=True)
class Grades:
    """Upper bounds (mm) of the grades but the last, which is beyond them all."""

    CORRECTED: ClassVar = (0.05, 0.1, 0.2)
    RAW: ClassVar = (0.2, 0.5, 1.0, 2.0)
    SHAPES: ClassVar = "·•○●■"
    LETTERS: ClassVar = ".:o*#"  # of a terminal without the shapes
    STYLES: ClassVar = ("$live 70%", "$live", "$label", "bold $foreground", "bold $fault")

    bounds: tuple[float, ...]
    limited: bool  # whether the last bound is the limit

    @classmethod
    def of(cls, limit_mm: float | None) -> Grades:
        """Return the grades below a limit, or those of errors that have none."""
        if limit_mm is None:
            return cls(cls.RAW, limited=False)
        return cls((*(each for each in cls.CORRECTED if each < limit_mm), limit_mm), limited=True)

    def grade(self, errors: Array) -> Ints:
        """Return the grade (N,) of errors (N,); NaN is beyond every bound."""
        grades: Ints = np.sum(~(errors[:, None] <= np.array(self.bounds)), axis=1)
        return grades

    def drawn(self, grade: int, *, plain: bool) -> tuple[str, str]:
        """Return the shape of a grade and its style.

        The last two shapes are those of the limit; only beyond a limit is the colour of a fault.
        """
        from_end = grade - len(self.bounds) - 1
        at = grade if from_end < -2 else len(self.SHAPES) + from_end
        style = self.STYLES[min(at, len(self.STYLES) - (1 if self.limited else 2))]
        return (self.LETTERS if plain else self.SHAPES)[at], style


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

    def heading(self, width: int) -> Content:
        """Return the heading with as many of its words as fit."""
        n = len(self.errors_mm)
        count = tr("{n} of {planned}", n=n, planned=self.planned) if self.planned else str(n)
        for title, remark in (
            (tr("map: {title}", title=self.title), tr("{count} targets", count=count)),
            (tr("map: {count}", count=count), ""),
        ):
            if len(title) + len(remark) + 4 * (1 + bool(remark)) <= width:  # rules beside the words
                return section(title, remark).lines(width)[0]
        return section(tr("map")).lines(width)[0]

    @classmethod
    def of(cls, log: Log, targets: Rows) -> Volume:
        """Return the map's data: corrected targets, before there are any the errors as sent."""
        after = [row for row in targets if row.point.id.how == Sent.CHOSEN]
        raw = [row for row in targets if row.point.id.how in ("", Sent.BEFORE)]
        shown = after or raw or targets
        last = max(range(len(shown)), key=lambda n: log.recorded(shown[n].point))
        newest = max(targets, key=lambda row: log.recorded(row.point))
        errors = (tr("|e| after correction") if after else tr("|e| as sent"),)
        title = OWN.get(newest.point.id.kind, errors)[0]
        rail = (
            int(np.argmax(np.abs(log.cell.layout.rail_direction[:2]))) if log.cell.has_rail else 1
        )
        low_mm, high_mm, middles_mm = cls._extent(log, targets)
        return cls(
            np.array([row.point.nominal_mm for row in shown], dtype=float),
            np.array([row.norm_mm for row in shown]),
            low_mm,
            high_mm,
            log.cell.validation.max_tolerance_mm if after else None,
            rail,
            last if shown[last] is newest else NO_POINT,
            cls._planned(log) if after else 0,
            title,
            tuple((name, float(at[rail])) for name, at in middles_mm.items() if log.cell.has_rail),
            newest.point.station,
        )

    @staticmethod
    def _extent(log: Log, targets: Rows) -> tuple[Array, Array, dict[str, Array]]:
        """Return the corners (3,) of what will be measured at all stations, and their middles (3,).

        The targets known so far, moved along the rail: the map does not grow while a run goes on.
        """
        direction = np.array(log.cell.layout.rail_direction)
        shift_mm = {each.name: each.strip_mm * direction for each in log.cell.station}
        kept = [row.point for row in targets if row.point.station in shift_mm]
        at_zero = np.array([point.nominal_mm for point in kept], dtype=float).reshape(-1, 3)
        at_zero -= np.array([shift_mm[point.station] for point in kept]).reshape(-1, 3)
        low_mm, high_mm = at_zero.min(axis=0), at_zero.max(axis=0)
        middles_mm = {name: (low_mm + high_mm) / 2 + shift for name, shift in shift_mm.items()}
        shifts_mm = np.array([*shift_mm.values()])
        return (low_mm + shifts_mm).min(axis=0), (high_mm + shifts_mm).max(axis=0), middles_mm

    @staticmethod
    def _planned(log: Log) -> int:
        """Return how many corrected targets a whole validation has; 0 where that is not stated."""
        cell, steps = log.cell, log.inputs.steps
        if cell.plan.quick or not any(step.name == "validate" for step in steps):
            return 0
        others = len(cell.station) - 1
        at_others = cell.validation.others // others * others if others else 0
        return cell.validation.per_cell * math.prod(cell.grid.cells) + at_others

    def lines(self, width: int, height: int, *, plain: bool) -> Lines:
        """Return the map in at most so many rows; the views that have no room are left out."""
        beside = width >= Views.ACROSS + Views.FRAME + Views.GAP + Views.LEGEND
        views = Views(self, Views.ACROSS if beside else width - Views.FRAME, plain=plain)
        legend = views.legend()
        lines = [self.heading(width), *([] if beside else views.flowing(width))]
        room = height - len(lines)
        both = room >= 2 * (Views.FRAME + 3) + 1
        rows = min(Views.ROWS, (room - 1) // 2 - Views.FRAME if both else room - Views.FRAME - 1)
        if views.columns >= 8 and rows >= 2:
            first = views.above(rows)
            key: list[Text] = [
                (tr("|e| in mm"), "$label"),
                *legend,
                (tr("blank: not yet"), "$label"),
            ]
            key += [""] * len(first)
            grid = Grid(zip(first, key, strict=False), Col(), Col(), gap=Views.GAP)
            lines += grid.lines(width) if beside else first
            lines.append(views.stations())
            if both:
                pairs = zip(*views.sides(rows, both=beside), strict=True)
                sides = Grid(pairs, Col(), Col(), gap=Views.GAP)
                lines += sides.lines(width)
        return [line.truncate(width) for line in lines[: max(height, 1)]]


class Views:
    """The views of a volume, whose axes they share: the rail's axis has so many columns."""

    AXES, UP = "xyz", 2
    ACROSS, ROWS, ALONG = 38, 8, 13  # cells: along the rail's axis, high; of the view along it
    LEGEND, GAP, FRAME = 15, 2, 2  # columns

    def __init__(self, of: Volume, columns: int, *, plain: bool) -> None:
        self.of, self.columns, self._plain = of, columns, plain
        self._grades = Grades.of(of.limit_mm)
        self._newest = "<" if plain else "◄", "bold $live"

    def legend(self) -> Lines:
        bounds, lines = self._grades.bounds, []
        grades = self._grades.grade(self.of.errors_mm)
        for grade, count in enumerate(np.bincount(grades, minlength=len(bounds) + 1).tolist()):
            last = grade == len(bounds)
            words = f" {'>' if last else '≤'} {bounds[grade - last]:.2f} ", "$label"
            shape = self._grades.drawn(grade, plain=self._plain)
            lines.append(Content.assemble(shape, words, f"{count:>4}"))
        return [*lines, Content.assemble(self._newest, (tr(" newest"), "$label"))]

    def flowing(self, width: int) -> Lines:
        """Return the legend in rows of as many entries as fit."""
        rows: Lines = []
        for each in self.legend():
            if rows and rows[-1].cell_length + self.GAP + each.cell_length <= width:
                rows[-1] = rows[-1].append(" " * self.GAP).append(each)
            else:
                rows.append(each)
        return rows

    def above(self, rows: int) -> Lines:
        of, across = self.of, 1 - self.of.rail
        size_m = float(of.high_mm[of.rail] - of.low_mm[of.rail]) / 1000.0
        cells = self._view((of.rail, across), self.columns, rows)
        top = tr("from above: {axis} up", axis=self.AXES[across])
        return self._framed(cells, top, f"{size_m:.2f} m, {self._rail}")

    def sides(self, rows: int, *, both: bool) -> tuple[Lines, Lines]:
        """Return the view from the side, and that along the rail, empty where not ``both``."""
        cells = self._view((self.of.rail, self.UP), self.columns, rows)
        side = self._framed(cells, tr("from the side: z up"), self._rail)
        if not both:
            return side, [Content("")] * len(side)
        across = 1 - self.of.rail
        along = self._view((across, self.UP), self.ALONG, rows)
        return side, self._framed(along, tr("z up"), f"{self.AXES[across]} ►")

    def stations(self) -> Content:
        of, width = self.of, self.columns + self.FRAME
        low_mm, high_mm = float(of.low_mm[of.rail]), float(of.high_mm[of.rail])
        line = Content("")
        for name, at_mm in of.stations:
            share = (at_mm - low_mm) / max(high_mm - low_mm, 1e-9)
            text = f"─ {name} ─"
            start = self.FRAME // 2 + round(share * self.columns) - len(text) // 2
            start = max(min(start, width - len(text)), 0)
            style = "bold $foreground" if name == of.station else "$label"
            if line.cell_length <= start:
                line = line.truncate(start, pad=True).append(Content.styled(text, style))
        return line

    @property
    def _rail(self) -> str:
        return f"{tr('rail ') * bool(self.of.stations)}{self.AXES[self.of.rail]} ►"

    def _view(self, axes: tuple[int, int], columns: int, rows: int) -> Lines:
        """Return the cells of a view: ``axes`` are those to the right and up."""
        of, (right, up) = self.of, axes
        size_mm = np.maximum(of.high_mm - of.low_mm, 1e-9)
        share = np.clip((of.targets_mm - of.low_mm) / size_mm, 0.0, 1.0 - 1e-9)
        column = np.floor(share[:, right] * columns).astype(int)
        row = np.floor((1.0 - 1e-9 - share[:, up]) * rows).astype(int)
        cells = np.full((rows, columns), NO_POINT)
        grades = self._grades.grade(of.errors_mm).tolist()
        np.maximum.at(cells, (row, column), grades)
        shapes = {grade: self._grades.drawn(grade, plain=self._plain) for grade in set(grades)}
        drawn = [[shapes.get(grade, (" ", "")) for grade in line] for line in cells.tolist()]
        if of.newest != NO_POINT:
            drawn[row[of.newest]][column[of.newest]] = self._newest
        return [Content.assemble(*line) for line in drawn]

    @staticmethod
    def _framed(cells: Lines, top: str, bottom: str) -> Lines:
        """Return cells in a frame, in whose edges the words stand that have room there."""
        width = cells[0].cell_length
        above, below = (f" {words} " if len(words) + 3 <= width else "" for words in (top, bottom))
        line = "─" * (width - 1)
        first = ("┌─", "$stale"), (above, "$label"), (f"{line[len(above) :]}┐", "$stale")
        last = (f"└{line[len(below) :]}", "$stale"), (below, "$label"), ("─┘", "$stale")
        edge = "│", "$stale"
        rows = [Content.assemble(edge, each, edge) for each in cells]
        return [Content.assemble(*first), *rows, Content.assemble(*last)]
