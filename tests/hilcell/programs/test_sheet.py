"""The drilling sheet: what it says of holes, stations and conditions."""

from dataclasses import replace

from hilcell.programs.station_jobs import Sheet, SheetHole, SheetStation, sheet_html

HOLE = SheetHole("<i>H1</i>", (-1.0, 2.0, 3.0), 0.5, 0.1)
STATION = SheetStation("S1", 1.0, 1.0, 0.01, "S1", ["S1.src"], [HOLE])
SHEET = Sheet("1 hole", False, True, [("Air", "20 C")], ["<b>ready</b>"], [STATION], "", [], ["x"])


def test_names_are_escaped_and_figures_are_rounded() -> None:
    page = sheet_html(replace(SHEET, footer='run </style>"x'))
    assert "&lt;i&gt;H1&lt;/i&gt;" in page
    assert "&lt;b&gt;ready" in page
    assert "<td>\u22121.00</td><td>2.00</td>" in page
    assert "0.100 mm" in page
    assert 'content: "run\\000020\\00003c\\00002fstyle\\00003e\\000022x"' in page


def test_columns_are_those_that_have_figures() -> None:
    """Those of the rail, of the bounds, of the bounds of orientation."""
    page = sheet_html(SHEET)
    assert "strip" in page
    assert "95 % bound mm" in page
    assert 'colspan="8"' in page
    page = sheet_html(replace(SHEET, has_rail=False))
    assert "strip" not in page
    assert "Rail at" not in page
    station = replace(STATION, holes=[replace(HOLE, bound95_mm=None)])
    page = sheet_html(replace(SHEET, stations=[station], no_bounds="<none stated>"))
    assert "&lt;none stated&gt;" in page
    assert "95 % bound mm" not in page
    assert 'colspan="7"' in page
    station = replace(STATION, holes=[replace(HOLE, turn95_deg=0.01234)])
    page = sheet_html(replace(SHEET, stations=[station]))
    assert "<td>0.0123</td>" in page
    assert 'colspan="9"' in page
