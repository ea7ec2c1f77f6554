"""Plots as lines of text: arrays in, styled lines out; nothing here knows a run.

A plot has a frame with ticks, a dotted grid, limits, series, and their names beside them.
Ticks are steps of 1, 2 and 5. A limit never lies on the frame: its scale goes on by at least a
whole step. A scale only grows (`before`), so that a plot of a live run does not jump. The canvas
has two marks a row; where colours do not tell series apart, a cell shows a letter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise, product
from operator import itemgetter
from typing import ClassVar, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from textual.content import Content

from hilcell.language import decimal, marked, tr
from hilcell.ports import Array

ROUNDING = 1e-9  # relative: a step is its own multiple


@dataclass(frozen=True, slots=True)
class Scale:
    """A scale from its lowest to its highest tick; ``step`` is 0 where it is logarithmic."""

    LEAST: ClassVar = 1e-4  # of a log scale, mm: below any tracker's resolution
    MOST: ClassVar = 1e4  # mm: beyond any cell
    LOG_LOW: ClassVar = 0.01  # of a log scale that nothing extends, mm
    LOG_HIGH: ClassVar = 2.0
    FINEST: ClassVar = 1e-6  # step of an even scale
    LARGEST: ClassVar = 1e9  # value of an even scale
    ROOM: ClassVar = 1.5  # rows from tick to tick, in the mean

    low: float
    high: float
    step: float = 0.0

    @classmethod
    def log(cls, values: Array, limits: Sequence[float] = (), before: Self | None = None) -> Self:
        """Return a log scale for values (N,) in mm, of whole steps of 1, 2 and 5."""
        numbers = np.asarray(values, dtype=float).tolist()
        known = [each for each in numbers if cls.LEAST <= each <= cls.MOST]
        lows, highs = [cls.LOG_LOW], [cls.LOG_HIGH]
        lows += [step_at_most(each) for each in known]
        lows += [max(s for s in _around(each) if s < each * (1 - ROUNDING)) for each in limits]
        highs += [step_at_least(each) for each in known] + [step_above(each) for each in limits]
        if before is not None and before.is_log:
            lows, highs = [*lows, before.low], [*highs, before.high]
        return cls(min(lows), max(highs))

    @classmethod
    def even(
        cls,
        values: Array,
        limits: Sequence[float] = (),
        height: int = 24,
        before: Self | None = None,
    ) -> Self:
        """Return an even scale for values (N,), zero among them; its step is 1, 2 or 5."""
        numbers = np.asarray(values, dtype=float)
        included = [0.0, *limits, *numbers[np.abs(numbers) <= cls.LARGEST].tolist()]
        if before is not None and not before.is_log:
            included += [before.low, before.high]
        low, high = min(included), max(included)
        step = step_at_least(max((high - low or 1.0) / max(2, height // 3), cls.FINEST))
        first, last = math.floor(low / step + ROUNDING), math.ceil(high / step - ROUNDING)
        first -= any(not first * step < each for each in limits)
        last += any(not each < last * step for each in limits)
        return cls(first * step, max(last, first + 1) * step, step)

    @property
    def is_log(self) -> bool:
        return not self.step

    @property
    def decimals(self) -> int:
        least = self.low if self.is_log else self.step
        return max(0, -math.floor(math.log10(least) + ROUNDING))

    def share(self, values: Array) -> Array:
        """Return where values (N,) stand, 0 at the lowest tick and 1 at the highest; NaN stays.

        A value beyond an end is at that end.
        """
        at, low, high = np.asarray(values, dtype=float), self.low, self.high
        if self.is_log:
            with np.errstate(divide="ignore", invalid="ignore"):
                at, low, high = np.log(np.maximum(at, 0.0)), math.log(low), math.log(high)
        return np.clip((at - low) / (high - low), 0.0, 1.0)

    def rows(self, values: Array, height: int) -> Array:
        """Return the depths (N,) of values in rows from the top; a tick is at a row's middle."""
        return (1.0 - self.share(values)) * (height - 1) + 0.5

    def ticks(self, height: int) -> list[tuple[int, float]]:
        """Return row and value of each tick, from the top; fewer where rows are few."""
        ticks: list[tuple[int, float]] = []
        for values in self._ladders():
            at = np.floor(self.rows(np.array(values), height)).astype(int).tolist()
            ticks = sorted(zip(at, values, strict=True))
            apart = all(a[0] < b[0] for a, b in pairwise(ticks))
            if apart and ticks[-1][0] - ticks[0][0] >= self.ROOM * (len(ticks) - 1):
                return ticks
        return ticks[:1]

    def _ladders(self) -> Iterable[list[float]]:
        if self.is_log:
            steps = [self.low]
            while steps[-1] < self.high * (1 - ROUNDING):
                steps.append(step_above(steps[-1]))
            yield steps
            yield [step for step in steps if float(f"{step:e}".partition("e")[0]) == 1.0]
        else:
            step = self.step
            while step <= self.high - self.low:
                first, last = math.ceil(self.low / step - ROUNDING), self.high / step + ROUNDING
                yield [n * step for n in range(first, math.floor(last) + 1)]
                step = step_above(step)
        yield [self.low, self.high]
        yield [self.high]


