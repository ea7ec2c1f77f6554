"""The report and the exports of a calibration that was really run, by the commands."""

import json
import os
import re
import sqlite3
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from hilcell.atomic_files import NotWritten
from hilcell.journal.journal import Journal, read_journal
from hilcell.journal.runs import JOURNAL
from hilcell.report.facts import Facts, read_facts
from hilcell.report.html import report_html
from hilcell.report.pdf import pages_of, pdf_of
from tests.hilcell.report.browser import looked_at, use_fonts
from tests.hilcell.report.drawn import apart, boxes
from tests.hilcell.report.journals import renamed
from tests.hilcell.report.pages import Page
from tests.whole.bench import HILCELL, command
from tests.whole.golden import GoldenRun, GoldenRuns

RUST, BLUE = (176, 86, 26), (11, 74, 125)  # the figures' colours before and after
PHONE_PX = 500
A4_PX = (297 - 11 - 14) * 96 / 25.4  # within its margins
SIGNED_PX = 19 * 96 / 25.4


@pytest.fixture(scope="module")
def run(golden: GoldenRuns) -> GoldenRun:
    return golden["small"]


@pytest.fixture(scope="module")
def html(run: GoldenRun) -> str:
    return report_html(read_facts(run.folder))


def test_figures_are_those_of_the_result(html: str, run: GoldenRun) -> None:
    rows = Page(html).table("Before and after")
    for place, name in (("S1100", "S1100"), ("others", "others together"), ("S300", "S300")):
        figures = run.result["validation"][place]
        at = next(number for number, row in enumerate(rows) if row["station"] == name)
        for row, how in zip(rows[at:], ("before", "idw"), strict=False):
            for key, value in figures[how].items():
                assert row[f"{key} mm"] == f"{value:.3f}"
        ratio = 100 * (1 - figures["idw"]["mean"] / figures["before"]["mean"])
        assert rows[at + 1]["removed by means %"] == f"{ratio:.1f}"


def test_it_holds_every_figure_of_a_calibration_and_is_small(html: str) -> None:
    found = Page(html)
    ids = {each for each in found.ids if each.startswith("figure-")}
    shown = ("plan", "side", "order", "enlarged", "volume", "variance", "nests", "air", "histogram")
    assert ids == {f"figure-{name}" for name in shown}
    assert len(html.encode()) <= 2_000_000
    assert "B. Operator" in found.text
    assert "402871" in found.text


def test_the_course_calls_each_step_as_the_screen_does(html: str) -> None:
    lines = [row["event"] for row in Page(html).table("Timeline of the run")]
    for words in ("Home the rail.", "Hold station.", "Robot grid. 27 points."):
        assert lines.count(words) == 1


@pytest.mark.process
def test_another_machine_writes_the_same_bytes(html: str, run: GoldenRun, tmp_path: Path) -> None:
    elsewhere = run.copied_to(tmp_path)
    rc = tmp_path / "matplotlibrc"
    rc.write_text("font.size: 20\nlines.linewidth: 9\n")
    other = {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "LC_ALL": "C", "MATPLOTLIBRC": str(rc)}
    again = tmp_path / "again.html"
    subprocess.run(
        [*HILCELL, "report", str(elsewhere), "-o", str(again)],
        env=os.environ | other, check=True, capture_output=True,
    )  # fmt: skip
    assert again.read_text("utf-8") == html


@pytest.mark.parametrize("form", ["csv", "xlsx", "json", "dcc"])
def test_exports(form: str, run: GoldenRun, tmp_path: Path) -> None:
    out = tmp_path / f"out.{'xml' if form == 'dcc' else form}"
    assert command("export", run.folder, f"--{form}", "-o", out).returncode == 0
    if form == "json":
        assert json.loads(out.read_bytes())["result"] == run.result
    elif form == "csv":
        wanted = sum(run.result["points"].values())
        assert len(out.read_text("utf-8").splitlines()) == 1 + wanted
    else:
        assert out.read_bytes()[:2] == (b"<?" if form == "dcc" else b"PK")
    assert [each.name for each in tmp_path.iterdir()] == [out.name]


def test_a_changed_journal_is_refused(run: GoldenRun, tmp_path: Path) -> None:
    folder = run.copied_to(tmp_path)
    with sqlite3.connect(folder / JOURNAL) as base:
        base.execute("DROP TRIGGER record_is_never_changed")
        base.execute("UPDATE record SET body = replace(body, 'B. Operator', 'C. Operator')")
    base.close()
    out = tmp_path / "report.html"
    out.write_text("the report of before")
    assert command("report", folder, "-o", out).returncode == 7
    assert out.read_text() == "the report of before"


