"""Where a command writes: a place that can be written, whose name does not contradict its form."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from hilcell.writing import NotWritten, check_place

CSV = (".csv", ".txt")
KNOWN = (
    ".csv", ".txt", ".xlsx", ".xls", ".ods", ".json", ".html", ".htm", ".pdf", ".src", ".dat",
    ".urdf", ".toml", ".sqlite", ".zip", ".xml", ".dcc", ".doc", ".docx", ".odt", ".rtf", ".md",
    ".xhtml", ".xlsm", ".xlsb", ".tsv", ".jsonl", ".png", ".jpg", ".jpeg", ".svg", ".db",
    ".script",
)  # fmt: skip


def check_output(
    path: Path, suffixes: tuple[str, ...], what: str, *, inputs: Iterable[Path] = ()
) -> None:
    """Raise `NotWritten` where a file cannot be written, or is named like one of another form.

    ``what`` is what is written, ``suffixes`` its own, the usual one first. Names without a suffix,
    or with one that no form has, are taken as they are.
    """
    check_place(path, inputs=inputs)
    suffix = path.suffix.lower()
    if suffix in KNOWN and suffix not in suffixes:
        raise NotWritten(
            f"{path} is a {suffix} file by its name, and {what} is written; name it "
            f"{path.with_suffix(suffixes[0]).name}"
        )
