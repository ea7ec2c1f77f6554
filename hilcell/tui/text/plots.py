"""The page of plots: points and curves of a journal as series, and their figures.

A plot is turned by its pick: a station, or a swept axis. Its figures stand beside it, under it, or
away: a table of its series, of stations and of the worst targets, and words.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import msgspec
import numpy as np
from textual.content import Content

from hilcell.calibration.decision_rule import tolerance_limits
from hilcell.calibration.iso9283 import attained_positions
from hilcell.calibration.position_errors import Errors, counting, position_errors
from hilcell.calibration.recheck import KIND as RECHECK
from hilcell.calibration.recheck import RecheckErrors
from hilcell.decoding import typed
from hilcell.geometry.statistics import bounds95_mm, figures_of, from_mean_mm, repeatability_mm
from hilcell.journal.log import Log, positions_mm
from hilcell.language import decimal, marked, tr
from hilcell.model.point import Point, Sent
from hilcell.model.results import Floor, Place
from hilcell.model.verdicts import AP, ISO, RP
from hilcell.ports import Array, HilcellError
from hilcell.tui.layout import BLANK, Cell, Col, Fitting, Grid, Lines, Stack, Text, section
from hilcell.tui.plots import Ink, Mark, Plot, PlotStyle, Scale, Series, draw, step_at_least

STROKE = 80  # marks of a line from the bottom of a spectrum
AS_SENT = Ink("$label", "o", "$label")
PAPER = Ink("$live 70%", "+", "$label")
LIVE = Ink("$live", "x", "$live")
OTHER = Ink("$foreground", "*", "$foreground")
INKS = {Sent.BEFORE: AS_SENT, Sent.IDW: PAPER, Sent.CHOSEN: LIVE}
PLACES = (LIVE, AS_SENT, PAPER, OTHER)
MOST_TICKS = 5

Target = tuple[str, int]  # station and number


@dataclass(frozen=True, slots=True, eq=False)
class Errors3D:
    """|e| of targets (N,) in mm by how they were sent; NaN where one was not measured."""

    targets: tuple[Target, ...]
    by_how: dict[Sent, Array]
    grid: bool = False  # of the grid's points: no target was validated yet

    @classmethod
    def of(cls, points: Sequence[Point], norms_mm: Array, *, grid: bool) -> Errors3D:
        """Return |e| (N,) of points by target, in the order in which each was first measured."""
        order: dict[Target, int] = {}
        where = np.array(
            [
                order.setdefault((point.station, n if grid else point.id.number or 0), len(order))
                for n, point in enumerate(points)
            ]
        )
        hows = np.array([point.id.how or Sent.BEFORE for point in points])
        by_how: dict[Sent, Array] = {}
        for how in Sent:
            if (mine := hows == how).any():
                by_how[how] = np.full(len(order), np.nan)
                by_how[how][where[mine]] = norms_mm[mine]
        return cls(tuple(order), by_how, grid)

    def at(self, station: str) -> Errors3D:
        if not station:
            return self
        kept = [n for n, (name, _) in enumerate(self.targets) if name == station]
        by_how = {how: values[kept] for how, values in self.by_how.items()}
        some = {how: values for how, values in by_how.items() if np.isfinite(values).any()}
        return Errors3D(tuple(self.targets[n] for n in kept), some, self.grid)

    @property
    def stations(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for name, _ in self.targets))

    @property
    def corrected(self) -> dict[str, Array]:
        by_station = {name: self.at(name).by_how.get(Sent.CHOSEN) for name in self.stations}
        return {name: errors for name, errors in by_station.items() if errors is not None}


class Measured:
    """A journal as the plots see it: errors and residuals are computed once for each drawing.

    Each plot is turned by its pick.
    """

    def __init__(self, log: Log) -> None:
        self.log = log

    @cached_property
    def errors(self) -> Errors3D:
        """Return |e| of every target, in the order in which each was first measured.

        Of a target that was measured more than once the larger error counts, as in the verdict.
        """
        log = self.log
        if "world" not in log.frames:
            return Errors3D((), {})
        validated = [*log.measured("validate")]
        points = validated or [*log.measured("grid")]
        points = [counting(log, point) for point in points if point.nominal_mm is not None]
        return Errors3D.of(points, position_errors(log, points).norms_mm, grid=not validated)

    def stations(self) -> tuple[str, ...]:
        return "", *self.errors.stations

    @cached_property
    def strip_mm(self) -> dict[str, Array]:
        """Return the strip's readings less the stations' by station, at every point."""
        nominal_mm = {each.name: each.strip_mm for each in self.log.cell.station}
        offsets_mm: dict[str, list[float]] = {}
        for point in self.log.points.values():
            if point.strip_mm is not None and point.station in nominal_mm:
                off_mm = point.strip_mm - nominal_mm[point.station]
                offsets_mm.setdefault(point.station, []).append(off_mm)
        return {name: np.array(values) for name, values in offsets_mm.items()}

    @cached_property
    def visits_mm(self) -> dict[str, Array]:
        by_place: dict[str, list[Point]] = {}
        for kind in ("repeat", "repeatability", ISO):
            for point in self.log.measured(kind):
                id, place = point.id, tr("place {place}", place=(point.id.place or 0) + 1)
                if id.kind in (ISO, "repeat"):
                    place = (
                        tr("pose {pose}", pose=id.pose)
                        if id.kind == ISO
                        else f"{id.how} {id.direction}"
                    )
                by_place.setdefault(place, []).append(point)
        return {name: from_mean_mm(positions_mm(points)) for name, points in by_place.items()}

    @cached_property
    def poses(self) -> dict[str, Errors]:
        return attained_positions(self.log) if {"world", "base"} <= self.log.frames.keys() else {}

    @cached_property
    def figures_by_pose(self) -> dict[str, tuple[float, float]]:
        """Return AP_p and RP_l (mm) by pose; RP_l is NaN before the second visit."""
        figures = {}
        for name, each in self.poses.items():
            distances_mm = from_mean_mm(each.error_mm)
            rp_mm = repeatability_mm(distances_mm) if len(distances_mm) > 1 else math.nan
            figures[name] = (float(np.linalg.norm(each.error_mm.mean(axis=0))), rp_mm)
        return figures

    @cached_property
    def rechecked_mm(self) -> tuple[Array, Array]:
        """Return |e| of the re-checked targets so far (N,), and the predicted bounds, 95 %.

        Without bounds (0,) where the calibration does not predict them yet.
        """
        points = self.log.select(RECHECK)
        if not points or "world" not in self.log.frames:
            return np.zeros(0), np.zeros(0)
        try:
            result = RecheckErrors.of_run(self.log)
        except HilcellError:
            return position_errors(self.log, points).norms_mm, np.zeros(0)
        return np.linalg.norm(result.errors_mm, axis=1), bounds95_mm(result.each_mm2)

    @property
    def swept(self) -> tuple[str, ...]:
        return tuple(f"A{axis}" for axis in sorted(self.log.curves))

    def errors_plot(self, pick: str = "") -> Plot:
        errors = self.errors.at(pick)
        return target_plot(errors, *self._limit(errors))

    def sorted_plot(self, pick: str = "") -> Plot:
        """Return |e| in rising order, over the share of the targets that have less."""
        errors = self.errors.at(pick)
        series = []
        for how, y in errors.by_how.items():
            known = np.sort(y[np.isfinite(y)])
            x = np.arange(len(known)) / max(len(known), 1)
            series.append(Series(how.text, INKS[how], x, known, joined=True))
        what = tr("grid points") if errors.grid else tr("targets")
        ticks = tuple((share / 100, f"{share} %") for share in (0, 25, 50, 75, 95))
        x_title = tr("share of the {what} that have less than this error", what=what)
        return Plot(
            tr("|e| in rising order, mm"), x_title, ticks, tuple(series), *self._limit(errors)
        )

    def _limit(self, errors: Errors3D) -> tuple[tuple[float, ...], str]:
        """Return the limit and its name; there is none before anything is corrected."""
        corrected = bool(errors.by_how) and not errors.grid
        limits = (self.log.cell.validation.max_tolerance_mm,) if corrected else ()
        return limits, tr("limit of each target")

    def poses_plot(self, pick: str = "") -> Plot:
        """Return AP_p of the poses of a pose test so far, over |e| of each visit."""
        poses, limit_mm = self.poses, self.log.cell.iso9283.ap_limit_mm
        middles = _middles(len(poses))
        norms_mm = [np.linalg.norm(errors.error_mm, axis=1) for errors in poses.values()]
        x = [
            middle + np.linspace(-0.3, 0.3, len(each)) / len(poses)  # visits, around the middle
            for middle, each in zip(middles, norms_mm, strict=True)
        ]
        ap_mm = np.array([ap_mm for ap_mm, _ in self.figures_by_pose.values()])
        series = [Series(tr("each visit"), AS_SENT, np.concatenate(x), np.concatenate(norms_mm)),
                  Series("AP_p", LIVE, middles, ap_mm)] if poses else []  # fmt: skip
        ticks = tuple(zip(middles.tolist(), poses, strict=True))
        limits = () if limit_mm is None else (limit_mm,)
        title = tr("pose accuracy AP_p, mm")
        return Plot(title, tr("pose"), ticks, tuple(series), limits, tr("limit of AP_p"))

    def recheck_plot(self, pick: str = "") -> Plot:
        """Return |e| of the targets of a re-check, beside the bound that is predicted."""
        found_mm, bounds_mm = self.rechecked_mm
        x = _middles(len(found_mm))
        series = [Series(tr("now"), LIVE, x, found_mm)] if len(found_mm) else []
        if len(bounds_mm):
            series.insert(0, Series(tr("95 % bound"), PAPER, x, bounds_mm))
        title = tr("|e| of the re-checked targets, mm")
        return Plot(title, tr("re-checked target"), _counted(len(x) or 1), tuple(series))

    def repeat_plot(self, pick: str = "") -> Plot:
        """Return how far repeated readings of a place lie from their mean."""
        values = self.visits_mm
        if len(values) > len(PLACES):
            values = {tr("all visits"): np.concatenate([*values.values()])}
        count = max((len(each) for each in values.values()), default=1)
        series = [
            Series(name, ink, _middles(len(y), count), y)
            for ink, (name, y) in zip(PLACES, values.items(), strict=False)
        ]
        title = tr("distance from the mean of the visits, mm")
        return Plot(title, tr("visit"), _counted(count), tuple(series))

    def strip_plot(self, pick: str = "") -> Plot:
        """Return the strip's reading less the station's value at every point, in its own scale.

        The limit is that of a slide that is held: twice the tolerance to which it was approached.
        """
        shown = [each for name, each in self.strip_mm.items() if pick in ("", name)]
        values = np.concatenate([np.zeros(0), *shown])
        within_mm, count = self.log.cell.rail.hold_limit_mm, len(values)
        series = (Series(tr("strip"), LIVE, _middles(count), values),) if count else ()
        title = tr("strip's reading less the station's, mm")
        return Plot(title, tr("point"), _counted(count), series, (within_mm, -within_mm),
                    tr("station held within"))  # fmt: skip

    def sweep_plot(self, pick: str = "") -> Plot:
        """Return the spectrum of a swept axis, with the lines of its gears."""
        axes = self.swept
        title, x_title = tr("transmission error, µrad"), tr("cycles per revolution of the joint")
        if not axes:
            return Plot(title, x_title, (), ())
        record = self.log.curves[int((pick or axes[0])[1:])]
        spectrum = np.array(record.spectrum).reshape(-1, 2)
        most = 1.02 * float(spectrum[:, 0].max(initial=1.0))
        step = step_at_least(most / MOST_TICKS)
        ticks = [
            (n * step / most, decimal(f"{n * step:g}")) for n in range(math.floor(most / step) + 1)
        ]
        series = [
            Series(tr("spectrum"), AS_SENT, spectrum[:, 0] / most, spectrum[:, 1], joined=True)
        ]
        lines = [*zip(record.cycles, record.amplitudes_urad, strict=True)]
        if lines:
            x = np.repeat([cycles / most for cycles, _ in lines], STROKE)
            y = np.concatenate([np.linspace(0.0, size, STROKE) for _, size in lines])
            series.append(Series(tr("gear lines"), LIVE, x, y))
        marks = tuple(Mark(decimal(f"{cycles:.1f}"), cycles / most, size) for cycles, size in lines)
        used = "" if record.holds else tr("; not used: {reason}", reason=record.reason)
        title = tr("{title}: axis A{axis}{used}", title=title, axis=record.axis, used=used)
        return Plot(title, x_title, tuple(ticks), tuple(series),
                    marks=marks)  # fmt: skip


def target_plot(errors: Errors3D, limits: tuple[float, ...], limit_name: str) -> Plot:
    count, x = max(len(errors.targets), 1), _middles(len(errors.targets))
    series = [Series(how.text, INKS[how], x, y) for how, y in errors.by_how.items()]
    what = tr("grid point") if errors.grid else tr("target")
    title = tr("|e| {what} by {what}, mm", what=what)
    return Plot(title, what, _counted(count), tuple(series), limits, limit_name)


def _middles(count: int, of: int | None = None) -> Array:
    """Return the middles (count,), in shares of the width, of things that are ``of`` in a row."""
    return (np.arange(count) + 0.5) / (of or max(count, 1))


def _counted(count: int) -> tuple[tuple[float, str], ...]:
    """Return ticks for things that are counted from 1."""
    step = round(step_at_least(max(count / MOST_TICKS, 1.0)))
    numbers = [1, *range(step, count + 1, step)]
    return tuple(((n - 0.5) / max(count, 1), str(n)) for n in dict.fromkeys(numbers))


def legend_mark(style: PlotStyle, ink: Ink) -> Content:
    words = ink.letter, ink.words
    return Content.styled(*words) if style.letters else Content.styled("■", ink.colour)


def validated_places(log: Log) -> dict[str, Place]:
    """Return the places of a validation that has ended; none of another procedure's result."""
    with suppress(msgspec.ValidationError):
        return typed(log.result.get("validation", {}), dict[str, Place])
    return {}


