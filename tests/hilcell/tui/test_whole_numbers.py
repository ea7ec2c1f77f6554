"""No number is cut: columns and remarks without room lose decimals, or leave."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import pytest

from hilcell.tui.plots import PlotStyle
from hilcell.tui.screens.start import Checked
from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.points import WIDE, PointRows, columns_for
from hilcell.tui.text.side import side_lines
from tests.hilcell.tui.views import view_of


@pytest.mark.parametrize("scale", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("width", [WIDE, WIDE + 20])
def test_places_fit_their_columns(width: int, scale: float) -> None:
    view = view_of("done")
    columns = columns_for(width)
    for row in PointRows().rows(view.log):
        far = (-1506.1234 * scale, -1234.5678 * scale, -1998.7654 * scale)
        point = msgspec.structs.replace(row.point, nominal_mm=far, xyz_mm=far)
        found = replace(row, point=point)
        if row.deviation is not None:
            found = replace(found, deviation=replace(row.deviation, actual_mm=far))
        for cell, column in zip(found.to_row((), width).cells, columns, strict=True):
            assert len(cell) <= column.width, (column.title, cell)


@pytest.mark.parametrize("width", [14, 16, 19, 24, 30, 40, 58])
def test_the_side_panel_cuts_no_number(width: int) -> None:
    view = view_of("done")
    rows = [*PointRows().rows(view.log)]
    lines, _ = side_lines(view, rows, width, 29, PlotStyle())
    text = "\n".join(line.plain for line in lines)
    wide, _ = side_lines(view, rows, 58, 29, PlotStyle())
    means = {word for line in wide if "mean" in line.plain for word in line.plain.split()}
    legend = next(line.plain for line in lines if "mean" in line.plain)
    assert legend.rstrip().split("mean ")[-1].split()[0] in means
    assert "targe\n" not in text
    assert max(line.cell_length for line in lines) <= width


def test_a_refusal_is_whole_where_there_is_room() -> None:
    reason = (
        "Paper's campaign refused before anything moves: this cell has no rail, "
        "its robot stands still"
    )
    lines = Checked(refused=reason).check_lines(UNICODE).lines(40, 8)
    assert reason in " ".join(" ".join(line.plain for line in lines).split())
