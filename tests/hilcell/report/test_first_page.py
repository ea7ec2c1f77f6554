"""The first page: what is signed must be whole, and nothing simulated can be signed."""

import hashlib
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.measurement_budget import budget_of
from hilcell.cell.file import load_cell
from hilcell.journal.index import row_of
from hilcell.report.certificate import conformity_words, title
from hilcell.report.drawings.paper_figures import drawings
from hilcell.report.drawings.plan_view import plan_view
from hilcell.report.facts import Facts, read_facts
from hilcell.report.first_page import (
    instruments,
    results_at,
    results_sheet,
    uncertainty_words,
    validity_facts,
    verdict_word,
)
from hilcell.report.html import report_html, sentence, standing
from tests.hilcell.report.journals import AFTER_MM, validated_run
from tests.whole.golden import GoldenRuns

JUDGED = {
    "holds": True, "mean_mm": 0.05, "mean_tolerance_mm": 0.12, "mean_U_mm": 0.04,
    "max_mm": 0.2, "max_tolerance_mm": 0.3, "max_U_mm": 0.05,
    "outcome": "accepted", "decision": "in tolerance",
}  # fmt: skip
TRACKER = {"device": "Tracker", "model": "AT960", "serial": "750123", "kind": "tracker"}


def judged(
    folder: Path, *, code: int = 0, plan: dict[str, Any] | None = None, **more: Any
) -> Facts:
    writer = validated_run(folder, **({"simulated": False} | (plan or {})))
    writer.journal.append("event", "", {"what": "connected", "devices": [TRACKER]})
    writer.journal.append("verdict", "validation.S1100", JUDGED | more)
    writer.state("calibration", "validated")
    return read_facts(writer.ended(code=code))


@pytest.mark.parametrize(
    ("code", "more", "plan", "word"),
    [
        (0, {}, {}, "PASS"),
        (1, {"holds": False}, {}, "FAIL"),
        (1, {}, {}, "FAIL"),  # another verdict does not hold
        (0, {}, {"simulated": True}, "WOULD PASS"),
        (1, {"holds": False}, {"simulated": True}, "WOULD FAIL"),
        (1, {"holds": False, "outcome": "undecided"}, {}, "UNDECIDED"),
        (1, {"holds": False, "outcome": "undecided"}, {"simulated": True}, "WOULD BE UNDECIDED"),
    ],
)
def test_the_verdict_in_a_word(
    tmp_path: Path, code: int, more: dict[str, Any], plan: dict[str, Any], word: str
) -> None:
    assert verdict_word(judged(tmp_path / "r", code=code, plan=plan, **more)) == word


TURNED: dict[str, Any] = {
    "holds": False, "outcome": "undecided", "max_deg": 0.022, "max_tolerance_deg": 0.03,
    "max_U_deg": 0.015,
}  # fmt: skip


def test_the_figure_that_decided_and_its_limit_stand_in_the_sentence(tmp_path: Path) -> None:
    undecided = sentence(judged(tmp_path / "r", code=1, **TURNED))
    assert "0.0220 + U 0.0150°" in undecided
    assert "0.03°" in undecided
    both: dict[str, Any] = {"outcome": "rejected", "max_mm": 0.4, "mean_mm": 0.1}
    rejected = sentence(judged(tmp_path / "s", code=1, **(TURNED | both)))
    assert "0.4000 + U 0.0500 mm" in rejected
    assert "0.3 mm" in rejected
    assert "0.0220" not in rejected


def test_the_rule_has_the_limit_of_orientation_where_that_was_judged(tmp_path: Path) -> None:
    assert "0.03°" in conformity_words(judged(tmp_path / "r", code=1, **TURNED))
    assert "°" not in conformity_words(judged(tmp_path / "s"))


@pytest.mark.parametrize(
    ("key", "body", "code", "word"),
    [
        ("recheck", {"holds": True, "verdict": "valid"}, 0, "STILL VALID"),
        ("recheck", {"holds": False, "verdict": "redo"}, 1, "CALIBRATE AGAIN"),
        ("backlash", {"holds": True}, 0, "MEASURED"),
        ("backlash", {"holds": False}, 1, "OUT OF TOLERANCE"),
        ("fit", {"holds": True}, 0, "NOT VALIDATED"),
    ],
)
def test_report_and_list_of_runs_have_one_word(
    tmp_path: Path, key: str, body: dict[str, Any], code: int, word: str
) -> None:
    writer = validated_run(tmp_path / "r")
    writer.journal.append("verdict", key, body)
    folder = writer.ended(code=code)
    facts = read_facts(folder)
    assert verdict_word(facts) == word
    assert row_of(folder).verdict == standing(facts)[1] == word.lower()


