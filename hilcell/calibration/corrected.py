"""Corrected targets are known again by their points, where their stamp was lost.

A spreadsheet drops the column with the stamp, a controller strips comments from a program; a second
correction would then take the error off twice. So each correction leaves its points in the folder
of the run whose calibration it used, and targets that stand at such points are refused. For a
calibration that lies alone the folder of runs itself keeps them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilcell.compensation.stamp import CorrectedBefore
from hilcell.errors import bounded
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.runs import is_run, run_folders
from hilcell.ports import Array

NAME = "corrected.csv"
SAME_MM = 0.009  # numbers may have been rounded, to two decimals
FAR = 4.0  # times that a correction moves a point: one that hardly moved is its nominal target


def memory_of(runs: Path, calibration: Path) -> Path | None:
    """Return the folder that keeps what is corrected by the file of a calibration, if there is one.

    It is that of the run that the file is in, else the folder of runs.
    """
    folder = calibration.resolve().parent
    if is_run(folder):
        return folder
    return runs if runs.is_dir() else None


def memories(runs: Path, calibration: Path) -> list[Path]:
    """Return all folders that may keep corrected points, in ``runs`` and beside a calibration's.

    Raises `StorageError`.
    """
    folder = calibration.resolve().parent
    places = dict.fromkeys([runs.resolve(), *([folder.parent] if is_run(folder) else [])])
    return [each for place in places for each in (place, *run_folders(place))]


def note_corrected(folder: Path, stamp: str, nominal_mm: Array, command_mm: Array) -> None:
    """Keep corrected points (N, 3), and how far each was moved; raises `OSError`."""
    moved_mm = lengths_mm(command_mm - nominal_mm)
    rows = np.column_stack([command_mm, moved_mm])[moved_mm >= FAR * SAME_MM]
    with (folder / NAME).open("a", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(
            [stamp, *(f"{value:.4f}" for value in row)] for row in rows.tolist()
        )


def refuse_known(
    folders: Iterable[Path], source: str, names: list[str], *targets_mm: Array
) -> None:
    """Raise `CorrectedBefore` where targets are the output of a correction.

    ``targets_mm`` (N, 3) are the same targets in each frame that they may have been corrected in.
    """
    for folder in folders:
        stamps, known = _noted(folder / NAME)
        for places_mm in targets_mm if stamps else ():
            same, nearest = _same(known, places_mm)
            if not same.any():
                continue
            which = ", ".join(bounded([names[n] for n in np.flatnonzero(same)]))
            raise CorrectedBefore(
                f"{source}: {int(same.sum())} of {len(places_mm)} targets are corrected ones "
                f"({which}; {stamps[int(nearest[int(np.argmax(same))])]}), whose stamp was lost; a "
                "second correction would move them by the error once more: give the nominal targets"
            )


def _same(known: Array, places_mm: Array) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return which of places (N, 3) are known points (K, 4), and the number of the nearest."""
    from scipy.spatial import KDTree  # loads long, and few folders have corrected anything

    found = KDTree(known[:, :3]).query(places_mm)
    same, nearest = np.asarray(found[0]) <= SAME_MM, np.asarray(found[1])
    rounded_mm = 0.09  # or to one: then most of a list stands at points of before
    far = np.flatnonzero(known[:, 3] >= FAR * rounded_mm)
    if not same.any() and len(far):
        off_mm, nearest_far = KDTree(known[far, :3]).query(places_mm)
        rounded = np.asarray(off_mm) <= rounded_mm
        if rounded.mean() >= 0.5:
            return rounded, far[np.asarray(nearest_far)]
    return same, nearest


def _noted(file: Path) -> tuple[list[str], Array]:
    """Return the stamps and points with their moves (N, 4) of a file.

    Lines that a crash has cut count for none.
    """
    if not file.is_file():
        return [], np.empty((0, 4))
    found = list(_points(file))
    return [stamp for stamp, _ in found], np.array([row for _, row in found]).reshape(-1, 4)


def _points(file: Path) -> Iterator[tuple[str, list[float]]]:
    with file.open(encoding="utf-8", errors="replace", newline="") as lines:
        for row in csv.reader(lines):
            if len(row) != 5:
                continue
            try:
                numbers = [float(value) for value in row[1:]]
            except ValueError:
                continue
            if np.isfinite(numbers).all():
                yield row[0], numbers
