"""The first page and its verdicts: a page that is signed is whole, nothing simulated can be."""

import dataclasses
import hashlib
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from hilcell.calibration.influence import Bounds
from hilcell.cell.file import load_cell
from hilcell.journal.calibration_status import CalibrationStatus
from hilcell.journal.index import row_of
from hilcell.model.outcome import Outcome
from hilcell.model.verdicts import Oriented, OtherVerdict, PoseTested, Verdict
from hilcell.report.budgets import TargetBudget
from hilcell.report.drawings.views import plan_view
from hilcell.report.facts import Facts, read_facts
from hilcell.report.first_page import Certificate, FirstPage
from hilcell.report.html import report_html
from hilcell.report.tables import Tables, typeset
from hilcell.report.timeline import timeline
from hilcell.run.last_word import last_word
from tests.hilcell import verdicts
from tests.hilcell.commands.finished_runs import MADE, REDO, finished
from tests.hilcell.report.journals import validated_run
from tests.whole.golden import GoldenRuns

JUDGED = replace(verdicts.JUDGED, max_mm=0.2)
TRACKER = {"device": "Tracker", "model": "AT960", "serial": "750123", "kind": "tracker"}


def judged(
    folder: Path, *, code: int = 0, plan: dict[str, Any] | None = None, **more: Any
) -> Facts:
    writer = validated_run(folder, **({"simulated": False} | (plan or {})))
    writer.event("connected", devices=[TRACKER])
    writer.journal.append("verdict", "validation.S1100", replace(JUDGED, **more))
    writer.state("calibration", "validated")
    return read_facts(writer.ended(code=code))


DOUBTED = {"holds": False, "decided": Outcome.UNDECIDED}


@pytest.mark.parametrize(
    ("code", "more", "simulated", "word"),
    [
        (0, {}, False, "PASS"),
        (1, {"holds": False}, False, "FAIL"),
        (1, {}, False, "FAIL"),  # another verdict does not hold
        (0, {}, True, "WOULD PASS"),
        (1, {"holds": False}, True, "WOULD FAIL"),
        (1, DOUBTED, False, "UNDECIDED"),
        (1, DOUBTED, True, "WOULD BE UNDECIDED"),
    ],
)
def test_the_verdict_in_a_word(
    tmp_path: Path, code: int, more: dict[str, Any], simulated: bool, word: str
) -> None:
    facts = judged(tmp_path / "r", code=code, plan={"simulated": simulated}, **more)
    assert FirstPage(facts).verdict_title() == word


@pytest.mark.parametrize(
    ("more", "word"), [({}, "passes"), ({"holds": False}, "fails"), (DOUBTED, "undecided")]
)
def test_the_table_of_verdicts_calls_each_as_the_first_page(
    tmp_path: Path, more: dict[str, Any], word: str
) -> None:
    (row,) = Tables(judged(tmp_path / "r", code=1, **more)).verdicts().texts()
    assert row[1] == word


TURNED: dict[str, Any] = {
    "holds": False, "decided": Outcome.UNDECIDED, "max_deg": 0.022, "max_tolerance_deg": 0.03,
    "max_U_deg": 0.015,
}  # fmt: skip


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ({}, 0, "is in tolerance, the uncertainty added."),
        (TURNED, 1, "within the uncertainty of the limit: at S1100"),
        ({"holds": False, "decided": Outcome.REJECTED, "mean_mm": 0.5}, 1,
         "is out of tolerance, the uncertainty taken off: at S1100, mean"),
        ({}, 1, "A check of this run is beyond its limit"),
    ],
)  # fmt: skip
def test_the_sentence_has_the_rule_of_its_outcome(
    tmp_path: Path, more: dict[str, Any], code: int, words: str
) -> None:
    assert words in FirstPage(judged(tmp_path / "r", code=code, **more)).sentence()