@pytest.mark.parametrize("where", ["no/such/folder/report.html", ".", "n" * 300])
def test_a_place_that_cannot_be_written(
    where: str, run: GoldenRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("hilcell.commands.runs.read_facts")  # refused before anything is read
    done = command("report", run.folder, "-o", tmp_path / where)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert list(tmp_path.iterdir()) == []
    assert not list(tmp_path.parent.glob("*.part"))


@pytest.mark.parametrize("name", [JOURNAL, "calibration.json"])
def test_a_run_is_not_written_over(name: str, run: GoldenRun) -> None:
    file = run.folder / name
    before = file.read_bytes()
    assert command("report", run.folder, "-o", file).returncode == 2
    assert command("export", run.folder, "--json", "-o", file).returncode == 2
    assert file.read_bytes() == before


def test_a_journal_that_lacks_a_frame_of_its_result_is_refused(
    run: GoldenRun, tmp_path: Path
) -> None:
    folder = tmp_path / "older"
    folder.mkdir()
    journal = Journal(folder / JOURNAL, "older", create=True)
    for record in read_journal(run.folder / JOURNAL):
        if record.key != "base":
            journal.append(record.kind, record.key, record.body)
    journal.close()
    done = command("report", folder, "-o", tmp_path / "x.html")
    assert done.returncode == 2
    assert "'base'" in done.stderr


LONG = "Ωmega Flugzeugbau Łódź GmbH und Co. KG, Fertigungsinsel Süd, Straße der Montage 12"
STATION = "Heck-Spantaktstation-Nord-Linie-2.Bauabschnitt_4-Platz-11-B"
FOREIGN = "https://x.invalid/x.png"


def long_names(facts: Facts) -> Facts:
    """Return the facts of a real run whose parties, cell and people have long names."""
    parties = msgspec.structs.replace(
        facts.cell.certificate, laboratory=LONG, laboratory_address=LONG, customer=LONG,
        customer_address=LONG,
    )  # fmt: skip
    cell = msgspec.structs.replace(facts.cell, name=LONG, certificate=parties)
    facts.log.plan = msgspec.structs.replace(facts.inputs, operator=LONG, job=LONG, simulated=False)
    return replace(facts, cell=cell, run=LONG)


@pytest.mark.process
def test_seen_in_a_browser(
    html: str, run: GoldenRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a screen and on a phone; page 1 has room to be signed, and for long names."""
    use_fonts(tmp_path, monkeypatch)
    page = html.replace("</main>", f'<img src="{FOREIGN}"></main>', 1)
    named = report_html(long_names(read_facts(run.folder)))
    seen, phone, long = looked_at(tmp_path, (page, 900), (html, PHONE_PX), (named, 900))
    assert seen.width <= 900
    assert 0 < seen.first <= A4_PX - 57  # signatures need 57 more
    assert seen.blocked == [f"img-src: {FOREIGN}"]
    *images, foreign = seen.images
    assert all(image["width"] > 0 for image in images)
    assert foreign["width"] == 0
    assert len(seen.drawings) >= 4
    for box in seen.drawings + [image["box"] for image in images]:
        assert 0.01 < seen.inked(box) < 0.9
    assert 0.4 < seen.share((255, 255, 255)) < 0.95
    for colour in (RUST, BLUE):
        assert seen.near(colour, 24) > 300, f"the figures' colour {colour} is not to be seen"
    assert phone.width <= PHONE_PX
    assert phone.verdicts
    assert all(left + width <= PHONE_PX for left, _, width, _ in phone.verdicts)
    assert all(left + width <= PHONE_PX for (left, _, width, _), _ in phone.sheets)
    scrolled = [table[2] for sheet, table in phone.sheets if table[2] > sheet[2] + 1]
    assert scrolled, "a wide table keeps its width and scrolls in its own box"
    assert long.signatures >= SIGNED_PX
    assert 0 < long.first <= A4_PX
    assert long.width <= 900


@pytest.mark.process
def test_printed_on_a4(run: GoldenRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use_fonts(tmp_path, monkeypatch)
    paper = tmp_path / "report.pdf"
    assert command("report", run.folder, "-o", paper).returncode == 0
    content = paper.read_bytes()
    assert content.startswith(b"%PDF-")
    assert 4 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 12
    begins = pages_of(content, ("stations", "uncertainty"))
    assert begins["stations"] == 3, "the first two pages are whole, nothing runs over"
    boxes = {
        tuple(round(float(side)) for side in box.split())
        for box in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", content)
    }
    assert boxes in ({(0, 0, 595, 842)}, {(0, 0, 596, 842)})
    broken = tmp_path / "chromium"
    broken.write_text("#!/bin/sh\necho no display\n")
    broken.chmod(0o755)
    with pytest.raises(NotWritten, match="no display"):
        pdf_of("<p>x</p>", str(broken))


def test_without_a_browser_no_pdf_is_printed(
    run: GoldenRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delattr("hilcell.commands.runs.read_facts")  # refused before anything is read
    done = command("report", run.folder, "-o", tmp_path / "x.pdf")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert list(tmp_path.iterdir()) == []


def test_the_page_of_each_part_is_read_from_the_print() -> None:
    print_ = b"""1 0 obj <</Type /Pages /Kids [2 0 R 7 0 R]>> endobj
2 0 obj
<</Type /Page /Parent 1 0 R>> endobj
7 0 obj
<</Type /Page /Parent 1 0 R>> endobj
9 0 obj <</first [2 0 R /XYZ 0 841 0] /second [7 0 R /XYZ 0 1 0] /gone [5 0 R /XYZ 0 0 0]>>"""
    assert pages_of(print_, ("first", "second", "gone", "none")) == {"first": 1, "second": 2}


EDGE_MM = 2.0  # words may reach so far beyond a drawing's edge, on the page's margin


def test_long_station_names_stay_in_their_drawings(run: GoldenRun, tmp_path: Path) -> None:
    names = {each: f"{STATION}-{each[1:]}" for each in ("S1100", "S1900", "S300")}
    page = report_html(read_facts(renamed(run.folder, tmp_path / "r", names)))
    drawn = re.findall(r'<svg class="drawn".*?</svg>', page, re.DOTALL)
    assert len(drawn) >= 8
    cut = 0
    for drawing in drawn:
        width = float(ET.fromstring(drawing).attrib["viewBox"].split()[2])
        found = boxes(drawing)
        named = [box for box in found if "…" in box[0]]
        cut += len(named)
        for one in named:
            words, left, right, *_ = one
            assert left >= -EDGE_MM, words
            assert right <= width + EDGE_MM, words
            for other in found:
                assert other[0] == words or apart(one, other), (one, other)
    assert cut >= 6
    assert all(name in Page(page).text for name in names.values())
