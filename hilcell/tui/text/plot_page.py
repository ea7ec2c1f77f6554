"""The page of plots: tabs, one plot, and its figures beside it, under it, or away.

The figures are a table of the plot's series, of stations and of the worst targets, and words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from textual.content import Content

from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.geometry.statistics import figures_of, repeatability_mm
from hilcell.journal.log import Log
from hilcell.model.point import Sent
from hilcell.model.verdicts import AP, ISO, RP
from hilcell.ports import Array
from hilcell.tui.layout import BLANK, Cell, Col, Fitting, Grid, Lines, Stack, Text, section
from hilcell.tui.plots import Look, Plot, Scale, Series, draw, even_scale, log_scale
from hilcell.tui.text.plots import (
    PLACES,
    Errors3D,
    Measured,
    errors_plot,
    mark_of,
    mean_of,
    poses_plot,
    recheck_plot,
    repeat_plot,
    sorted_plot,
    strip_plot,
    sweep_plot,
)

BESIDE = 100  # columns, from which the figures stand beside the plot
GAP = 3  # columns between both
LEAST = 8  # rows of a plot
WIDTH = 31  # columns of the figures
MOST_WORST = 5
NEAR = 0.8  # of the limit
HEADS = "mean", "95 %", "max"


@dataclass(frozen=True, slots=True)
class Tab:
    """One plot of the page: its name, its drawing, its figures, what it can be turned to."""

    name: str
    make: Callable[[Measured, str], Plot]
    figures: Callable[[Measured, str, Plot, Look], Lines]
    picks: Callable[[Measured], Sequence[str]] = lambda of: ("",)
    is_log: bool = False  # at first
    may_be_log: bool = False


@dataclass(slots=True)
class Choice:
    """The state of the page: plot, station, scale and series, and the scales so far."""

    tab: int = 0
    picks: dict[int, int] = field(default_factory=dict)  # by tab
    turned: dict[int, bool] = field(default_factory=dict)  # by tab: the other kind of scale
    series: int = 0  # 0: all, else only that
    scales: dict[tuple[object, ...], Scale] = field(default_factory=dict)

    def pick(self, of: Measured, tab: Tab) -> str:
        """Return the station, or axis, that is shown."""
        picks = tab.picks(of)
        return picks[self.picks.get(self.tab, 0) % len(picks)]

    def is_log(self, tab: Tab) -> bool:
        """Whether the scale is logarithmic."""
        return tab.is_log != self.turned.get(self.tab, False) if tab.may_be_log else False

    @property
    def state(self) -> tuple[object, ...]:
        """Return what a drawing depends on."""
        return self.tab, tuple(self.picks.items()), tuple(self.turned.items()), self.series

    def turn_pick(self) -> None:
        """Choose the next station, or axis."""
        self.picks[self.tab] = self.picks.get(self.tab, 0) + 1

    def turn_scale(self) -> None:
        """Choose the other scale."""
        self.turned[self.tab] = not self.turned.get(self.tab, False)

    def turn_series(self, count: int) -> None:
        """Show the next series alone; after the last, all."""
        self.series = (self.series + 1) % (count + 1) if count > 1 else 0


@dataclass(frozen=True, slots=True)
class Shown:
    """One drawing of the page."""

    tab: Tab
    pick: str
    whole: Plot  # with all series
    plot: Plot
    scale: Scale

    @classmethod
    def of(cls, of: Measured, choice: Choice, height: int) -> Self:
        """Return what is chosen, in a scale that holds all that it held before."""
        tab = tabs_of(of.log)[choice.tab]
        pick, is_log = choice.pick(of, tab), choice.is_log(tab)
        whole = tab.make(of, pick)
        plot = whole
        if 0 < choice.series <= len(whole.series):
            plot = replace(whole, series=(whole.series[choice.series - 1],))
        name = (tab.name, is_log, pick if tab.name == "sweeps" else "")
        before, values, limits = choice.scales.get(name), whole.values, whole.limits
        scale = choice.scales[name] = (
            log_scale(values, limits, before)
            if is_log
            else even_scale(values, limits, height, before)
        )
        return cls(tab, pick, whole, plot, scale)

    @property
    def title(self) -> Content:
        """Return the plot's title."""
        scale = ", log scale" if self.scale.is_log else ""
        return Content.styled(f"{self.plot.title}{scale}", "bold")


