"""Tables for other programs: CSV, and a workbook for spreadsheets, units in the headers.

Spreadsheets run text that begins like a formula, so such text is quoted.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from hilcell.clean import harmless
from hilcell.present.table import Named, Table, Value

if TYPE_CHECKING:
    from xlsxwriter.format import Format
    from xlsxwriter.worksheet import Worksheet


def csv_of(table: Table) -> bytes:
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
_TIME = re.compile(r"\d{4}-\d\d-\d\dT")


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
            if style is not None and style.num_format == _FORMS["utc"] and _TIME.match(text):
                # Spreadsheets know no zones.
                time = datetime.fromisoformat(text).astimezone(UTC).replace(tzinfo=None)
                sheet.write_datetime(number, column, time, style)
            else:
                sheet.write_string(number, column, harmless(text), style)
        elif isinstance(text, bool):
            sheet.write_boolean(number, column, text)
        elif text is not None:
            sheet.write_number(number, column, text, style)
