"""Large digits in three rows, drawn with ``_`` and ``|`` alone: they look the same everywhere."""

from __future__ import annotations

_SEGMENTS = {
    "0": (" _ ", "| |", "|_|"),
    "1": ("   ", "  |", "  |"),
    "2": (" _ ", " _|", "|_ "),
    "3": (" _ ", " _|", " _|"),
    "4": ("   ", "|_|", "  |"),
    "5": (" _ ", "|_ ", " _|"),
    "6": (" _ ", "|_ ", "|_|"),
    "7": (" _ ", "  |", "  |"),
    "8": (" _ ", "|_|", "|_|"),
    "9": (" _ ", "|_|", " _|"),
    "-": ("  ", "__", "  "),
    "+": ("   ", "_|_", " | "),
    ".": (" ", " ", "."),
    " ": ("  ", "  ", "  "),
    "n": ("   ", " _ ", "| |"),  # nan and inf can be shown, too
    "a": ("   ", " _|", "(_|"),
    "i": (" ", ".", "|"),
    "f": (" _", "|_", "| "),
}


def large(text: str) -> tuple[str, str, str]:
    """Return three rows of equal length; raises `KeyError` for what is no number."""
    glyphs = [_SEGMENTS[letter] for letter in text]
    top, middle, bottom = ("".join(glyph[row] for glyph in glyphs) for row in range(3))
    return top, middle, bottom
