"""Measured targets of ``hilcell fit``, and their lists.

Measurements need commanded joints: those read back from a moving robot spoil a fit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hilcell.cell.settings import SettingsError, read_file
from hilcell.compensation.targets import CsvText, numbers
from hilcell.geometry.kinematics import Array

HEADER = ["pose", "target", *(f"j{n}_deg" for n in range(1, 7)), "x_mm", "y_mm", "z_mm"]
LABELS = 2


@dataclass(frozen=True, eq=False)
class Measurements:
    """N measured targets: labels, joints (N, 6) in rad, positions (N, 3) in the tracker's frame.

    Messages name the rows by ``source``, a file, and by their ``lines`` (N) in it.
    """

    pose: list[str]
    target: list[str]
    joints_rad: Array
    xyz_mm: Array
    source: str = "the measurements"
    lines: Sequence[int] = ()

    @classmethod
    def from_arrays(
        cls,
        joints_rad: ArrayLike,
        xyz_mm: ArrayLike,
        target: str | Sequence[str] = "SMR",
        pose: Sequence[str] | None = None,
    ) -> Self:
        """Measurements from arrays: commanded joints (N, 6), positions (N, 3).

        ``target`` names the reflector of all rows, or of each; ``pose`` (N) labels rows measured in
        one pose, each its own by default. Raises `ValueError`.
        """
        joints, xyz = np.array(joints_rad, dtype=float), np.array(xyz_mm, dtype=float)
        for name, values, width in (("joints_rad", joints, 6), ("xyz_mm", xyz, 3)):
            if values.shape != (len(joints), width) or not np.isfinite(values).all():
                raise ValueError(
                    f"{name}: expected finite numbers ({len(joints)}, {width}), got shape "
                    f"{values.shape}"
                )
        targets = [target] * len(joints) if isinstance(target, str) else list(target)
        poses = list(map(str, range(1, len(joints) + 1))) if pose is None else list(pose)
        for name, labels in (("target", targets), ("pose", poses)):
            if len(labels) != len(joints):
                raise ValueError(f"{name}: expected {len(joints)} labels, got {len(labels)}")
        return cls(poses, targets, joints, xyz)

    @classmethod
    def unmeasured(cls, joints_rad: Array, target: str) -> Self:
        """Rows of a reflector at joints (N, 6) whose positions are to be predicted."""
        labels = list(map(str, range(len(joints_rad))))
        return cls(labels, [target] * len(labels), joints_rad, np.full((len(labels), 3), np.nan))

    def __len__(self) -> int:
        return len(self.pose)

    def where(self, rows: Iterable[int]) -> str:
        lines = sorted(self.lines[n] for n in rows) if self.lines else []
        if not lines:
            return self.source
        named = 5
        listed = ", ".join(map(str, lines[:named])) + ", .." * (len(lines) > named)
        return f"{self.source} line{'s' * (len(lines) > 1)} {listed}"

    def of(self, target: str) -> list[int]:
        return [n for n, each in enumerate(self.target) if each == target]

    def once(self) -> Measurements:
        """The rows without duplicates: no reading repeats joints and position exactly."""
        values = np.column_stack([self.joints_rad, self.xyz_mm]).tolist()
        first: dict[tuple[object, ...], int] = {}
        for n, (target, row) in enumerate(zip(self.target, values, strict=True)):
            first.setdefault((target, *row), n)
        return self.at(first.values())

    def at(self, rows: Iterable[int]) -> Measurements:
        chosen = list(rows)
        return Measurements(
            [self.pose[n] for n in chosen],
            [self.target[n] for n in chosen],
            self.joints_rad[chosen],
            self.xyz_mm[chosen],
            self.source,
            [self.lines[n] for n in chosen] if self.lines else (),
        )


def read_measurements(path: Path | str) -> Measurements:
    """Read measured targets, the CSV of ``hilcell fit --train``.

    Columns: pose, target, j1_deg .. j6_deg as commanded, x_mm, y_mm, z_mm in the tracker's frame.
    Raises `SettingsError` naming the invalid lines.
    """
    path = Path(path)
    text = CsvText.read(path, read_file(path), LABELS)
    text.matched_header(path, [HEADER])
    problems: list[str] = []
    labels, rows, lines = [], [], []
    for line, cells in text.rows[1:]:
        if not cells:
            continue
        try:
            rows.append(_numbers(cells, text))
            labels.append([cell.strip() for cell in cells[:LABELS]])
            lines.append(line)
        except ValueError as error:
            problems.append(f"line {line}: {error}")
    if not (labels or problems):
        problems.append("no measured target follows the header")
    if problems:
        raise SettingsError(str(path), problems)
    poses, targets = map(list, zip(*labels, strict=True))
    values = np.array(rows)
    joints_rad = np.radians(values[:, :6])
    return Measurements(poses, targets, joints_rad, values[:, 6:], str(path), lines)


def _numbers(cells: list[str], text: CsvText) -> list[float]:
    if len(cells) != len(HEADER):
        more = text.surplus(len(cells), len(HEADER))
        raise ValueError(f"{len(cells)} fields, expected {len(HEADER)}{more}")
    for name, cell in zip(HEADER[:LABELS], cells, strict=False):
        if not cell.strip():
            raise ValueError(f"{name} is empty")
    return numbers(HEADER[LABELS:], cells[LABELS:], text.decimal)
