"""The map of the volume and the right side: shapes grow with |e|, counts, what goes first."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest

from hilcell.journal.log import Log
from hilcell.model.point import PointId
from hilcell.tui.plots import PlotStyle
from hilcell.tui.run_view import RunView
from hilcell.tui.text.points import PointRows
from hilcell.tui.text.side import MAP_ROWS, NO_POINT, Grades, Volume, side_lines
from tests.hilcell.tui.sample_runs import SampleRun, begun, measuring, validated

WIDE = 58
ERRORS = (0.01, 0.08, 0.15, 0.9, 1.2)


def volume(errors: tuple[float, ...] = ERRORS, **more: Any) -> Volume:
    """Return one target after the other along the rail's axis y, in the middle of x and z."""
    y_mm = np.linspace(0.0, 1000.0, len(errors))
    targets_mm = np.column_stack([np.full(len(errors), 50.0), y_mm, np.full(len(errors), 50.0)])
    low_mm, high_mm = np.zeros(3), np.array([100.0, 1000.0, 100.0])
    return Volume(targets_mm, np.array(errors), low_mm, high_mm, 1.0, **more)


def shown(of: Volume, width: int = WIDE, height: int = 22, *, plain: bool = False) -> list[str]:
    return [line.plain for line in of.lines(width, height, plain=plain)]


def test_shapes_grow_with_the_error() -> None:
    grades = Grades.of(1.0)
    assert grades.grade(np.array([0.05, 0.1, 0.2, 1.0, 1.001, math.nan])).tolist() == [
        0, 1, 2, 3, 4, 4,
    ]  # fmt: skip
    for plain, shapes in ((False, Grades.SHAPES), (True, Grades.LETTERS)):
        assert "".join(grades.drawn(n, plain=plain)[0] for n in range(5)) == shapes


@pytest.mark.parametrize(("limit_mm", "shapes"), [(1.0, "·•○●■"), (0.15, "·•●■"), (0.05, "●■")])
def test_no_grade_lies_beyond_the_limit(limit_mm: float, shapes: str) -> None:
    grades = Grades.of(limit_mm)
    assert grades.bounds[-1] == limit_mm
    assert "".join(grades.drawn(n, plain=False)[0] for n in range(len(shapes))) == shapes
    assert "$fault" in grades.drawn(len(shapes) - 1, plain=False)[1]


def test_errors_without_a_limit_have_no_colour_of_a_fault() -> None:
    grades = Grades.of(None)
    assert not any(
        "$fault" in grades.drawn(n, plain=False)[1] for n in range(len(grades.bounds) + 1)
    )


def test_three_views_share_their_axes() -> None:
    lines = shown(volume(stations=(("S1", 500.0),)))
    above = next(line for line in lines if "■" in line[:40])
    side = next(line for line in lines[12:] if "■" in line[:40])
    assert [above[:40].index(shape) for shape in Grades.SHAPES] == [
        side[:40].index(shape) for shape in Grades.SHAPES
    ]
    assert any("■" in line[42:] for line in lines[12:])  # along the rail: the worst of all
    assert "1.00 m, rail y ►" in "\n".join(lines)
    assert len(lines) == MAP_ROWS


def test_a_cell_shows_its_worst_and_the_newest_is_marked() -> None:
    one = volume((0.01, 0.01))
    worst = Volume(np.tile(one.targets_mm[:1], (2, 1)), np.array([2.0, 0.01]), one.low_mm,
                   one.high_mm, 1.0)  # fmt: skip
    assert "■" in "".join(line[:40] for line in shown(worst))
    assert "·" not in "".join(line[:40] for line in shown(worst))
    newest = [line[:40] for line in shown(volume(newest=1))]
    assert "◄" in "".join(newest)
    assert "•" not in "".join(newest)


def test_the_legend_counts_each_grade() -> None:
    text = "\n".join(shown(volume((0.01, 0.02, 0.15, 3.0))))
    for words in ("· ≤ 0.05    2", "• ≤ 0.10    0", "○ ≤ 0.20    1", "● ≤ 1.00    0",
                  "■ > 1.00    1", "◄ newest"):  # fmt: skip
        assert words in text


def test_a_map_never_leaves_its_room() -> None:
    odd = volume((math.nan, 0.1), newest=1, stations=(("S1", 500.0),), planned=285)
    for width, height in product((5, 20, 38, 58, 100), (1, 10, 12, 40)):
        lines = shown(odd, width, height)
        assert all(len(line) <= width for line in lines)
        assert len(lines) <= height


# -- the right side --------------------------------------------------------------------------------


def rows_of(story: SampleRun) -> tuple[RunView, PointRows]:
    view = RunView("r")
    for record in story.records:
        view.take(record)
    return view, PointRows()


def side(story: SampleRun, width: int = WIDE, height: int = 42) -> str:
    view, table = rows_of(story)
    lines, _ = side_lines(view, table.rows(view.log), width, height, PlotStyle())
    assert len(lines) <= height
    return "\n".join(line.plain for line in lines)


def test_the_map_is_of_corrected_targets_once_there_are_any() -> None:
    assert "map: |e| as sent" in side(measuring())
    text = side(validated())
    assert "map: |e| after correction" in text
    assert "2 of 285 targets" in text
    assert "as sent: mean 1.200" in text
    assert "corrected: mean 0.100" in text
    assert "0 over" not in text


def test_the_newest_is_that_of_the_map_alone() -> None:
    view, table = rows_of(validated())
    assert Volume.of(view.log, [r for r in table.rows(view.log) if r.deviation]).newest == 1
    other = validated().point(PointId("grid", vertex=(9, 9, 9)), (1000.0, 200.0, 300.0))
    view, table = rows_of(other)
    rows = [row for row in table.rows(view.log) if row.deviation and row.point.nominal_mm]
    assert Volume.of(view.log, rows).newest == NO_POINT


def test_the_map_spans_all_stations_from_the_first_point_on() -> None:
    view, table = rows_of(measuring())
    of = Volume.of(view.log, [row for row in table.rows(view.log) if row.deviation])
    strips_mm = [each.strip_mm for each in view.log.cell.station]
    wanted_mm = max(strips_mm) - min(strips_mm)
    assert of.high_mm[1] - of.low_mm[1] >= wanted_mm
    assert [name for name, _ in of.stations] == [each.name for each in view.log.cell.station]
    assert of.station == "S1100"


def test_before_the_first_target_it_says_so() -> None:
    assert "first target" in side(begun())
    assert side_lines(RunView("r", Log()), [], 20, 10, PlotStyle())[1] is None
