"""CSV files of named rows in {W}: strict reading, whole writing.

Targets are ``name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg`` with Z-Y-X angles. Python
takes ``1_0`` for 10, digits of any script, and ``nan`` for a number; all are refused here. So is a
list that was corrected before: it has a stamp in a column of its own.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hilcell.cell.settings import SettingsError, unreadable
from hilcell.clean import clean
from hilcell.compensation.stamp import COLUMN, Stamp, refuse_corrected
from hilcell.ports import Array
from hilcell.writing import write_whole

MOST, MOST_DEG = 1e6, 1e4  # mm and whatever else, deg; beyond is a slip, and overflows
SHOWN = 40  # characters of a bad field
HEADER = ["name", "x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg"]


@dataclass(slots=True)
class NamedRows:
    """Rows of one file: ``header``, names (N) that differ, finite ``values`` (N) lists."""

    header: list[str]
    names: list[str] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)


def read_targets(path: Path) -> tuple[list[str], Array]:
    """Return names and values (N, 6); raises as `read_named_rows` does."""
    rows = read_named_rows(path, [HEADER], "targets")
    return rows.names, np.array(rows.values)


def read_named_rows(
    path: Path,
    headers: Sequence[list[str]],
    what: str,
    fault_of: Callable[[list[str], list[float]], str] = lambda header, values: "",
) -> NamedRows:
    """Return the rows of a CSV that has one of ``headers``: a name, then numbers.

    ``fault_of`` says in words what is wrong with finite values, or nothing. Raises
    `SettingsError` with every problem and its line, and `CorrectedBefore`.
    """
    lines = _lines(path)
    refuse_corrected(str(path), (cell for cells in lines for cell in cells))
    header = [cell.strip() for cell in lines[0]] if lines else []
    if header not in headers:
        wanted = " or ".join(",".join(each) for each in headers)
        found = ",".join(lines[0]) if lines else "an empty file"
        raise SettingsError(str(path), [f"header must be {wanted}, found {found}"])
    rows, known, problems = NamedRows(header), set[str](), list[str]()
    for number, cells in enumerate(lines[1:], start=2):
        if cells:
            faults = _take(cells, rows, known, fault_of)
            problems += [f"line {number}: {fault}" for fault in faults]
    if not rows.names and not problems:
        problems.append(f"no {what}")
    if problems:
        raise SettingsError(str(path), problems)
    return rows


def _lines(path: Path) -> list[list[str]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise unreadable(str(path), error) from error


def _take(
    cells: list[str],
    rows: NamedRows,
    known: set[str],
    fault_of: Callable[[list[str], list[float]], str],
) -> list[str]:
    """Add one line to ``rows``; return what is wrong with it."""
    if len(cells) != len(rows.header):
        return [f"{len(rows.header)} fields are wanted, found {len(cells)}"]
    name, faults = cells[0], []
    if name in known:
        faults.append(f"name {name!r} was used before")
    elif not name or name != clean(name):
        faults.append(f"name {name!r} is empty, too long, or has outer spaces or controls")
    known.add(name)
    try:
        values = numbers(rows.header[1:], cells[1:])
    except ValueError as error:
        return [*faults, str(error)]
    fault = fault_of(rows.header, values)
    faults += [fault] if fault else []
    rows.names.append(name)
    rows.values.append(values)
    return faults


def numbers(columns: Sequence[str], cells: Sequence[str]) -> list[float]:
    """Return plain finite numbers of sane size; raises ValueError naming the column."""
    return [_number(column, cell) for column, cell in zip(columns, cells, strict=True)]


def _number(column: str, cell: str) -> float:
    shown = repr(cell if len(cell) <= SHOWN else f"{cell[:SHOWN]}...")
    try:
        value = float(cell) if cell.isascii() and "_" not in cell else None
    except ValueError:
        value = None
    if value is None:
        raise ValueError(f"{column} is {shown}, wanted a number like -12.5")
    if not math.isfinite(value):
        raise ValueError(f"{column} is {shown}, wanted a finite number")
    most = MOST_DEG if column.endswith("_deg") else MOST
    if not abs(value) <= most:
        raise ValueError(f"{column} is {shown}, wanted within +-{most:g}")
    return value


def write_targets(
    path: Path,
    names: list[str],
    values: Array,
    *,
    stamp: Stamp | None = None,
    inputs: Iterable[Path] = (),
) -> None:
    """Write targets (N, 6), corrected ones with their stamp; raises `NotWritten`."""
    write_rows(path, HEADER, target_rows(names, values), stamp=stamp, inputs=inputs)


def target_rows(names: Iterable[str], values: Array) -> Iterator[list[str]]:
    """Yield the rows of targets (N, 6)."""
    for name, row in zip(names, values, strict=True):
        yield [name, *(f"{each:.4f}" for each in row[:3]), *(f"{each:.6f}" for each in row[3:])]


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
