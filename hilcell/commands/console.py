"""Printing: data and tables on stdout, messages on stderr, in any encoding.

Names of folders, values of cell files and text of journals are untrusted: their escape sequences
would act on the terminal, so all text for people is cleaned.

A character that a stream's encoding lacks, such as the border of a table in the C locale, is
replaced by similar ASCII by the error handler of its codec.
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
    """Print cleaned lines on stderr; errors of a full or closed stderr are ignored."""
    if sys.stderr is not None:  # `print` would use stdout
        with suppress(OSError, ValueError):
            print(harmless_lines(text), file=sys.stderr)


def print_error(error: Exception) -> None:
    if isinstance(error, HilcellError):
        print_message(f"hilcell: {error}")
    else:
        print_message("".join(traceback.format_exception(error)).rstrip())
        what = f"{type(error).__name__}: {error}"
        print_message(f"hilcell: {what}; a defect of hilcell or of a driver, please report it")


def print_answer(values: Mapping[str, object], text: str, *, as_json: bool) -> None:
    """Print ``values`` as one JSON object on stdout, or ``text`` on stderr."""
    if as_json:
        print_json(values)
    else:
        print_message(text)


def print_json(values: Mapping[str, object]) -> None:
    """Print ``values`` as one JSON object on stdout; raises `NotPrinted`."""
    print_data(json_line(values))


def json_line(values: Mapping[str, object]) -> str:
    """Return ``values`` as one JSON object on one line, in ASCII."""
    import msgspec  # not for `--help`

    return in_ascii(msgspec.json.encode(values).decode())


def print_data(text: str) -> None:
    """Print lines on stdout; raises `NotPrinted`, at the latest in `flush_data`."""
    with stdout_checked():
        print(text)


def flush_data() -> None:
    """Flush stdout; raises `NotPrinted`."""
    with stdout_checked():
        sys.stdout.flush()


@contextmanager
def stdout_checked() -> Iterator[None]:
    """Raise `NotPrinted` where stdout fails, and redirect it to the null device.

    Else the interpreter would fail to flush its buffer at the end, with a message of its own.
    """
    try:
        if sys.stdout is None:
            raise ValueError("it is closed")
        yield
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError, AttributeError):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, sys.stdout.fileno())
            os.close(null)
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise NotPrinted(f"stdout cannot be written: {reason}; the output is incomplete") from error


def terminal_columns() -> int | None:
    """Return the width of stdout's terminal; None for a file or a pipe."""
    if sys.stdout is None or not sys.stdout.isatty():
        return None
    return shutil.get_terminal_size().columns


def print_table(table: Table) -> None:
    """Print a table on stdout, unless it has no rows. Raises `NotPrinted`."""
    if table:
        from hilcell.present.renderers import drawn  # not for `--help`

        with stdout_checked():
            sys.stdout.write(drawn(table, terminal_columns()))


# -- encodings ------------------------------------------------------------------------------------

SIMILAR = "hilcell.similar"
_ASCII = {
    "μ": "u", "±": "+-", "×": "x", "·": "*", "÷": "/", "°": "deg", "Δ": "d", "σ": "sigma", "−": "-",
    "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "«": '"', "»": '"', "•": "*",
    "→": "->", "←": "<-", "↔": "<->", "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "ß": "ss",
    "\N{REPLACEMENT CHARACTER}": "?",
}  # fmt: skip


def never_fail_to_encode(streams: Iterable[object]) -> None:
    """Let open text streams replace characters that they cannot encode."""
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper) and not stream.closed:
            stream.reconfigure(errors=SIMILAR)


def in_ascii(text: str) -> str:
    """Return JSON with its other characters escaped: RFC 8259, section 7."""
    import json  # not for `--help`

    return re.sub(r"[^\x00-\x7f]+", lambda beyond: json.dumps(beyond[0])[1:-1], text)


def _similar(error: UnicodeError) -> tuple[str, int]:
    """Replace characters that an encoding lacks: a handler of `codecs.register_error`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_plain, error.object[error.start : error.end])), error.end


def _plain(character: str) -> str:
    """Return one character in ASCII: similar characters, else its escape sequence."""
    simple = unicodedata.normalize("NFKD", character)
    letters = "".join(_ASCII.get(each, each) for each in simple if not unicodedata.combining(each))
    if letters and letters.isascii():
        return letters
    if unicodedata.category(character) == "Cs":  # an undecodable byte of a file's name
        return "?"
    match unicodedata.name(character, "").split():
        case ["BOX", "DRAWINGS", *shape]:
            if "AND" in shape:
                return "+"
            return "-" if "HORIZONTAL" in shape else "|" if "VERTICAL" in shape else "+"
        case _:
            return character.encode("ascii", "backslashreplace").decode("ascii")


codecs.register_error(SIMILAR, _similar)
