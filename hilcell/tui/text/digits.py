"""Large figures and words: three rows of half blocks, three columns a digit, one between.

1 has a foot: without one it looks like 7. In ASCII the large text is one bold line.
"""

from __future__ import annotations

import math

from textual.content import Content

from hilcell.tui.terminal.capabilities import Glyphs

ROWS = 3
_SHAPES = {
    "0": ("█▀█", "█ █", "▀▀▀"),
    "1": ("▄█ ", " █ ", "▀▀▀"),
    "2": ("▀▀█", "█▀▀", "▀▀▀"),
    "3": ("▀▀█", " ▀█", "▀▀▀"),
    "4": ("█ █", "▀▀█", "  ▀"),
    "5": ("█▀▀", "▀▀█", "▀▀▀"),
    "6": ("█▀▀", "█▀█", "▀▀▀"),
    "7": ("▀▀█", "  █", "  ▀"),
    "8": ("█▀█", "█▀█", "▀▀▀"),
    "9": ("█▀█", "▀▀█", "▀▀▀"),
    "+": (" ▄ ", "▀█▀", "   "),
    "-": ("  ", "▀▀", "  "),
    ".": (" ", " ", "▀"),
    "P": ("█▀█", "█▀▀", "▀  "),
    "A": ("█▀█", "█▀█", "▀ ▀"),
    "S": ("█▀▀", "▀▀█", "▀▀▀"),
    "F": ("█▀▀", "█▀▀", "▀  "),
    "I": ("█", "█", "▀"),
    "L": ("█  ", "█  ", "▀▀▀"),
    "T": ("▀█▀", " █ ", " ▀ "),
    "V": ("█ █", "█ █", " ▀ "),
    "D": ("█▀▄", "█ █", "▀▀ "),
    "U": ("█ █", "█ █", "▀▀▀"),
    "E": ("█▀▀", "█▀▀", "▀▀▀"),
    "R": ("█▀█", "█▀▄", "▀ ▀"),
    "O": ("█▀█", "█ █", "▀▀▀"),
}


def figure(value_mm: float) -> str:
    """Return a length as it is shown in large digits; dashes for what is no number."""
    return f"{value_mm:.3f}" if math.isfinite(value_mm) else "-.---"


def large_rows(text: str) -> tuple[str, str, str]:
    """Return three rows of equal length; raises `KeyError` for a letter without a shape."""
    shapes = [_SHAPES[letter] for letter in text.replace("−", "-")]
    top, middle, bottom = (" ".join(shape[row] for shape in shapes) for row in range(ROWS))
    return top, middle, bottom


def large(text: str, style: str, glyphs: Glyphs) -> list[Content]:
    """Return `ROWS` lines of equal width that show the text large; in ASCII the middle one does."""
    if glyphs.plain:
        shown = Content.styled(text, f"bold {style}")
        blank = Content(" " * shown.cell_length)
        return [blank, shown, blank]
    return [Content.styled(row, style) for row in large_rows(text)]
