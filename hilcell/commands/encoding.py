"""Text for streams whose encoding lacks some of its characters: similar ASCII, never an error.

The streams keep their encodings. A character that one of them lacks, such as the border of a table
in the C locale, is replaced while it is encoded, so nothing that prints needs to know of it.
"""

from __future__ import annotations

import codecs
import io
import unicodedata
from collections.abc import Iterable

SIMILAR, ESCAPED = "hilcell.similar", "hilcell.json-escaped"
_WORDS = {
    "μ": "u", "±": "+-", "×": "x", "·": "*", "÷": "/", "°": "deg", "Δ": "d", "σ": "sigma", "−": "-",
    "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "«": '"', "»": '"', "•": "*",
    "→": "->", "←": "<-", "↔": "<->", "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "ß": "ss",
    "\N{REPLACEMENT CHARACTER}": "?",
}  # fmt: skip


def never_fail_to_encode(streams: Iterable[object]) -> None:
    """Let streams of text replace what they cannot encode; others, and closed ones, are left."""
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper) and not stream.closed:
            stream.reconfigure(errors=SIMILAR)


def in_ascii(json: str) -> str:
    """Return JSON that is the same in any encoding of a terminal or pipe: RFC 8259, section 7."""
    return json.encode("ascii", ESCAPED).decode("ascii")


def _similar(error: UnicodeError) -> tuple[str, int]:
    """Return what stands for the characters that an encoding lacks, and where to go on."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(map(_plain, lacking)), error.end


def _plain(character: str) -> str:
    """Return one character in ASCII: a similar one or its word, else its escape sequence."""
    simple = unicodedata.normalize("NFKD", character)
    letters = "".join(_WORDS.get(each, each) for each in simple if not unicodedata.combining(each))
    if letters and letters.isascii():
        return letters
    if unicodedata.category(character) == "Cs":  # a byte of a file's name that is no text
        return "?"
    match unicodedata.name(character, "").split():
        case ["BOX", "DRAWINGS", *shape]:
            return _line(shape)
        case _:
            return character.encode("ascii", "backslashreplace").decode("ascii")


def _line(shape: list[str]) -> str:
    if "HORIZONTAL" in shape:
        return "+" if "AND" in shape else "-"
    return "|" if "VERTICAL" in shape and "AND" not in shape else "+"


def _escaped(error: UnicodeError) -> tuple[str, int]:
    r"""Return characters as JSON escapes: ``\u00b5``, or two beyond the basic plane."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass").hex()
    return "".join(f"\\u{units[n : n + 4]}" for n in range(0, len(units), 4)), error.end


codecs.register_error(SIMILAR, _similar)
codecs.register_error(ESCAPED, _escaped)
