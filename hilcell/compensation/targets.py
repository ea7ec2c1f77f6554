"""CSV files of named rows in {W}: strict reading, whole writing.

Targets are ``name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg`` with Z-Y-X angles. Python takes ``1_0`` for
10, digits of any script, and ``nan`` for a number; all are refused here. So is a list that was
corrected before: it has a stamp in a column of its own. Read are the forms of `csv_text`, written
is our own.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hilcell.cell.settings import SettingsError, read_file
from hilcell.clean import LONGEST, UNSAFE
from hilcell.compensation.csv_text import POINT, CsvText, read_csv
from hilcell.compensation.stamp import COLUMN, Stamp, refuse_corrected
from hilcell.ports import Array
from hilcell.writing import write_whole

MOST, MOST_DEG = 1e6, 1e4  # mm and whatever else, deg; beyond is a slip, and overflows
JOINERS = re.compile("[\u200c\u200d]")
BRACKETS = re.compile(r"\s*[\[(]\s*(\w+)\s*[\])]$")  # a unit, as spreadsheets state it
BOUND = "bound95_mm"
MM_DECIMALS, DEG_DECIMALS = 4, 6
NEAR_MM = 200.0  # from the origin are all points of a list in metres or inches
HEADER = ["name", "x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg"]


@dataclass(slots=True)
class NamedRows:
    """Rows of one file: ``header``, names (N) that differ, finite ``values`` (N) lists."""

    header: list[str]
    names: list[str] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)


def read_targets(path: Path) -> tuple[list[str], Array]:
    """Return names and values (N, 6); raises as `read_named_rows` does."""
    rows = read_named_rows(path, read_file(path), [HEADER], "targets")
    return rows.names, np.array(rows.values)


def unit_hint(points_mm: Array) -> str:
    """Return the question whether points (N, 3) are in another unit; "" where they cannot be."""
    if not np.abs(points_mm).max() < NEAR_MM:
        return ""
    return "\nis the list in metres or inches? It must be in mm"


def read_named_rows(
    path: Path,
    content: bytes,
    headers: Sequence[list[str]],
    what: str,
    fault_of: Callable[[list[str], list[float]], str] = lambda header, values: "",
) -> NamedRows:
    """Return the rows of a CSV that has one of ``headers``: a name, then numbers.

    ``fault_of`` says in words what is wrong with finite values, or nothing. Raises
    `SettingsError` with every problem and its line, and `CorrectedBefore`.
    """
    text = read_csv(path, content, labels=1)
    refuse_corrected(str(path), (cell for _, cells in text.rows for cell in cells))
    header = header_of(path, text, headers)
    rows, known, problems = NamedRows(header), set[str](), list[str]()
    for line, cells in text.rows[1:]:
        if cells:
            faults = _take(cells, text, rows, known, fault_of)
            problems += [f"line {line}: {fault}" for fault in faults]
    if not rows.names and not problems:
        problems.append(f"no {what}")
    if problems:
        raise SettingsError(str(path), problems)
    return rows


def header_of(path: Path, text: CsvText, headers: Sequence[list[str]]) -> list[str]:
    """Return which of ``headers`` a file has; raises `SettingsError` naming other columns."""
    columns = [column for each in headers for column in each]
    header = [column_of(cell, columns) for cell in text.header]
    if header not in headers:
        expected = " or ".join(",".join(each) for each in headers)
        found, most = text.separator.join(text.header).replace("\t", "\\t"), 200
        found = found if len(found) <= most else f"{found[:most]}..."
        got = f"{found if text.rows else 'an empty file'}{_differs(header, headers)}"
        raise SettingsError(str(path), [f"line 1: expected header {expected}, got {got}"])
    return header


def column_of(cell: str, columns: Iterable[str]) -> str:
    """Return the column that a header's field means (``X``, ``x [mm]``: x_mm), else the field."""
    word = BRACKETS.sub(r"_\1", cell.strip().casefold().replace("\u00b0", "deg"))
    for each in columns:
        if word and word in (each, each.removesuffix("_mm").removesuffix("_deg")):
            return each
    return cell.strip()


