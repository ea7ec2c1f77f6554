"""Which contributions a journal proves, with figures worked out by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from hilcell.journal.point_id import PointId
from hilcell.report.budget import Budget, budget_of
from hilcell.report.uncertainty import ASSUMED, MEASURED, Contribution
from tests.hilcell.report.journals import Writer, validated_run

CLOUD_MM = np.array([[0.0, 0.0, 0.0], [0.06, 0.0, 0.0]])  # std of a coordinate 0.06 / sqrt(6)


def by_name(budget: Budget | None) -> dict[str, Contribution]:
    assert budget is not None
    return {each.name: each for each in (*budget.measurement, *budget.target)}


def test_nothing_measured_gives_no_budget(tmp_path: Path) -> None:
    assert budget_of(Writer(tmp_path / "none").began().facts().log) is None


def test_what_is_not_measured_is_a_stated_assumption(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "few").began()
    writer.point(PointId("world", nest="F1"), (0, 0, 0))
    lines = by_name(budget_of(writer.facts().log))
    assert set(lines) == {
        "Tracker, reading noise",
        "Tracker, systematic",
        "SMR centring",
        "Drift",
        "Thermal expansion",
    }
    assert lines["Tracker, reading noise"].source == MEASURED
    assert lines["Tracker, reading noise"].u_mm == pytest.approx(0.01)
    assert lines["Drift"].source == ASSUMED
    assert lines["Thermal expansion"].u_mm == 0.0  # one temperature only


def test_drift_is_what_the_floor_nests_moved(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "drift").began()
    writer.point(PointId("world", nest="F1"), (1000, 0, 0))
    for turn, at_mm in enumerate(((1000.03, 0, 0), (1000, 0.03, 0)), start=1):
        writer.point(PointId("control", session=1, turn=turn, nest="F1"), at_mm)
    drift = by_name(budget_of(writer.facts().log))["Drift"]
    assert drift.source == MEASURED
    assert drift.u_mm == pytest.approx(0.03 / math.sqrt(3))


def test_thermal_from_the_range_of_temperatures(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "warm").began()
    writer.point(PointId("world", nest="F1"), (0, 0, 0), temperature_c=21.0)
    writer.point(PointId("world", nest="F2"), (2000, 0, 0), temperature_c=23.0)
    thermal = by_name(budget_of(writer.facts().log))["Thermal expansion"]
    assert thermal.estimate_mm == pytest.approx(0.023)
    assert thermal.u_mm == pytest.approx(0.023 / math.sqrt(3))


def test_a_corrected_target(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "whole").visited([CLOUD_MM])
    writer.frame("station.S1100", tool_uncertainty_mm=0.01)
    writer.frame("station.S300", tool_uncertainty_mm=0.03)
    budget = budget_of(writer.facts().log)
    lines = by_name(budget)
    assert budget is not None
    assert lines["Station frame"].u_mm == pytest.approx(0.03 / math.sqrt(3))  # the worst
    assert lines["Strip"].u_mm == pytest.approx(0.01 / 3)
    scatter_mm2 = 0.06**2 / 6
    assert lines["Robot repeatability"].u_mm == pytest.approx(math.sqrt(scatter_mm2 - 0.01**2))
    rms_mm2 = (0.01 + 0.04 + 0.09 + 0.04) / 12  # of four targets, three coordinates
    assert lines["Model residual"].u_mm == pytest.approx(math.sqrt(rms_mm2 - scatter_mm2))
    squares = sum(each.u_mm**2 for each in lines.values())
    assert budget.target_U_mm == pytest.approx(2 * math.sqrt(squares))
    assert budget.measurement_u_mm < budget.target_u_mm
    assert budget.check is not None
    assert budget.check.targets == 4
    assert budget.check.found_mm == pytest.approx(math.sqrt(rms_mm2))


def test_the_strip_by_its_repeats(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "strip").visited([CLOUD_MM])
    for number, along_mm in enumerate((0.0, 0.02, 0.04)):  # std 0.02 along y, the rail
        id = PointId("repeat", how="strip", way="random", number=number)
        writer.point(id, (0, along_mm, 0))
    strip = by_name(budget_of(writer.facts().log))["Strip"]
    assert strip.estimate_mm == pytest.approx(0.02)
    assert strip.u_mm == pytest.approx(0.02 / math.sqrt(3))