def step_at_least(value: float) -> float:
    """Return the least of 1, 2, 5 x 10^n that is not below a value."""
    return min(each for each in _around(value) if each >= value * (1 - ROUNDING))


def step_at_most(value: float) -> float:
    """Return the greatest of 1, 2, 5 x 10^n that is not above a value."""
    return max(each for each in _around(value) if each <= value * (1 + ROUNDING))


def step_above(value: float) -> float:
    """Return the least step above a value."""
    return min(each for each in _around(value) if each > value * (1 + ROUNDING))


def _around(value: float) -> list[float]:
    tens = math.floor(math.log10(value))
    return [float(f"{step:g}e{n}") for n in (tens - 1, tens, tens + 1) for step in (1, 2, 5)]


NONE = -1


@dataclass(frozen=True, slots=True)
class Ink:
    """How a series is drawn: its colour, and a letter where colours tell nothing.

    ``words`` is the style of letters, which are read: a colour of marks may be too faint for that.
    """

    colour: str
    letter: str
    words: str


class Canvas:
    """Rows and columns of cells, the first at the top left; marks outside it are dropped."""

    def __init__(self, width: int, height: int, *, letters: bool = False) -> None:
        self.width, self.height = width, height
        self._letters = letters  # marks are letters, not half blocks
        self._texts = [[" "] * width for _ in range(height)]
        self._styles = [[""] * width for _ in range(height)]
        self._halves = [[NONE] * width for _ in range(2 * height)]
        self._inks: list[Ink] = []

    def ink(self, ink: Ink) -> int:
        """Add an ink; return its number for `mark`."""
        self._inks.append(ink)
        return len(self._inks) - 1

    def text(self, row: int, column: int, text: str, style: str = "") -> None:
        """Write a text; marks lie over it."""
        if 0 <= row < self.height:
            for at, letter in enumerate(text, start=column):
                if 0 <= at < self.width:
                    self._texts[row][at], self._styles[row][at] = letter, style

    def mark(self, half: int, column: int, ink: int) -> None:
        """Fill the half of a cell: ``half`` counts from the top, two a row."""
        if 0 <= half < 2 * self.height and 0 <= column < self.width:
            self._halves[half][column] = ink

    def lines(self) -> list[Content]:
        return [self._line(row) for row in range(self.height)]

    def _line(self, row: int) -> Content:
        cells = [self._cell(row, column) for column in range(self.width)]
        runs = groupby(cells, key=itemgetter(1))
        return Content.assemble(*(("".join(cell for cell, _ in run), style) for style, run in runs))

    def _cell(self, row: int, column: int) -> tuple[str, str]:
        upper, lower = self._halves[2 * row][column], self._halves[2 * row + 1][column]
        if upper == lower == NONE:
            return self._texts[row][column], self._styles[row][column]
        if self._letters:
            ink = self._inks[max(upper, lower)]
            return ink.letter, ink.words
        if upper == lower:
            return "█", self._inks[upper].colour
        if lower == NONE:
            return "▀", self._inks[upper].colour
        if upper == NONE:
            return "▄", self._inks[lower].colour
        return "▀", f"{self._inks[upper].colour} on {self._inks[lower].colour}"