def test_counts_before_and_after_are_both_stated(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    writer.validated("S1100", "chosen", [*AFTER_MM, (0.1, 0.1, 0.1)])
    writer.journal.append("verdict", "validation.S1100", JUDGED)
    mean, _ = results_at(writer.facts(), "S1100")
    assert "5 targets" in mean.name
    assert "before: 4" in mean.name


def test_results_beside_their_limits(tmp_path: Path) -> None:
    found = results_sheet(judged(tmp_path / "r", max_mm=0.27))
    assert found is not None
    assert found.rows == [
        ["Mean of 4 targets at S1100", "0.120", "2.000", "0.050", "0.040", "0.080", "pass"],
        ["Largest of 4 targets at S1100", "0.300", "3.000", "0.270", "0.050", "0.250", "undecided"],
    ]


def test_both_coverage_factors_are_stated(tmp_path: Path) -> None:
    facts = judged(tmp_path / "r")
    budget = budget_of(facts.log)
    assert budget is not None
    words = uncertainty_words(facts, budget)
    assert "k = 2 " in words
    assert f"{2.8 * budget.u_mm:.3f} mm" in words


def test_a_real_run_can_be_signed_and_a_simulated_one_not(tmp_path: Path) -> None:
    real = report_html(judged(tmp_path / "r"))
    simulated = report_html(judged(tmp_path / "s", plan={"simulated": True}))
    assert real.count("signature</span>") == 1
    assert "signature</span>" not in simulated


def test_certificates_of_the_cell_file_make_it_a_certificate(tmp_path: Path) -> None:
    cell = load_cell("paper")
    stated = msgspec.structs.replace(
        cell.uncertainty, tracker_certificate="TC-17, 2026-04-17", smr_certificate="SC-88",
        weather_certificate="KC-90",
    )  # fmt: skip
    certified = msgspec.structs.replace(cell, uncertainty=stated)
    assert certified.digest == cell.digest
    facts = judged(tmp_path / "r", plan={"cell": msgspec.to_builtins(certified)})
    found = instruments(facts)
    assert found is not None
    assert [row[3] for row in found.rows] == ["TC-17, 2026-04-17", "SC-88", "KC-90", "simulated"]
    assert found.rows[0][2] == "750123"
    assert title(facts) == "Calibration certificate"
    assert title(judged(tmp_path / "s")) == "Calibration report"


def test_validity_in_full_and_the_file_s_digest(golden: GoldenRuns, tmp_path: Path) -> None:
    folder = golden["small"].copied_to(tmp_path)
    facts = read_facts(folder)
    words = {each.name: each.words for each in validity_facts(facts)}
    assert "x 1400 to 2300, y -450 to 450, z 500 to 1400 mm" in words["Volume"]
    assert "B 75.0°" in words["Orientation"]
    assert "turned by at most 2°" in words["Orientation"]
    assert "°C at the tracker" in words["Temperature"]
    assert "(180 days)" in words["Age"]
    file = folder / "calibration.json"
    assert facts.file_digest == hashlib.sha256(file.read_bytes()).hexdigest()
    file.write_text(file.read_text().replace("B. Operator", "C. Operator"))
    assert read_facts(folder).file_digest == ""  # changed: not vouched for


def test_the_plan_names_stations_and_tracker() -> None:
    cell = load_cell("paper")
    drawn = ET.fromstring(plan_view(cell, np.array([4400.0, 100.0, 1500.0])))
    words = [each.text for each in drawn.iter("text")]
    for name in ("S300", "S1100", "S1900"):
        assert words.count(name) == 2  # on the rail and at its volume
    assert {"tracker", "F1", "1 m"} <= set(words)
    _, _, width, height = map(float, drawn.attrib["viewBox"].split())
    for each in drawn.iter("text"):
        assert 0 <= float(each.attrib["x"]) <= width
        assert 0 <= float(each.attrib["y"]) <= height


@pytest.mark.parametrize(("procedure", "speaks"), [("paper", True), ("calibrate", False)])
def test_only_the_paper_s_run_speaks_of_its_figures(
    tmp_path: Path, procedure: str, speaks: bool
) -> None:
    facts = validated_run(tmp_path / "r").facts()
    facts.log.plan = msgspec.structs.replace(facts.inputs, procedure=procedure)
    words = " ".join(each.title + each.caption for each in drawings(replace(facts, result={})))
    assert ("Fig 12" in words) == speaks
    assert ("The paper" in words) == speaks
