"""Which contributions a journal proves, with figures worked out by hand."""

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.influence import ASSUMED, MEASURED, Bounds, Part
from hilcell.calibration.measurement_budget import NOISE, Contribution, measurement_budget
from hilcell.calibration.position_errors import Errors
from hilcell.cell.file import load_cell
from hilcell.model.point import PointId
from hilcell.report.budgets import (
    ERROR_SUM,
    ROWS,
    TARGET_SUM,
    budget_table,
    error_rows,
    mean_table,
    target_budget,
    target_rows,
)
from hilcell.report.facts import read_facts
from tests.hilcell.report.journals import BEFORE_MM, Writer
from tests.whole.golden import GoldenRuns


def lines_of(writer: Writer) -> dict[str, Contribution]:
    """Return the lines of a run's budget by name."""
    budget = measurement_budget(writer.facts().log)
    assert budget is not None
    assert budget.U_mm == pytest.approx(2 * budget.u_mm)
    assert budget.u_mm == pytest.approx(math.sqrt(sum(each.u_mm**2 for each in budget.lines)))
    return {each.name: each for each in budget.lines}


def test_nothing_measured_gives_no_budget(tmp_path: Path) -> None:
    assert measurement_budget(Writer(tmp_path / "none").began().facts().log) is None


def test_what_is_not_measured_is_a_stated_assumption(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "few").began()
    writer.point(PointId("world", nest="F1"), (0, 0, 0))
    lines = lines_of(writer)
    noise, drift, thermal = "Tracker, reading noise", "Drift", "Thermal expansion"
    assert set(lines) == {noise, "Tracker, systematic", "SMR centring", drift, thermal}
    assert lines[noise].source == MEASURED
    assert lines[noise].u_mm == pytest.approx(0.01)
    assert lines[drift].source == ASSUMED
    assert lines[thermal].u_mm == 0.0  # one temperature only


def test_a_limit_from_a_certificate_names_it(tmp_path: Path) -> None:
    cell = msgspec.to_builtins(load_cell("paper"))
    cell["uncertainty"] |= {"tracker_dcc": "t.xml#errors", "tracker_certificate": "TC-1"}
    writer = Writer(tmp_path / "r", cell=cell).began()
    writer.validated("S1100", "before", BEFORE_MM)
    lines = lines_of(writer)
    assert lines["Tracker, systematic"].source == "certificate TC-1"
    assert lines["SMR centring"].source == "stated assumption"


def test_drift_is_what_the_floor_nests_moved(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "drift").began()
    writer.point(PointId("world", nest="F1"), (1000, 0, 0))
    for turn, at_mm in enumerate(((1000.03, 0, 0), (1000, 0.03, 0)), start=1):
        writer.point(PointId("control", session=1, pass_number=turn, nest="F1"), at_mm)
    drift = lines_of(writer)["Drift"]
    assert drift.source == MEASURED
    noise_mm2 = 2 * 0.01**2  # of both readings: it is a line of its own
    assert drift.u_mm == pytest.approx(math.sqrt(0.03**2 / 3 - noise_mm2))


def test_thermal_from_the_range_of_temperatures(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "warm").began()
    writer.point(PointId("world", nest="F1"), (0, 0, 0), temperature_c=21.0)
    writer.point(PointId("world", nest="F2"), (2000, 0, 0), temperature_c=23.0)
    thermal = lines_of(writer)["Thermal expansion"]
    assert thermal.estimate_mm == pytest.approx(0.023)
    assert thermal.u_mm == pytest.approx(0.023 / math.sqrt(3))


def part(name: str, source: str, clause: str, variances_mm2: tuple[float, float, float]) -> Part:
    return Part(name, source, "how", clause, np.diag(variances_mm2)[None], math.inf)


def test_each_measurand_ends_with_its_sum(golden: GoldenRuns) -> None:
    facts = read_facts(golden["small"].folder)
    budget, targets = measurement_budget(facts.log), target_budget(facts.log, facts.run)
    found = budget_table(budget, targets)
    assert found.headers == [column.header for column in ROWS]
    sources = [row[0] for row in found.texts()]
    half = sources.index(ERROR_SUM) + 1
    assert sources[-1] == TARGET_SUM
    for rows in (found.texts()[:half], found.texts()[half:]):
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
    stated = (everywhere.kind, everywhere.along, everywhere.divisor)
    assert stated == ("B, rectangular", "x, y, z", "√3")
    assert everywhere.estimate == "±0.0300"
    assert everywhere.u_mm == pytest.approx(0.03 / math.sqrt(3))
    assert (one.kind, one.along, one.divisor) == ("A, normal", "one", "1")
    assert one.u_mm == pytest.approx(0.01), "of the three coordinates, root mean square"
    assert one.estimate == "0.0173"
    assert (everywhere.percent, one.percent) == pytest.approx((75.0, 25.0))


def test_the_mean_s_table_says_what_averages_and_what_stays(tmp_path: Path) -> None:
    budget = measurement_budget(Writer(tmp_path / "r").began().nests_read().facts().log)
    assert budget is not None
    few = Errors(np.zeros((4, 3)), np.tile([5.0, 0.0, 0.0], (4, 1)))
    table = mean_table(budget, {"S300": few, "others": replace(few, error_mm=few.error_mm * 2)})
    then_mm = {name: then for name, *_, then in table.rows}
    lines = {line.name: line for line in budget.lines if line.u_mm}
    assert set(then_mm) == set(lines)
    whole_mm = budget.of_mean(few.error_mm)
    for name, line in lines.items():
        share = 1 / 4 if name == NOISE else 1.0  # of the variance that is in a mean of 4
        wanted_mm2 = whole_mm**2 - 4 * share * 0.75 * line.u_mm**2
        assert then_mm[name] == pytest.approx(math.sqrt(wanted_mm2), rel=0.01)
    assert not mean_table(budget, {}).rows
    assert not mean_table(None, {"S300": few}).rows
