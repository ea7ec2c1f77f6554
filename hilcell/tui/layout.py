"""Small tables, rows and drawings, whose lines are made for the room that their panel has.

A panel asks for the lines as it paints: nothing outside this module and the style sheet counts
columns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Protocol

from textual.content import Content

Cell = Content | str | tuple[str, str]  # the last: a text and its style
BLANK = Content("")


class Lines(Protocol):
    """A text that is laid out as it is painted."""

    @property
    def state(self) -> object:
        """Return a value that is equal where the lines look the same."""

    def lines(self, width: int, height: int) -> list[Content]:
        """Return lines of at most ``width`` columns; the panel cuts those after ``height``."""


@dataclass(frozen=True, slots=True)
class Col:
    """One column: its width, 0 for that of its longest cell.

    ``grows``: it takes the room that the others leave; ``wraps``: long cells wrap, others are cut.
    """

    width: int = 0
    right: bool = False
    grows: bool = False
    wraps: bool = False


class Grid:
    """Rows of cells in columns; ``styles`` are those of whole rows, by number."""

    def __init__(
        self,
        rows: Iterable[Sequence[Cell]],
        *columns: Col,
        gap: int = 1,
        styles: Mapping[int, str] | None = None,
    ) -> None:
        self._rows = [[content_of(cell) for cell in row] for row in rows]
        self._columns, self._gap, self._styles = columns, gap, styles or {}

    @property
    def state(self) -> object:
        """Return what the look depends on."""
        cells = [look_of(cell) for row in self._rows for cell in row]
        return cells, self._columns, self._gap, self._styles

    def lines(self, width: int, height: int = 0) -> list[Content]:
        """Return the rows, each in as many lines as its longest cell needs."""
        widths = [
            0
            if col.grows
            else col.width or max((row[n].cell_length for row in self._rows), default=0)
            for n, col in enumerate(self._columns)
        ]
        room = max(width - sum(widths) - self._gap * (len(widths) - 1), 1)
        widths = [
            room if col.grows else each for col, each in zip(self._columns, widths, strict=True)
        ]
        found = []
        for number, row in enumerate(self._rows):
            cells = [
                self._cell_lines(*each) for each in zip(row, self._columns, widths, strict=True)
            ]
            for n in range(max(map(len, cells))):
                parts = (
                    cell[n] if n < len(cell) else Content(" " * room)
                    for cell, room in zip(cells, widths, strict=True)
                )
                line = Content(" " * self._gap).join(parts).truncate(width)
                found.append(line.stylize_before(self._styles.get(number, "")))
        return found

    def _cell_lines(self, cell: Content, column: Col, width: int) -> list[Content]:
        """Return the lines of a cell, each of its column's width."""
        wrapped = cell.wrap(width) if column.wraps and cell.cell_length > width else [cell]
        lines = (line.truncate(width, ellipsis=True) for line in wrapped)
        return [
            line.pad_left(width - line.cell_length)
            if column.right
            else line.truncate(width, pad=True)
            for line in lines
        ]


def ends(left: Cell, right: Cell) -> Grid:
    """Return one line with a text at each end; the left one is cut where room is short."""
    return Grid([(left, right)], Col(grows=True), Col())


class Stack:
    """Parts one under the other; contents wrap."""

    def __init__(self, *parts: Lines | Cell) -> None:
        self._parts = [
            part
            if not isinstance(part, Content | str | tuple)
            else Grid([(part,)], Col(grows=True, wraps=True))
            for part in parts
        ]

    @property
    def state(self) -> object:
        """Return what the look depends on."""
        return [part.state for part in self._parts]

    def lines(self, width: int, height: int = 0) -> list[Content]:
        """Return the lines of all parts."""
        return [*chain.from_iterable(part.lines(width, height) for part in self._parts)]


@dataclass(frozen=True, slots=True)
class Drawing:
    """Lines that fill their panel; they look the same as long as ``state`` is equal."""

    state: object
    lines: Callable[[int, int], list[Content]]


def content_of(cell: Cell) -> Content:
    """Return a cell as content."""
    if isinstance(cell, Content):
        return cell
    return Content(cell) if isinstance(cell, str) else Content.styled(*cell)


def look_of(content: Content) -> object:
    """Return a value that is equal where contents look the same."""
    return content.plain, tuple(content.spans)
