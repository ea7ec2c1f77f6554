"""One plot in its frame: ticks, a dotted grid, limits, series, their names beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from textual.content import Content

from hilcell.ports import Array
from hilcell.tui.plots.canvas import Canvas, Ink
from hilcell.tui.plots.labels import place
from hilcell.tui.plots.scale import Scale

GRID_COLUMNS = 4  # from dot to dot
BELOW = 3  # rows under the area: frame, ticks, title
FRAME, DOT, TICK, LIMIT = "$stale", "$track", "$label", "bold $foreground"
BEGIN = (0.3, 0.6, 0.5, 0.4)  # of the names, in shares of the width: apart from each other
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Values ``y`` (N,) at shares ``x`` (N,) of the width, rising; ``joined``: steps, not points.

    A value that is no number is left out.
    """

    name: str
    ink: Ink
    x: Array
    y: Array
    joined: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A word above a value at a share of the width."""

    text: str
    x: float
    y: float


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Series over an axis whose ticks are (share of the width, label)."""

    title: str
    x_title: str
    x_ticks: tuple[tuple[float, str], ...]
    series: tuple[Series, ...]
    limits: tuple[float, ...] = ()
    limit_name: str = "limit"
    marks: tuple[Mark, ...] = ()

    @property
    def values(self) -> Array:
        """Return the values of all series, (N,)."""
        return np.concatenate([np.zeros(0), *(each.y for each in self.series)])


@dataclass(frozen=True, slots=True)
class Look:
    """Shapes that the terminal has: ``letters`` in place of half blocks, ``plain`` ASCII alone."""

    letters: bool = False
    plain: bool = False

    @property
    def dot(self) -> str:
        """Return a dot of the grid."""
        return "." if self.plain else "·"


@dataclass(slots=True)
class _Area:
    """The place within the frame, and the canvas around it."""

    canvas: Canvas
    scale: Scale
    left: int
    width: int
    height: int
    limit_rows: list[tuple[int, float]]
    letters: bool

    def column(self, share: float) -> int:
        return int(min(share, 1.0 - 1e-9) * self.width)


def draw(
    plot: Plot, scale: Scale, width: int, height: int, look: Look, *, named: bool = True
) -> list[Content]:
    """Return a plot in exactly so many rows; ``named``: each series has its name at its line."""
    canvas = Canvas(width, height, letters=look.letters)
    rows = max(height - BELOW, 2)
    limit_rows = [
        (int(row), limit)
        for row, limit in zip(
            np.floor(scale.rows(np.array(plot.limits), rows)), plot.limits, strict=True
        )
    ]
    labels = {row: _label(value, scale) for row, value in scale.ticks(rows)}
    bold = {row: _label(value, scale) for row, value in limit_rows}
    left = max((len(label) for label in (*labels.values(), *bold.values())), default=0) + 1
    area = _Area(canvas, scale, left, max(width - left, 1), rows, limit_rows, look.letters)
    _frame(area, labels, bold, look)
    _x_axis(area, plot)
    lines = [_series(area, each) for each in plot.series]
    words = np.zeros((rows, area.width), bool)
    taken = np.any([words, *lines], axis=0)
    for mark in plot.marks:
        _mark(area, mark, taken, words)
    if named:
        _names(area, plot, lines, words)
    return canvas.lines()


def _label(value: float, scale: Scale) -> str:
    decimals = scale.decimals
    while decimals < scale.decimals + 2 and abs(round(value, decimals) - value) > 1e-9:
        decimals += 1  # a limit need not be a step
    return f"{value + 0.0:.{decimals}f}"


def _frame(area: _Area, labels: dict[int, str], bold: dict[int, str], look: Look) -> None:
    canvas, left = area.canvas, area.left
    for row in range(area.height):
        canvas.text(row, left - 1, "│", FRAME)
    for row, label in labels.items():
        canvas.text(row, left - 1 - len(label), label, TICK)
        canvas.text(row, left - 1, "┤", FRAME)
        for column in range(left, left + area.width, GRID_COLUMNS):
            canvas.text(row, column, look.dot, DOT)
    for row, label in bold.items():
        canvas.text(row, 0, " " * (left - 1))
        canvas.text(row, left - 1 - len(label), f"{label}┤", LIMIT)
        canvas.text(row, left, "─" * area.width, "$foreground")


