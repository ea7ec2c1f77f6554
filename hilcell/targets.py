"""Targets CSV: ``name,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg`` in {W}, KUKA Z-Y-X angles."""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path

import numpy as np

from hilcell.ports import Array
from hilcell.settings import SettingsError

HEADER = ["name", "x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg"]


def read_targets(path: Path) -> tuple[list[str], Array]:
    """Return names and values (N, 6); raises `SettingsError` with every problem and its line."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SettingsError(str(path), [f"cannot be read: {error}"]) from error
    if not rows or [cell.strip() for cell in rows[0]] != HEADER:
        found = ",".join(rows[0]) if rows else "an empty file"
        raise SettingsError(str(path), [f"header must be {','.join(HEADER)}, found {found}"])
    problems: list[str] = []
    names: list[str] = []
    values: list[list[float]] = []
    for number, row in enumerate(rows[1:], start=2):
        if row:
            _take(row, number, names, values, problems)
    if not names and not problems:
        problems.append("no targets")
    if problems:
        raise SettingsError(str(path), problems)
    return names, np.array(values)


def _take(
    row: list[str], number: int, names: list[str], values: list[list[float]], problems: list[str]
) -> None:
    if len(row) != len(HEADER):
        problems.append(f"line {number}: {len(HEADER)} fields are wanted, found {len(row)}")
        return
    if row[0] in names:
        problems.append(f"line {number}: name {row[0]!r} was used before")
    try:
        numbers = [float(cell) for cell in row[1:]]
    except ValueError as error:
        problems.append(f"line {number}: {error}")
        return
    if not all(math.isfinite(each) for each in numbers):
        problems.append(f"line {number}: values must be finite")
    names.append(row[0])
    values.append(numbers)


def write_targets(path: Path, names: list[str], values: Array) -> None:
    """Write the file beside its place, then rename."""
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    with beside.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for name, row in zip(names, values, strict=True):
            lengths = [f"{each:.4f}" for each in row[:3]]
            writer.writerow([name, *lengths, *(f"{each:.6f}" for each in row[3:])])
    beside.replace(path)
