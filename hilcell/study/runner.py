"""Execution of a study: workers simulate the missing cases, rows are stored as they come.

Every point is simulated on the same machines with the same targets, so points do not differ by
their draws, and no point is simulated twice. An optimiser evaluates a generation as a whole, so its
search does not depend on the number of workers, and a resumed one repeats its path through the
stored points.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hilcell.cell.settings import SettingsError
from hilcell.ports import Array, HilcellError
from hilcell.study.analysis import designs, value
from hilcell.study.case import CANNOT_BE, DONE, CaseResult, Row, encode_cell, planned
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


class _TrialsUsed(Exception):
    """All trials are used."""


def run_study(
    results: Results, workers: Workers, on_progress: Callable[[Row], object]
) -> Counter[str]:
    """Simulate all missing cases; return how many ended in each state.

    ``on_progress`` receives each row. Rows before an interruption are stored.
    """
    run = _Execution(results, workers, on_progress)
    try:
        if results.study.optimise is None:
            for _ in run.measure(cases(results.study)):
                pass
        else:
            run.search(results.study.optimise)
    finally:
        run.store()
    results.merge()
    return run.counts


class PointPlan(NamedTuple):
    """Minutes of robot and people of a point's cases, or why they cannot be."""

    minutes: float | None
    cannot_be: str = ""

    @property
    def shown_minutes(self) -> float | str:
        return CANNOT_BE if self.minutes is None else self.minutes


def plan_of(study: Study, point: Point) -> PointPlan:
    """Plan a point's calibration for each set of targets; all machines share it."""
    try:
        cell = encode_cell(study_cell(study, point.values))
        plans = [planned(cell, seed)[1] for seed in range(1, study.seeds + 1)]
    except HilcellError as error:
        return PointPlan(None, str(error))
    return PointPlan(max(each.duration_s for each in plans) / 60.0 + point.minutes)


class _Execution:
    def __init__(
        self, results: Results, workers: Workers, on_progress: Callable[[Row], object]
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._results, self._workers, self._on_progress = results, workers, on_progress
        self._study, self._finished = results.study, results.finished()
        self._rows: list[Row] = []  # to be stored together: 64, or those of a second
        self._since_s = time.monotonic()

    def store(self) -> None:
        rows, self._rows = self._rows, []
        self._results.add(rows)
        self._since_s = time.monotonic()

    def measure(self, requested: Iterable[Case]) -> Iterator[Row]:
        """Yield the rows of cases that are not stored yet."""
        impossible: list[Row] = []
        missing = (case for case in requested if case.number not in self._finished)
        for case, result in self._workers.measure(self._with_cells(missing, impossible)):
            yield self._add(case, result)
        yield from impossible

    def search(self, wanted: Optimum) -> None:
        """Minimise the value of points."""
        from scipy.optimize import Bounds, differential_evolution

        study, known = self._study, dict[tuple[float, ...], float]()
        rows: dict[int, list[Row]] = defaultdict(list)
        for row in self._results.rows():
            rows[row.point].append(row)

        def values(generation: Array) -> Array:
            every = [choices_at(study, place) for place in generation.T]
            by_key = {point_key(each): each for each in every}
            new = [key for key in by_key if key not in known]
            allowed = new[: wanted.trials - len(known)]
            points = [Point(n, by_key[key]) for n, key in enumerate(allowed, start=len(known) + 1)]
            for row in self.measure(case for each in points for case in cases_at(study, each)):
                rows[row.point].append(row)
            found = [self._value(wanted, rows[each.number]) for each in points]
            known.update(zip(allowed, found, strict=True))
            if len(allowed) < len(new):
                raise _TrialsUsed
            return np.array([known[point_key(each)] for each in every])

        ends = [each.span if each.is_range else (0, len(each.ends) - 1) for each in study.factor]
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

    def _value(self, wanted: Optimum, rows: Sequence[Row]) -> float:
        if not all(row.state == DONE for row in rows):
            return 1e9  # it cannot be planned, or failed on a machine
        in_order = sorted(rows, key=lambda row: row.case)  # digits of a mean depend on it
        (design,) = designs(self._study, in_order)
        return value(wanted, design)

    def _add(self, case: Case, result: CaseResult) -> Row:
        row = case_row(case, result, self._study)
        self._rows.append(row)
        if len(self._rows) >= 64 or time.monotonic() - self._since_s >= 1.0:
            self.store()
        self.counts[row.state] += 1
        self._on_progress(row)
        return row

    def _with_cells(
        self, cases: Iterable[Case], impossible: list[Row]
    ) -> Iterator[tuple[Case, bytes]]:
        """Yield cases with their cells, lazily; the rows of invalid cells are ``impossible``."""
        cells: dict[int, bytes] = {}  # of the last points, shared by their machines
        for case in cases:
            number = case.point.number
            try:
                cell = cells.get(number) or encode_cell(study_cell(self._study, case.point.values))
            except SettingsError as error:
                impossible.append(self._add(case, CaseResult(CANNOT_BE, str(error))))
            else:
                cells[number] = cell
                if len(cells) > 4096:  # of 6 kB each
                    del cells[next(iter(cells))]
                yield case, cell
