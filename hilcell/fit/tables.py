"""Tables as people have them, as rows of text: CSV, XLSX, Parquet.

Of a workbook the first sheet is read. Untrusted: sizes are limited, document types are refused.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.targets import CsvText
from hilcell.ports import HilcellError

MOST_CELLS = 4_000_000
MOST_PART = 32_000_000  # bytes of a part of a workbook
# Of encrypted and of unknown archives.
NO_ARCHIVE = (zipfile.BadZipFile, NotImplementedError, RuntimeError, zlib.error, EOFError)
Rows = list[tuple[int, list[str]]]


class NotTable(ValueError):
    """A workbook that is not read."""


def read_table(path: Path) -> tuple[CsvText, str]:
    """The rows of a file, and its sheet, or ""; raises `SettingsError`."""
    content = read_file(path)
    try:
        if content.startswith(b"PK\x03\x04"):
            rows, sheet = _workbook(content)
            return CsvText.of_rows(rows), sheet
        if content.startswith(b"PAR1"):
            return CsvText.of_rows(_parquet(content)), ""
        if content.startswith(b"\xd0\xcf\x11\xe0"):
            raise NotTable("is a workbook of Excel 97; save it as .xlsx or CSV")
    except NotTable as error:
        raise SettingsError(str(path), [str(error)]) from error
    return CsvText.split(path, content), ""


def _parquet(content: bytes) -> Rows:
    try:
        from pyarrow import ArrowException, BufferReader, parquet
    except ImportError as error:
        raise HilcellError(
            f"fit: {error.name or error} is not installed, which reads Parquet; in a clone, run "
            "`pip install '.[study]'`",
            code="HC-D03",
        ) from error
    try:
        file = parquet.ParquetFile(BufferReader(content))
        _refuse_many(file.metadata.num_rows * file.metadata.num_columns)
        columns = file.read().to_pydict()
    except NotTable:
        raise
    except (ArrowException, OSError, ValueError) as error:
        raise NotTable(f"is not Parquet: {error}") from error
    names = [str(name) for name in columns]
    lines = zip(*columns.values(), strict=True)
    # NaN too is how tables of numbers say that there is none.
    texts = [["" if cell is None or cell != cell else str(cell) for cell in line] for line in lines]
    return [*enumerate([names, *texts], start=1)]


def _workbook(content: bytes) -> tuple[Rows, str]:
    """The rows of the first sheet, and its name with the count of sheets."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            sheets = [*_named(_part(archive, "xl/workbook.xml"), "sheet")]
            files = {
                each.get("Id"): each.get("Target", "")
                for each in _part(archive, "xl/_rels/workbook.xml.rels")
            }
            first = sheets[0]
            key = next(value for name, value in first.items() if name.endswith("}id"))
            file = files[key].removeprefix("/xl/")
            shared = []
            if "xl/sharedStrings.xml" in archive.namelist():
                shared = [
                    _text(each) for each in _named(_part(archive, "xl/sharedStrings.xml"), "si")
                ]
            rows = _rows(_part(archive, f"xl/{file}"), shared)
    except NotTable:
        raise
    except (*NO_ARCHIVE, ElementTree.ParseError, LookupError, StopIteration, ValueError) as error:
        raise NotTable(f"is not a workbook of .xlsx: {error}") from error
    name = first.get("name", "")
    return rows, f"sheet {name}" + (f", the first of {len(sheets)}" if len(sheets) > 1 else "")


def _refuse_many(cells: int) -> None:
    if cells > MOST_CELLS:
        raise NotTable(f"has {cells} cells, expected at most {MOST_CELLS}")


def _part(archive: zipfile.ZipFile, name: str) -> ElementTree.Element:
    with archive.open(name) as file:
        content = file.read(MOST_PART + 1)
    if len(content) > MOST_PART:
        raise NotTable(f"has more than {MOST_PART} bytes in {name}")
    if b"<!DOCTYPE" in content or b"\0" in content:  # the latter is UTF-16, which could hide one
        raise NotTable(f"has a document type in {name}, or is not UTF-8; entities are refused")
    return ElementTree.fromstring(content)  # noqa: S314 - without a document type no entities


def _named(element: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Elements of a name in any namespace: two forms of .xlsx differ by theirs."""
    return (each for each in element.iter() if each.tag.rpartition("}")[2] == name)


def _text(element: ElementTree.Element) -> str:
    return "".join(each.text or "" for each in _named(element, "t"))


def _rows(sheet: ElementTree.Element, shared: list[str]) -> Rows:
    rows: Rows = []
    for row in _named(sheet, "row"):
        line = int(row.get("r", rows[-1][0] + 1 if rows else 1))
        cells: list[str] = []
        for cell in _named(row, "c"):
            place = _place(cell.get("r", "")) if cell.get("r") else len(cells)
            cells += [""] * (place - len(cells)) + [_value(cell, shared)]
        rows.append((line, cells))
    # A line of one cell is a title.
    header = next((line for line, cells in rows if sum(map(bool, map(str.strip, cells))) > 1), 0)
    for merged in _named(sheet, "mergeCell"):
        corners = re.findall(r"[0-9]+", merged.get("ref", ""))
        if corners and int(corners[0]) <= header <= int(corners[-1]):
            raise NotTable(
                f"has merged cells in its header ({merged.get('ref')}); name each column in one row"
            )
    width = max((len(cells) for _, cells in rows), default=0)
    _refuse_many(width * len(rows))
    return [(line, cells + [""] * (width - len(cells))) for line, cells in rows]


def _place(reference: str) -> int:
    """The column, from 0, of a cell such as AB12."""
    place = 0
    for letter in reference.rstrip("0123456789"):
        place = 26 * place + ord(letter) - ord("A") + 1
    most_columns = 16384  # of .xlsx
    if not 1 <= place <= most_columns:
        raise NotTable(f"has a cell {reference!r}")
    return place - 1


def _value(cell: ElementTree.Element, shared: list[str]) -> str:
    kind = cell.get("t", "n")
    if kind == "inlineStr":
        return _text(cell)
    value = next((each.text or "" for each in _named(cell, "v")), "")
    if not value and next(_named(cell, "f"), None) is not None:
        raise NotTable(
            f"{cell.get('r')} is a formula without its result; open the file in a spreadsheet and "
            "save it"
        )
    return shared[int(value)] if kind == "s" else value
