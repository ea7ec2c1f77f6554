"""CSV text as spreadsheets of several countries write it: fields, and the decimal sign in force.

Our own form has commas between fields and decimal points, in UTF-8. German and French spreadsheets
write semicolons and decimal commas, older ones in CP1252. Some state the separator in a first line
of its own, ``sep=;``, or end each line with separators of columns that were empty. 1,234 is 1.234
there and 1234 where commas group thousands. One number of the file that cannot be grouped
thousands, such as 0,5 or 1234,5, proves the sign for all; without one the file is refused.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hilcell.cell.settings import SettingsError

POINT, COMMA = ".", ","
GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*", re.ASCII)  # may be thousands
FIGURES = re.compile(r"[+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?", re.ASCII)  # by whatever sign
STATED = re.compile(r'"?sep=([;,])"?', re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CsvText:
    """Rows as (line, fields), the header among them, and the decimal sign of their numbers."""

    rows: list[tuple[int, list[str]]]
    separator: str = ","
    decimal: str = POINT

    @property
    def header(self) -> list[str]:
        """Return the fields of the first line as they stand."""
        return self.rows[0][1] if self.rows else []

    def surplus(self, count: int, wanted: int) -> str:
        """Return what may have split a row into more fields than wanted; may be nothing."""
        if count > wanted and self.separator == ",":
            return "; where a decimal comma has split numbers, separate fields by semicolons"
        return ""


def read_csv(path: Path, content: bytes, labels: int) -> CsvText:
    """Return a file with ``labels`` columns of words before numbers; raises `SettingsError`."""
    text = _text(path, content)
    first, _, others = text.partition("\n")
    stated = STATED.fullmatch(first.strip())
    if stated:
        text = others
    separator = stated[1] if stated else ";" if ";" in first and "," not in first else ","
    try:
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
        rows = [(reader.line_num + bool(stated), cells) for cells in reader]
    except csv.Error as error:
        raise SettingsError(str(path), [f"cannot be read: {error}"]) from error
    begin = next((n for n, (_, cells) in enumerate(rows) if any(map(str.strip, cells))), 0)
    rows = _without_empty_columns(rows[begin:])
    if separator == ",":
        return CsvText(rows)
    figures = ((line, cell.strip()) for line, cells in rows[1:] for cell in cells[labels:])
    return CsvText(rows, separator, _decimal(path, figures))


def _without_empty_columns(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """Return rows without fields that are empty beyond the header's last; empty rows have none."""
    if not rows or not any(rows[0][1]):
        return rows
    width = 1 + max(n for n, cell in enumerate(rows[0][1]) if cell.strip())

    def needed(cells: list[str]) -> list[str]:
        if not any(cell.strip() for cell in cells):
            return []
        return cells if any(cell.strip() for cell in cells[width:]) else cells[:width]

    return [(line, needed(cells)) for line, cells in rows]


def _text(path: Path, content: bytes) -> str:
    utf_16 = (b"\xff\xfe", b"\xfe\xff")
    if content.startswith(utf_16):
        raise SettingsError(str(path), ["is UTF-16; save it as CSV in UTF-8"])
    other_coding = "cp1252"
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # All our headers are ASCII: a file whose first line is not is no list in any coding.
        if content.partition(b"\n")[0].isascii():
            with suppress(UnicodeDecodeError):
                return content.decode(other_coding)
        raise SettingsError(str(path), ["is not UTF-8 text; save it as UTF-8"]) from error


def _decimal(path: Path, figures: Iterable[tuple[int, str]]) -> str:
    """Return the decimal sign of a file with semicolons; raises `SettingsError`."""
    seen: dict[str, tuple[int, str]] = {}  # the first number with a sign
    proven: set[str] = set()
    for line, cell in figures:
        longest = 40  # characters of a number that is looked at
        number = len(cell) <= longest and FIGURES.fullmatch(cell)
        signs = {POINT, COMMA} & {*cell} if number else set()
        if len(signs) > 1:
            raise _refusal(path, line, cell, "has a thousands separator; write digits without one")
        for sign in signs:
            seen.setdefault(sign, (line, cell))
            if not GROUPED.fullmatch(cell):
                proven.add(sign)
    if len(seen) > 1:
        (line, cell), (other_line, other) = sorted(seen.values(), reverse=True)
        words = f"while line {other_line} has {other!r}; write all with one decimal sign"
        raise _refusal(path, line, cell, words)
    for sign, (line, cell) in seen.items():
        if sign not in proven:
            plain, grouped = cell.replace(sign, POINT), cell.replace(sign, "")
            raise _refusal(
                path, line, cell,
                f"may be {plain}, or {grouped} with a thousands separator, and no other number "
                f"of the file says which; write one of them with another count of decimals, as "
                f"{cell}0",
            )  # fmt: skip
    return next(iter(seen), POINT)


def _refusal(path: Path, line: int, cell: str, words: str) -> SettingsError:
    return SettingsError(str(path), [f"line {line}: {cell[:40]!r} {words}"])
