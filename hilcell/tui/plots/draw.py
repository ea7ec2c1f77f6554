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

BELOW = 3  # rows under the area: frame, ticks, title
FRAME, TICK = "$stale", "$label"
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


def draw(
    plot: Plot, scale: Scale, width: int, height: int, look: Look, *, named: bool = True
) -> list[Content]:
    """Return a plot in exactly so many rows; ``named``: each series has its name at its line."""
    return _Drawing(plot, scale, width, height, look).lines(named=named)


class _Drawing:
    """One plot on its canvas; the area within the frame has its own rows and columns."""

    def __init__(self, plot: Plot, scale: Scale, width: int, height: int, look: Look) -> None:
        self._plot, self._scale, self._look = plot, scale, look
        self._canvas = Canvas(width, height, letters=look.letters)
        self._height = max(height - BELOW, 2)
        limit_rows = np.floor(scale.rows(np.array(plot.limits), self._height)).astype(int).tolist()
        self._limits = [*zip(limit_rows, plot.limits, strict=True)]
        self._labels = {row: self._label(value) for row, value in scale.ticks(self._height)}
        self._bold = {row: self._label(value) for row, value in self._limits}
        labels = (*self._labels.values(), *self._bold.values())
        self._left = max(map(len, labels), default=0) + 1
        self._width = max(width - self._left, 1)

    def lines(self, *, named: bool) -> list[Content]:
        """Return the rows, all of them drawn."""
        self._frame()
        self._x_axis()
        lines = [self._series(each) for each in self._plot.series]
        words = np.zeros((self._height, self._width), bool)
        taken = np.any([words, *lines], axis=0)
        for mark in self._plot.marks:
            self._mark(mark, taken, words)
        if named:
            self._names(lines, words)
        return self._canvas.lines()

    def _label(self, value: float) -> str:
        decimals = self._scale.decimals
        while decimals < self._scale.decimals + 2 and abs(round(value, decimals) - value) > 1e-9:
            decimals += 1  # a limit need not be a step
        return f"{value + 0.0:.{decimals}f}"

    def _column(self, share: float) -> int:
        return int(min(share, 1.0 - 1e-9) * self._width)

    def _frame(self) -> None:
        canvas, left = self._canvas, self._left
        for row in range(self._height):
            canvas.text(row, left - 1, "│", FRAME)
        for row, label in self._labels.items():
            canvas.text(row, left - 1 - len(label), label, TICK)
            canvas.text(row, left - 1, "┤", FRAME)
            for column in range(left, left + self._width, 4):
                canvas.text(row, column, "." if self._look.plain else "·", "$track")
        for row, label in self._bold.items():
            canvas.text(row, 0, " " * (left - 1))
            canvas.text(row, left - 1 - len(label), f"{label}┤", "bold $foreground")
            canvas.text(row, left, "─" * self._width, "$foreground")

    def _x_axis(self) -> None:
        canvas, bottom = self._canvas, self._height
        canvas.text(bottom, self._left - 1, "└" + "─" * self._width, FRAME)
        free = 0
        for share, label in self._plot.x_ticks:
            column = self._left + self._column(share)
            canvas.text(bottom, column, "┴", FRAME)
            start = min(column - len(label) // 2, canvas.width - len(label))
            if start >= free:
                canvas.text(bottom + 1, start, label, TICK)
                free = start + len(label) + 1
        canvas.text(bottom + 2, self._left, self._plot.x_title[: self._width], TICK)

    def _halves(self, values: Array) -> Ints:
        """Return the half (N,) of each value, on the right side of every limit's line.

        A letter fills both halves: it stands in the row above or under the line.
        """
        halves: Ints = np.floor(2.0 * self._scale.rows(values, self._height)).astype(int)
        room = int(self._look.letters)
        for row, limit in self._limits:
            over, under = 2 * row - room, 2 * row + 1 + room
            halves = np.where(values <= limit, np.maximum(halves, under), np.minimum(halves, over))
        return np.clip(halves, 0, 2 * self._height - 1)

    def _series(self, series: Series) -> Bools:
        """Draw a series; return the cells of the area (rows, columns) that it covers."""
        ink = self._canvas.ink(series.ink)
        covered = np.zeros((self._height, self._width), bool)
        known = np.isfinite(series.y)
        columns = np.array([self._column(share) for share in series.x[known]], dtype=int)
        for column, top, bottom in self._spans(columns, self._halves(series.y[known]), series):
            for half in range(top, bottom + 1):
                self._canvas.mark(half, self._left + column, ink)
                covered[half // 2, column] = True
        return covered

    def _spans(self, columns: Ints, halves: Ints, series: Series) -> list[tuple[int, int, int]]:
        """Return column, first and last half of each stroke: of a point, or of a line's step."""
        if not series.joined:
            return [(c, h, h) for c, h in zip(columns.tolist(), halves.tolist(), strict=True)]
        found = []
        for column in range(int(columns[0]) if len(columns) else self._width, self._width):
            here = [*halves[columns == column].tolist(), *halves[columns < column][-1:].tolist()]
            found.append((column, min(here), max(here)))
        return found

    def _mark(self, mark: Mark, taken: Bools, words: Bools) -> None:
        """Write a word above its value and all that is ``taken`` there; add it to ``words``."""
        start = self._column(mark.x) - len(mark.text) // 2
        start = max(min(start, self._width - len(mark.text)), 0)
        span = slice(start, start + len(mark.text))
        filled = np.flatnonzero(taken[:, span].any(axis=1)).tolist()
        row = max(min([int(self._halves(np.array([mark.y]))[0]) // 2, *filled]) - 1, 0)
        self._canvas.text(row, self._left + start, mark.text, "bold $foreground")
        words[row, span] = True

    def _names(self, lines: list[Bools], words: Bools) -> None:
        """Write the name of each series, and of the limit, at its line, off the other ``words``."""
        names = [series.name for series in self._plot.series]
        styles = [f"bold {series.ink.words}" for series in self._plot.series]
        for row, _ in self._limits[:1]:
            line = np.zeros((self._height, self._width), bool)
            line[row] = True
            names, styles, lines = (
                [*names, self._plot.limit_name],
                [*styles, "$foreground"],
                [*lines, line],
            )
        wanted = [*BEGIN[: len(self._plot.series)], 0.0]
        spots = place(names, [*lines, words], wanted)
        for name, style, spot in zip(names, styles, spots, strict=True):
            if spot is not None:
                self._canvas.text(spot.row, self._left + spot.column, name, style)
