"""A table drawn for a terminal, at its full width, or folded into a narrow one."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from hilcell.clean import harmless, harmless_lines

if TYPE_CHECKING:
    from rich.table import Table as Drawn

    from hilcell.present.table import Table

WIDEST = 500  # columns of a table


def drawn(table: Table, room: int | None) -> str:
    """Return the table in lines, harmless; ``room`` are the terminal's columns, None for a file.

    In a narrow terminal long words are folded: those of the first column stay whole, to be copied.
    """
    from rich.console import Console

    width = width_of(table)
    folded = room is not None and room < width
    text = io.StringIO()
    console = Console(file=text, markup=False, highlight=False, width=WIDEST)
    console.width = room if room is not None and folded else width
    console.print(_built(table, folded=folded))
    return text.getvalue()


def width_of(table: Table) -> int:
    """Return how many columns of a terminal a table takes, unfolded."""
    from rich.console import Console
    from rich.measure import Measurement

    console = Console(file=io.StringIO(), markup=False, highlight=False, width=WIDEST)
    return Measurement.get(console, console.options, _built(table, folded=False)).maximum


def _built(table: Table, *, folded: bool) -> Drawn:
    from rich.table import Table as Drawn

    made = Drawn()
    for n, column in enumerate(table.columns):
        made.add_column(
            harmless(column.plain_header),
            justify="right" if n else "left",
            no_wrap=not (n and folded),
            overflow="fold",
        )
    for row in table.texts(minus="-"):
        made.add_row(*map(harmless_lines, row))
    return made
