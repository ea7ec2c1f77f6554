"""The sheet without a rail, without bounds, and with names that would act in a browser."""

from dataclasses import replace

from hilcell.report.sheet import Sheet, SheetHole, SheetStation, sheet_html

HOLE = SheetHole("<i>H1</i>", (-1.0, 2.0, 3.0), 0.5, 0.1)
STATION = SheetStation("S1", 1.0, 1.0, 0.01, "S1", ["S1.src"], [HOLE])
SHEET = Sheet("1 hole", False, True, [("Air", "20 C")], ["<b>ready</b>"], [STATION], "", [], ["x"])


def test_names_are_escaped_and_figures_are_rounded() -> None:
    page = sheet_html(SHEET)
    assert "&lt;i&gt;H1&lt;/i&gt;" in page
    assert "&lt;b&gt;ready" in page
    assert "<td>\u22121.00</td><td>2.00</td>" in page
    assert "Largest 95 % bound 0.100 mm." in page


def test_a_robot_on_the_floor_has_no_strip() -> None:
    assert "strip must read" in sheet_html(SHEET)
    page = sheet_html(replace(SHEET, has_rail=False))
    assert "strip" not in page
    assert "Rail at" not in page


def test_without_bounds_it_says_why() -> None:
    station = replace(STATION, holes=[replace(HOLE, bound95_mm=None)])
    page = sheet_html(replace(SHEET, stations=[station], no_bounds="<none stated>"))
    assert "No bounds are stated: &lt;none stated&gt;" in page
    assert "95 % bound mm" not in page
    assert "Largest" not in page


def test_every_page_in_print_says_which_station_program_run_and_file() -> None:
    """The head of a table is repeated on each page; the footer is a margin box of the pages."""
    made = replace(SHEET, footer='run </style>"x')
    page = sheet_html(made)
    assert "Station S1, strip must read 1.00 ± 0.01 mm, program S1</th></tr>" in page
    assert 'content: "run\\000020\\00003c\\00002fstyle\\00003e\\000022x"' in page
    assert 'colspan="8"' in page
    page = sheet_html(replace(made, has_rail=False, no_bounds="none"))
    assert "Station S1, program S1</th></tr>" in page
    assert 'colspan="7"' in page


def test_bounds_of_orientation_have_a_column() -> None:
    assert "95 % bound °" not in sheet_html(SHEET)
    station = replace(STATION, holes=[replace(HOLE, turn95_deg=0.01234)])
    page = sheet_html(replace(SHEET, stations=[station]))
    assert "<th>95 % bound °</th>" in page
    assert "<td>0.0123</td>" in page
    assert 'colspan="9"' in page
