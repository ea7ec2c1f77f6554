"""Only words that a report uses are explained."""

from pathlib import Path

import numpy as np

from hilcell.cell.file import load_cell
from hilcell.report.drawings.plan_view import plan_view
from hilcell.report.glossary import WORDS, words_of
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer, validated_run
from tests.hilcell.report.pages import Page


def test_a_word_in_a_tag_is_not_read() -> None:
    assert words_of('<p class="rms">Place of S300 in {W}</p>') == [
        (name, meaning) for name, _, meaning in WORDS if name in ("{W}", "Station")
    ]


def test_a_report_explains_what_it_uses_and_ends(tmp_path: Path) -> None:
    full = Page(report_html(validated_run(tmp_path / "r1").facts()))
    bare = Page(report_html(Writer(tmp_path / "r2").began().facts()))
    known = {name for name, *_ in WORDS}
    assert {"u", "p95", "3-D error"} <= set(full.of("dt"))
    assert "p95" not in bare.of("dt")
    assert known & set(bare.of("dt")) < known & set(full.of("dt"))
    for page, run in ((full, "r1"), (bare, "r2")):
        assert page.texts[-1] == ("p", f"End of report {run}")


def test_a_cell_on_the_floor_has_no_rail_in_its_words_and_drawings() -> None:
    assert "rail" not in dict(words_of("at S300", has_rail=False))["Station"]
    for name, has_rail in (("paper", True), ("fixed", False)):
        drawn = plan_view(load_cell(name), np.array([4400.0, 100.0, 1500.0]))
        assert ("rail" in drawn) == has_rail