def test_the_sentence_of_a_tracker_check_is_that_of_its_last_word(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    for key, verdict in (("tracker-axes", verdicts.TRACKER_AXES),
                         ("tracker-drift", verdicts.TRACKER_DRIFT)):  # fmt: skip
        writer.journal.append("verdict", key, verdict)
    facts = read_facts(writer.ended(code=1))
    said = FirstPage(facts).sentence()
    assert said.startswith("Proven beyond its limit: both faces at N1 0.0539 mm exceeds 0.015 mm")
    assert said[1:-1] in last_word(facts.log, tmp_path / "r").sentence


def test_the_figure_that_decided_and_its_limit_stand_in_the_sentence(tmp_path: Path) -> None:
    undecided = FirstPage(judged(tmp_path / "r", code=1, **TURNED)).sentence()
    assert "0.0220° keeps 0.03°, but not with its U of 0.0150° added" in undecided
    both: dict[str, Any] = {"decided": Outcome.REJECTED, "max_mm": 0.4, "mean_mm": 0.1}
    rejected = FirstPage(judged(tmp_path / "s", code=1, **(TURNED | both))).sentence()
    assert "0.4000 mm exceeds 0.3 mm by more than its U of 0.0500 mm" in rejected
    assert "0.0220" not in rejected


@pytest.mark.parametrize(
    ("key", "verdict", "code", "word"),
    [
        ("recheck", verdicts.RECHECKED, 0, "STILL VALID"),
        ("recheck", verdicts.REDO, 1, "CALIBRATE AGAIN"),
        ("backlash", verdicts.BACKLASH, 0, "MEASURED"),
        ("backlash", replace(verdicts.BACKLASH, holds=False), 1, "OUT OF TOLERANCE"),
        ("fit", verdicts.FITTED, 0, "NOT VALIDATED"),
        ("tracker-drift", verdicts.TRACKER_DRIFT, 0, "NOTHING PROVEN WRONG"),
        ("tracker-axes", verdicts.TRACKER_AXES, 1, "OUT OF TOLERANCE"),
    ],
)
def test_report_and_list_of_runs_have_one_word(
    tmp_path: Path, key: str, verdict: Verdict, code: int, word: str
) -> None:
    writer = validated_run(tmp_path / "r")
    writer.journal.append("verdict", key, verdict)
    folder = writer.ended(code=code)
    facts = read_facts(folder)
    assert FirstPage(facts).verdict_title() == word
    assert row_of(folder).verdict == FirstPage(facts).status()[1] == word.lower()


PASSES = ["Mean of 4 targets at S1100", "0.120", "2.000", "0.050", "0.040", "0.080"]
NEAR = ["Largest of 4 targets at S1100", "0.300", "3.000", "0.270", "0.050", "0.250"]


@pytest.mark.parametrize(
    ("simulated", "passes", "undecided"),
    [(False, "pass", "undecided"), (True, "(pass)", "(undecided)")],
)
def test_results_beside_their_limits(
    tmp_path: Path, simulated: bool, passes: str, undecided: str
) -> None:
    facts = judged(tmp_path / "r", plan={"simulated": simulated}, max_mm=0.27)
    found = FirstPage(facts).results_table(TargetBudget("none"))
    assert found.texts() == [[*PASSES, passes], [*NEAR, undecided]]


def test_a_real_run_can_be_signed_and_a_simulated_one_not(tmp_path: Path) -> None:
    real = report_html(judged(tmp_path / "r"))
    simulated = report_html(judged(tmp_path / "s", plan={"simulated": True}))
    assert real.count("signature</span>") == 1
    assert "signature</span>" not in simulated
    places = [real.index(word) for word in ("Laboratory", "Customer", "<h1>", 'class="verdict')]
    assert places == sorted(places)
    assert simulated.count("SIMULATION</div>") == 1  # figures have it in their titles alone
    assert not re.search(r">SIMULATION</text>", simulated)
    mark = re.search(r"\.watermark \{([^}]*)\}", simulated)
    assert mark is not None
    assert {"z-index: -1", "color: transparent"} <= set(mark[1].split("; "))
    for red, green, blue in re.findall(r"#([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})\b", simulated):
        assert int(green, 16) <= max(int(red, 16), int(blue, 16)) + 8, "nothing is green"


def test_certificates_of_the_cell_file_make_it_a_certificate(tmp_path: Path) -> None:
    cell = load_cell("paper")
    stated = msgspec.structs.replace(
        cell.uncertainty, tracker_certificate="TC-17, 2026-04-17", smr_certificate="SC-88",
        weather_certificate="KC-90",
    )  # fmt: skip
    certified = msgspec.structs.replace(cell, uncertainty=stated)
    assert certified.digest == cell.digest
    facts = judged(tmp_path / "r", plan={"cell": msgspec.to_builtins(certified)})
    found = FirstPage(facts).instruments()
    assert [row[3] for row in found.texts()] == ["TC-17, 2026-04-17", "SC-88", "KC-90", "simulated"]
    assert found.texts()[0][2] == "750123"
    assert Certificate(facts).title() == "Calibration certificate"
    assert Certificate(judged(tmp_path / "s")).title() == "Calibration report"


def test_validity_in_full_and_the_file_s_digest(golden: GoldenRuns, tmp_path: Path) -> None:
    folder = golden["small"].copied_to(tmp_path)
    facts = read_facts(folder)
    words = {each.name: each.words for each in FirstPage(facts).validity_facts()}
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


def test_a_revoked_calibration_says_so_and_ended_when_it_did(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "run")
    writer.event("calibration revoked", reason="wrong reflector")
    facts = writer.facts()
    assert facts.revoked == "wrong reflector"
    assert facts.last.kind == "end"
    page = FirstPage(facts)
    assert page.status() == ("bad", "its calibration is revoked: wrong reflector")
    assert page.sentence().startswith("The calibration of this run was revoked")
    assert page.time_span()
    items = Certificate(facts).items(None, TargetBudget("none"))
    (validity,) = (each.words for each in items if each.name == "Validity")
    assert validity.startswith("REVOKED: wrong reflector; the results")


VALIDATED = replace(
    verdicts.JUDGED, mean_mm=0.0771, mean_tolerance_mm=0.3, max_mm=0.14975, max_tolerance_mm=1.0,
    mean_U_mm=0.0485, max_U_mm=0.0522,
)  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "figures"),
    [
        (replace(verdicts.REVISITED, ratio=9.2467, limit=3.0812, suspected=["the base moved"]),
         ["9.25", "3.08", "99.9 %", "the base moved"]),
        (
            replace(
                verdicts.LOST_MOTION, mean_mm=0.1235, max_mm=0.1557, points=4,
                lost_urad=[40.2, 34.4, 36.7], U_urad=[26.5, 57.0, 29.8], limit_urad=100.0,
            ),
            ["4 vertices", "0.123 mm", "0.156 mm", "A1 40 ± 26, A2 34 ± 57, A3 37 ± 30 µrad",
             "100 µrad"],
        ),
        (replace(verdicts.SIGN, limit=0.5, before_mm=1.2376, corrected_mm=0.1013, ratio=0.0818),
         ["1.238 mm", "0.101 mm", "8 %", "50 %"]),
        (VALIDATED, ["0.0771 mm (U 0.0485), limit 0.3 mm", "0.1497 mm (U 0.0522), limit 1 mm"]),
        (replace(VALIDATED, decided=Outcome.UNDECIDED, decision="too few targets"),
         ["0.0771 mm (U 0.0485)", "too few targets"]),
        (replace(verdicts.UPDATED, drift_mm=0.0123, drift_u_mm=0.004, doubt="or a slip"),
         ["0.012 mm", "u 0.004 mm", "or a slip"]),
        (PoseTested(holds=False, ap_mm=0.5, ap_u95_mm=0.02, ap_limit_mm=0.6, rp_limit_deg=0.1),
         ["AP 0.500 mm (U 0.020), limit 0.6 mm", "RP not known, limit 0.1°"]),
        (Oriented(holds=True, before_mean_deg=0.1, mean_deg=0.02, reflectors_moved_mm=0.01),
         ["0.1000°", "0.0200°", "0.010 mm"]),
        (replace(verdicts.BACKLASH, found_mm=0.19842, limit_mm=0.4),
         ["backlash 0.1984 mm, limit 0.4 mm"]),
        (verdicts.TOUCHED, ["S300"]),
        (OtherVerdict(holds=True, facts={"worst_mm": 0.25, "count": 3}),
         ["worst 0.2500 mm", "count 3"]),
    ],
)  # fmt: skip
def test_figures_have_units(verdict: Verdict, figures: list[str]) -> None:
    words = typeset(verdict.text)
    assert [each for each in figures if each not in words] == []


