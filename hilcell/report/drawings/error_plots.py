"""Errors drawn: of targets in order, beside bounds, as vectors, in short; of gears; over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from hilcell.calibration.decision_rule import tolerance_limits
from hilcell.calibration.from_run import calibration_so_far
from hilcell.calibration.measurement_budget import control_moves
from hilcell.calibration.position_errors import Errors, grid_errors, validation
from hilcell.calibration.validity import TEMPERATURE_MARGIN_K
from hilcell.geometry.statistics import lengths_mm
from hilcell.journal.log import run_noise
from hilcell.model.events import CurveMeasured
from hilcell.model.point import BOTH, Sent
from hilcell.model.records import StateChanged
from hilcell.model.results import Repeated
from hilcell.ports import Array
from hilcell.report.budgets import Row, TargetBudget, target_rows
from hilcell.report.drawings.drawing import (
    AFTER,
    BAND,
    BEFORE,
    ENDS,
    HAIR,
    HATCH,
    INK,
    MUTED,
    NEAREST_MM,
    Frame,
    Scale,
    apart,
    circle,
    hatched,
    labels,
    path,
    rectangle,
    round_up,
    shortened,
    svg,
    text,
    text_width_mm,
)
from hilcell.report.facts import Facts
from hilcell.report.first_page import Result
from hilcell.run import watch

WIDTH_MM, HEIGHT_MM, LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 88.0, 54.0, 10.0, 22.0, 6.0, 10.0
PERCENTS = [(each, f"{each:g}") for each in (0.0, 25.0, 50.0, 75.0, 100.0)]


def _frame(y: Scale) -> Frame:
    return Frame(Scale(0.0, 100.0, LEFT_MM, WIDTH_MM - RIGHT_MM), y)


def _curve(frame: Frame, norms_mm: Array, colour: str, dash: str) -> str:
    shares = 100 * (np.arange(len(norms_mm)) + 0.5) / len(norms_mm)
    return path(frame.at(shares, np.sort(norms_mm)), colour, 0.7, dash)


def _views(name: str, errors: Errors, colour: str, top: float, width_mm: float) -> Iterator[str]:
    panel_mm, gap_mm, left_mm, top_mm = 31.0, 10.0, 9.0, 8.0
    low, high = errors.nominal_mm.min(axis=0), errors.nominal_mm.max(axis=0)
    span = 1.3 * (float((high - low).max()) or 1000.0)  # of a cube with a margin
    low = (low + high) / 2 - span / 2
    scale = panel_mm / span
    share = 0.1  # of the panel, that the largest error is drawn as, at most
    factor = round_down(share * span / max(errors.figures.max, 1e-6))
    title = f"{name}, {factor:g} times enlarged"
    yield text(0.0, top + 3.0, title, bold=True, most_mm=width_mm)
    views = (("from above", 0, 1), ("from the side", 1, 2), ("from the front", 0, 2))
    axes = "xyz"
    for n, (seen, across, up) in enumerate(views):
        left = left_mm + n * (panel_mm + gap_mm)
        box = top + top_mm
        yield rectangle(left, box, panel_mm, panel_mm, "none", HAIR)
        yield text(left + panel_mm / 2, box - 1.0, seen, "middle", MUTED)
        yield text(left - 1.0, box + panel_mm / 2, axes[up], "end", MUTED)
        for value, y in ((low[up] + span, box + 3.0), (low[up], box + panel_mm)):
            yield text(left - 1.0, y, f"{value:.0f}", "end", MUTED)
        below = box + panel_mm + 3.4
        yield text(left, below, f"{low[across]:.0f}", "start", MUTED)
        yield text(left + panel_mm / 2, below, axes[across], "middle", MUTED)
        yield text(left + panel_mm, below, f"{low[across] + span:.0f}", "end", MUTED)
        corner = np.array([low[across], low[up]])
        nominal = (errors.nominal_mm[:, (across, up)] - corner) * scale
        foot = np.array([left, box + panel_mm]) + nominal * (1, -1)
        end = foot + errors.error_mm[:, (across, up)] * factor * scale * (1, -1)
        gap = np.full_like(foot, np.nan)
        yield path(np.stack([foot, end, gap], axis=1).reshape(-1, 2), colour, 0.35)
        yield "".join(circle(x, y, 0.3, INK, "none") for x, y in foot)
    bar_mm = round_down(max(errors.figures.max, 1e-6))
    y, x = top + top_mm + panel_mm + 6.2, left_mm
    yield path([(x, y), (x + bar_mm * factor * scale, y)], colour, 0.8)
    yield text(x + bar_mm * factor * scale + 1.0, y + 1.0, f"error {bar_mm:g} mm")


def round_down(value: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)


def strip(results: list[tuple[str, Result]], simulated: bool) -> str:
    """Return a row a named result: limit, before, after with U; "" where there are none.

    All are on one logarithmic scale.
    """
    if not results:
        return ""
    width_mm, row_mm, left_mm, top_mm = 120.0, 8.6, 26.0, 4.2
    largest = max(max(each.before or 0.0, 1.6 * each.limit) for _, each in results)
    least_mm = 0.005  # the scale begins here
    scale = Scale(least_mm, 1.3 * largest, left_mm, width_mm - 2.0, logarithmic=True)
    bottom = top_mm + row_mm * len(results)
    parts = list[str]()
    for n, (name, each) in enumerate(results):
        parts += _strip_row(name, each, scale, top_mm + row_mm * (n + 0.5))
    parts.append(path([(scale.begin, bottom), (scale.end, bottom)]))
    for tick in scale.ticks():
        at = scale.one(tick)
        parts += [path([(at, bottom), (at, bottom + 0.8)]),
                  text(at, bottom + 3.8, f"{tick:g}", "middle", MUTED)]  # fmt: skip
    middle = (scale.begin + scale.end) / 2
    parts.append(text(middle, bottom + 7.2, "3-D error, mm (logarithmic)", "middle", MUTED))
    title = "Limit, before, and after with its uncertainty"
    return svg(width_mm, bottom + 8.4, title, parts, simulated)


def _strip_row(name: str, result: Result, scale: Scale, y: float) -> Iterator[str]:
    limit, after = scale.one(result.limit), scale.one(result.after)
    named = [(after, f"after {result.after:.3f}", AFTER)]
    room_mm = scale.begin - 1.0
    yield text(0.0, y + 1.0, shortened(name, room_mm), bold=True, most_mm=room_mm)
    yield hatched(limit, y - 2.4, scale.end - limit, 5.0)
    yield path([(scale.begin, y), (scale.end, y)], "#c9d0d8", 0.2)
    yield path([(limit, y - 2.6), (limit, y + 2.8)], INK, 0.8)
    yield text(limit + 1.0, y + 3.2, f"limit {result.limit:g}")
    if result.before is not None:
        before = scale.one(result.before)
        yield circle(before, y, 1.2, "#fff", BEFORE)
        named.append((before, f"before {result.before:.2f}", BEFORE))
    if result.U is not None:
        ends = [scale.one(result.after + sign * result.U) for sign in (-1, 1)]
        yield path([(ends[0], y), (ends[1], y)], AFTER, 0.5)
        for end in ends:
            yield path([(end, y - 0.9), (end, y + 0.9)], AFTER, 0.4)
    yield circle(after, y, 1.2, AFTER, AFTER)
    label_mm = 18.6  # the widest: "before 1.20"
    places = apart([at for at, _, _ in named], label_mm, scale.end - label_mm / 2)
    for at, (_, words, colour) in zip(places, named, strict=True):
        yield text(at, y - 1.9, words, "middle", colour, bold=True)


def variance_bar(budget: TargetBudget, simulated: bool) -> str:
    """Return a bar of the contributions to a corrected target's variance, the largest at the top.

    It is of the station where bounds are largest; "" where none are stated.
    """
    if budget.missing:
        return ""
    width_mm, height_mm, bar_mm = 55.0, 90.0, 12.0
    shades = ("#0b4a7d", "#3f76a6", "#7fa6c9", "#b4cbe0", "#d9e4ee", "#eef3f8")
    parts, tops, top = list[str](), list[float](), 1.0
    shares, scale = _shares(budget, len(shades)), (height_mm - 2.0) / 100.0
    white_on = 2  # so many shades are dark
    least_mm = 5.0  # of a part that has its share written in it
    for shade, (_, percent, _) in zip(shades, shares, strict=False):
        high = percent * scale
        parts.append(rectangle(0.0, top, bar_mm, high, shade, INK))
        if high >= least_mm:
            colour = "#fff" if len(tops) < white_on else INK
            middle = top + high / 2 + 1.0
            parts.append(text(bar_mm / 2, middle, f"{percent:.1f} %", "middle", colour, bold=True))
        tops.append(top + high / 2)
        top += high
    pitch = 2.1  # of two-line labels, in labels
    places = [pitch * each for each in apart([each / pitch for each in tops])]
    below = min(0.0, height_mm - 4.0 - places[-1])  # the last label ends inside
    for at, place, (name, percent, u_mm) in zip(tops, places, shares, strict=True):
        x, y, share = bar_mm + 3.5, place + below, f"u {u_mm:.4f} mm, {percent:.1f} %"
        parts += [path([(bar_mm, at), (bar_mm + 2.5, y)], HAIR), text(x, y, name, bold=True),
                  text(x, y + 3.4, share, "start", MUTED)]  # fmt: skip
    return svg(width_mm, height_mm, "Shares of the variance", parts, simulated)


def _shares(budget: TargetBudget, most: int) -> list[tuple[str, float, float]]:
    """Return name, share in percent and u of the largest contributions; the last may be others."""
    rows: list[Row] = [each for each in target_rows(budget.in_use[budget.worst]) if each.percent]
    rows.sort(key=lambda each: -each.percent)
    shown = [(each.source, each.percent, each.u_mm) for each in rows[: most - 1]]
    others = rows[most - 1 :]
    if others:
        u_mm = sum(each.u_mm**2 for each in others) ** 0.5
        shown.append((f"{len(others)} others", sum(each.percent for each in others), u_mm))
    return shown


def _gear(record: CurveMeasured, most_urad: float, width_mm: float) -> Iterator[str]:
    high, low = 8.0, 34.0
    curve_mm, spectrum_mm = (12.0, 108.0), (122.0, 176.0)
    joint_deg, measured_urad, by_curve_urad = np.array(record.shown).T
    size = round_up(float(np.abs(measured_urad).max()))
    joints = Scale(float(joint_deg.min()), float(joint_deg.max()), *curve_mm)
    frame = Frame(joints, Scale(-size, size, low, high))
    yield frame.drawn("joint, °", f"A{record.axis}: error, µrad")
    yield path(frame.at(joint_deg, measured_urad), HATCH, 0.3)
    if record.holds:
        yield path(frame.at(joint_deg, by_curve_urad), AFTER, 0.4)
    else:
        yield text(curve_mm[1], high - 1.0, f"not used: {record.reason}", "end")
    cycles, amplitude_urad = np.array(record.spectrum).T
    ends = max(10.0, float(cycles.min())), float(cycles.max())
    across = Frame(Scale(*ends, *spectrum_mm, logarithmic=True), Scale(0.0, most_urad, low, high))
    yield across.drawn("cycles per revolution (logarithmic)", "")
    yield path(across.at(cycles, amplitude_urad), INK, 0.3)
    half_mm = 17.0 / 2  # of the widest label
    for at, amplitude in zip(record.cycles, record.amplitudes_urad, strict=True):
        x, y = across.x.one(at), across.y.one(float(amplitude))
        yield circle(x, y, 0.8, AFTER, AFTER)
        x = min(max(x, spectrum_mm[0] + half_mm), width_mm - half_mm)
        yield text(x, y - 1.4, f"{at:.1f}: {amplitude:.0f}", "middle", AFTER, bold=True)


# -- did anything move meanwhile: floor nests and air over time; stops are hatched -----------------


@dataclass(frozen=True, eq=False)
class _Times:
    """The frame of a plot over the time of a run."""

    HIGH_MM, BEGIN_MM, OVER_MM = 46.0, 12.0, 6.5  # on paper: the drawing, left and over the frame

    facts: Facts

    def times(self) -> dict[str, float]:
        """Return when each point that counts was recorded, s."""
        return {each.key: _seconds(each.t) for each in self.facts.records if each.kind == "point"}

    def ends(self) -> tuple[float, float]:
        """Return when the run began and ended, s; it lasted a second at least."""
        begin = _seconds(self.facts.records[0].t)
        return begin, max(_seconds(self.facts.last.t), begin + 1.0)

    def frame(self, low: float, high: float) -> Frame:
        y = Scale(low, high, self.HIGH_MM - BOTTOM_MM, self.OVER_MM)
        return Frame(Scale(*self.ends(), self.BEGIN_MM, WIDTH_MM - 7.0), y)

    def drawn(self, frame: Frame, y_name: str) -> str:
        return frame.drawn(f"time, {self.facts.zone.tzname(None)}", y_name, self.ticks())

    def svg(self, title: str, parts: list[str]) -> str:
        return svg(WIDTH_MM, self.HIGH_MM, title, parts, self.facts.inputs.simulated)

    def ticks(self) -> list[tuple[float, str]]:
        begin, end = self.ends()
        short_s = 600.0  # of a run so short seconds are shown
        form = "%H:%M:%S" if end - begin < short_s else "%H:%M"
        ticks = 4
        return [
            (float(each), datetime.fromtimestamp(each, tz=self.facts.zone).strftime(form))
            for each in np.linspace(begin, end, ticks)
        ]

    def stops(self, frame: Frame) -> Iterator[str]:
        before = ""
        for record in self.facts.records:
            match record.fact:
                case StateChanged(machine="run", to="checking"):
                    left, right = (frame.x.one(_seconds(t)) for t in (before or record.t, record.t))
                    yield hatched(left, frame.y.end, right - left, frame.y.begin - frame.y.end)
                    before = record.t
            before = before and record.t


def _seconds(time: str) -> float:
    return datetime.fromisoformat(time).timestamp()


@dataclass(frozen=True, slots=True)
class ErrorPlots:
    """The plots of one run; "" for one without data."""

    facts: Facts

    def sorted_errors(self) -> str:
        """Return all errors in rising order, before and after, against the limits."""
        facts = self.facts
        series = validation(facts.log, [station.name for station in facts.cell.station])
        shown = {how: series[how].norms_mm for how in BOTH if how in series}
        if not shown:
            return ""
        limits = tolerance_limits(facts.cell)
        largest = max(*(float(each.max()) for each in shown.values()), limits.max_mm)
        least_mm = 0.005  # the logarithmic scale begins here
        frame = _frame(
            Scale(least_mm, 1.5 * largest, HEIGHT_MM - BOTTOM_MM, TOP_MM, logarithmic=True)
        )
        at = frame.y.one(limits.max_mm)
        parts = [hatched(frame.x.begin, TOP_MM, frame.x.end - frame.x.begin, at - TOP_MM),
                 frame.drawn("share of targets, %", "3-D error, mm", PERCENTS)]  # fmt: skip
        parts += [
            frame.level(limits.max_mm, INK, 0.6),
            frame.level(limits.mean_mm, INK, 0.4, "1.4 1"),
        ]
        named = [(at, f"limit {limits.max_mm:g}", INK),
                 (frame.y.one(limits.mean_mm), f"mean {limits.mean_mm:g}", INK)]  # fmt: skip
        parts += labels(frame.x.end + 1.0, named)
        parts += self._floor(frame)
        named = []
        for how, norms_mm in shown.items():
            colour, name = (BEFORE, "before") if how == Sent.BEFORE else (AFTER, "after")
            parts.append(_curve(frame, norms_mm, colour, "2 1" if how == Sent.BEFORE else ""))
            # Left, where the curve after is low, and below that before.
            y = frame.y.one(float(norms_mm.min() if how == Sent.BEFORE else norms_mm.max())) + 2.6
            words = f"{name}: mean {norms_mm.mean():.3f}, largest {norms_mm.max():.3f}"
            named.append((y, words, colour))
        parts += labels(frame.x.begin + 1.0, named, frame.y.begin - 2.5 - NEAREST_MM)
        return svg(
            WIDTH_MM, HEIGHT_MM, "Errors in order, logarithmic", parts, facts.inputs.simulated
        )

    def errors_after(self, budget: TargetBudget) -> str:
        facts = self.facts
        norms_mm = {
            station.name: errors[Sent.CHOSEN].norms_mm
            for station in facts.cell.station
            for errors in (validation(facts.log, [station.name]),)
            if Sent.CHOSEN in errors
        }
        if not norms_mm:
            return ""
        dashes = ("", "1.6 0.9", "0.4 0.8")  # of the stations
        most_lines = len(dashes)
        nearest = sorted(norms_mm, key=lambda name: -float(norms_mm[name].max()))[:most_lines]
        judged = [budget.coverage.get(each.name) for each in facts.cell.station]
        bounds_mm = np.concatenate([each.bounds_mm for each in judged if each] or [np.empty(0)])
        largest = max(*(float(norms_mm[name].max()) for name in nearest), *bounds_mm, 0.01)
        frame = _frame(Scale(0.0, round_up(1.05 * largest, ENDS), HEIGHT_MM - BOTTOM_MM, TOP_MM))
        parts = []
        if len(bounds_mm):
            top, low = frame.y.one(float(bounds_mm.max())), frame.y.one(float(bounds_mm.min()))
            parts.append(
                rectangle(frame.x.begin, top, frame.x.end - frame.x.begin, low - top, BAND)
            )
            words = f"95 % bounds {bounds_mm.min():.3f} to {bounds_mm.max():.3f}"
            parts.append(text(frame.x.begin + 2.0, top - 1.0, words))
        parts.append(frame.drawn("share of targets, %", "3-D error after, mm", PERCENTS))
        named, room_mm = [], RIGHT_MM - 1.0
        for name, dash in zip(nearest, dashes, strict=False):
            parts.append(_curve(frame, norms_mm[name], AFTER, dash))
            high = float(norms_mm[name].max())
            figure = f" {high:.3f}"
            shown = shortened(name, room_mm - text_width_mm(figure))
            named.append((frame.y.one(high), shown + figure, AFTER))
        parts += labels(frame.x.end + 1.0, named, most_mm=room_mm)
        return svg(WIDTH_MM, HEIGHT_MM, "Errors after correction, enlarged", parts,
                   facts.inputs.simulated)  # fmt: skip

    def bound_histogram(self, budget: TargetBudget) -> str:
        judged = [budget.coverage.get(each.name) for each in self.facts.cell.station]
        ratios = np.concatenate(
            [each.errors_mm / each.bounds_mm for each in judged if each] or [np.empty(0)]
        )
        if not len(ratios):
            return ""
        bin_wide = 0.1  # of error over bound
        most = max(1.8, bin_wide * np.ceil(ratios.max() / bin_wide))
        edges = np.arange(0.0, most + bin_wide / 2, bin_wide)
        counts = np.histogram(ratios, edges)[0]
        x = Scale(0.0, float(most), LEFT_MM, WIDTH_MM - 4.0)
        y = Scale(0.0, round_up(1.05 * counts.max(), ENDS), HEIGHT_MM - BOTTOM_MM, TOP_MM)
        frame = Frame(x, y)
        parts = [frame.drawn("error ÷ own 95 % bound", "targets")]
        for edge, count in zip(edges, counts, strict=False):
            left, top = x.one(edge), y.one(float(count))
            fill = "#7fa6c9" if edge < 1.0 - bin_wide / 2 else "#fff"
            wide = x.one(edge + bin_wide) - left
            parts.append(rectangle(left, top, wide, y.begin - top, fill, AFTER))
        middles = np.linspace(0.0, most, 61)
        u = 2.796 * middles  # in sigma: a bound is chi of three degrees of freedom, 95 %
        density = 2.796 * np.sqrt(2 / np.pi) * u**2 * np.exp(-(u**2) / 2)  # Maxwell's law
        parts.append(path(frame.at(middles, len(ratios) * bin_wide * density), INK, 0.4, "1.4 1"))
        at, beyond = x.one(1.0), int((ratios > 1.0).sum())
        parts.append(path([(at, y.begin), (at, TOP_MM)], INK, 0.8))
        share = f"({100 * beyond / len(ratios):.1f} %, 5 % expected)"
        texts = (f"{beyond} of {len(ratios)} beyond it", share, "dashed: predicted")
        for n, words in enumerate(texts):
            parts.append(text(at + 1.5, TOP_MM + 3.0 + 4.0 * n, words, bold=n == 0))
        return svg(WIDTH_MM, HEIGHT_MM, "Errors as shares of their own bounds", parts,
                   self.facts.inputs.simulated)  # fmt: skip

    def _floor(self, frame: Frame) -> Iterator[str]:
        """Yield the error floor of repeatability and tracker noise (Maxwell's law)."""
        repeated = self.facts.part("repeatability", Repeated)
        if repeated is None:
            return
        from scipy.special import chdtri

        shares = np.linspace(0.5, 99.5, 100)
        norms_mm = repeated.floor_mm / np.sqrt(8 / np.pi) * np.sqrt(chdtri(3, 1 - shares / 100))
        yield path(frame.at(shares, norms_mm), MUTED, 0.4, "0.3 0.8")
        words = f"dotted: floor by repeatability, {repeated.floor_mm:.3f}"
        yield text(frame.x.end - 1.0, frame.y.begin - 1.5, words, "end", MUTED)

    def vectors(self) -> str:
        facts = self.facts
        station = facts.cell.grid.station
        series = validation(facts.log, [station])
        name_mm = 60.0  # of a station, at most
        shown = shortened(station, name_mm)
        names = ((Sent.BEFORE, "before", BEFORE), (Sent.CHOSEN, "after", AFTER))
        rows = [
            (f"{shown}, {name}", series[how], colour)
            for how, name, colour in names
            if how in series
        ]
        if not rows and (grid := grid_errors(facts.log)) is not None:
            rows = [(f"{shown}, grid", grid, BEFORE)]
        if not rows:
            return ""
        width_mm, row_mm = 123.0, 47.0
        parts: list[str] = []
        for n, (name, errors, colour) in enumerate(rows):
            parts += _views(name, errors, colour, n * row_mm, width_mm)
        high, simulated = row_mm * len(rows), facts.inputs.simulated
        return svg(width_mm, high, "Error vectors in three views", parts, simulated)

    def gears(self) -> str:
        """Return a drawing of each swept axis: the curve of its gear, and its spectrum.

        A page may end between two of them.
        """
        records = [record for record in self.facts.log.curves.values() if record.shown]
        if not records:
            return ""
        width_mm, row_mm = 178.0, 44.0
        most = max(float(np.array(record.spectrum)[:, 1].max()) for record in records)
        high_urad, simulated = round_up(most, ENDS), self.facts.inputs.simulated
        title = "Transmission error of a gear, and its spectrum, axis"
        return "".join(
            svg(
                width_mm,
                row_mm,
                f"{title} {each.axis}",
                _gear(each, high_urad, width_mm),
                simulated,
            )
            for each in records
        )

    def floor_nests(self) -> str:
        facts = self.facts
        moves, time_axis = control_moves(facts.log), _Times(facts)
        if not moves:
            return ""
        times, points = time_axis.times(), [each.now for each in moves]
        at_s = np.array([times[point.key] for point in points])
        size_mm = lengths_mm([each.moved_mm for each in moves])
        limit_mm = float(
            np.median(watch.motion_limits_mm(facts.cell, run_noise(facts.log), points, points))
        )
        beyond = 1.25  # the limit
        most_mm = beyond * max(limit_mm, float(size_mm.max()))
        frame = time_axis.frame(0.0, most_mm)
        limit = frame.y.one(limit_mm)
        parts = [
            *time_axis.stops(frame),
            hatched(frame.x.begin, frame.y.end, frame.x.end - frame.x.begin, limit - frame.y.end),
            time_axis.drawn(frame, "move since the first, mm"),
            frame.level(limit_mm, INK, 0.6),
            text(frame.x.end, limit - 1.2, f"limit {limit_mm:.3f}", "end"),
        ]
        parts += [circle(x, y, 0.7, AFTER, AFTER) for x, y in frame.at(at_s, size_mm)]
        words = f"largest {size_mm.max():.3f} mm, {len(moves)} measurements"
        parts.append(text(frame.x.begin + 2.0, limit + 3.4, words, colour=AFTER, bold=True))
        return time_axis.svg("Moves of the floor nests", parts)

    def air(self) -> str:
        facts = self.facts
        time_axis = _Times(facts)
        times, points = time_axis.times(), facts.log.points.values()
        readings = sorted(
            (times[p.key], p.temperature_c) for p in points if p.temperature_c is not None
        )
        if not readings:
            return ""
        at_s, celsius = np.array(readings).T
        calibration = calibration_so_far(facts.log, facts.run)
        range_c = calibration.validity.temperature_c if calibration is not None else None
        margin_k = TEMPERATURE_MARGIN_K
        valid = None if range_c is None else (range_c[0] - margin_k, range_c[1] + margin_k)
        ends_c = [*celsius, *(valid or ())]
        low, high = min(ends_c) - 0.3, max(ends_c) + 0.3
        frame = time_axis.frame(float(low), float(high))
        parts, named = [], []
        if valid is not None:
            bottom, top = frame.y.one(valid[0]), frame.y.one(valid[1])
            parts.append(
                rectangle(frame.x.begin, top, frame.x.end - frame.x.begin, bottom - top, "#e6edf4")
            )
            for value, words in ((valid[1], "valid up to"), (valid[0], "valid from")):
                parts.append(frame.level(value, INK, 0.4, "1.4 1"))
                y = frame.y.one(value) + (3.2 if value == valid[1] else -1.0)
                named.append(text(frame.x.end - 1.0, y, f"{words} {value:.1f}", "end"))
        parts += time_axis.stops(frame)
        parts.append(time_axis.drawn(frame, "air at the tracker, °C"))
        places = frame.at(at_s, celsius)
        parts.append(path(places[:: max(1, len(places) // 300)], AFTER, 0.6))
        parts += named
        words = f"{celsius.min():.1f} to {celsius.max():.1f} °C"
        parts.append(text(frame.x.begin + 2.0, frame.y.end + 7.0, words, colour=AFTER, bold=True))
        return time_axis.svg("Air at the tracker", parts)