def tab_line(of: Measured, choice: Choice, width: int, look: Look) -> Content:
    """Return the tabs, and at the right the station and how many targets it has."""
    parts: list[Content] = []
    for n, tab in enumerate(tabs_of(of.log)):
        text = f" {n + 1} {tab.name} "
        if n == choice.tab:
            text = f"[{text[1:-1]}]" if look.plain else text
            parts.append(Content.styled(text, "bold $background on $foreground"))
        else:
            parts.append(Content.styled(text, "$label" if look.letters else "$label on $panel"))
    tab = tabs_of(of.log)[choice.tab]
    right = BLANK
    if len(tab.picks(of)) > 1:
        right = Content.assemble(
            (" S ", "bold on $badge"), f" {choice.pick(of, tab) or 'all stations'}"
        )
    tabs = Fitting((Content("  ").join(parts), Content("").join(parts), parts[choice.tab]))
    return Grid([(tabs, right)], Col(grows=True), Col()).lines(width)[0]


def plot_lines(of: Measured, choice: Choice, width: int, height: int, look: Look) -> list[Content]:
    """Return title, plot and figures in at most so many rows."""
    beside = width >= BESIDE
    figures_rows = height // 3 if not beside and height >= 34 else 0
    rows = max(height - 1 - (figures_rows and figures_rows + 1), LEAST)
    shown = Shown.of(of, choice, rows)
    if not len(shown.whole.values):
        return [shown.title, Content.styled("nothing measured for this plot yet", "$label")]
    across = width - WIDTH - GAP if beside else width
    named = [replace(each, name=_short(each)) for each in shown.plot.series]
    drawn = draw(replace(shown.plot, series=tuple(named)), shown.scale, across, rows, look)
    figures = shown.tab.figures(of, shown.pick, shown.plot, look).lines(WIDTH)
    if beside:
        figures += [BLANK] * (len(drawn) - len(figures))
        both = Grid(zip(drawn, figures, strict=False), Col(across), Col(), gap=GAP)
        return [shown.title, *both.lines(width)]
    names = Content("  ").join(
        Content.assemble(mark_of(look, series.ink), (f" {_short(series)}", "$label"))
        for series in shown.plot.series
    )
    heading = Grid([(shown.title, Fitting((names,)))], Col(), Col(right=True, grows=True))
    under = [BLANK, *figures[:figures_rows]] if figures_rows else []
    return [*heading.lines(width), *drawn, *under]


# -- the figures -----------------------------------------------------------------------------------

Parts = list[Lines | Text]
Numbers = Sequence[float | str | None]
Row = tuple[Text, Text, Numbers]  # a mark, a name and at most three numbers


def _short(series: Series) -> str:
    return "paper" if series.name == Sent.IDW.text else series.name


def _table(*rows: Row, heads: Sequence[str] = (), bold: str = "") -> Grid:
    """Return rows under the heads of their numbers; ``bold``: whose first number is so."""
    shown: list[list[Cell]] = []
    if heads:
        shown.append(["", ("mm", "$label"), *((head, "$label") for head in heads)])
    for mark, name, numbers in rows:
        first, *others = map(_number, (*numbers, None, None, None)[:3])
        shown.append([mark, name, (first, "bold" if name == bold else ""), *others])
    return Grid(shown, Col(1), Col(10), *[Col(5, right=True)] * 3)


