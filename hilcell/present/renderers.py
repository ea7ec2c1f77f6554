"""A table rendered: drawn for a terminal, as HTML by a macro, as CSV, as a workbook."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, MutableMapping, Sequence
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, Any

from hilcell.language import tr
from hilcell.present.table import Named, Table, Value
from hilcell.sanitize import harmless, harmless_lines

if TYPE_CHECKING:
    from jinja2 import Environment
    from rich.console import Console
    from rich.table import Table as Drawn
    from xlsxwriter.format import Format
    from xlsxwriter.worksheet import Worksheet

WIDEST = 500  # columns of a table


def drawn(table: Table, room: int | None) -> str:
    """Return the table in lines, harmless; ``room`` are the terminal's columns, None for a file.

    In a narrow terminal long words are folded: those of the first column stay whole, to be copied.
    """
    text, made = io.StringIO(), _built(table, folded=False)
    console = _console(text)
    if room is not None and room < _width(made):
        made, console.width = _built(table, folded=True), room
    console.print(made)
    return text.getvalue()


def width_of(table: Table) -> int:
    return _width(_built(table, folded=False))


def _width(made: Drawn) -> int:
    from rich.measure import Measurement

    console = _console(io.StringIO())
    return Measurement.get(console, console.options, made).maximum


def _console(file: io.StringIO) -> Console:
    from rich.console import Console

    return Console(file=file, markup=False, highlight=False, width=WIDEST)


def _built(table: Table, *, folded: bool) -> Drawn:
    from rich.table import Table as Drawn

    made = Drawn()
    headers = map(harmless, (column.plain_header for column in table.columns))
    for n, header in enumerate(headers):
        made.add_column(
            header, justify="right" if n else "left", no_wrap=not (n and folded), overflow="fold"
        )
    for row in table.texts(minus="-"):
        made.add_row(*map(harmless_lines, row))
    return made


# -- pages of HTML from templates: a table's macro is ``table.html.j2``, of every room -------------


@cache  # to compile the templates takes longer than to fill them in
def environment(*packages: str) -> Environment:
    """Return jinja2's environment: every value is escaped and in one line, none may be missing.

    Templates are those of the packages, the first first, and of this room.
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    def finalize(value: object) -> object:
        return harmless("; ".join(value.splitlines())) if type(value) is str else value

    made = Environment(
        loader=ChoiceLoader(
            [PackageLoader(each, ".") for each in (*packages, __name__.rpartition(".")[0])]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=finalize,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["trusted"] = Markup  # for hilcell's own SVG only
    known: MutableMapping[str, Any] = made.globals
    known["tr"] = tr
    return made


# -- tables for other programs: CSV, and a workbook for spreadsheets, units in the headers ---------

# Spreadsheets run text that begins like a formula, so such text is quoted.


def csv_content(table: Table) -> bytes:
    """Return a table as CSV in UTF-8."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.keys)
    writer.writerows(map(_quoted, row) for row in table.rows)
    return text.getvalue().encode()


def _quoted(value: Value) -> str | int | float | None:
    if isinstance(value, Named):
        value = value.name
    if not isinstance(value, str):
        return value
    shown = harmless(value)
    return f"'{shown}" if shown.startswith(("=", "+", "-", "@")) else shown


# How a spreadsheet shows a figure, by the unit that ends its key.
_FORMS = {
    "utc": "yyyy-mm-dd hh:mm:ss",
    "mm": "0.0000",
    "deg": "0.00000",
    "c": "0.00",
    "mbar": "0.0",
    "percent": "0.0",
    "s": "0.000",
}


def xlsx_of(tables: Sequence[Table], created: datetime, names: Mapping[str, str]) -> bytes:
    """Return a workbook with a sheet for each table, by its title.

    A row of a table whose second column is "value" has its unit in its first cell. ``names`` gives
    those tables a name, by title, under which formulas find them.
    """
    from xlsxwriter import Workbook

    file = io.BytesIO()
    with Workbook(file, {"in_memory": True, "nan_inf_to_errors": True}) as book:
        book.set_properties({"created": created})
        styles = {form: book.add_format({"num_format": form}) for form in _FORMS.values()}
        bold = book.add_format({"bold": True})
        for table in tables:
            sheet, keys = book.add_worksheet(table.title), table.keys
            last_row, last_column = len(table.rows), len(keys) - 1
            sheet.freeze_panes(1, 0)
            sheet.set_column(0, last_column, 16)
            _write_row(sheet, 0, keys, [bold] * len(keys))
            for number, row in enumerate(table.rows, start=1):
                units = [str(row[0])] * 2 if keys[1:] == ["value"] else keys
                forms = (_FORMS.get(key.rpartition("_")[2], "") for key in units)
                _write_row(sheet, number, row, [styles.get(form) for form in forms])
            if table.title not in names:
                sheet.autofilter(0, 0, max(1, last_row), last_column)
            elif table:
                options = {"name": names[table.title], "columns": [{"header": key} for key in keys]}
                sheet.add_table(0, 0, last_row, last_column, options)
    return file.getvalue()


def _write_row(
    sheet: Worksheet, number: int, row: Sequence[Value], styles: Sequence[Format | None]
) -> None:
    for column, (value, style) in enumerate(zip(row, styles, strict=True)):
        text = value.name if isinstance(value, Named) else value
        if isinstance(text, str):
            is_time = re.match(r"\d{4}-\d\d-\d\dT", text) is not None
            if is_time and style is not None and style.num_format == _FORMS["utc"]:
                # Spreadsheets know no zones.
                time = datetime.fromisoformat(text).astimezone(UTC).replace(tzinfo=None)
                sheet.write_datetime(number, column, time, style)
            else:
                sheet.write_string(number, column, harmless(text), style)
        elif isinstance(text, bool):
            sheet.write_boolean(number, column, text)
        elif text is not None:
            sheet.write_number(number, column, text, style)
