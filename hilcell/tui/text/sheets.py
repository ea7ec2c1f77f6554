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
from hilcell.tui.text.frame import wrapped

GAP = 2
WIDEST = 30  # columns of a cell; a longer text wraps
HEAD = "$label on $panel"


def sheet_lines(table: Table, width: int, log: Log | None = None) -> list[Content]:
    """Return the table in lines of at most ``width``, each block with its header.

    Names of the program, and keys of the points of ``log``, are in words.
    """
    shown = [table.headers, *table.texts("-")]
    for texts, values in zip(shown[1:], table.rows, strict=True):
        for at, value in enumerate(values):
            text = value.words if isinstance(value, Named) else texts[at]
            texts[at] = text if log is None else in_words(text, log)
    shown = [[harmless(cell) for cell in row] for row in shown]
    columns = [list(column) for column in zip(*shown, strict=True)]
    widest = max(min(WIDEST, width - 2), 1)
    widths = [_column_width(column, widest, whole=True) for column in columns]
    if sum(widths) + GAP * (len(widths) - 1) > width - 1:
        widths = [_column_width(column, widest, whole=False) for column in columns]
    lines: list[Content] = []
    for block in _blocks(widths, width - 1):
        picked = [(columns[n], widths[n]) for n in block]
        for row in range(len(shown)):
            lines += _row_lines([(column[row], room) for column, room in picked], head=row == 0)
    return [line.truncate(width) for line in lines]


def _column_width(column: Sequence[str], widest: int, *, whole: bool) -> int:
    """Return the room of the longest cell, and of the header or its longest word."""
    head, *cells = column
    words = len(head) if whole else max((len(word) for word in head.split()), default=0)
    texts = max((len(cell) for cell in cells), default=0)
    return max(min(texts, widest), min(words, widest), 1)


def _blocks(widths: Sequence[int], width: int) -> list[list[int]]:
    """Return the columns of each block; the first column begins all of them."""
    blocks, used = [[0]], widths[0] if widths else 0
    for n in range(1, len(widths)):
        if used + GAP + widths[n] > width and len(blocks[-1]) > 1:
            blocks.append([0])
            used = widths[0]
        blocks[-1].append(n)
        used += GAP + widths[n]
    return blocks if widths else []


def _row_lines(cells: Sequence[tuple[str, int]], *, head: bool) -> list[Content]:
    """Return one row, in as many lines as its longest cell; numbers stand at the right."""
    parts = [[line.plain for line in wrapped(text, room)] or [""] for text, room in cells]
    height = max(map(len, parts))
    lines = []
    for at in range(height):
        texts = []
        for n, (part, (_, room)) in enumerate(zip(parts, cells, strict=True)):
            lead = height - len(part) if head else 0
            text = part[at - lead] if lead <= at < lead + len(part) else ""
            texts.append(f"{text:<{room}}" if n == 0 else f"{text:>{room}}")
        text = " " + (" " * GAP).join(texts)
        lines.append(Content.styled(text, HEAD) if head else Content(text))
    return lines