def _number(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return f"{round(value, 3) + 0.0:.3f}" if np.isfinite(value) else ""


def _figures(words: str, *rows: Row, heads: Sequence[str], title: str = "figures") -> Stack:
    """Return a heading, a table, and under it what it means."""
    return Stack(section(title), _table(*rows, heads=heads), BLANK, (words, "$label"))


def _series(plot: Plot, look: Look, numbers: Iterable[Numbers]) -> list[Row]:
    named = zip(plot.series, numbers, strict=True)
    return [(mark_of(look, each.ink), _short(each), values) for each, values in named]


def _three(values: Array) -> Numbers:
    known = values[np.isfinite(values)]
    return (*figures_of(known),) if len(known) else ()


def error_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean, 95 % and maximum of |e| by series and station, the worst, and words."""
    log, found = of.log, of.errors.at(pick)
    by_name = {way.text: values for way, values in found.by_how.items()}
    rows = _series(plot, look, (_three(by_name[each.name]) for each in plot.series))
    floor = floor_mm(log)
    if floor:
        rows.append(("", ("floor", "$label"), (floor.get("mean"), floor.get("p95"))))
    if plot.limits:
        table = log.cell.validation
        rows.append(("", "limit", (table.mean_tolerance_mm, None, table.max_tolerance_mm)))
    parts: Parts = [section("figures"), _table(*rows, heads=HEADS, bold=Sent.CHOSEN.text)]
    if Sent.CHOSEN in found.by_how:
        parts += _by_station(of.errors) + _worst(found) + _words(log, found, floor)
    return Stack(*parts)


def floor_mm(log: Log) -> Mapping[str, float]:
    """Return mean and p95 that robot and tracker leave by themselves, of a run that has ended."""
    places = log.result.get("validation", {})
    place = places.get(log.cell.grid.station, {}) if isinstance(places, dict) else {}
    floor = place.get("floor", {}) if isinstance(place, dict) else {}
    return {name: each for name, each in floor.items() if isinstance(each, float)}


def _by_station(errors: Errors3D) -> Parts:
    if len(errors.stations) < 2:
        return []
    by_station = {name: errors.at(name).by_how.get(Sent.CHOSEN) for name in errors.stations}
    rows = (("", name, _three(e)) for name, e in by_station.items() if e is not None)
    return [BLANK, section("corrected, by station"), _table(*rows)]


def _worst(found: Errors3D) -> Parts:
    errors = np.nan_to_num(found.by_how[Sent.CHOSEN], nan=-1.0)
    rows: list[Sequence[Cell]] = []
    for at in np.argsort(-errors, kind="stable")[:MOST_WORST].tolist():
        if errors[at] >= 0:
            station, number = found.targets[at]
            rows.append((f"target {number + 1}", (station, "$label"), f"{errors[at]:.3f}"))
    grid = Grid(rows, Col(11), Col(12), Col(5, right=True))
    return [BLANK, section("worst targets"), grid]


def _words(log: Log, found: Errors3D, floor: Mapping[str, float]) -> Parts:
    limit_mm = log.cell.validation.max_tolerance_mm
    errors = found.by_how[Sent.CHOSEN][np.isfinite(found.by_how[Sent.CHOSEN])]
    over = int(np.sum(~(errors <= limit_mm)))
    near = int(np.sum(errors > NEAR * limit_mm)) - over
    said = "No target near its limit."
    if over or near:
        said = f"{over} over the limit, {near} within {100 * (1 - NEAR):.0f} % of it."
    means_mm = {
        name: mean_of(found.at(name).by_how[Sent.CHOSEN])
        for name in found.stations
        if Sent.CHOSEN in found.at(name).by_how
    }
    worst = max(means_mm, key=lambda name: means_mm[name])
    worst_mm, limit_mm = means_mm[worst], log.cell.validation.mean_tolerance_mm
    of_means = "No station's mean near its limit."
    if not worst_mm <= limit_mm:
        of_means = f"Mean at {worst} {worst_mm:.3f}: over its limit {limit_mm:.3f}."
    elif worst_mm > NEAR * limit_mm:
        of_means = f"Mean at {worst} {worst_mm:.3f}: near its limit {limit_mm:.3f}."
    sentences, mean_mm = [said, of_means], mean_of(errors)
    if Sent.BEFORE in found.by_how and mean_mm > 0:
        same = found.by_how[Sent.BEFORE][np.isfinite(found.by_how[Sent.CHOSEN])]
        sentences.append(f"Mean {mean_of(same) / mean_mm:.1f} times smaller.")
    if floor.get("mean", 0) > 0:
        times = mean_mm / floor["mean"]
        sentences.append(
            f"Corrected is {times:.1f} times the floor that the robot and tracker leave by "
            "themselves."
        )
    return [BLANK, section("what it tells"), *((each, "$label") for each in sentences)]


def repeat_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean, RP (ISO 9283) and maximum of the distances from the mean, by place."""
    inks, rows = {series.name: series.ink for series in plot.series}, []
    for name, distances_mm in of.visits_mm.items():
        rp_mm = repeatability_mm(distances_mm) if len(distances_mm) > 1 else None
        numbers = (float(distances_mm.mean()), rp_mm, float(distances_mm.max()))
        rows.append((mark_of(look, inks.get(name, PLACES[0])), name, numbers))
    words = f"RP: mean + 3 s of the distances from the mean (ISO 9283, {RP.clause})."
    return _figures(words, *rows, heads=("mean", "RP", "max"))


def pose_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return AP_p and RP_l of each pose, and the limits that are stated."""
    rows: list[Row] = [
        ("", name, (*figures, str(len(of.poses[name].error_mm))))
        for name, figures in of.figures_by_pose.items()
    ]
    table = of.log.cell.iso9283
    stated, words = (table.ap_limit_mm, table.rp_limit_mm), ""
    if any(each is not None for each in stated):
        rows.append(("", "limit", stated))
    else:
        words = "No limits are stated (iso9283.ap_limit_mm, iso9283.rp_limit_mm). "
    words += f"AP_p: from the commanded place to the visits' mean (ISO 9283, {AP.clause})."
    return _figures(words, *rows, heads=("AP_p", "RP_l", "n"))


def recheck_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return |e| now and its predicted bound, mean and largest, and the worst targets."""
    now_mm, bounds_mm = of.rechecked_mm
    rows = _series(plot, look, (_three(each.y) for each in plot.series))
    if not len(bounds_mm):
        words = "The calibration predicts no bound of these targets."
        return _figures(words, *rows, heads=HEADS)
    worst: list[Row] = [
        ("", f"target {n + 1}", (float(bounds_mm[n]), None, float(now_mm[n])))
        for n in np.argsort(-now_mm, kind="stable")[:MOST_WORST].tolist()
    ]
    over = int(np.sum(~(now_mm <= bounds_mm)))
    words = f"{over} of {len(now_mm)} targets over their bound; 95 % are expected below it."
    below = _figures(words, *worst, heads=("bound", "", "now"), title="worst targets")
    return Stack(section("figures"), _table(*rows, heads=HEADS), BLANK, below)


def strip_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return mean and largest of the strip's residual, by station, and its limit."""
    rows: list[Row] = [
        ("", name, (float(values.mean()), None, float(np.abs(values).max())))
        for name, values in of.strip_mm.items()
    ]
    rail = of.log.cell.rail
    rows.append(("", "approached", (None, None, rail.strip_tolerance_mm)))
    rows.append(("", "held within", (None, None, rail.held_within_mm)))
    words = (
        "max: largest distance from the station, either way. An approach ends within the "
        "tolerance; a slide at rest may read up to twice as far off."
    )
    return _figures(words, *rows, heads=("mean", "", "max"))


def sweep_figures(of: Measured, pick: str, plot: Plot, look: Look) -> Lines:
    """Return the gear lines of every swept axis."""
    rows: list[Sequence[Cell]] = [
        [(head, "$label") for head in ("axis", "cycles/rev.", "size µrad")]
    ]
    remarks: Parts = []
    for name in of.swept:
        record = of.log.curves[int(name[1:])]
        style = "bold" if name == (pick or of.swept[0]) else "$label"
        for cycles, size in zip(record.cycles, record.amplitudes_urad, strict=True):
            rows.append([(each, style) for each in (name, f"{cycles:.1f}", f"{size:.1f}")])
        if not record.holds:
            remarks.append((f"{name} not used: {record.reason}", "$label"))
        elif not record.cycles:
            rows.append([(name, style), ("none", style), ""])
    words = ("A line is an error that comes back so often in one turn of the joint.", "$label")
    columns = Col(4), Col(13, right=True), Col(11, right=True)
    return Stack(section("gear lines"), Grid(rows, *columns), *remarks, BLANK, words)


REPEAT = Tab("repeatability", repeat_plot, repeat_figures, may_be_log=True)
TABS = (
    Tab("each target", errors_plot, error_figures, Measured.stations, is_log=True, may_be_log=True),
    Tab("sorted", sorted_plot, error_figures, Measured.stations, is_log=True, may_be_log=True),
    REPEAT,
)
STRIP = Tab("strip", strip_plot, strip_figures, lambda of: ("", *of.strip_mm))
SWEEPS = Tab("sweeps", sweep_plot, sweep_figures, lambda of: of.swept)
MOST_TABS = len((*TABS, STRIP, SWEEPS))
OF_PROCEDURE = {
    ISO: (Tab("pose accuracy", poses_plot, pose_figures, may_be_log=True), REPEAT),
    RECHECK: (Tab("re-check", recheck_plot, recheck_figures, may_be_log=True),),
}


def tabs_of(log: Log) -> tuple[Tab, ...]:
    """Return the plots of a run: of the strip where there is a rail, of sweeps that were made."""
    own = OF_PROCEDURE.get(log.plan.procedure) if log.plan is not None else None
    has_rail, swept = log.plan is None or log.cell.has_rail, own is None and log.curves
    return (*(own or TABS), *[STRIP] * has_rail, *[SWEEPS] * bool(swept))
