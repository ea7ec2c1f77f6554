"""A study performed: cases that are not kept yet go to the workers, rows are kept as they come."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from hilcell.cell.file import Cell
from hilcell.cell.settings import SettingsError
from hilcell.study.case import CANNOT_BE, Row
from hilcell.study.cluster import Workers
from hilcell.study.design import Case, cases
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
    study, kept = results.study, results.finished()
    counts: Counter[str] = Counter()
    with _batch(results) as batch:

        def keep(case: Case, found: Row) -> None:
            row = row_of(case, found, study)
            batch.add(row)
            counts[row["state"]] += 1
            heard(row)

        waiting = (case for case in cases(study) if case.number not in kept)
        for case, found in workers.measure(_able(study, waiting, keep)):
            keep(case, found)
    results.merge()
    return counts


def _able(
    study: Study, waiting: Iterable[Case], keep: Callable[[Case, Row], None]
) -> Iterator[tuple[Case, Cell]]:
    """Yield cases with their cells as they are asked for; keep those whose cell cannot be."""
    for case in waiting:
        try:
            cell = cell_of(study, case.point.values)
        except SettingsError as error:
            keep(case, {"state": CANNOT_BE, "reason": str(error), "minutes": None})
        else:
            yield case, cell


@contextmanager
def _batch(results: Results) -> Iterator[Batch]:
    batch = Batch(results)
    try:
        yield batch
    finally:
        batch.keep()