def finite_mean(values: Array) -> float:
    """Return the mean of the values (N,) that are numbers; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


BESIDE = 100  # columns, from which the figures stand beside the plot
GAP = 3  # columns between both
LEAST = 8  # rows of a plot
WIDTH = 31  # columns of the figures
HEADS = marked("mean"), "95 %", marked("max")


@dataclass(frozen=True, slots=True)
class Tab:
    """One plot of the page: its name, its drawing, its figures, what it can be turned to.

    ``is_log``: whether its scale is, at first; None where its values are not all above zero.
    """

    name: str
    make: Callable[[Measured, str], Plot]
    figures: Callable[[Figures], Lines]
    picks: Callable[[Measured], Sequence[str]] = lambda of: ("",)
    is_log: bool | None = None


@dataclass(slots=True)
class Choice:
    """The state of the page: plot, station, scale and series, and the scales so far."""

    tab: int = 0
    picks: Counter[int] = field(default_factory=Counter)  # by tab
    turned: Counter[int] = field(default_factory=Counter)  # by tab: to the other kind of scale
    series: int = 0  # 0: all, else only that
    scales: dict[tuple[object, ...], Scale] = field(default_factory=dict)

    def pick(self, of: Measured, tab: Tab) -> str:
        picks = tab.picks(of)
        return picks[self.picks[self.tab] % len(picks)]

    def is_log(self, tab: Tab) -> bool:
        return tab.is_log is not None and tab.is_log != bool(self.turned[self.tab] % 2)

    def turn_series(self, count: int) -> None:
        self.series = (self.series + 1) % (count + 1) if count > 1 else 0

    def scale(self, tab: Tab, plot: Plot, pick: str, height: int) -> Scale:
        """Return a scale for all series of a plot, which holds all that it held before."""
        is_log = self.is_log(tab)
        name = (tab.name, is_log, pick if tab is SWEEPS else "")
        included = plot.values, plot.limits
        before = self.scales.get(name)
        scale = Scale.log(*included, before) if is_log else Scale.even(*included, height, before)
        self.scales[name] = scale
        return scale


def tab_line(of: Measured, choice: Choice, width: int, style: PlotStyle) -> Content:
    parts, tabs = list[Content](), tabs_for(of.log)
    for n, tab in enumerate(tabs):
        text = f" {n + 1} {tr(tab.name)} "
        if n == choice.tab:
            text = f"[{text[1:-1]}]" if style.plain else text
            parts.append(Content.styled(text, "bold $background on $foreground"))
        else:
            parts.append(Content.styled(text, "$label" if style.letters else "$label on $panel"))
    tab, right = tabs[choice.tab], BLANK
    if len(tab.picks(of)) > 1:
        pick = choice.pick(of, tab) or tr("all stations")
        right = Content.assemble((tr(" S "), "bold on $badge"), f" {pick}")
    left = Fitting((Content("  ").join(parts), Content("").join(parts), parts[choice.tab]))
    return Grid([(left, right)], Col(grows=True), Col()).lines(width)[0]


def plot_lines(
    of: Measured, choice: Choice, width: int, height: int, style: PlotStyle
) -> list[Content]:
    beside = width >= BESIDE
    figures_rows = height // 3 if not beside and height >= 34 else 0
    rows = max(height - 1 - (figures_rows and figures_rows + 1), LEAST)
    tab = tabs_for(of.log)[choice.tab]
    pick = choice.pick(of, tab)
    plot = tab.make(of, pick)
    scale = choice.scale(tab, plot, pick, rows)
    title = Content.styled(f"{plot.title}{tr(', log scale') * scale.is_log}", "bold")
    if not len(plot.values):
        return [title, Content.styled(tr("nothing measured for this plot yet"), "$label")]
    if 0 < choice.series <= len(plot.series):
        plot = replace(plot, series=plot.series[choice.series - 1 : choice.series])
    across = width - WIDTH - GAP if beside else width
    named = tuple(replace(each, name=_short(each)) for each in plot.series)
    drawn = draw(replace(plot, series=named), scale, across, rows, style)
    figures = tab.figures(Figures(of, pick, plot, style)).lines(WIDTH)
    if beside:
        figures += [BLANK] * (len(drawn) - len(figures))
        both = Grid(zip(drawn, figures, strict=False), Col(across), Col(), gap=GAP)
        return [title, *both.lines(width)]
    names = Content("  ").join(
        Content.assemble(legend_mark(style, each.ink), (f" {tr(each.name)}", "$label"))
        for each in named
    )
    heading = Grid([(title, Fitting((names,)))], Col(), Col(right=True, grows=True))
    under = [BLANK, *figures[:figures_rows]] if figures_rows else []
    return [*heading.lines(width), *drawn, *under]


# -- the figures -----------------------------------------------------------------------------------

Numbers = Sequence[float | str | None]
Row = tuple[Text, Text, Numbers]  # a mark, a name and at most three numbers


def _short(series: Series) -> str:
    return tr("paper" if series.name == Sent.IDW.text else series.name)


def _table(*rows: Row, heads: Sequence[str] = (), bold: str = "") -> Grid:
    """Return rows under the heads of their numbers; ``bold``: whose first number is so."""
    shown: list[list[Cell]] = []
    if heads:
        shown.append(["", ("mm", "$label"), *((tr(head), "$label") for head in heads)])
    for mark, name, numbers in rows:
        first, *others = map(_number, (*numbers, None, None, None)[:3])
        shown.append([mark, name, (first, "bold" if name == bold else ""), *others])
    return Grid(shown, Col(1), Col(10), *[Col(5, right=True)] * 3)


def _number(value: float | str | None) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return decimal(f"{round(value, 3) + 0.0:.3f}") if np.isfinite(value) else ""


def _figures(words: str, *rows: Row, heads: Sequence[str], title: str = marked("figures")) -> Stack:
    return Stack(section(tr(title)), _table(*rows, heads=heads), BLANK, (words, "$label"))


def _three(values: Array) -> Numbers:
    known = values[np.isfinite(values)]
    return (*figures_of(known),) if len(known) else ()


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of a plot that is turned to its pick, as tables and words."""

    MOST_WORST: ClassVar = 5
    NEAR: ClassVar = 0.8  # of the limit

    of: Measured
    pick: str
    plot: Plot
    style: PlotStyle

    def errors(self) -> Lines:
        """Return mean, 95 % and maximum of |e| by series and station, the worst, and words."""
        log, errors = self.of.log, self.of.errors.at(self.pick)
        by_name = {how.text: values for how, values in errors.by_how.items()}
        rows = self._series(_three(by_name[each.name]) for each in self.plot.series)
        place = validated_places(log).get(log.cell.grid.station)
        floor = None if place is None else place.floor
        if floor is not None:
            rows.append(("", (tr("floor"), "$label"), (floor.mean, floor.p95)))
        if self.plot.limits:
            limits = tolerance_limits(log.cell)
            rows.append(("", tr("limit"), (limits.mean_mm, None, limits.max_mm)))
        parts: list[Lines | Text] = [
            section(tr("figures")),
            _table(*rows, heads=HEADS, bold=tr(Sent.CHOSEN.text)),
        ]
        if Sent.CHOSEN in errors.by_how:
            parts += self._by_station() + self._worst(errors) + self._words(errors, floor)
        return Stack(*parts)

    def visits(self) -> Lines:
        """Return mean, RP (ISO 9283) and maximum of the distances from the mean, by place."""
        inks, rows = {series.name: series.ink for series in self.plot.series}, []
        for name, distances_mm in self.of.visits_mm.items():
            rp_mm = repeatability_mm(distances_mm) if len(distances_mm) > 1 else None
            numbers = (float(distances_mm.mean()), rp_mm, float(distances_mm.max()))
            rows.append((legend_mark(self.style, inks.get(name, PLACES[0])), name, numbers))
        words = tr(
            "RP: mean + 3 s of the distances from the mean (ISO 9283, {clause}).", clause=RP.clause
        )
        return _figures(words, *rows, heads=(tr("mean"), "RP", tr("max")))

    def poses(self) -> Lines:
        rows: list[Row] = [
            ("", name, (*figures, str(len(self.of.poses[name].error_mm))))
            for name, figures in self.of.figures_by_pose.items()
        ]
        table = self.of.log.cell.iso9283
        stated, words = (table.ap_limit_mm, table.rp_limit_mm), ""
        if any(each is not None for each in stated):
            rows.append(("", tr("limit"), stated))
        else:
            words = tr("No limits are stated (iso9283.ap_limit_mm, iso9283.rp_limit_mm). ")
        words += tr(
            "AP_p: from the commanded place to the visits' mean (ISO 9283, {clause}).",
            clause=AP.clause,
        )
        return _figures(words, *rows, heads=("AP_p", "RP_l", "n"))

    def recheck(self) -> Lines:
        """Return |e| now and its predicted bound, mean and largest, and the worst targets."""
        now_mm, bounds_mm = self.of.rechecked_mm
        rows = self._series(_three(each.y) for each in self.plot.series)
        if not len(bounds_mm):
            words = tr("The calibration predicts no bound of these targets.")
            return _figures(words, *rows, heads=HEADS)
        worst: list[Row] = [
            ("", tr("target {n}", n=n + 1), (float(bounds_mm[n]), None, float(now_mm[n])))
            for n in np.argsort(-now_mm, kind="stable")[: Figures.MOST_WORST].tolist()
        ]
        over = int(np.sum(~(now_mm <= bounds_mm)))
        words = tr(
            "{over} of {n} targets over their bound; 95 % are expected below it.",
            over=over,
            n=len(now_mm),
        )
        below = _figures(
            words, *worst, heads=(tr("bound"), "", tr("now")), title=tr("worst targets")
        )
        return Stack(section(tr("figures")), _table(*rows, heads=HEADS), BLANK, below)

    def strip(self) -> Lines:
        """Return mean and largest of the strip's residual, by station, and its limit."""
        rows: list[Row] = [
            ("", name, (float(values.mean()), None, float(np.abs(values).max())))
            for name, values in self.of.strip_mm.items()
        ]
        rail = self.of.log.cell.rail
        rows.append(("", tr("approached"), (None, None, rail.strip_tolerance_mm)))
        rows.append(("", tr("held within"), (None, None, rail.hold_limit_mm)))
        words = tr(
            "max: largest distance from the station, either way. An approach ends within the "
            "tolerance; a slide at rest may read up to twice as far off."
        )
        return _figures(words, *rows, heads=(tr("mean"), "", tr("max")))

    def sweeps(self) -> Lines:
        heads = (tr("axis"), tr("cycles/rev."), tr("size µrad"))
        rows: list[Sequence[Cell]] = [[(head, "$label") for head in heads]]
        remarks: list[Lines | Text] = []
        for name in self.of.swept:
            record = self.of.log.curves[int(name[1:])]
            style = "bold" if name == (self.pick or self.of.swept[0]) else "$label"
            for cycles, size in zip(record.cycles, record.amplitudes_urad, strict=True):
                rows.append(
                    [
                        (each, style)
                        for each in (name, decimal(f"{cycles:.1f}"), decimal(f"{size:.1f}"))
                    ]
                )
            if not record.holds:
                remarks.append(
                    (tr("{name} not used: {reason}", name=name, reason=record.reason), "$label")
                )
            elif not record.cycles:
                rows.append([(name, style), (tr("none"), style), ""])
        words = (
            tr("Each line is an error, with its cycles per revolution of the joint."),
            "$label",
        )
        columns = Col(4), Col(13, right=True), Col(11, right=True)
        return Stack(section(tr("gear lines")), Grid(rows, *columns), *remarks, BLANK, words)

    def _series(self, numbers: Iterable[Numbers]) -> list[Row]:
        named = zip(self.plot.series, numbers, strict=True)
        return [(legend_mark(self.style, each.ink), _short(each), values) for each, values in named]

    def _by_station(self) -> list[Lines | Text]:
        errors = self.of.errors
        if len(errors.stations) < 2:
            return []
        rows = (("", name, _three(values)) for name, values in errors.corrected.items())
        return [BLANK, section(tr("corrected, by station")), _table(*rows)]

    @staticmethod
    def _worst(errors: Errors3D) -> list[Lines | Text]:
        norms_mm = np.nan_to_num(errors.by_how[Sent.CHOSEN], nan=-1.0)
        rows: list[Sequence[Cell]] = []
        for at in np.argsort(-norms_mm, kind="stable")[: Figures.MOST_WORST].tolist():
            if norms_mm[at] >= 0:
                station, number = errors.targets[at]
                rows.append(
                    (
                        tr("target {n}", n=number + 1),
                        (station, "$label"),
                        decimal(f"{norms_mm[at]:.3f}"),
                    )
                )
        grid = Grid(rows, Col(11), Col(12), Col(5, right=True))
        return [BLANK, section(tr("worst targets")), grid]

    def _words(self, errors: Errors3D, floor: Floor | None) -> list[Lines | Text]:
        limits = tolerance_limits(self.of.log.cell)
        known = np.isfinite(errors.by_how[Sent.CHOSEN])
        norms_mm = errors.by_how[Sent.CHOSEN][known]
        over = int(np.sum(~(norms_mm <= limits.max_mm)))
        near = int(np.sum(norms_mm > self.NEAR * limits.max_mm)) - over
        sentence = tr("No target near its limit.")
        if over or near:
            sentence = tr(
                "{over} over the limit, {near} within {percent:.0f} % of it.",
                over=over,
                near=near,
                percent=100 * (1 - self.NEAR),
            )
        means_mm = {name: finite_mean(values) for name, values in errors.corrected.items()}
        worst = max(means_mm, key=means_mm.__getitem__)
        of_means = tr("No station's mean near its limit.")
        if not means_mm[worst] <= self.NEAR * limits.mean_mm:
            how = tr("near") if means_mm[worst] <= limits.mean_mm else tr("over")
            mean = tr("Mean at {station} {mean_mm:.3f}", station=worst, mean_mm=means_mm[worst])
            of_means = tr(
                "{mean}: {how} its limit {limit_mm:.3f}.",
                mean=mean,
                how=how,
                limit_mm=limits.mean_mm,
            )
        sentences, mean_mm = [sentence, of_means], finite_mean(norms_mm)
        if Sent.BEFORE in errors.by_how and mean_mm > 0:
            times = finite_mean(errors.by_how[Sent.BEFORE][known]) / mean_mm
            sentences.append(tr("Mean {times:.1f} times smaller.", times=times))
        if floor is not None and floor.mean > 0:
            sentences.append(
                tr(
                    "Corrected is {times:.1f} times the floor that the robot and tracker leave by "
                    "themselves.",
                    times=mean_mm / floor.mean,
                )
            )
        return [BLANK, section(tr("what it tells")), *((each, "$label") for each in sentences)]