# -- simulated, zones, bounds ----------------------------------------------------------------------


def test_the_95_percent_bound_stands_in_the_table_and_is_not_judged(tmp_path: Path) -> None:
    facts = judged(tmp_path / "r")
    radii_mm = np.array([0.05, 0.074])
    bounds = cast("Bounds", SimpleNamespace(radii_mm=radii_mm))
    found = FirstPage(facts).results_table(TargetBudget(in_use={"S1100": bounds}))
    limit = f"{facts.cell.validation.max_tolerance_mm:.3f}"
    assert found.texts()[-1][1:] == [limit, "–", "0.074", "included", limit, "–"]


def test_too_few_targets_make_a_row_undecided_whose_figures_are_not(tmp_path: Path) -> None:
    facts = judged(
        tmp_path / "r", decided=Outcome.UNDECIDED, holds=False, decision="too few targets"
    )
    found = FirstPage(facts).results_table(TargetBudget("none"))
    assert [row[-1] for row in found.texts()] == ["undecided", "pass"]


def test_a_later_run_revokes_or_supersedes(tmp_path: Path) -> None:
    """The page said WOULD PASS of a calibration that a re-check had revoked."""
    finished(tmp_path, "1-made", MADE)
    finished(tmp_path, "2-re-checked", REDO, used="1-made", code=1)
    facts = read_facts(tmp_path / "1-made")
    assert FirstPage(facts).verdict_title() == "REVOKED"
    reason = "by 2-re-checked: its re-check says redo"
    assert FirstPage(facts).status() == ("bad", f"its calibration is revoked: {reason}")
    assert FirstPage(facts).validity_facts() == []
    finished(tmp_path, "3-made", MADE)
    finished(tmp_path, "4-made", MADE)
    words = FirstPage(read_facts(tmp_path / "3-made")).status()[1]
    assert words.endswith("; its calibration is superseded by 4-made")
    assert "superseded" not in FirstPage(read_facts(tmp_path / "4-made")).status()[1]