def _x_axis(area: _Area, plot: Plot) -> None:
    canvas, bottom = area.canvas, area.height
    canvas.text(bottom, area.left - 1, "└" + "─" * area.width, FRAME)
    free = 0
    for share, label in plot.x_ticks:
        column = area.left + area.column(share)
        canvas.text(bottom, column, "┴", FRAME)
        start = min(column - len(label) // 2, canvas.width - len(label))
        if start >= free:
            canvas.text(bottom + 1, start, label, TICK)
            free = start + len(label) + 1
    canvas.text(bottom + 2, area.left, plot.x_title[: area.width], TICK)


def _halves(area: _Area, values: Array) -> Ints:
    """Return the half (N,) of each value, on the right side of every limit's line.

    A letter fills both halves: it stands in the row above or under the line.
    """
    halves: Ints = np.floor(2.0 * area.scale.rows(values, area.height)).astype(int)
    for row, limit in area.limit_rows:
        over, under = (2 * row - 1, 2 * row + 2) if area.letters else (2 * row, 2 * row + 1)
        halves = np.where(values <= limit, np.maximum(halves, under), np.minimum(halves, over))
    return np.clip(halves, 0, 2 * area.height - 1)


def _series(area: _Area, series: Series) -> Bools:
    """Draw a series; return the cells of the area (rows, columns) that it covers."""
    ink = area.canvas.ink(series.ink)
    covered = np.zeros((area.height, area.width), bool)
    known = np.isfinite(series.y)
    columns = np.array([area.column(share) for share in series.x[known]], dtype=int)
    spans = _spans(columns, _halves(area, series.y[known]), area.width, joined=series.joined)
    for column, top, bottom in spans:
        for half in range(top, bottom + 1):
            area.canvas.mark(half, area.left + column, ink)
            covered[half // 2, column] = True
    return covered


def _spans(columns: Ints, halves: Ints, width: int, *, joined: bool) -> list[tuple[int, int, int]]:
    """Return column, first and last half of each stroke: of a point, or of a step of a line."""
    if not joined:
        return [(c, h, h) for c, h in zip(columns.tolist(), halves.tolist(), strict=True)]
    if not len(columns):
        return []
    found = []
    for column in range(int(columns[0]), width):
        here = halves[columns == column].tolist()
        before = halves[columns < column]
        here += before[-1:].tolist()
        found.append((column, min(here), max(here)))
    return found


def _mark(area: _Area, mark: Mark, taken: Bools, words: Bools) -> None:
    """Write a word above its value, and above all that is ``taken`` there; add it to ``words``."""
    start = area.column(mark.x) - len(mark.text) // 2
    start = max(min(start, area.width - len(mark.text)), 0)
    span = slice(start, start + len(mark.text))
    filled = np.flatnonzero(taken[:, span].any(axis=1)).tolist()
    row = max(min([int(_halves(area, np.array([mark.y]))[0]) // 2, *filled]) - 1, 0)
    area.canvas.text(row, area.left + start, mark.text, "bold $foreground")
    words[row, span] = True


def _names(area: _Area, plot: Plot, lines: list[Bools], words: Bools) -> None:
    """Write the name of each series, and of the limit, at its line, off the other ``words``."""
    names = [series.name for series in plot.series]
    styles = [f"bold {series.ink.words}" for series in plot.series]
    for row, _ in area.limit_rows[:1]:
        line = np.zeros((area.height, area.width), bool)
        line[row] = True
        lines, names, styles = [*lines, line], [*names, plot.limit_name], [*styles, "$foreground"]
    wanted = [*BEGIN[: len(plot.series)], 0.0]
    spots = place(names, [*lines, words], wanted)
    for name, style, spot in zip(names, styles, spots, strict=True):
        if spot is not None:
            area.canvas.text(spot.row, area.left + spot.column, name, style)
