"""Prints answers and tables on stdout, messages on stderr, in any encoding.

Names of folders, values of cell files and text of journals are untrusted: escape sequences in them
would act on the terminal, so everything that is printed for people is cleaned.

The streams keep their encodings. A character that one of them lacks, such as the border of a table
in the C locale, is replaced while it is encoded by similar ASCII, so nothing that prints needs to
know of it.
"""

from __future__ import annotations

import codecs
import io
import os
import re
import shutil
import sys
import traceback
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from hilcell.atomic_files import NotPrinted
from hilcell.errors import HilcellError
from hilcell.sanitize import harmless_lines

if TYPE_CHECKING:
    from hilcell.present.table import Table


def print_message(text: str) -> None:
    """Print lines on stderr, without anything that a terminal obeys.

    A stderr that is full or closed changes nothing: the exit code still says how it ended.
    """
    if sys.stderr is not None:  # `print` would take stdout instead
        with suppress(OSError, ValueError):
            print(harmless_lines(text), file=sys.stderr)


def print_error(error: Exception) -> None:
    """Print an error on stderr; one that hilcell did not expect with the trace of its origin."""
    if isinstance(error, HilcellError):
        print_message(f"hilcell: {error}")
    else:
        print_message("".join(traceback.format_exception(error)).rstrip())
        what = f"{type(error).__name__}: {error}"
        print_message(f"hilcell: {what}; a defect of hilcell or of a driver, please report it")


def print_answer(values: Mapping[str, object], words: str, *, as_json: bool) -> None:
    """Print ``values`` as one JSON object on stdout where asked for, else ``words`` on stderr."""
    if as_json:
        print_json(values)
    else:
        print_message(words)


def print_json(values: Mapping[str, object]) -> None:
    """Print ``values`` as one JSON object on stdout; raises `NotPrinted`."""
    print_data(json_line(values))


def json_line(values: Mapping[str, object]) -> str:
    """Return ``values`` as one JSON object on one line, in ASCII."""
    import msgspec  # `--help` does without it

    return in_ascii(msgspec.json.encode(values).decode())


def print_data(text: str) -> None:
    """Print lines on stdout; raises `NotPrinted`, at the latest when they are flushed."""
    with stdout_checked():
        print(text)


def flush_data() -> None:
    """Hand on what was printed; raises `NotPrinted` where stdout does not take it."""
    with stdout_checked():
        sys.stdout.flush()


@contextmanager
def stdout_checked() -> Iterator[None]:
    """Raise `NotPrinted` where stdout fails, and leave it so that its buffer fails no second time.

    The interpreter flushes the buffer at its end, and would report that in its own words.
    """
    try:
        if sys.stdout is None:
            raise ValueError("it is closed")
        yield
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError, AttributeError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise NotPrinted(
            f"stdout: cannot be written: {reason}; the output is not complete; make room, or give "
            "it to a program that reads it to its end"
        ) from error


def terminal_columns() -> int | None:
    """Return how wide the terminal is to which stdout goes; None for a file or a pipe."""
    if sys.stdout is None or not sys.stdout.isatty():
        return None
    return shutil.get_terminal_size().columns


def print_table(table: Table) -> None:
    """Print a table on stdout; one without rows is left out. Raises `NotPrinted`."""
    if table:
        from hilcell.present.renderers import drawn  # `--help` does without it

        with stdout_checked():
            sys.stdout.write(drawn(table, terminal_columns()))


# -- encodings ------------------------------------------------------------------------------------

SIMILAR = "hilcell.similar"
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


def in_ascii(text: str) -> str:
    """Return JSON that is the same in any encoding of a terminal or pipe: RFC 8259, section 7."""
    import json  # `--help` does without it

    return re.sub(r"[^\x00-\x7f]+", lambda beyond: json.dumps(beyond[0])[1:-1], text)


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


codecs.register_error(SIMILAR, _similar)
