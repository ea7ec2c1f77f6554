"""CSV files of named rows in {W}: strict reading of spreadsheets' forms, and atomic writing.

Targets are ``name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg`` with Z-Y-X angles. Python reads ``1_0`` as 10,
digits of any script, and ``nan`` as a number; all are refused here.

Written: commas, decimal points, UTF-8. Read also: semicolons and decimal commas, CP1252, a first
line ``sep=;``, trailing separators of empty columns. 1,234 may be 1.234 or 1234: one number of the
file that cannot be grouped thousands, such as 0,5 or 1234,5, decides for all; without one the file
is refused.

Corrected targets must not be corrected again: corrected lists have a column with a stamp, programs
a comment, and every reader of targets checks it first.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

import numpy as np

from hilcell.atomic_files import write_whole
from hilcell.cell.settings import SettingsError, read_file
from hilcell.ports import Array, HilcellError
from hilcell.sanitize import LONGEST, UNSAFE, clean

COLUMN = "corrected_by"
MARK = "hilcell: corrected by "


class CorrectedBefore(HilcellError):
    """Targets that have the stamp of a correction."""

    code = "HC-C10"


@dataclass(frozen=True, slots=True)
class Stamp:
    """The mark of corrected targets: the run or other source, UTC, and warnings."""

    by: str
    written: str
    station: str = ""
    simulated: bool = False
    remarks: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """One line, without commas."""
        at = f" for {self.station}" if self.station else ""
        parts = [f"{MARK}{self.by}{at} on {self.written}"]
        parts += ["SIMULATION"] if self.simulated else []
        return "; ".join(clean(each.replace(",", " ")) for each in (*parts, *self.remarks))


def refuse_corrected(source: str, texts: Iterable[str]) -> None:
    """Raise `CorrectedBefore` where one of the texts of a file is a stamp, or names its column."""
    stamp = ""
    for text in texts:
        if MARK.strip() in text:
            stamp = text[text.index(MARK.strip()) :]
            break
        if text.strip() == COLUMN:
            stamp = f"it has a column {COLUMN}"
    if stamp:
        raise CorrectedBefore(
            f"{source} was corrected before ({clean(stamp)}); a second correction would move "
            "every target by the error once more: give the nominal targets"
        )


MOST, MOST_DEG = 1e6, 1e4  # mm and whatever else, deg; beyond is a slip, and overflows
BOUND = "bound95_mm"
MM_DECIMALS, DEG_DECIMALS = 4, 6
NEAR_MM = 200.0  # from the origin are all points of a list in metres or inches
HEADER = ["name", "x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg"]
POINT = "."


@dataclass(frozen=True, slots=True)
class CsvText:
    """Rows as (line, fields), the header included, and the decimal sign of their numbers."""

    rows: list[tuple[int, list[str]]]
    separator: str = ","
    decimal: str = POINT

    @property
    def header(self) -> list[str]:
        return self.rows[0][1] if self.rows else []

    def matched_header(self, path: Path, headers: Sequence[list[str]]) -> list[str]:
        """The matching one of ``headers``; raises `SettingsError` naming other columns."""
        columns = [column for each in headers for column in each]
        header = [self._column_of(cell, columns) for cell in self.header]
        if header not in headers:
            expected = " or ".join(",".join(each) for each in headers)
            found, most = self.separator.join(self.header).replace("\t", "\\t"), 200
            found = found if len(found) <= most else f"{found[:most]}..."
            got = f"{found if self.rows else 'an empty file'}{self._differs(header, headers)}"
            raise SettingsError(str(path), [f"line 1: expected header {expected}, got {got}"])
        return header

    @staticmethod
    def _column_of(cell: str, columns: Iterable[str]) -> str:
        """Column of a header's field (``X``, ``x [mm]``: x_mm), else the field."""
        plain = cell.strip().casefold().replace("\u00b0", "deg")
        word = re.sub(r"\s*[\[(]\s*(\w+)\s*[\])]$", r"_\1", plain)  # a unit in brackets
        for each in columns:
            if word and word in (each, each.removesuffix("_mm").removesuffix("_deg")):
                return each
        return cell.strip()

    @staticmethod
    def _differs(header: list[str], headers: Sequence[list[str]]) -> str:
        """Difference of a header from the most similar one, as text."""
        if any("\t" in each for each in header):
            return "; its fields are separated by tabs: save it with commas or semicolons"
        expected = max(headers, key=lambda each: len({*each} & {*header}))
        missing = [each for each in expected if each not in header]
        unknown = [_shown(each) for each in header if each not in expected]
        words = [f"missing: {', '.join(missing)}"] if missing else []
        words += [f"unknown: {', '.join(unknown)}"] if unknown else []
        if not words:
            words = ["a column twice" if len(header) > len(expected) else "in another order"]
        return f" ({'; '.join(words)})" if any(header) else ""

    def surplus(self, count: int, expected: int) -> str:
        """Return the likely cause of more fields than expected, or ""."""
        if count > expected and self.separator == ",":
            return "; where a decimal comma has split numbers, separate fields by semicolons"
        return ""

    @classmethod
    def read(cls, path: Path, content: bytes, labels: int) -> Self:
        """Read a file with ``labels`` text columns before numbers; raises `SettingsError`."""
        return cls.split(path, content).with_decimal(path, lambda cells: cells[labels:])

    @classmethod
    def split(cls, path: Path, content: bytes) -> Self:
        """The rows of a CSV whose decimal sign is not known yet; raises `SettingsError`."""
        text = cls._text(path, content)
        first, _, others = text.partition("\n")
        stated = re.fullmatch(r'"?sep=([;,])"?', first.strip(), re.IGNORECASE)
        if stated:
            text = others
        separator = stated[1] if stated else ";" if ";" in first and "," not in first else ","
        try:
            reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
            rows = [(reader.line_num + bool(stated), cells) for cells in reader]
        except csv.Error as error:
            raise SettingsError(str(path), [f"cannot be read: {error}"]) from error
        return cls.of_rows(rows, separator)

    @classmethod
    def of_rows(cls, rows: list[tuple[int, list[str]]], separator: str = ",") -> Self:
        """The rows from the header on, without empty columns behind it."""
        begin = next((n for n, (_, cells) in enumerate(rows) if any(map(str.strip, cells))), 0)
        return cls(cls._without_empty_columns(rows[begin:]), separator)

    def with_decimal(self, path: Path, numbers_of: Callable[[list[str]], Iterable[str]]) -> Self:
        """The same with the sign that the numbers of its rows have; raises `SettingsError`."""
        if self.separator == ",":
            return self
        figures = (
            (line, cell.strip()) for line, cells in self.rows[1:] for cell in numbers_of(cells)
        )
        return replace(self, decimal=self._decimal(path, figures))

    @staticmethod
    def _without_empty_columns(rows: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
        """Rows without fields empty beyond the header's last; empty rows have none."""
        if not rows or not any(rows[0][1]):
            return rows
        width = 1 + max(n for n, cell in enumerate(rows[0][1]) if cell.strip())

        def needed(cells: list[str]) -> list[str]:
            if not any(cell.strip() for cell in cells):
                return []
            return cells if any(cell.strip() for cell in cells[width:]) else cells[:width]

        return [(line, needed(cells)) for line, cells in rows]

    @staticmethod
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

    @classmethod
    def _decimal(cls, path: Path, figures: Iterable[tuple[int, str]]) -> str:
        """Return the decimal sign of a file with semicolons; raises `SettingsError`."""
        grouped = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*", re.ASCII)  # or a decimal
        any_sign = re.compile(r"[+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?", re.ASCII)
        seen: dict[str, tuple[int, str]] = {}  # the first number with a sign
        proven: set[str] = set()
        for line, cell in figures:
            longest = 40  # characters of a number that is looked at
            number = len(cell) <= longest and any_sign.fullmatch(cell)
            signs = {POINT, ","} & {*cell} if number else set()
            if len(signs) > 1:
                raise cls._refusal(
                    path, line, cell, "has a thousands separator; write digits without one"
                )
            for sign in signs:
                seen.setdefault(sign, (line, cell))
                if not grouped.fullmatch(cell):
                    proven.add(sign)
        if len(seen) > 1:
            (line, cell), (other_line, other) = sorted(seen.values(), reverse=True)
            words = f"while line {other_line} has {other!r}; write all with one decimal sign"
            raise cls._refusal(path, line, cell, words)
        for sign, (line, cell) in seen.items():
            if sign not in proven:
                plain, whole = cell.replace(sign, POINT), cell.replace(sign, "")
                raise cls._refusal(
                    path, line, cell,
                    f"may be {plain}, or {whole} with a thousands separator, and no other number "
                    f"of the file says which; write one of them with another count of decimals, as "
                    f"{cell}0",
                )  # fmt: skip
        return next(iter(seen), POINT)

    @staticmethod
    def _refusal(path: Path, line: int, cell: str, words: str) -> SettingsError:
        return SettingsError(str(path), [f"line {line}: {cell[:40]!r} {words}"])


@dataclass(slots=True)
class NamedRows:
    """Rows of one file: ``header``, unique names (N), finite ``values`` (N) lists."""

    header: list[str]
    names: list[str] = field(default_factory=list)
    values: list[list[float]] = field(default_factory=list)

    def take(
        self,
        cells: list[str],
        text: CsvText,
        known: set[str],
        fault_of: Callable[[list[str], list[float]], str],
    ) -> list[str]:
        """Add one row, or return its faults; ``known``: the names of all rows before."""
        if len(cells) != len(self.header):
            more = text.surplus(len(cells), len(self.header))
            return [f"{len(cells)} fields, expected {len(self.header)}{more}"]
        name = cells[0]
        fault = f"name {_shown(name)} was used before" if name in known else self._name_fault(name)
        known.add(name)
        try:
            values = numbers(self.header[1:], cells[1:], text.decimal)
        except ValueError as error:
            return [*filter(None, [fault]), str(error)]
        self.names.append(name)
        self.values.append(values)
        return [*filter(None, (fault, fault_of(self.header, values)))]

    @staticmethod
    def _name_fault(name: str) -> str:
        """Fault of a name; joiners within it are letters' (Persian)."""
        if not name:
            return "name is empty"
        if len(name) > LONGEST:
            return f"name {_shown(name)} has {len(name)} characters, expected at most {LONGEST}"
        if name != name.strip():
            return f"name {_shown(name)} has outer spaces"
        within = re.sub("[\u200c\u200d]", "", name[1:-1])  # without joiners
        if found := UNSAFE.search(name[0] + within + name[1:][-1:]):
            return f"name {_shown(name)} has a control character, U+{ord(found[0]):04X}"
        if name[0] in "=+-@":
            return f"name {_shown(name)} begins with {name[0]}: a spreadsheet would compute it"
        return ""


def read_targets(path: Path) -> tuple[list[str], Array]:
    rows = read_named_rows(path, read_file(path), [HEADER], "targets")
    return rows.names, np.array(rows.values)


def unit_hint(points_mm: Array) -> str:
    """Text asking whether points (N, 3) are in another unit; "" where they cannot be."""
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
    """Rows of a CSV that has one of ``headers``: a name, then numbers.

    ``fault_of`` gives the fault of finite values, or "". Raises `SettingsError` with every problem
    and its line, and `CorrectedBefore`.
    """
    text = CsvText.read(path, content, labels=1)
    refuse_corrected(str(path), (cell for _, cells in text.rows for cell in cells))
    header = text.matched_header(path, headers)
    rows, known, problems = NamedRows(header), set[str](), list[str]()
    for line, cells in text.rows[1:]:
        if cells:
            faults = rows.take(cells, text, known, fault_of)
            problems += [f"line {line}: {fault}" for fault in faults]
    if not rows.names and not problems:
        problems.append(f"no {what}")
    if problems:
        raise SettingsError(str(path), problems)
    return rows


def _shown(text: str) -> str:
    shown = 40  # characters of a bad field
    return repr(text if len(text) <= shown else f"{text[:shown]}...")


def numbers(columns: Sequence[str], cells: Sequence[str], decimal: str = POINT) -> list[float]:
    """Finite numbers of plausible size; raises ValueError naming the column."""
    values = []
    for column, cell in zip(columns, cells, strict=True):
        shown = _shown(cell)
        try:
            plain = cell.replace(decimal, POINT)
            value = float(plain) if plain.isascii() and "_" not in plain else None
        except ValueError:
            value = None
        if value is None:  # a comma is refused in quotes, where it separates fields, or twice
            comma = ": its comma may be a decimal or a thousands separator" if "," in cell else ""
            raise ValueError(f"{column} is {shown}, expected a number like -12{decimal}5{comma}")
        if not math.isfinite(value):
            raise ValueError(f"{column} is {shown}, expected a finite number")
        most = MOST_DEG if column.endswith("_deg") else MOST
        if not abs(value) <= most:
            raise ValueError(f"{column} is {shown}, expected within +-{most:g}")
        values.append(value)
    return values


def target_rows(names: Iterable[str], values: Array) -> Iterator[list[str]]:
    for name, row in zip(names, values, strict=True):
        places_mm = (f"{each:.{MM_DECIMALS}f}" for each in row[:3])
        yield [name, *places_mm, *(f"{each:.{DEG_DECIMALS}f}" for each in row[3:])]


def as_listed(values: Array) -> Array:
    """Targets (N, 6) as a reader of a list gets them, with its decimals."""
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
    write_whole(path, csv_content(header, rows, stamp), inputs=inputs)


def csv_content(header: list[str], rows: Iterable[list[str]], stamp: Stamp | None = None) -> bytes:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    more = [] if stamp is None else [stamp.text]
    writer.writerow([*header, COLUMN] if more else header)
    writer.writerows([*row, *more] for row in rows)
    return text.getvalue().encode()
