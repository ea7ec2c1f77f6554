"""The report's table and pictures of swept axes."""

from __future__ import annotations

from pathlib import Path

from hilcell.identification.sweeps import SweptAxis
from hilcell.report.curves import curves
from hilcell.report.drawings.curve_plots import LABEL_MM, SPECTRUM_MM, WIDTH_MM, label_mm
from hilcell.report.html import report_html
from hilcell.tui.text.plots import SWEEPS, TABS, Measured, sweep_plot, tabs_of
from tests.hilcell.journal.test_curve_record import FOUND, body_of
from tests.hilcell.report.journals import validated_run
from tests.hilcell.report.pages import Page


def test_each_axis_has_its_line_its_picture_and_its_reason(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    writer.journal.append("event", "", body_of(FOUND))
    writer.journal.append("event", "", body_of(SweptAxis(4, "upwards: 9 samples")))
    writer.state("calibration", "validated")
    facts = writer.facts()
    sheet = curves(facts)
    assert sheet is not None
    assert [row[:3] for row in sheet.rows] == [
        ["A2", "40.0: 31.6, 203.5: 20.0", "yes"],
        ["A5", "none", "no: upwards: 9 samples"],
    ]
    page = Page(report_html(facts))
    assert "figure-curves" in page.ids
    assert "Transmission errors" in page.text
    assert "A2: 31.6 µrad at 40.0" in page.text  # in the course of the run
    assert tabs_of(facts.log)[-1] is SWEEPS
    plots = {name: sweep_plot(Measured(facts.log), name) for name in ("A2", "A5")}
    assert [mark.text for mark in plots["A2"].marks] == ["40.0", "203.5"]
    assert "A5; not used: upwards: 9 samples" in plots["A5"].title


def test_no_edge_cuts_the_label_of_a_line() -> None:
    low_mm, high_mm = SPECTRUM_MM
    half_mm = LABEL_MM / 2
    placed_mm = [label_mm(x) for x in (low_mm, 150.0, high_mm)]
    assert placed_mm == [low_mm + half_mm, 150.0, WIDTH_MM - half_mm]


def test_a_run_without_sweeps_has_neither(tmp_path: Path) -> None:
    writer = validated_run(tmp_path / "r")
    writer.state("calibration", "validated")
    facts = writer.facts()
    assert curves(facts) is None
    assert "figure-curves" not in Page(report_html(facts)).ids
    assert tabs_of(facts.log) == TABS
