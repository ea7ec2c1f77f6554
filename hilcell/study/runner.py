"""A study performed: cases that are not kept yet go to the workers, rows are kept as they come."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from hilcell.cell.settings import SettingsError
from hilcell.ports import Array
from hilcell.study.analysis import designs, value
from hilcell.study.case import CANNOT_BE, DONE, Found, Row, packed
from hilcell.study.design import Case, Point, cases, cases_at, generation, placed, places, shares_of
from hilcell.study.results import Results, row_of
from hilcell.study.study_file import Optimum, Study, cell_of

if TYPE_CHECKING:
    from hilcell.study.cluster import Workers


# Every point is measured on the same machines with the same targets, so differences between
# points are not those between draws, and the same point is never measured twice. A generation is
# asked for as a whole before the next is thought of: the search is the same with one worker or
# many, and one that goes on takes the path again through the points that are kept.

Measure = Callable[[Sequence[Point]], Mapping[int, float]]


class _SpentError(Exception):
    """All trials are used."""


def search(study: Study, wanted: Optimum, measure: Measure) -> None:
    """Ask ``measure`` for the values of points, by number, until the search ends."""
    from scipy.optimize import Bounds, differential_evolution

    known: dict[tuple[float, ...], float] = {}

    def values(found: Array) -> Array:
        asked = {shares_of(each): each for place in found.T for each in [placed(study, place)]}
        fresh = [shares for shares in asked if shares not in known]
        room = fresh[: wanted.trials - len(known)]
        points = [Point(n, asked[each]) for n, each in enumerate(room, start=len(known) + 1)]
        measured = measure(points) if points else {}
        known.update(zip(room, (measured[each.number] for each in points), strict=True))
        if len(room) < len(fresh):
            raise _SpentError
        return np.array([known[shares_of(placed(study, place))] for place in found.T])

    ends = [
        factor.span if factor.is_range else (0, len(factor.ends) - 1) for factor in study.factor
    ]
    of_generation: Callable[..., Any] = values  # scipy's types know no vectorized function
    try:
        differential_evolution(
            of_generation,
            Bounds([low for low, _ in ends], [high for _, high in ends]),
            integrality=[not each.is_range or each.is_whole for each in study.factor],
            init=np.array(places(study, generation(study, wanted))),
            rng=wanted.seed,
            maxiter=wanted.trials,
            tol=0.0,  # a share of the mean: points that are all too long would agree
            atol=1e-4,  # mm, the standard deviation of points that agree
            polish=False,
            vectorized=True,
            updating="deferred",
        )
    except _SpentError:
        return


NEVER = 1e9  # the value of a point that cannot be, or that failed on a machine


class Batch:
    """Rows that wait for their file, no longer than a second while others come."""

    def __init__(self, results: Results) -> None:
        self._results = results
        self._rows: list[Row] = []
        self._since_s = time.monotonic()

    def add(self, row: Row) -> None:
        self._rows.append(row)
        if len(self._rows) >= 64 or time.monotonic() - self._since_s >= 1.0:
            self.keep()

    def keep(self) -> None:
        rows, self._rows = self._rows, []
        self._results.add(rows)
        self._since_s = time.monotonic()


def perform(results: Results, workers: Workers, heard: Callable[[Row], object]) -> Counter[str]:
    """Measure every case that is not kept yet; return how many ended in which state.

    ``heard`` takes each row. Rows that came before an interruption are kept.
    """
    study, kept = results.study, results.finished()
    counts: Counter[str] = Counter()
    with ExitStack() as stack:
        batch = Batch(results)
        stack.callback(batch.keep)

        def measure(asked: Iterable[Case]) -> Iterator[Row]:
            """Yield the rows of cases that are not kept."""

            def keep(case: Case, found: Found) -> Row:
                row = row_of(case, found, study)
                batch.add(row)
                counts[row.state] += 1
                heard(row)
                return row

            never: list[Row] = []
            waiting = (case for case in asked if case.number not in kept)
            able = _able(study, waiting, lambda case, found: never.append(keep(case, found)))
            for case, found in workers.measure(able):
                yield keep(case, found)
            yield from never

        if study.optimise is None:
            for _ in measure(cases(study)):
                pass
        else:
            search(study, study.optimise, _values(results, study.optimise, measure))
    results.merge()
    return counts


def _values(
    results: Results, wanted: Optimum, measure: Callable[[Iterable[Case]], Iterator[Row]]
) -> Measure:
    """Return how an optimiser gets the values of points: of rows that are kept, or measured."""
    study = results.study
    kept: dict[int, list[Row]] = defaultdict(list)
    for row in results.rows():
        kept[row.point].append(row)

    def values(asked: Sequence[Point]) -> dict[int, float]:
        rows = {point.number: kept[point.number] for point in asked}
        for row in measure(case for point in asked for case in cases_at(study, point)):
            rows[row.point].append(row)
        return {number: value_of(own) for number, own in rows.items()}

    def value_of(rows: Sequence[Row]) -> float:
        if not all(row.state == DONE for row in rows):
            return NEVER
        in_order = sorted(rows, key=lambda row: row.case)  # digits of a mean depend on it
        (design,) = designs(study, in_order)
        return value(wanted, design)

    return values


def _able(
    study: Study, waiting: Iterable[Case], keep: Callable[[Case, Found], None]
) -> Iterator[tuple[Case, bytes]]:
    """Yield cases with their cells as they are asked for; keep those whose cell cannot be."""
    cells: dict[int, bytes] = {}  # of the last points: machines share them
    for case in waiting:
        number = case.point.number
        try:
            cell = cells.get(number) or packed(cell_of(study, case.point.values))
        except SettingsError as error:
            keep(case, Found(CANNOT_BE, str(error)))
        else:
            cells[number] = cell
            if len(cells) > 4096:  # of 6 kB each
                del cells[next(iter(cells))]
            yield case, cell
