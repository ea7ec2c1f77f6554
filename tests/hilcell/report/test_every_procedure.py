"""A run of every procedure has a report, however it ended; a part without contents is not there."""

import xml.etree.ElementTree as ET
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer
from tests.hilcell.report.pages import Page

PROCEDURES = sorted(each.name for each in entry_points(group="hilcell.procedures"))
PARTS = ("nests", "air", "order", "volume", "variance", "histogram", "curves")


ENDS = [*((name, "aborted") for name in PROCEDURES), ("calibrate", "faulted"), ("paper", "left")]


@pytest.mark.parametrize(("procedure", "state"), ENDS)
def test_a_run_that_measured_nothing(tmp_path: Path, procedure: str, state: str) -> None:
    writer = Writer(tmp_path / "r", procedure=procedure).began()
    folder = writer.left() if state == "left" else writer.ended(state, 3, "the operator")
    html = report_html(read_facts(folder))
    page = Page(html)
    assert page.of("h2") == [
        "At a glance",
        "Stations, worst targets, drift",
        "Record",
        "Where each required item stands",
    ]
    assert not {f"figure-{name}" for name in PARTS} & set(page.ids)
    assert "This run holds no result." in page.text
    for drawn in html.split("<svg")[1:]:
        ET.fromstring(f"<svg{drawn.partition('</svg>')[0]}</svg>")
