"""The report's drawings: places on paper, words that do not overlap, figures that are right."""

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from hilcell.cell.file import load_cell
from hilcell.model.point import PointId
from hilcell.report.budgets import TargetBudget, target_budget
from hilcell.report.drawings.drawing import MUTED, Scale
from hilcell.report.drawings.error_plots import ErrorPlots, strip, variance_bar
from hilcell.report.drawings.views import side_view
from hilcell.report.facts import Facts, read_facts
from hilcell.report.first_page import Result
from hilcell.report.tables import Tables
from tests.hilcell.report.drawn import assert_apart
from tests.hilcell.report.journals import Writer, validated_run
from tests.whole.golden import GoldenRuns

LEFT_OUT_MM = 1.5  # a letter may stand so far outside


@pytest.fixture(scope="module")
def real(golden: GoldenRuns) -> tuple[Facts, TargetBudget]:
    facts = read_facts(golden["small"].folder)
    return facts, target_budget(facts.log, facts.run)


def words(svg: str) -> list[str]:
    return ["".join(each.itertext()) for each in ET.fromstring(svg).iter("text")]


def test_a_scale_keeps_values_on_paper() -> None:
    scale = Scale(0.01, 1.0, 10.0, 30.0, logarithmic=True)
    assert scale.at(np.array([0.001, 0.1, 9.0])).tolist() == pytest.approx([10.0, 20.0, 30.0])
    assert scale.ticks() == pytest.approx([0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0])
    assert Scale(0.0, 100.0, 0.0, 1.0).ticks() == pytest.approx([0, 20, 40, 60, 80, 100])


def test_every_drawing_of_a_run_keeps_its_words_inside(real: tuple[Facts, TargetBudget]) -> None:
    facts, budget = real
    plots = ErrorPlots(facts)
    drawings = [
        plots.sorted_errors(), plots.errors_after(budget), plots.bound_histogram(budget),
        plots.vectors(), variance_bar(budget, simulated=True), plots.floor_nests(), plots.air(),
    ]  # fmt: skip
    for drawn in drawings:
        shown = ET.fromstring(drawn)
        _, _, width, height = map(float, shown.attrib["viewBox"].split())
        for each in shown.iter("text"):
            assert -LEFT_OUT_MM <= float(each.attrib["x"]) <= width + LEFT_OUT_MM
            assert 0.0 <= float(each.attrib["y"]) <= height + LEFT_OUT_MM, each.text


def test_the_shares_of_the_bar_are_the_whole(real: tuple[Facts, TargetBudget]) -> None:
    said = [line for line in words(variance_bar(real[1], simulated=False)) if line.startswith("u ")]
    assert 3 <= len(said) <= 6
    shares = [float(line.rpartition(", ")[2].removesuffix(" %")) for line in said]
    assert sum(shares) == pytest.approx(100.0, abs=0.3)
    assert shares[:-1] == sorted(shares[:-1], reverse=True)


def test_how_many_are_beyond_their_bound(real: tuple[Facts, TargetBudget]) -> None:
    facts, budget = real
    names = [station.name for station in facts.cell.station]
    found = [budget.coverage[name] for name in names]
    beyond, every = sum(len(each) - each.inside for each in found), sum(map(len, found))
    assert f"{beyond} of {every} beyond it" in words(ErrorPlots(facts).bound_histogram(budget))


def test_the_worst_come_first_with_both_values(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    id = PointId("validate", station="S300", how="chosen", number=1)
    nominal_mm = (100.0, 50.0, 970.0)
    writer.point(id, (100.0, 50.0, 970.4), "S300", nominal_mm=nominal_mm)
    facts = writer.facts()
    found = Tables(facts).worst(target_budget(facts.log, "r"))
    assert found is not None
    first = dict(zip(found.headers, found.texts()[0], strict=True))
    wanted = {"rank": "1", "target": "2\u00a0at\u00a0S300", "z mm": "970", "before mm": "2.000",
              "ez mm": "+0.400", "3-D mm": "0.400", "again mm": "0.200"}  # fmt: skip
    assert first.items() >= wanted.items()
    assert [row[1] for row in found.texts()[1:3]] == ["3\u00a0at\u00a0S300", "3\u00a0at\u00a0S1100"]
    assert found.title == "The worst targets"


@pytest.mark.parametrize("tracker_mm", [(4400.0, 100.0, 1500.0), (2500.0, 0.0, 1500.0),
                                        (250.0, 0.0, 600.0)])  # fmt: skip
@pytest.mark.parametrize("name", ["paper", "fixed"])
def test_no_label_of_the_side_view_lies_on_another(
    name: str, tracker_mm: tuple[float, ...]
) -> None:
    drawn = side_view(load_cell(name), np.array(tracker_mm), simulated=True)
    assert {"tracker", "z 800", "z 1700"} <= set(words(drawn))
    assert_apart(drawn)


@pytest.mark.parametrize("limit_mm", [0.006, 0.09, 0.3])
@pytest.mark.parametrize("after_mm", [0.005, 0.089, 0.2])
@pytest.mark.parametrize("before_mm", [None, 0.02, 0.1, 1.2])
def test_labels_of_the_strip_do_not_overlap(
    limit_mm: float, after_mm: float, before_mm: float | None
) -> None:
    rows = [
        (name, Result("Mean", limit_mm, before_mm, after_mm, 0.02)) for name in ("Mean", "Largest")
    ]
    assert_apart(strip(rows, simulated=False), room_mm=1.2)


@pytest.mark.parametrize("before", [0.007, 0.1, 1.0])
@pytest.mark.parametrize("after", [0.004, 0.04])
@pytest.mark.parametrize("limit_mm", [0.02, 0.06])
def test_labels_of_the_errors_in_order_do_not_overlap(
    tmp_path: Path, before: float, after: float, limit_mm: float
) -> None:
    writer = Writer(tmp_path / "r").began()
    for how, error_mm in (("before", before), ("chosen", after)):
        writer.validated("S300", how, [(share * error_mm, 0.0, 0.0) for share in (0.9, 1.0)])
    facts = writer.facts()
    facts.result["repeatability"] = {
        "rp_mm": 0.06, "rp_robot_mm": 0.05,
        "pooled_radius_mm": 0.06, "pooled_radius_robot_mm": 0.05, "floor_mm": 0.01,
    }  # fmt: skip
    stated = structs.replace(
        facts.cell.validation, mean_tolerance_mm=limit_mm, max_tolerance_mm=1.5 * limit_mm
    )
    cell = structs.replace(facts.cell, validation=stated)
    drawn = ET.fromstring(ErrorPlots(replace(facts, cell=cell)).sorted_errors())
    for each in [each for each in drawn if each.attrib.get("fill") in ("none", MUTED)]:
        if "dotted" not in "".join(each.itertext()):
            drawn.remove(each)  # ticks, below which nothing is written, and the watermark
    assert_apart(drawn)
