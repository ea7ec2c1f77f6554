"""A run of every procedure has a report, however it ended; a part without contents is not there."""

import re
import xml.etree.ElementTree as ET
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer
from tests.hilcell.report.pages import Page
from tests.whole.bench import sweep
from tests.whole.golden import GoldenRuns

PROCEDURES = sorted(each.name for each in entry_points(group="hilcell.procedures"))
PARTS = ("nests", "air", "order", "volume", "variance", "histogram", "curves")


ENDS = [
    *((name, "aborted", True) for name in PROCEDURES),
    ("calibrate", "faulted", False), ("paper", "left", False), ("home", "aborted", False),
]  # fmt: skip


@pytest.mark.parametrize(("procedure", "state", "measured"), ENDS)
def test_a_run_that_measured_nothing(
    tmp_path: Path, procedure: str, state: str, measured: bool
) -> None:
    writer = Writer(tmp_path / "r", procedure=procedure)
    if measured:
        writer.began()  # which frames {W}
    folder = writer.left() if state == "left" else writer.ended(state, 3, "the operator")
    html = report_html(read_facts(folder))
    page = Page(html)
    assert page.of("h2") == [
        "At a glance",
        *(["Frames"] if measured else []),
        "Record",
        "Where each required item is",
    ]
    assert not {f"figure-{name}" for name in PARTS} & set(page.ids)
    assert "This run holds no result." in page.text
    assert "Calibrated volume" not in page.of("h3")
    assert_references_resolve(html)
    for drawn in html.split("<svg")[1:]:
        ET.fromstring(f"<svg{drawn.partition('</svg>')[0]}</svg>")


def assert_references_resolve(html: str) -> None:
    """Fail where a link, or the place of an item, names what the report does not have."""
    page = Page(html)
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    places = set(page.of("a")) | set(re.findall(r'class="where">([^<]*)</td>', html)) - {""}
    assert places <= {"first page", "here", *page.of("h2")}
    for named in re.findall(r"[Ss]ee (?:the table of )?([A-Z][a-z]+)", page.text):
        assert named in {*page.of("h2"), *page.of("h3")}


@pytest.mark.parametrize("name", ["small", "paper", "seats", *sweep("calibration")])
def test_every_reference_of_a_finished_run_resolves(golden: GoldenRuns, name: str) -> None:
    html = report_html(read_facts(golden[name].folder))
    assert_references_resolve(html)
    assert "Calibrated volume" in Page(html).of("h3")
    assert "Stations, worst targets, drift" in Page(html).of("h2")
