"""The plots of a run: the report's figures, drawn where they belong."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hilcell.calibration.position_errors import position_errors
from hilcell.journal.log import Log
from hilcell.model.point import PointId, Sent
from hilcell.tui.plots import PlotStyle
from hilcell.tui.text.plots import (
    BESIDE,
    STRIP,
    TABS,
    Choice,
    Figures,
    Measured,
    plot_lines,
    tab_line,
    tabs_for,
)
from tests.hilcell.report.journals import validated_run
from tests.hilcell.tui.sample_runs import SampleRun, measuring, validated
from tests.hilcell.tui.test_points import changed
from tests.hilcell.tui.views import drawn

LETTERS = PlotStyle(letters=True, plain=True)


def measured_errors(story: SampleRun) -> Measured:
    return Measured(Log(story.records))


def test_plots_show_the_reports_errors(tmp_path: Path) -> None:
    log = validated_run(tmp_path / "run").facts().log
    for how in Sent:
        points = log.select("validate", how=how)
        if points:
            wanted = position_errors(log, points).norms_mm
            np.testing.assert_allclose(Measured(log).errors.by_how[how], wanted, atol=1e-9)


def test_each_way_is_a_series_with_the_name_of_the_work() -> None:
    of = measured_errors(validated())
    for make in (Measured.errors_plot, Measured.sorted_plot):
        names = [series.name for series in make(of).series]
        assert names == ["as sent", "paper method", "corrected"]
        assert make(of).limits == (of.log.cell.validation.max_tolerance_mm,)
    assert np.all(np.diff(of.sorted_plot().series[1].y) >= 0)


def test_before_validation_the_grids_errors_have_no_limit() -> None:
    plot = measured_errors(measuring()).errors_plot()
    assert [series.name for series in plot.series] == ["as sent"]
    assert plot.limits == ()


def test_a_target_that_was_not_measured_yet_keeps_its_place() -> None:
    story = validated()
    story.records = [r for r in story.records if r.key != "validate/S1100/chosen/000"]
    found = measured_errors(story).errors
    assert math.isnan(found.by_how[Sent.CHOSEN][0])
    assert found.by_how[Sent.CHOSEN][1] == pytest.approx(np.hypot(0.1, 0.01))
    assert np.isfinite(found.by_how[Sent.BEFORE]).all()


@pytest.mark.parametrize(("again_mm", "wanted_mm"), [(0.3, 0.4), (0.5, 0.5)])
def test_of_a_target_measured_again_the_larger_error_is_drawn(
    again_mm: float, wanted_mm: float
) -> None:
    id = PointId("validate", station="S1100", how="chosen", number=1)
    story = validated(worst_mm=0.4)
    story.point(id, (1100.0, 301.0, 400.0), (0.0, again_mm, 0.0), retaken=True)
    of = measured_errors(story)
    assert of.errors.by_how[Sent.CHOSEN][1] == pytest.approx(wanted_mm, abs=1e-3)
    lines = plot_lines(of, Choice(), 130, 30, LETTERS)
    [worst] = [line.plain for line in lines if "target 2" in line.plain]
    assert f"{wanted_mm:.3f}" in worst


@pytest.mark.parametrize(
    ("tolerance_mm", "said"),
    [(0.030, "over its limit 0.030"), (0.110, "near its limit 0.110"), (0.2, "No station's mean")],
)
def test_words_beside_the_errors_speak_of_the_mean_too(tolerance_mm: float, said: str) -> None:
    of = measured_errors(validated())
    plan = of.log.inputs
    table = plan.cell["validation"] | {"mean_tolerance_mm": tolerance_mm}
    of.log.plan = msgspec.structs.replace(plan, cell=plan.cell | {"validation": table})
    text = " ".join(drawn(Figures(of, "", of.errors_plot(), LETTERS).errors(), 31).split())
    assert "No target near its limit." in text
    assert said in text


def test_a_station_has_its_own_targets() -> None:
    story = validated()
    other = PointId("validate", station="S300", how="before", number=0)
    story.point(other, (1100.0, -300.0, 400.0), (0.0, 0.0, 3.0), station="S300")
    of = measured_errors(story)
    assert of.errors.stations == ("S1100", "S300")
    assert of.errors.at("S300").targets == (("S300", 0),)
    assert list(of.errors.at("S300").by_how) == [Sent.BEFORE]
    assert len(of.errors.at("").targets) == 3


def test_repeated_visits_scatter_about_their_mean() -> None:
    story = measuring(0)
    for place in range(2):
        for visit, x in enumerate((0.0, 0.3)):
            id = PointId("repeatability", place=place, number=visit)
            story.point(id, off=(x + place, 0.0, 0.0))
    series = measured_errors(story).repeat_plot().series
    assert [each.name for each in series] == ["place 1", "place 2"]
    for each in series:
        assert each.y == pytest.approx([0.15, 0.15])


def test_many_places_become_one_series() -> None:
    story = measuring(0)
    for place in range(5):
        for visit in range(2):
            story.point(PointId("repeatability", place=place, number=visit))
    (series,) = measured_errors(story).repeat_plot().series
    assert len(series.y) == 10


def test_the_strip_is_shown_less_its_station_between_its_limits() -> None:
    of = measured_errors(measuring(2))
    station = next(each for each in of.log.cell.station if each.name == "S1100")
    changed(of.log, "grid/0-0-1", strip_mm=station.strip_mm + 0.02)
    plot = of.strip_plot()
    assert plot.series[0].y == pytest.approx([0.0, 0.02])
    within_mm = 2.0 * of.log.cell.rail.strip_tolerance_mm
    assert plot.limits == (within_mm, -within_mm)
    assert plot.limit_name == "station held within"


@pytest.mark.parametrize("tab", TABS, ids=lambda tab: tab.name)
def test_every_plot_is_drawn_at_any_size(tab: Any) -> None:
    for story in (measuring(0), validated()):
        of = measured_errors(story)
        for size, style in product(
            [(20, 8), (80, 20), (80, 40), (200, 60)], (PlotStyle(), LETTERS)
        ):
            choice = Choice(tab=TABS.index(tab))
            lines = [tab_line(of, choice, size[0], style), *plot_lines(of, choice, *size, style)]
            assert len(lines) <= max(size[1], 9) + 1
            assert "\x1b" not in "".join(line.plain for line in lines)


def test_figures_stand_beside_the_plot_or_under_it_or_are_away() -> None:
    of = measured_errors(validated())

    def at(width: int, height: int) -> list[str]:
        return [line.plain for line in plot_lines(of, Choice(tab=1), width, height, PlotStyle())]

    beside, under, away = at(BESIDE, 30), at(80, 40), at(80, 20)
    assert any("┤" in line and "─ figures" in line for line in beside)
    assert any(line.startswith("─ figures") for line in under)
    assert not any("figures" in line for line in away)
    assert "corrected" in away[0]  # the key, where no figures name the series


def test_figures_say_mean_limit_and_the_worst() -> None:
    of = measured_errors(validated(worst_mm=1.2))
    plot = of.errors_plot()
    text = drawn(Figures(of, "", plot, PlotStyle()).errors(), 31)
    limit_mm = of.log.cell.validation.max_tolerance_mm
    assert f"{limit_mm:.3f}" in text
    assert "target 2    S1100        1.200" in text
    assert "1 over the limit" in text
    mean_mm = of.errors.by_how[Sent.CHOSEN].mean()
    assert f"{1.2 / mean_mm:.1f} times smaller" in " ".join(text.split())


def test_the_scale_of_a_live_run_only_grows() -> None:
    choice = Choice(tab=0)
    plot_lines(measured_errors(validated(worst_mm=30.0)), choice, 120, 30, PlotStyle())
    (before,) = choice.scales.values()
    plot_lines(measured_errors(validated()), choice, 120, 30, PlotStyle())
    assert choice.scales == {("each target", True, ""): before}
    assert before.high == 50.0


def test_only_errors_above_zero_have_a_log_scale() -> None:
    for tab in TABS:
        choice = Choice(tab=TABS.index(tab))
        choice.turned[choice.tab] += 1
        assert choice.is_log(tab) == (tab.is_log is False)


def test_series_are_shown_one_by_one_and_then_all() -> None:
    choice = Choice()
    seen = []
    for _ in range(4):
        seen.append(choice.series)
        choice.turn_series(3)
    assert seen == [0, 1, 2, 3]
    assert choice.series == 0


def test_a_robot_on_the_floor_has_no_strip(tmp_path: Path) -> None:
    log = validated_run(tmp_path / "run").facts().log
    assert Measured.strip_plot in [tab.make for tab in tabs_for(log)]
    of, choice = Measured(log), Choice(tab=tabs_for(log).index(STRIP))
    assert choice.scale(STRIP, STRIP.make(of, ""), "", 20).step > 0
