"""A canvas of cells: letters, and marks in half blocks, two steps a row.

Where colours tell series apart, each half of a cell has a colour of its own; where they do not,
a cell shows the letter of its uppermost series.
"""

from __future__ import annotations

from dataclasses import dataclass

from textual.content import Content

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
        """Return the rows as styled text."""
        return [self._line(row) for row in range(self.height)]

    def _pair(self, row: int, column: int) -> tuple[int, int]:
        return self._halves[2 * row][column], self._halves[2 * row + 1][column]

    def _line(self, row: int) -> Content:
        parts: list[tuple[str, str]] = []
        for column in range(self.width):
            letter, style = self._cell(row, column)
            if parts and parts[-1][1] == style:
                parts[-1] = (parts[-1][0] + letter, style)
            else:
                parts.append((letter, style))
        return Content.assemble(*parts)

    def _cell(self, row: int, column: int) -> tuple[str, str]:
        upper, lower = self._pair(row, column)
        if (upper, lower) == (NONE, NONE):
            return self._texts[row][column], self._styles[row][column]
        if self._letters:
            ink = self._inks[max(upper, lower)]
            return ink.letter, ink.words
        if upper == lower:
            return "█", self._inks[upper].colour
        if NONE in (upper, lower):
            return ("▀", self._inks[upper].colour) if lower == NONE else (
                "▄", self._inks[lower].colour)  # fmt: skip
        return "▀", f"{self._inks[upper].colour} on {self._inks[lower].colour}"
