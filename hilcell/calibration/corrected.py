"""Corrected targets are known again by their points, where their stamp was lost.

A spreadsheet drops the column with the stamp, a controller strips comments from a program; a second
correction would then take the error off twice. So each correction leaves its points in the folder
of the run whose calibration it used, and targets that stand at such points are refused.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hilcell.compensation.stamp import CorrectedBefore
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.runs import run_folders
from hilcell.ports import Array

NAME = "corrected.csv"
SAME_MM = 0.009  # numbers may have been rounded, to two decimals at least
LEAST_MM = 4.0 * SAME_MM  # of a correction: a point that hardly moved is its nominal target as well
MOST_BY_CHANCE = 1  # of targets at places of before, where they are not half of them or more


def note_corrected(folder: Path, stamp: str, nominal_mm: Array, command_mm: Array) -> None:
    """Keep corrected points (N, 3) in {W} in a run's folder; raises `OSError`."""
    moved = lengths_mm(command_mm - nominal_mm) >= LEAST_MM
    with (folder / NAME).open("a", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(
            [stamp, *(f"{value:.4f}" for value in point)] for point in command_mm[moved].tolist()
        )


def refuse_known(runs: Path, source: str, targets_mm: Array) -> None:
    """Raise `CorrectedBefore` where targets (N, 3) in {W} are the output of a correction."""
    for folder in run_folders(runs):
        stamps, known_mm = _noted(folder / NAME)
        if not stamps or not len(targets_mm):
            continue
        from scipy.spatial import KDTree  # loads long, and few folders have corrected anything

        found = KDTree(known_mm).query(targets_mm)
        same, nearest = np.asarray(found[0]) <= SAME_MM, np.asarray(found[1])
        if same.sum() > MOST_BY_CHANCE or same.mean() >= 0.5:
            stamp = stamps[int(nearest[int(np.argmax(same))])]
            raise CorrectedBefore(
                f"{source}: {int(same.sum())} of {len(targets_mm)} targets are corrected ones "
                f"({stamp}), whose stamp was lost; a second correction would move every target by "
                "the error once more: give the nominal targets"
            )


def _noted(file: Path) -> tuple[list[str], Array]:
    """Return the stamps and points (N, 3) of a file; lines that a crash has cut count for none."""
    if not file.is_file():
        return [], np.empty((0, 3))
    found = list(_points(file))
    return [stamp for stamp, _ in found], np.array([point for _, point in found]).reshape(-1, 3)


def _points(file: Path) -> Iterator[tuple[str, list[float]]]:
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        for row in csv.reader(lines):
            if len(row) != 4:
                continue
            try:
                point = [float(value) for value in row[1:]]
            except ValueError:
                continue
            if np.isfinite(point).all():
                yield row[0], point
