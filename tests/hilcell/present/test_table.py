"""A column is one definition, which every form of a table takes its header and values from."""

from pathlib import Path

import pytest

from hilcell.present.renderers import csv_content, drawn
from hilcell.present.table import Column, Named, Table
from hilcell.report import tables
from hilcell.report.html import report_html
from hilcell.tui.text.finished import table_lines
from tests.hilcell.report.journals import validated_run
from tests.hilcell.report.pages import Page

LENGTH = Column[float]("Length", lambda row: row or None, "mm", ".2f")
TURN = Column[float]("A", lambda row: row, "°", ".0f")
NAME = Column[float]("name", str)


def test_a_column_has_its_unit_in_its_header_and_in_its_key() -> None:
    assert [each.header for each in (LENGTH, TURN, NAME)] == ["Length mm", "A °", "name"]
    assert [each.key for each in (LENGTH, TURN, NAME)] == ["length_mm", "a_deg", "name"]


@pytest.mark.parametrize(
    ("value", "text"), [(1.005, "1.00"), (-2.0, "\N{MINUS SIGN}2.00"), (0.0, "")]
)
def test_a_figure_is_rounded_and_a_missing_one_is_blank(value: float, text: str) -> None:
    assert LENGTH.text(LENGTH.of(value)) == text


def test_words_stand_before_figures() -> None:
    made = Table((NAME, LENGTH, NAME), [1.5])
    assert made.headers == ["name", "Length mm", "name"]
    assert (made.rows, made.texts()) == ([["1.5", 1.5, "1.5"]], [["1.5", "1.50", "1.5"]])
    assert made.words == 1
    assert made
    assert not Table((NAME,), [])


def test_a_name_of_the_program_is_in_words_on_the_screen_only() -> None:
    table = Table([Column[str]("error of", lambda way: Named(way, "as sent"))], ["before"])
    assert table.texts() == [["before"]]
    assert csv_content(table) == b"error of\nbefore\n"
    assert "before" in drawn(table, None)
    assert "as sent" in "".join(line.plain for line in table_lines(table).lines(80))


def test_a_terminal_has_ascii() -> None:
    angle = Column[float]("turn", float, "µrad", "+.1f")
    assert drawn(Table([angle], [-2.0]), None).splitlines()[1::2][:2] == [
        "┃ turn urad ┃",
        "│ -2.0      │",
    ]


def test_a_new_column_of_the_report_is_one_definition(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    column = Column[tables.Validated]("least", lambda row: row.errors.norms_mm.min(), "mm", ".1f")
    monkeypatch.setattr(tables, "ACCURACY", (*tables.ACCURACY, column))
    rows = Page(report_html(validated_run(tmp_path / "r1").facts())).table("Before and after")
    assert [row["least mm"] for row in rows[:2]] == ["1.0", "0.1"]
