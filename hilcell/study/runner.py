"""Execution of a study: workers simulate the missing cases, rows are stored as they come."""

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
from hilcell.study.case import CANNOT_BE, DONE, CaseResult, Row, encode_cell
from hilcell.study.design import (
    Case,
    Point,
    cases,
    cases_at,
    choices_at,
    generation,
    places,
    point_key,
)
from hilcell.study.results import Results, case_row
from hilcell.study.study_file import Optimum, Study, study_cell

if TYPE_CHECKING:
    from hilcell.study.cluster import Workers


# Every point is simulated on the same machines with the same targets, so points do not differ by
# their draws, and no point is simulated twice. A generation is evaluated as a whole, so the search
# does not depend on the number of workers, and a resumed one repeats its path through the stored
# points.

Measure = Callable[[Sequence[Point]], Mapping[int, float]]


class _TrialsUsed(Exception):
    """All trials are used."""


def search(study: Study, wanted: Optimum, measure: Measure) -> None:
    """Minimise the values that ``measure`` returns for points, by number."""
    from scipy.optimize import Bounds, differential_evolution

    known: dict[tuple[float, ...], float] = {}

    def values(generation: Array) -> Array:
        every = [choices_at(study, place) for place in generation.T]
        by_key = {point_key(each): each for each in every}
        new = [key for key in by_key if key not in known]
        allowed = new[: wanted.trials - len(known)]
        points = [Point(n, by_key[key]) for n, key in enumerate(allowed, start=len(known) + 1)]
        measured = measure(points) if points else {}
        known.update(zip(allowed, (measured[each.number] for each in points), strict=True))
        if len(allowed) < len(new):
            raise _TrialsUsed
        return np.array([known[point_key(each)] for each in every])

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
            tol=0.0,  # relative to the mean, which too long points make large
            atol=1e-4,  # mm, standard deviation of a converged generation
            polish=False,
            vectorized=True,
            updating="deferred",
        )
    except _TrialsUsed:
        return


IMPOSSIBLE = 1e9  # the value of a point that cannot be planned, or failed on a machine


class Batch:
    """Rows to be stored together: 64, or those of a second."""

    def __init__(self, results: Results) -> None:
        self._results = results
        self._rows: list[Row] = []
        self._since_s = time.monotonic()

    def add(self, row: Row) -> None:
        self._rows.append(row)
        if len(self._rows) >= 64 or time.monotonic() - self._since_s >= 1.0:
            self.store()

    def store(self) -> None:
        rows, self._rows = self._rows, []
        self._results.add(rows)
        self._since_s = time.monotonic()


def run_study(
    results: Results, workers: Workers, on_progress: Callable[[Row], object]
) -> Counter[str]:
    """Simulate all missing cases; return how many ended in each state.

    ``on_progress`` receives each row. Rows before an interruption are stored.
    """
    study, finished = results.study, results.finished()
    counts: Counter[str] = Counter()
    with ExitStack() as stack:
        batch = Batch(results)
        stack.callback(batch.store)

        def measure(requested: Iterable[Case]) -> Iterator[Row]:
            def store(case: Case, result: CaseResult) -> Row:
                row = case_row(case, result, study)
                batch.add(row)
                counts[row.state] += 1
                on_progress(row)
                return row

            impossible: list[Row] = []
            missing = (case for case in requested if case.number not in finished)
            valid = _with_cells(
                study, missing, lambda case, result: impossible.append(store(case, result))
            )
            for case, result in workers.measure(valid):
                yield store(case, result)
            yield from impossible

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
    """Return the objective of an optimiser, from stored rows and ``measure``."""
    study = results.study
    stored: dict[int, list[Row]] = defaultdict(list)
    for row in results.rows():
        stored[row.point].append(row)

    def values(points: Sequence[Point]) -> dict[int, float]:
        rows = {point.number: stored[point.number] for point in points}
        for row in measure(case for point in points for case in cases_at(study, point)):
            rows[row.point].append(row)
        return {number: point_value(own) for number, own in rows.items()}

    def point_value(rows: Sequence[Row]) -> float:
        if not all(row.state == DONE for row in rows):
            return IMPOSSIBLE
        in_order = sorted(rows, key=lambda row: row.case)  # digits of a mean depend on it
        (design,) = designs(study, in_order)
        return value(wanted, design)

    return values


def _with_cells(
    study: Study, cases: Iterable[Case], refuse: Callable[[Case, CaseResult], None]
) -> Iterator[tuple[Case, bytes]]:
    """Yield cases with their cells, lazily; ``refuse`` receives those with an invalid cell."""
    cells: dict[int, bytes] = {}  # of the last points, shared by their machines
    for case in cases:
        number = case.point.number
        try:
            cell = cells.get(number) or encode_cell(study_cell(study, case.point.values))
        except SettingsError as error:
            refuse(case, CaseResult(CANNOT_BE, str(error)))
        else:
            cells[number] = cell
            if len(cells) > 4096:  # of 6 kB each
                del cells[next(iter(cells))]
            yield case, cell
