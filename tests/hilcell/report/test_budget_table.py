"""The budget as one table: two measurands, each with its own sum and shares."""

import math

import numpy as np
import pytest

from hilcell.calibration.influence import ASSUMED, MEASURED, Bounds, Part
from hilcell.calibration.measurement_budget import budget_of
from hilcell.report.budget_table import (
    ERROR_SUM,
    ROWS,
    TARGET_SUM,
    budget_sheet,
    error_rows,
    target_rows,
)
from hilcell.report.facts import read_facts
from hilcell.report.target_budget import target_budget
from tests.whole.golden import GoldenRuns


def part(name: str, source: str, clause: str, variances_mm2: tuple[float, float, float]) -> Part:
    return Part(name, source, "how", clause, np.diag(variances_mm2)[None], math.inf)


def test_each_measurand_ends_with_its_sum(golden: GoldenRuns) -> None:
    facts = read_facts(golden["small"].folder)
    budget, targets = budget_of(facts.log), target_budget(facts.log, facts.run)
    found = budget_sheet(budget, targets)
    assert found is not None
    assert found.headers == [column.header for column in ROWS]
    sources = [row[0] for row in found.rows]
    half = sources.index(ERROR_SUM) + 1
    assert sources[-1] == TARGET_SUM
    for rows in (found.rows[:half], found.rows[half:]):
        *lines, last = rows
        assert sum(float(row[-1]) for row in lines) == pytest.approx(100.0, abs=0.05 * len(rows))
        root_mm = math.sqrt(sum(float(row[-2]) ** 2 for row in lines))
        assert float(last[-2]) == pytest.approx(root_mm, abs=2e-4)
        assert last[-1] == "100.0"
    assert budget is not None
    assert sum(row.percent for row in error_rows(budget)) == pytest.approx(100.0)


def test_an_estimate_divided_gives_u() -> None:
    everywhere, one = target_rows(
        Bounds([part("a", ASSUMED, "4.3.7", (3e-4, 3e-4, 3e-4)),
                part("b", MEASURED, "4.2.2", (3e-4, 0.0, 0.0))])
    )  # fmt: skip
    assert (everywhere.kind, everywhere.along, everywhere.divisor) == (
        "B, rectangular",
        "x, y, z",
        "√3",
    )
    assert everywhere.estimate == "±0.0300"
    assert everywhere.u_mm == pytest.approx(0.03 / math.sqrt(3))
    assert (one.kind, one.along, one.divisor) == ("A, normal", "one", "1")
    assert one.u_mm == pytest.approx(0.01), "of the three coordinates, root mean square"
    assert one.estimate == "0.0173"
    assert (everywhere.percent, one.percent) == pytest.approx((75.0, 25.0))