REPEAT = Tab(marked("repeatability"), Measured.repeat_plot, Figures.visits, is_log=False)
TABS = (
    Tab(
        marked("each target"), Measured.errors_plot, Figures.errors, Measured.stations, is_log=True
    ),
    Tab(marked("sorted"), Measured.sorted_plot, Figures.errors, Measured.stations, is_log=True),
    REPEAT,
)
STRIP = Tab(marked("strip"), Measured.strip_plot, Figures.strip, lambda of: ("", *of.strip_mm))
SWEEPS = Tab(marked("sweeps"), Measured.sweep_plot, Figures.sweeps, lambda of: of.swept)
MOST_TABS = len((*TABS, STRIP, SWEEPS))
OF_PROCEDURE = {
    ISO: (Tab(marked("pose accuracy"), Measured.poses_plot, Figures.poses, is_log=False), REPEAT),
    RECHECK: (Tab(marked("re-check"), Measured.recheck_plot, Figures.recheck, is_log=False),),
}


def tabs_for(log: Log) -> tuple[Tab, ...]:
    """Return the plots of a run: of the strip where there is a rail, of sweeps that were made."""
    own = OF_PROCEDURE.get(log.plan.procedure) if log.plan is not None else None
    has_rail, swept = log.plan is None or log.cell.has_rail, own is None and log.curves
    return (*(own or TABS), *[STRIP] * has_rail, *[SWEEPS] * bool(swept))