BELOW = 3  # rows under the area: frame, ticks, title
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
    limit_name: str = marked("limit")
    marks: tuple[Mark, ...] = ()

    @property
    def values(self) -> Array:
        return np.concatenate([np.zeros(0), *(each.y for each in self.series)])


@dataclass(frozen=True, slots=True)
class PlotStyle:
    """Shapes that the terminal has: ``letters`` in place of half blocks, ``plain`` ASCII alone."""

    letters: bool = False
    plain: bool = False


def draw(
    plot: Plot, scale: Scale, width: int, height: int, style: PlotStyle, *, named: bool = True
) -> list[Content]:
    """Return a plot in exactly so many rows; ``named``: each series has its name at its line."""
    return _Drawing(plot, scale, width, height, style).lines(named=named)


class _Drawing:
    """One plot on its canvas; the area within the frame has its own rows and columns."""

    FRAME, TICK = "$stale", "$label"
    BEGIN = (0.3, 0.6, 0.5, 0.4)  # of the names, in shares of the width: apart from each other

    def __init__(self, plot: Plot, scale: Scale, width: int, height: int, style: PlotStyle) -> None:
        self._plot, self._scale, self._style = plot, scale, style
        self._canvas = Canvas(width, height, letters=style.letters)
        self._height = max(height - BELOW, 2)
        limit_rows = np.floor(scale.rows(np.array(plot.limits), self._height)).astype(int).tolist()
        self._limits = [*zip(limit_rows, plot.limits, strict=True)]
        self._labels = {row: self._label(value) for row, value in scale.ticks(self._height)}
        self._bold = {row: self._label(value) for row, value in self._limits}
        labels = (*self._labels.values(), *self._bold.values())
        self._left = max(map(len, labels), default=0) + 1
        self._width = max(width - self._left, 1)

    def lines(self, *, named: bool) -> list[Content]:
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
        return decimal(f"{value + 0.0:.{decimals}f}")

    def _column(self, share: float) -> int:
        return int(min(share, 1.0 - 1e-9) * self._width)

    def _frame(self) -> None:
        canvas, left = self._canvas, self._left
        for row in range(self._height):
            canvas.text(row, left - 1, "│", self.FRAME)
        for row, label in self._labels.items():
            canvas.text(row, left - 1 - len(label), label, self.TICK)
            canvas.text(row, left - 1, "┤", self.FRAME)
            for column in range(left, left + self._width, 4):
                canvas.text(row, column, "." if self._style.plain else "·", "$track")
        for row, label in self._bold.items():
            canvas.text(row, 0, " " * (left - 1))
            canvas.text(row, left - 1 - len(label), f"{label}┤", "bold $foreground")
            canvas.text(row, left, "─" * self._width, "$foreground")

    def _x_axis(self) -> None:
        canvas, bottom = self._canvas, self._height
        canvas.text(bottom, self._left - 1, "└" + "─" * self._width, self.FRAME)
        free = 0
        for share, label in self._plot.x_ticks:
            column = self._left + self._column(share)
            canvas.text(bottom, column, "┴", self.FRAME)
            start = min(column - len(label) // 2, canvas.width - len(label))
            if start >= free:
                canvas.text(bottom + 1, start, label, self.TICK)
                free = start + len(label) + 1
        canvas.text(bottom + 2, self._left, self._plot.x_title[: self._width], self.TICK)

    def _halves(self, values: Array) -> Ints:
        """Return the half (N,) of each value, on the right side of every limit's line.

        A letter fills both halves: it is in the row above or under the line.
        """
        halves: Ints = np.floor(2.0 * self._scale.rows(values, self._height)).astype(int)
        room = int(self._style.letters)
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
        strokes = []
        for column in range(int(columns[0]) if len(columns) else self._width, self._width):
            here = [*halves[columns == column].tolist(), *halves[columns < column][-1:].tolist()]
            strokes.append((column, min(here), max(here)))
        return strokes

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
        names = [tr(series.name) for series in self._plot.series]
        styles = [f"bold {series.ink.words}" for series in self._plot.series]
        for row, _ in self._limits[:1]:
            line = np.zeros((self._height, self._width), bool)
            line[row] = True
            names, styles, lines = (
                [*names, tr(self._plot.limit_name)],
                [*styles, "$foreground"],
                [*lines, line],
            )
        preferred = [*self.BEGIN[: len(self._plot.series)], 0.0]
        spots = place(names, [*lines, words], preferred)
        for name, style, spot in zip(names, styles, spots, strict=True):
            if spot is not None:
                self._canvas.text(spot[0], self._left + spot[1], name, style)


FARTHEST = 3  # rows between a name and its line
EDGE = 1  # free columns around a name
ENOUGH = 4  # rows to another line, beyond which more are no better


def place(
    names: Sequence[str], lines: Sequence[Bools], preferred: Sequence[float]
) -> list[tuple[int, int] | None]:
    """Return row and column of the first letter of each name, or None where there is no room.

    ``lines``: the cells (rows, columns) that each series covers. ``preferred``: the share of the
    width at which each name had best begin, so that names are apart.
    """
    taken: Bools = np.any(lines, axis=0)
    away = [_rows_away(line) for line in lines]
    spots: list[tuple[int, int] | None] = []
    for number, name in enumerate(names):
        others = [each for n, each in enumerate(away) if n != number]
        spot = _spot(len(name), lines[number], others, taken, preferred[number])
        if spot is not None:
            row, column = spot
            taken[row, max(column - EDGE, 0) : column + len(name) + EDGE] = True
        spots.append(spot)
    return spots


def _rows_away(line: Bools) -> Ints:
    """Return how many rows each cell (rows, columns) is from a line above or below it."""
    rows = np.arange(len(line))
    apart = abs(rows[:, None] - rows)[..., None]  # of each row from each other one
    away: Ints = np.where(line, apart, len(line)).min(axis=1)
    return away


def _spot(
    length: int, own: Bools, others: Sequence[Ints], taken: Bools, preferred: float
) -> tuple[int, int] | None:
    height, width = own.shape
    span = length + 2 * EDGE
    if width < span:
        return None
    # Whether any of ``span`` cells from each start on is set, (rows, starts).
    covered, busy = (
        np.any(sliding_window_view(each, span, axis=1), axis=2) for each in (own, taken)
    )
    foreign = np.full(covered.shape, height)
    for away in others:
        foreign = np.minimum(foreign, sliding_window_view(away, span, axis=1).min(axis=2))
    top, bottom = covered.argmax(axis=0), height - 1 - covered[::-1].argmax(axis=0)
    starts = np.arange(covered.shape[1])
    aside = abs(starts / width - preferred) * height / 3
    best, least = None, np.inf
    for far, side in product(range(1, FARTHEST + 1), (-1, 1)):
        rows = (top if side < 0 else bottom) + side * far
        inside = np.clip(rows, 0, height - 1)
        near = foreign[inside, starts]
        fits = (rows == inside) & covered.any(axis=0) & ~busy[inside, starts] & (near > far)
        costs = np.where(fits, far + aside - 0.5 * np.minimum(near, ENOUGH), np.inf)
        at = int(costs.argmin())
        if costs[at] < least:
            best, least = (int(rows[at]), at + EDGE), float(costs[at])
    return best