def _differs(header: list[str], headers: Sequence[list[str]]) -> str:
    """Return in words what is wrong with a header, compared with that which is most like it."""
    if any("\t" in each for each in header):
        return "; its fields are separated by tabs: save it with commas or semicolons"
    wanted = max(headers, key=lambda each: len({*each} & {*header}))
    missing = [each for each in wanted if each not in header]
    unknown = [_shown(each) for each in header if each not in wanted]
    words = [f"missing: {', '.join(missing)}"] if missing else []
    words += [f"unknown: {', '.join(unknown)}"] if unknown else []
    if not words:
        words = ["a column twice" if len(header) > len(wanted) else "in another order"]
    return f" ({'; '.join(words)})" if any(header) else ""


def _take(
    cells: list[str],
    text: CsvText,
    rows: NamedRows,
    known: set[str],
    fault_of: Callable[[list[str], list[float]], str],
) -> list[str]:
    if len(cells) != len(rows.header):
        more = text.surplus(len(cells), len(rows.header))
        return [f"{len(cells)} fields, expected {len(rows.header)}{more}"]
    name = cells[0]
    fault = f"name {_shown(name)} was used before" if name in known else _name_fault(name)
    known.add(name)
    try:
        values = numbers(rows.header[1:], cells[1:], text.decimal)
    except ValueError as error:
        return [*filter(None, [fault]), str(error)]
    rows.names.append(name)
    rows.values.append(values)
    return [*filter(None, (fault, fault_of(rows.header, values)))]


def _name_fault(name: str) -> str:
    """Return in words what is wrong with a name; joiners within it are letters' (Persian)."""
    if not name:
        return "name is empty"
    if len(name) > LONGEST:
        return f"name {_shown(name)} has {len(name)} characters, wanted at most {LONGEST}"
    if name != name.strip():
        return f"name {_shown(name)} has outer spaces"
    found = UNSAFE.search(name[0] + JOINERS.sub("", name[1:-1]) + name[1:][-1:])
    if found:
        return f"name {_shown(name)} has a control character, U+{ord(found[0]):04X}"
    computed = "=+-@"  # at a field's begin, for spreadsheets
    if name[0] in computed:
        return f"name {_shown(name)} begins with {name[0]}: a spreadsheet would compute it"
    return ""


def _shown(text: str) -> str:
    shown = 40  # characters of a bad field
    return repr(text if len(text) <= shown else f"{text[:shown]}...")


def numbers(columns: Sequence[str], cells: Sequence[str], decimal: str = POINT) -> list[float]:
    """Return plain finite numbers of sane size; raises ValueError naming the column."""
    found = []
    for column, cell in zip(columns, cells, strict=True):
        shown = _shown(cell)
        try:
            plain = cell.replace(decimal, POINT)
            value = float(plain) if plain.isascii() and "_" not in plain else None
        except ValueError:
            value = None
        if value is None:  # a comma is refused in quotes, where it separates fields, or twice
            comma = ": its comma may be a decimal or a thousands separator" if "," in cell else ""
            raise ValueError(f"{column} is {shown}, wanted a number like -12{decimal}5{comma}")
        if not math.isfinite(value):
            raise ValueError(f"{column} is {shown}, wanted a finite number")
        most = MOST_DEG if column.endswith("_deg") else MOST
        if not abs(value) <= most:
            raise ValueError(f"{column} is {shown}, wanted within +-{most:g}")
        found.append(value)
    return found


def target_rows(names: Iterable[str], values: Array) -> Iterator[list[str]]:
    """Yield the rows of targets (N, 6)."""
    for name, row in zip(names, values, strict=True):
        places_mm = (f"{each:.{MM_DECIMALS}f}" for each in row[:3])
        yield [name, *places_mm, *(f"{each:.{DEG_DECIMALS}f}" for each in row[3:])]


def as_listed(values: Array) -> Array:
    """Return targets (N, 6) as a reader of a list gets them, with its decimals."""
    return np.hstack([values[:, :3].round(MM_DECIMALS), values[:, 3:].round(DEG_DECIMALS)])


def write_rows(
    path: Path,
    header: list[str],
    rows: Iterable[list[str]],
    *,
    stamp: Stamp | None = None,
    inputs: Iterable[Path] = (),
) -> None:
    """Write a CSV; raises `NotWritten` as `write_whole` does."""
    write_whole(path, csv_of(header, rows, stamp), inputs=inputs)


def csv_of(header: list[str], rows: Iterable[list[str]], stamp: Stamp | None = None) -> bytes:
    """Return a CSV; a stamp is a column of its own."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    more = [] if stamp is None else [stamp.text]
    writer.writerow([*header, COLUMN] if more else header)
    writer.writerows([*row, *more] for row in rows)
    return text.getvalue().encode()
