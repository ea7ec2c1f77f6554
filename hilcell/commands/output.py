"""Prints answers and tables on stdout, messages on stderr.

Names of folders, values of cell files and text of journals are untrusted: escape sequences in them
would act on the terminal, so everything that is printed for people is cleaned.
"""

from __future__ import annotations

import io
import sys
import traceback
from collections.abc import Mapping
from typing import TYPE_CHECKING

from hilcell.clean import harmless
from hilcell.errors import HilcellError

if TYPE_CHECKING:
    from hilcell.run.procedure import Table

WIDEST = 500  # columns of a table


def print_message(text: str) -> None:
    """Print lines on stderr, without anything that a terminal obeys."""
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
    """Print ``values`` as one JSON object on stdout."""
    import msgspec  # `--help` does without it

    print(msgspec.json.encode(values).decode())


def harmless_lines(text: str) -> str:
    """Return ``text`` with its line breaks, but nothing else that a terminal obeys."""
    return "\n".join(map(harmless, text.split("\n")))


def print_table(table: Table) -> None:
    """Print a table on stdout, harmless, at its full width: names must stay whole to be copied."""
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table as RichTable

    headers, rows = table
    drawn = RichTable()
    for column, header in enumerate(headers):
        drawn.add_column(harmless(header), justify="left" if column == 0 else "right", no_wrap=True)
    for row in rows:
        drawn.add_row(*map(harmless_lines, row))
    text = io.StringIO()
    wide = Console(file=text, markup=False, highlight=False, width=WIDEST)
    wide.width = Measurement.get(wide, wide.options, drawn).maximum
    wide.print(drawn)
    sys.stdout.write(text.getvalue())
