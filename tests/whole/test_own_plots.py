"""A pose test and a re-check have plots of their own: as the screen draws their runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilcell.journal.log import Log
from hilcell.journal.runs import read_records
from hilcell.tui.plots import PlotStyle
from hilcell.tui.run_view import RunView
from hilcell.tui.text.plots import Choice, Measured, plot_lines, tabs_for
from hilcell.tui.text.points import point_page, row_of
from hilcell.tui.text.side import side_lines
from tests.whole.bench import SMALL, Ran, ran
from tests.whole.golden import GoldenRuns

LOOK = PlotStyle()


def view_of(run: Ran) -> RunView:
    assert run.done.returncode == 0, run.done.stderr
    view = RunView("x")
    for record in read_records(run.folder):
        view.take(record)
    return view


def page(of: Measured, tab: int = 0) -> str:
    lines = plot_lines(of, Choice(tab=tab), 119, 26, LOOK)
    assert max(line.cell_length for line in lines) <= 119
    return "\n".join(line.plain for line in lines)


def beside(view: RunView) -> str:
    rows = [row_of(view.log, point) for point in view.log.points.values()]
    lines, _ = side_lines(view, rows, 58, 42, LOOK)
    return "\n".join(line.plain for line in lines)


def test_a_pose_test_shows_each_pose_with_its_limit(golden: GoldenRuns) -> None:
    view = view_of(golden["pose-test"])
    of, log = Measured(view.log), view.log
    assert log.end is not None
    wanted = log.end.result["iso9283"]["poses"]
    found = of.figures_by_pose
    assert found.keys() == wanted.keys()
    for name, figures in found.items():
        np.testing.assert_allclose(figures, (wanted[name]["ap_mm"], wanted[name]["rp_mm"]))
    assert [tab.name for tab in tabs_for(log)] == ["pose accuracy", "repeatability"]
    for words in ("pose accuracy AP_p, mm", "P5", "limit of AP_p", "limit      3.000"):
        assert words in page(of), words
    assert "pose P3" in page(of, 1)
    for words in ("map: |e| of the poses", "20 targets", "pose accuracy AP_p, mm"):
        assert words in beside(view), words
    page_of_one = point_page(view, next(point.key for point in log.select("iso9283")))
    text = "\n".join(line.plain for line in page_of_one.lines(79))
    assert "rail" not in text.replace("rails", "")


def test_a_recheck_shows_each_target_with_its_bound(golden: GoldenRuns, tmp_path: Path) -> None:
    words = SMALL | {"recheck.calibration": str(golden["small"].folder)}
    view = view_of(ran(tmp_path, "recheck", words))
    of, log = Measured(view.log), view.log
    assert log.end is not None
    wanted = log.end.result["recheck"]["poses"]
    now_mm, bounds_mm = of.rechecked_mm
    np.testing.assert_allclose(now_mm, [each["error_mm"] for each in wanted])
    np.testing.assert_allclose(bounds_mm, [each["bound_mm"] for each in wanted])
    assert [tab.name for tab in tabs_for(log)] == ["re-check", "strip"]
    for text in ("|e| of the re-checked targets, mm", "95 % bound", "worst targets"):
        assert text in page(of), text
    assert "map: |e| re-checked" in beside(view)


def test_before_its_first_pose_a_plot_says_so() -> None:
    of = Measured(Log())
    assert of.poses == {}
    assert [len(each) for each in of.rechecked_mm] == [0, 0]
