"""A tracker without a weather station: the air is "not measured", in words, everywhere."""

import csv
import io
import json
from pathlib import Path

import pytest

from hilcell.calibration.measurement_budget import STEEL_EXPANSION_PER_K, budget_of
from hilcell.report.export import csv_bytes, json_bytes, xlsx_bytes
from hilcell.report.facts import Facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import AFTER_MM, BEFORE_MM, Writer
from tests.hilcell.report.pages import Page


@pytest.fixture
def facts(tmp_path: Path) -> Facts:
    writer = Writer(tmp_path / "r").began()
    writer.air = dict.fromkeys(writer.air)
    writer.validated("S1100", "before", BEFORE_MM).validated("S1100", "chosen", AFTER_MM)
    writer.state("calibration", "validated")
    return writer.facts()


def test_the_report_says_so(facts: Facts) -> None:
    page = Page(report_html(facts))
    assert "air not measured: the tracker has no weather station" in page.text
    assert "Air at the tracker" not in page.text
    assert "volume and orientation stated here; no temperature was measured" in page.text
    assert "thermometer" not in page.text
    assert "°C" not in page.text
    assert "nan" not in page.text.lower().split()


def test_the_budget_assumes_a_range(facts: Facts) -> None:
    budget = budget_of(facts.log)
    assert budget is not None
    (thermal,) = (each for each in budget.lines if each.name == "Thermal expansion")
    assert thermal.source == "stated assumption"
    assert "range 4.00 K assumed: no weather station" in thermal.how
    assert thermal.estimate_mm >= 900.0 * STEEL_EXPANSION_PER_K * 4.0 / 2


def test_exports_leave_it_blank(facts: Facts) -> None:
    row = next(csv.DictReader(io.StringIO(csv_bytes(facts).decode())))
    assert (row["temperature_c"], row["pressure_mbar"], row["humidity_percent"]) == ("", "", "")
    assert json.loads(json_bytes(facts))["points"][0]["temperature_c"] is None
    assert xlsx_bytes(facts)
