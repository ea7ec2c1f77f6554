"""A study performed: cases that are not kept yet go to the workers, rows are kept as they come."""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.study.case import CANNOT_BE, Row
from hilcell.study.cluster import Workers
from hilcell.study.design import cases, points
from hilcell.study.results import Results, row_of
from hilcell.study.study_file import Study, cell_of

BATCH_ROWS, BATCH_S = 64, 1.0


class Batch:
    """Rows that wait for their file, no longer than ``BATCH_S`` while others come."""

    def __init__(self, results: Results) -> None:
        self._results = results
        self._rows: list[Row] = []
        self._since_s = time.monotonic()

    def add(self, row: Row) -> None:
        """Take a row."""
        self._rows.append(row)
        if len(self._rows) >= BATCH_ROWS or time.monotonic() - self._since_s >= BATCH_S:
            self.keep()

    def keep(self) -> None:
        """Write what waits."""
        rows, self._rows = self._rows, []
        self._results.add(rows)
        self._since_s = time.monotonic()


def perform(results: Results, workers: Workers, heard: Callable[[Row], object]) -> Counter[str]:
    """Measure every case that is not kept yet; return how many ended in which state.

    ``heard`` takes each row. Rows that came before an interruption are kept.
    """
    kept = results.finished()
    waiting = [case for case in cases(results.study) if case.number not in kept]
    cells, problems = cells_of(results.study)
    counts: Counter[str] = Counter()
    refused = (
        (case, {"state": CANNOT_BE, "reason": problems[case.point.number], "minutes": None})
        for case in waiting
        if case.point.number in problems
    )
    able = (case for case in waiting if case.point.number in cells)
    with _batch(results) as batch:
        for case, found in itertools.chain(refused, workers.measure(able, cells)):
            row = row_of(case, found, results.study)
            batch.add(row)
            counts[row["state"]] += 1
            heard(row)
    results.merge()
    return counts


def cells_of(study: Study) -> tuple[dict[int, Cell], dict[int, str]]:
    """Return the cells of points by their numbers, and of the others why there can be none."""
    cells: dict[int, Cell] = {}
    problems: dict[int, str] = {}
    for point in points(study):
        try:
            cells[point.number] = cell_of(study, point.values)
        except SettingsError as error:
            problems[point.number] = str(error)
    return cells, problems


@contextmanager
def _batch(results: Results) -> Iterator[Batch]:
    batch = Batch(results)
    try:
        yield batch
    finally:
        batch.keep()
