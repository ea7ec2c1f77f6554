"""The report and the exports of a calibration that was really run, by the commands."""

import json
import os
import re
import shutil
import sqlite3
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.commands.cli import main
from hilcell.journal.runs import JOURNAL
from hilcell.report.facts import Facts, read_facts
from hilcell.report.html import report_html
from hilcell.report.pdf import pages_of, pdf_of
from tests.hilcell.report.browser import browse, browser, looked_at
from tests.hilcell.report.journals import renamed
from tests.hilcell.report.pages import Page
from tests.hilcell.report.printed import fills
from tests.whole.bench import HILCELL, command, sweep
from tests.whole.golden import GoldenRuns

RUST, BLUE = (176, 86, 26), (11, 74, 125)  # the figures' colours before and after


@pytest.fixture(scope="module")
def calibrated(golden: GoldenRuns) -> tuple[Path, dict[str, Any]]:
    """Return the folder of a small calibration and its result."""
    return golden["small"].folder, golden["small"].result


@pytest.fixture(scope="module")
def page(calibrated: tuple[Path, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return its report."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    done = command("report", calibrated[0], "-o", path)
    assert done.returncode == 0, done.stderr
    assert str(path) in done.stderr
    assert done.stdout == ""
    return path


def test_figures_are_those_of_the_result(
    page: Path, calibrated: tuple[Path, dict[str, Any]]
) -> None:
    rows = Page(page.read_text("utf-8")).table("Before and after")
    for place, name in (("S1100", "S1100"), ("others", "others together"), ("S300", "S300")):
        figures = calibrated[1]["validation"][place]
        at = next(number for number, row in enumerate(rows) if row["station"] == name)
        for row, how in zip(rows[at:], ("before", "idw"), strict=False):
            for key, value in figures[how].items():
                assert row[f"{key} mm"] == f"{value:.3f}"
        ratio = 100 * (1 - figures["idw"]["mean"] / figures["before"]["mean"])
        assert rows[at + 1]["removed by means %"] == f"{ratio:.1f}"


def test_it_holds_every_figure_of_a_calibration_and_is_small(page: Path) -> None:
    found = Page(page.read_text("utf-8"))
    ids = {each for each in found.ids if each.startswith("figure-")}
    shown = ("plan", "side", "order", "enlarged", "volume", "variance", "nests", "air", "histogram")
    assert ids == {f"figure-{name}" for name in shown}
    assert page.stat().st_size <= 2_000_000
    for words in (
        "B. Operator",
        "402871",
        "Error model",
        "Robot repeatability",
        "tool point u",
        "95 % bounds of corrected targets",
    ):
        assert words in found.text


def test_another_machine_writes_the_same_bytes(
    page: Path, calibrated: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    elsewhere = tmp_path / calibrated[0].name
    shutil.copytree(calibrated[0], elsewhere)
    rc = tmp_path / "matplotlibrc"
    rc.write_text("font.size: 20\nlines.linewidth: 9\n")
    other = {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "LC_ALL": "C", "MATPLOTLIBRC": str(rc)}
    again = tmp_path / "again.html"
    subprocess.run(
        [*HILCELL, "report", str(elsewhere), "-o", str(again)],
        env=os.environ | other,
        check=True,
        capture_output=True,
        timeout=100,
    )
    assert again.read_bytes() == page.read_bytes()


@pytest.mark.parametrize("form", ["csv", "xlsx", "json", "dcc"])
def test_exports(form: str, calibrated: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    out = tmp_path / f"out.{'xml' if form == 'dcc' else form}"
    assert main(["export", str(calibrated[0]), f"--{form}", "-o", str(out)]) == 0
    if form == "json":
        assert json.loads(out.read_bytes())["result"] == calibrated[1]
    elif form == "csv":
        wanted = sum(calibrated[1]["points"].values())
        assert len(out.read_text("utf-8").splitlines()) == 1 + wanted
    else:
        assert out.read_bytes()[:2] == (b"<?" if form == "dcc" else b"PK")
    assert [each.name for each in tmp_path.iterdir()] == [out.name]


def test_a_changed_journal_is_refused(
    calibrated: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(calibrated[0], folder)
    with sqlite3.connect(folder / JOURNAL) as base:
        base.execute("DROP TRIGGER record_is_never_changed")
        base.execute("UPDATE record SET body = replace(body, 'B. Operator', 'C. Operator')")
    base.close()
    out = tmp_path / "report.html"
    out.write_text("the report of before")
    assert main(["report", str(folder), "-o", str(out)]) == 7
    assert "was changed or damaged" in capsys.readouterr().err
    assert out.read_text() == "the report of before"


@pytest.mark.parametrize("where", ["no/such/folder/report.html", ".", "n" * 300])
def test_a_place_that_cannot_be_written(
    where: str,
    calibrated: tuple[Path, dict[str, Any]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr("hilcell.commands.report.read_facts")  # refused before anything is read
    assert main(["report", str(calibrated[0]), "-o", str(tmp_path / where)]) == 2
    err = capsys.readouterr().err
    assert "is a folder" in err if where == "." else "cannot be written" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    assert not list(tmp_path.parent.glob("*.part"))


@pytest.mark.parametrize("name", [JOURNAL, "calibration.json"])
def test_a_run_is_not_written_over(
    name: str, calibrated: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    file = calibrated[0] / name
    before = file.read_bytes()
    assert main(["report", str(calibrated[0]), "-o", str(file)]) == 2
    assert main(["export", str(calibrated[0]), "--json", "-o", str(file)]) == 2
    assert capsys.readouterr().err.count("is what is read") == 2
    assert file.read_bytes() == before


def test_a_journal_that_lacks_what_its_result_needs(
    calibrated: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hilcell.journal.journal import Journal, read_journal

    folder = tmp_path / "older"
    folder.mkdir()
    journal = Journal(folder / JOURNAL, "older", create=True)
    for record in read_journal(calibrated[0] / JOURNAL):
        if record.key != "base":
            journal.append(record.kind, record.key, record.body)
    journal.close()
    assert main(["report", str(folder), "-o", str(tmp_path / "x.html")]) == 2
    assert "lacks 'base'" in capsys.readouterr().err


def test_seen_in_a_browser(page: Path, tmp_path: Path) -> None:
    seen = looked_at(page, tmp_path, (900, 9000))
    assert seen.width <= 900
    assert 0 < seen.first <= 1028 - 57  # px of A4 within its margins; signatures need 57 more
    assert seen.blocked == []
    assert all(image["width"] > 0 for image in seen.images)
    assert len(seen.drawings) >= 4
    for box in seen.drawings + [image["box"] for image in seen.images]:
        assert 0.01 < seen.inked(box) < 0.9
    assert 0.4 < float(np.mean(np.all(seen.pixels == 255, axis=2))) < 0.95
    for colour in (RUST, BLUE):
        near = np.all(np.abs(seen.pixels - colour) < 24, axis=2)
        assert near.sum() > 300, f"the figures' colour {colour} is not to be seen"


MM_PX = 96 / 25.4
LEAST_FULL, LEAST_LAST = 0.40, 0.25  # of a printed page's height


def printed_fills(facts: Facts, more_css: str = "") -> list[float]:
    """Return how full each printed page of a run's report is, without the watermark."""
    facts.log.plan = msgspec.structs.replace(facts.inputs, simulated=False)
    page = report_html(facts).replace("</style>", f"{more_css}</style>", 1)
    return fills(pdf_of(page, browser()))


def well_filled(found: list[float]) -> bool:
    return min(found[:-1]) >= LEAST_FULL and found[-1] >= LEAST_LAST


@pytest.mark.parametrize(
    ("name", "most"),
    [("small", 11), *sweep(("paper", 15), ("paper-whole", 15), ("calibration", 11))],
)
def test_printed_pages_are_full(golden: GoldenRuns, name: str, most: int) -> None:
    found = printed_fills(read_facts(golden[name].folder))
    assert 4 <= len(found) <= most
    assert well_filled(found), found


@pytest.mark.nightly  # of the test above
def test_a_forced_page_break_is_seen_in_how_full_pages_are(golden: GoldenRuns) -> None:
    found = printed_fills(
        read_facts(golden["small"].folder), "@media print { .part h2 { break-after: page; } }"
    )
    assert not well_filled(found), found


LONG = "Ωmega Flugzeugbau Łódź GmbH und Co. KG, Fertigungsinsel Süd, Straße der Montage 12"


def test_page_1_can_be_signed_and_holds_long_names(
    calibrated: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    facts = read_facts(calibrated[0])
    plan = facts.inputs
    parties = msgspec.structs.replace(
        facts.cell.certificate, laboratory=LONG, laboratory_address=LONG, customer=LONG,
        customer_address=LONG,
    )  # fmt: skip
    cell = msgspec.structs.replace(facts.cell, name=LONG, certificate=parties)
    facts.log.plan = msgspec.structs.replace(plan, operator=LONG, job=LONG, simulated=False)
    page = tmp_path / "long.html"
    page.write_text(report_html(replace(facts, cell=cell, run=LONG)), "utf-8")
    seen = looked_at(page, tmp_path, (900, 3000), pixels=False)
    assert seen.signatures >= 19 * MM_PX
    assert 0 < seen.first <= (297 - 11 - 14) * MM_PX
    assert seen.width <= 900


STATION = "Heck-Spantaktstation-Nord-Linie-2.Bauabschnitt_4-Platz-11-B"
ABOUT_PX = 2.0  # words may reach so far beyond a drawing's edge, or into one another


def test_long_station_names_stay_in_their_drawings(golden: GoldenRuns, tmp_path: Path) -> None:
    names = {each: f"{STATION}-{each[1:]}" for each in ("S1100", "S1900", "S300")}
    facts = read_facts(renamed(golden["small"].folder, tmp_path / "r", names))
    facts.log.plan = msgspec.structs.replace(facts.inputs, operator=LONG, job=LONG, simulated=False)
    page = tmp_path / "long.html"
    cell = msgspec.structs.replace(facts.cell, name=LONG[:66])
    page.write_text(report_html(replace(facts, cell=cell)), "utf-8")
    seen = looked_at(page, tmp_path, (900, 3000), pixels=False)
    assert 0 < seen.first <= (297 - 11 - 14) * MM_PX
    named = 0
    for drawing in seen.words:
        left, _, width, _ = drawing["box"]
        for words, (x, y, wide, high) in drawing["words"]:
            named += "…" in words
            at = (drawing["drawing"], words)
            assert left - ABOUT_PX <= x, at
            assert x + wide <= left + width + ABOUT_PX, at
            if "…" not in words:
                continue
            for other, (x2, y2, wide2, high2) in drawing["words"]:
                across = min(x + wide, x2 + wide2) - max(x, x2)
                along = min(y + high, y2 + high2) - max(y, y2)
                apart = other == words or across <= ABOUT_PX or along <= ABOUT_PX
                assert apart, (*at, other)
    assert named >= 6
    assert all(name in Page(page.read_text("utf-8")).text for name in names.values())


PHONE_PX = 500  # a browser without a screen makes no narrower window


def test_seen_on_a_phone(page: Path, tmp_path: Path) -> None:
    seen = looked_at(page, tmp_path, (PHONE_PX, 3000), pixels=False)
    assert seen.width <= PHONE_PX
    assert seen.verdicts
    assert all(left + width <= PHONE_PX for left, _, width, _ in seen.verdicts)
    assert all(left + width <= PHONE_PX for (left, _, width, _), _ in seen.sheets)
    scrolled = [table[2] for sheet, table in seen.sheets if table[2] > sheet[2] + 1]
    assert scrolled, "a wide table keeps its width and scrolls in its own box"


PIXEL = (
    "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwAD"
    "hgGAWjR9awAAAABJRU5ErkJggg=="
)


@pytest.mark.parametrize(
    ("policy", "shown"),
    [("default-src 'none'", 0), pytest.param("img-src data:", 1, marks=pytest.mark.nightly)],
)
def test_the_browser_sees_what_a_policy_blocks(policy: str, shown: int, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        f"""<!DOCTYPE html><html><head>
        <meta http-equiv="Content-Security-Policy" content="{policy}; style-src 'unsafe-inline'">
        </head><body><img src="{PIXEL}" width="50" height="50">
        <svg width="50" height="50"><image href="{PIXEL}" width="50" height="50"/></svg>
        </body></html>"""
    )
    seen = looked_at(page, tmp_path, (300, 300))
    assert [image["width"] for image in seen.images] == [shown, shown]
    assert bool(seen.blocked) == (not shown)


def test_printed_on_a4(page: Path, tmp_path: Path) -> None:
    shown = tmp_path / "report.html"
    shutil.copy(page, shown)
    paper = tmp_path / "report.pdf"
    browse(shown, f"--print-to-pdf={paper}")
    content = paper.read_bytes()
    assert content.startswith(b"%PDF-")
    pages = re.findall(rb"/Type\s*/Page\b", content)
    assert 4 <= len(pages) <= 10
    begins = pages_of(content, ("stations", "uncertainty"))
    assert begins["stations"] == 3, "the first two pages are whole, nothing runs over"
    boxes = {
        tuple(round(float(side)) for side in box.split())
        for box in re.findall(rb"/MediaBox\s*\[([^\]]*)\]", content)
    }
    assert boxes <= {(0, 0, 595, 842), (0, 0, 596, 842)}
    assert boxes