@pytest.mark.parametrize(
    ("validated", "title"), [(JUDGED, "SUSPECTED"), (verdicts.UNDECIDED, "UNDECIDED")]
)
def test_a_suspected_cause_is_the_verdict_where_no_limit_is_missed(
    tmp_path: Path, validated: Verdict, title: str
) -> None:
    """The page said that limits are not kept over a table that passes, and FAIL of an undecided."""
    writer = validated_run(tmp_path / "r", simulated=False)
    writer.journal.append("verdict", "validation.S1100", validated)
    writer.journal.append("verdict", "suspicions", verdicts.SUSPECTED)
    cause = {"cause": "mount slipped", "size": 0.24, "unit": "mm", "noticed_by": "re-visits"}
    read = read_facts(writer.ended(code=1))
    facts = dataclasses.replace(read, result=read.result | {"suspicions": [cause]})
    assert FirstPage(facts).verdict_title() == title
    if title == "SUSPECTED":
        assert re.match(
            r".*mount slipped.*0\.24.*Correct nothing by it", FirstPage(facts).sentence()
        )
    assert facts.suspected
    assert not dataclasses.replace(facts, status=CalibrationStatus("current")).suspected


def test_a_resume_that_never_began_is_no_part_of_the_run(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    writer.state("run", "aborted")
    for code in (4, 3, 3):
        writer.journal.append("end", "", {"state": "aborted", "exit": code, "result": {}})
    facts = read_facts(writer.left())
    assert facts.last.body["exit"] == 4


def test_times_are_those_of_the_wall_beside_utc(tmp_path: Path) -> None:
    utc = judged(tmp_path / "u")
    assert FirstPage(utc).time_span().endswith(" UTC")
    assert "UTC+" not in FirstPage(utc).time_span()
    there = judged(tmp_path / "r", plan={"utc_offset_min": 330})
    assert "UTC+05:30 (" in FirstPage(there).time_span()
    assert FirstPage(there).time_span().endswith(" UTC)")
    listed = timeline(there)
    assert listed.headers[0] == "UTC+05:30 (UTC)"
    hours = [int(time[-9:-7]) * 60 + int(time[-6:-4]) for time, _ in listed.texts()]
    for (time, _), minutes in zip(listed.texts(), hours, strict=True):
        clock = time[:-11][-8:]
        assert (int(clock[:2]) * 60 + int(clock[3:5]) - minutes) % 1440 == 330
