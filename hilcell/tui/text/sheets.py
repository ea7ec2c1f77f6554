"""A procedure's table in a width: no number is cut, no line is drawn, columns go on below.

Headers wrap over their columns, long texts within theirs. Columns that have no room beside the
others follow in a block of their own, with the first column again.
"""

from __future__ import annotations

from collections.abc import Sequence

from textual.content import Content

from hilcell.clean import harmless
from hilcell.journal.key_words import in_words
from hilcell.journal.log import Log
from hilcell.present.table import Named, Table
from hilcell.tui.layout import Col, Drawing, Grid, Lines

GAP = 2
WIDEST = 30  # columns of a cell; a longer text wraps


def sheet_lines(table: Table, log: Log | None = None) -> Lines:
    """Return the table in as many blocks as it needs, each with its header.

    Names of the program, and keys of the points of ``log``, are in words.
    """
    shown = [table.headers, *table.texts("-")]
    for texts, values in zip(shown[1:], table.rows, strict=True):
        for at, value in enumerate(values):
            text = value.words if isinstance(value, Named) else texts[at]
            texts[at] = text if log is None else in_words(text, log)
    shown = [[harmless(cell) for cell in row] for row in shown]
    columns = [list(column) for column in zip(*shown, strict=True)]

    def draw(width: int, height: int) -> list[Content]:
        widths = [max(map(len, column)) for column in columns]
        if sum(widths) + GAP * len(widths) > width:  # headers wrap before columns go on below
            widths = [max(map(len, [*head.split(), *cells])) for head, *cells in columns]
        widths = [max(min(each, WIDEST, width - 2), 1) for each in widths]
        lines: list[Content] = []
        for block in _blocks(widths, width - 1):
            cols = (Col(most=widths[n], right=n > 0, wraps=True) for n in block)
            rows = [[row[n] for n in block] for row in shown]
            grid = Grid(rows, *cols, gap=GAP, styles={0: "$label on $panel"})
            lines += [line.pad_left(1) for line in grid.lines(width - 1)]
        return lines

    return Drawing(shown, draw)


def _blocks(widths: Sequence[int], width: int) -> list[list[int]]:
    """Return the columns of each block; the first column begins all of them."""
    blocks: list[list[int]] = [[0]] if widths else []
    for n in range(1, len(widths)):
        used = sum(widths[m] + GAP for m in blocks[-1])
        if used + widths[n] > width and len(blocks[-1]) > 1:
            blocks.append([0])
        blocks[-1].append(n)
    return blocks
