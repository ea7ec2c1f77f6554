"""The page: its structure, its figures, its refusals and its harmlessness."""

import csv
import io
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hilcell.calibration.influence import ASSUMED
from hilcell.calibration.measurement_budget import STEEL_EXPANSION_PER_K, measurement_budget
from hilcell.cell.file import load_cell
from hilcell.identification.sweeps import without_curve
from hilcell.model.point import PointId
from hilcell.model.verdicts import CurvesUsed
from hilcell.report.drawings.views import plan_view
from hilcell.report.export import csv_bytes, json_bytes, xlsx_bytes
from hilcell.report.facts import Facts, read_facts
from hilcell.report.html import GLOSSARY, glossary_terms, report_html
from hilcell.report.tables import Tables
from tests.hilcell.identification.test_sweeps import FOUND, body_of
from tests.hilcell.report.journals import AFTER_MM, BEFORE_MM, Writer, validated_run
from tests.hilcell.report.pages import Page
from tests.hilcell.verdicts import FITTED, REDO

HOSTILE = "<script>alert(1)</script>\x1b[2J\u202egnp.exe\u2066\"'&${x} {{ 7*7 }}\x00"


@pytest.fixture(scope="module")
def validated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a validated run."""
    return validated_run(tmp_path_factory.mktemp("validated") / "r1").ended()


@pytest.fixture(scope="module")
def html(validated: Path) -> str:
    """Return its report."""
    return report_html(read_facts(validated))


def page_of(facts: Facts) -> Page:
    return Page(report_html(facts))


CELL = {"plan", "side"}  # drawn of every run


def figures_of(page: Page) -> set[str]:
    return {each.removeprefix("figure-") for each in page.ids if each.startswith("figure-")}


def test_a_validated_run(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r1")
    writer.state("calibration", "validated")
    page = page_of(writer.facts())
    assert page.of("h1") == ["Simulated calibration"]
    assert page.tags["html"] == page.tags["main"] == page.tags["h1"] == 1
    assert figures_of(page) == CELL | {"order", "enlarged", "volume", "air"}
    assert len(set(page.ids)) == len(page.ids)
    for facts in ("A. Technician", "J-17", "860112", "r1", "22.0 to 22.0 °C", "7.8.2.1 d"):
        assert facts in page.text


def test_means_maxima_and_both_ratios(html: str) -> None:
    before, after, *_ = Page(html).table("Before and after")
    figures = {"targets": "4", "mean mm": "2.000", "p95 mm": "2.850", "max mm": "3.000"}
    assert before.items() >= ({"station": "S1100", "error": "before"} | figures).items()
    figures = {"targets": "4", "mean mm": "0.200", "p95 mm": "0.285", "max mm": "0.300"}
    removed = {"removed by means %": "90.0", "removed by maxima %": "90.0"}
    assert after.items() >= ({"station": "", "error": "after, chosen"} | figures | removed).items()
    assert before["removed by means %"] == ""


def test_nothing_is_fetched_and_nothing_runs(html: str) -> None:
    page = Page(html)
    active = {"script", "link", "img", "image", "iframe", "object", "embed", "form"}
    assert not active & set(page.tags)
    assert page.links
    assert all(link.startswith("#") for link in page.links)
    assert {link[1:] for link in page.links} <= set(page.ids)
    assert all(found == "#" for found in re.findall(r"url\(\s*['\"]?(.)", html))
    assert "://" not in re.sub(r"<td>[^<]*</td>", "", html)  # addresses of devices are words
    assert "@import" not in html
    assert not [name for name, _ in page.attributes if name.startswith("on")]


def test_every_svg_is_well_formed_and_says_that_it_is_of_a_simulation(html: str) -> None:
    drawn = re.findall(r"<svg.*?</svg>", html, re.DOTALL)
    assert len(drawn) == 6
    assert "tracker" in "".join(ET.fromstring(drawn[0]).itertext())
    for each in drawn:
        shown = ET.fromstring(each)
        assert "SIMULATION" in "".join(shown.itertext())
        assert shown.findtext("title") == shown.attrib["aria-label"]
    page = Page(html)
    assert ("class", "watermark") in page.attributes
    assert page.of("title")[0].startswith("SIMULATION")
    assert '@bottom-center { content: "SIMULATION"; }' in html


def test_hostile_strings_are_shown_harmless(tmp_path: Path) -> None:
    devices = [{"device": "Robot", "model": HOSTILE, "serial": HOSTILE, "address": HOSTILE}]
    folder = tmp_path / 'r<b>1"; } body { display: none'
    plan = {"operator": HOSTILE, "job": HOSTILE, "settings": {HOSTILE: HOSTILE}}
    writer = Writer(folder, **plan).began(devices)
    writer.validated("S1100", "before", BEFORE_MM)
    writer.journal.append("event", "", {"what": HOSTILE, "reason": HOSTILE})
    writer.journal.append("verdict", "fit", msgspec.structs.replace(FITTED, method=HOSTILE))
    writer.validated("S1100", "chosen", BEFORE_MM)
    writer.journal.append("verdict", HOSTILE, {"holds": False, "found": HOSTILE})
    html = report_html(read_facts(writer.ended("faulted", 3, HOSTILE)))
    page = Page(html)
    assert 'content: "r_b_1_____body___display__none"' in html
    assert page.tags["script"] == page.tags["b"] == 0
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e\u2066-\u2069]", html)
    shown = "<script>alert(1)</script>\ufffd[2J\ufffdgnp.exe\ufffd\"'&${x} {{ 7*7 }}\ufffd"
    assert page.text.count(shown) >= 8
    assert "49" not in page.of("dd")


def test_a_cell_without_a_rail_has_no_words_of_one(tmp_path: Path) -> None:
    cell = load_cell("fixed")
    plan = {"cell": msgspec.to_builtins(cell), "digest": cell.digest}
    writer = Writer(tmp_path / "r1", **plan).began()
    for number, name in enumerate(("home", "hold-station", "station-frames"), start=1):
        writer.step(name, number, 3)
    text = page_of(writer.facts()).text
    for words in ("slide held", "slide did", "rail referenced", "station frames"):
        assert words not in text.lower()
    drawn = plan_view(cell, np.array([4400.0, 100.0, 1500.0]))
    assert "rail" not in drawn
    assert "rail" not in dict(glossary_terms("at S300", has_rail=False))["Station"]


@pytest.mark.parametrize(
    ("state", "code", "words"),
    [
        ("", 0, "not finished: running, engine gone"),
        ("faulted", 3, "not finished: faulted"),
        ("aborted", 4, "not finished: aborted"),
        ("finished", 0, "measured"),
        ("finished", 1, "out of tolerance"),
    ],
)
def test_how_the_run_ended(tmp_path: Path, state: str, code: int, words: str) -> None:
    writer = Writer(tmp_path / "r1").began()
    writer.validated("S1100", "before", BEFORE_MM)
    folder = writer.ended(state, code, "Rail: no answer") if state else writer.left()
    page = page_of(read_facts(folder))
    assert words in page.of("strong")
    shown = page.text.count("Rail: no answer")
    assert shown == bool(state) + (state == "faulted")  # course, banner
    assert "$" not in page.text
    assert "order" in figures_of(page)


def test_a_run_that_never_began_shows_the_cell(tmp_path: Path) -> None:
    page = page_of(read_facts(Writer(tmp_path / "r1").left()))
    assert "not begun" in " ".join(page.of("strong"))
    assert figures_of(page) == CELL


def test_a_touch_run_adopts_station_frames(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r1", procedure="touch").began()
    for key in ("base", "station.S1100", "station.S300"):
        writer.frame(key, calibration="1-made")  # this run did not measure it
    writer.frame(
        "touch.S300", poses=8, shift_mm=[0.003, 0.0, 0.004], along_rail_mm=0.003,
        turn_urad=[1.0, 0.0, 0.0], u_before_mm=0.03, u_after_mm=0.01, pull=0.9, misfit=0.5,
    )  # fmt: skip
    page = page_of(read_facts(writer.left()))
    (row,) = page.table("Touch poses")
    assert (row["station"], row["shift mm"], row["u after mm"]) == ("S300", "0.0050", "0.0100")
    assert "Stations" not in page.of("h3")


FIT = msgspec.structs.replace(
    FITTED,
    method="kinematic",
    loocv={
        "idw": {"mean": 0.4, "p95": 0.6, "max": 0.9},
        "kinematic": {"mean": 0.04, "p95": 0.08, "max": 0.12},
    },
    curves=CurvesUsed(used=False, reason="not used: axis sweeps were not made"),
)


def test_the_choice_and_its_reasons(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r1")
    writer.point(PointId("pose", number=0), (1.0, 2.0, 3.0))
    writer.journal.append("verdict", "fit", FIT)
    writer.state("calibration", "validated")
    page = page_of(writer.facts())
    _, chosen, *_ = page.table("Choice of the correction")
    assert (chosen["model"], chosen["mean mm"]) == ("kinematic, chosen", "0.040")
    for words in (FIT.reason, FIT.curves.reason, "identified", "at 1 poses"):
        assert words in page.text
    for words in ("interpolation", "touch poses", "sweeps of"):
        assert words not in page.text


def test_a_recheck_has_its_verdict_and_no_before_and_after(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r1", procedure="recheck").began()
    writer.journal.append("verdict", "recheck", REDO)
    page = page_of(read_facts(writer.left()))
    (row,) = page.table("Verdicts")
    assert row["by"] == "calibrate again: drift 0.900 mm, u 0.010 mm"
    assert "both are reported" not in page.text


def test_a_grid_without_validation_shows_its_vectors(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r1").began()
    for number, at_mm in enumerate(np.eye(3) * 900):
        vertex = PointId("grid", vertex=(0, 0, number))
        writer.point(vertex, at_mm + 1.0, nominal_mm=tuple(at_mm))
    assert figures_of(page_of(writer.facts())) == CELL | {"volume", "air"}


def test_each_axis_has_its_line_its_picture_and_its_reason(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    assert not Tables(read_facts(writer.folder)).curves()
    writer.journal.append("event", "", body_of(FOUND))
    writer.journal.append("event", "", body_of(without_curve(4, "upwards: 9 samples")))
    writer.state("calibration", "validated")
    facts = writer.facts()
    sheet = Tables(facts).curves()
    assert [row[:3] for row in sheet.texts()] == [
        ["A2", "40.0: 31.6, 203.5: 20.0", "yes"],
        ["A5", "none", "no: upwards: 9 samples"],
    ]
    page = page_of(facts)
    assert "figure-curves" in page.ids
    assert "31.6 µrad" in page.text  # in the course of the run


def test_a_report_explains_the_words_that_it_uses(tmp_path: Path) -> None:
    assert glossary_terms('<p class="rms">Place of S300 in {W}</p>') == [
        (name, meaning) for name, _, meaning in GLOSSARY if name in ("{W}", "Station")
    ]
    full = page_of(validated_run(tmp_path / "r1").facts())
    bare = page_of(Writer(tmp_path / "r2").began().facts())
    known = {name for name, *_ in GLOSSARY}
    assert {"u", "p95", "3-D error"} <= set(full.of("dt"))
    assert "p95" not in bare.of("dt")
    assert known & set(bare.of("dt")) < known & set(full.of("dt"))


def test_a_tracker_without_a_weather_station_has_no_air(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r").began()
    writer.air = dict.fromkeys(writer.air)
    writer.validated("S1100", "before", BEFORE_MM).validated("S1100", "chosen", AFTER_MM)
    writer.state("calibration", "validated")
    facts = writer.facts()
    page = page_of(facts)
    assert "no weather station" in page.text
    assert "thermometer" not in page.text
    assert "°C" not in page.text
    assert "nan" not in page.text.lower().split()
    budget = measurement_budget(facts.log)
    assert budget is not None
    (thermal,) = (each for each in budget.lines if each.name == "Thermal expansion")
    assert thermal.source == ASSUMED
    assert thermal.estimate_mm >= 900.0 * STEEL_EXPANSION_PER_K * 4.0 / 2
    row = next(csv.DictReader(io.StringIO(csv_bytes(facts).decode())))
    assert (row["temperature_c"], row["pressure_mbar"], row["humidity_percent"]) == ("", "", "")
    assert json.loads(json_bytes(facts))["points"][0]["temperature_c"] is None
    assert xlsx_bytes(facts)
