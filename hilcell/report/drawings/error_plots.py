"""Errors of the targets: in order, all and enlarged, and each beside its own 95 % bound."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hilcell.calibration.decision import limits_of
from hilcell.calibration.errors import validation
from hilcell.model.point import BOTH, Sent
from hilcell.model.results import Repeated
from hilcell.ports import Array
from hilcell.report.budgets import TargetBudget
from hilcell.report.drawings.drawing import (
    AFTER,
    BAND,
    BEFORE,
    ENDS,
    INK,
    MUTED,
    NEAREST_MM,
    Frame,
    Scale,
    hatched,
    labels,
    path,
    rectangle,
    round_up,
    shortened,
    svg,
    text,
    wide_mm,
)
from hilcell.report.facts import Facts

WIDTH_MM, HEIGHT_MM, LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 88.0, 54.0, 10.0, 22.0, 6.0, 10.0
PERCENTS = [(each, f"{each:g}") for each in (0.0, 25.0, 50.0, 75.0, 100.0)]


def in_order(facts: Facts) -> str:
    """Return all errors in rising order, before and after, against the limits; "" without any."""
    series = validation(facts.log, [station.name for station in facts.cell.station])
    shown = {how: series[how].norms_mm for how in BOTH if how in series}
    if not shown:
        return ""
    limits = limits_of(facts.cell)
    largest = max(*(float(each.max()) for each in shown.values()), limits.max_mm)
    least_mm = 0.005  # the logarithmic scale begins here
    frame = _frame(Scale(least_mm, 1.5 * largest, HEIGHT_MM - BOTTOM_MM, TOP_MM, logarithmic=True))
    at = frame.y.one(limits.max_mm)
    parts = [hatched(frame.x.begin, TOP_MM, frame.x.end - frame.x.begin, at - TOP_MM),
             frame.drawn("share of targets, %", "3-D error, mm", PERCENTS)]  # fmt: skip
    parts += [frame.level(limits.max_mm, INK, 0.6), frame.level(limits.mean_mm, INK, 0.4, "1.4 1")]
    named = [(at, f"limit {limits.max_mm:g}", INK),
             (frame.y.one(limits.mean_mm), f"mean {limits.mean_mm:g}", INK)]  # fmt: skip
    parts += labels(frame.x.end + 1.0, named)
    parts += _floor(facts, frame)
    named = []
    for how, norms_mm in shown.items():
        colour, name = (BEFORE, "before") if how == Sent.BEFORE else (AFTER, "after")
        parts.append(_curve(frame, norms_mm, colour, "2 1" if how == Sent.BEFORE else ""))
        # Left, where the curve after is low, and below that before.
        y = frame.y.one(float(norms_mm.min() if how == Sent.BEFORE else norms_mm.max())) + 2.6
        words = f"{name}: mean {norms_mm.mean():.3f}, largest {norms_mm.max():.3f}"
        named.append((y, words, colour))
    parts += labels(frame.x.begin + 1.0, named, frame.y.begin - 2.5 - NEAREST_MM)
    return svg(WIDTH_MM, HEIGHT_MM, "Errors in order, logarithmic", parts, facts.inputs.simulated)


def enlarged(facts: Facts, budget: TargetBudget) -> str:
    """Return the errors after correction by station, linear; "" without any."""
    found = {
        station.name: errors[Sent.CHOSEN].norms_mm
        for station in facts.cell.station
        for errors in (validation(facts.log, [station.name]),)
        if Sent.CHOSEN in errors
    }
    if not found:
        return ""
    dashes = ("", "1.6 0.9", "0.4 0.8")  # of the stations
    most_lines = len(dashes)
    nearest = sorted(found, key=lambda name: -float(found[name].max()))[:most_lines]
    bounds_mm = _bounds_mm(facts, budget)
    largest = max(*(float(found[name].max()) for name in nearest), *bounds_mm, 0.01)
    frame = _frame(Scale(0.0, round_up(1.05 * largest, ENDS), HEIGHT_MM - BOTTOM_MM, TOP_MM))
    parts = []
    if len(bounds_mm):
        top, low = frame.y.one(float(bounds_mm.max())), frame.y.one(float(bounds_mm.min()))
        parts.append(rectangle(frame.x.begin, top, frame.x.end - frame.x.begin, low - top, BAND))
        words = f"95 % bounds {bounds_mm.min():.3f} to {bounds_mm.max():.3f}"
        parts.append(text(frame.x.begin + 2.0, top - 1.0, words))
    parts.append(frame.drawn("share of targets, %", "3-D error after, mm", PERCENTS))
    named, room_mm = [], RIGHT_MM - 1.0
    for name, dash in zip(nearest, dashes, strict=False):
        parts.append(_curve(frame, found[name], AFTER, dash))
        high = float(found[name].max())
        figure = f" {high:.3f}"
        shown = shortened(name, room_mm - wide_mm(figure))
        named.append((frame.y.one(high), shown + figure, AFTER))
    parts += labels(frame.x.end + 1.0, named, most_mm=room_mm)
    return svg(WIDTH_MM, HEIGHT_MM, "Errors after correction, enlarged", parts,
               facts.inputs.simulated)  # fmt: skip


def over_bound(facts: Facts, budget: TargetBudget) -> str:
    """Return how often the error was which share of its own bound; "" without bounds."""
    names = [each.name for each in facts.cell.station]
    found = [budget.coverage[name] for name in names if name in budget.coverage]
    ratios = np.concatenate([each.errors_mm / each.bounds_mm for each in found] or [np.empty(0)])
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
        parts.append(
            rectangle(left, top, x.one(edge + bin_wide) - left, y.begin - top, fill, AFTER)
        )
    middles = np.linspace(0.0, most, 61)
    parts.append(
        path(frame.at(middles, len(ratios) * bin_wide * _maxwell(middles)), INK, 0.4, "1.4 1")
    )
    at, beyond = x.one(1.0), int((ratios > 1.0).sum())
    parts.append(path([(at, y.begin), (at, TOP_MM)], INK, 0.8))
    share = f"({100 * beyond / len(ratios):.1f} %, 5 % expected)"
    said = (f"{beyond} of {len(ratios)} beyond it", share, "dashed: predicted")
    for n, words in enumerate(said):
        parts.append(text(at + 1.5, TOP_MM + 3.0 + 4.0 * n, words, bold=n == 0))
    return svg(WIDTH_MM, HEIGHT_MM, "Errors as shares of their own bounds", parts,
               facts.inputs.simulated)  # fmt: skip


def _frame(y: Scale) -> Frame:
    return Frame(Scale(0.0, 100.0, LEFT_MM, WIDTH_MM - RIGHT_MM), y)


def _curve(frame: Frame, norms_mm: Array, colour: str, dash: str) -> str:
    shares = 100 * (np.arange(len(norms_mm)) + 0.5) / len(norms_mm)
    return path(frame.at(shares, np.sort(norms_mm)), colour, 0.7, dash)


def _floor(facts: Facts, frame: Frame) -> Iterator[str]:
    """Yield the errors that repeatability and tracker noise alone would leave (Maxwell's law)."""
    repeated = facts.part("repeatability", Repeated)
    if repeated is None:
        return
    from scipy.special import chdtri

    shares = np.linspace(0.5, 99.5, 100)
    norms_mm = repeated.floor_mm / np.sqrt(8 / np.pi) * np.sqrt(chdtri(3, 1 - shares / 100))
    yield path(frame.at(shares, norms_mm), MUTED, 0.4, "0.3 0.8")
    words = f"dotted: floor by repeatability, {repeated.floor_mm:.3f}"
    yield text(frame.x.end - 1.0, frame.y.begin - 1.5, words, "end", MUTED)


def _bounds_mm(facts: Facts, budget: TargetBudget) -> Array:
    names = [each.name for each in facts.cell.station]
    found = [budget.coverage[name].bounds_mm for name in names if name in budget.coverage]
    return np.concatenate(found or [np.empty(0)])


def _maxwell(ratios: Array) -> Array:
    """Return the density of |e| over its 95 % bound for three equal normal coordinates."""
    k_95 = 2.796  # bound over sigma: chi of three degrees of freedom
    u = k_95 * ratios
    found: Array = k_95 * np.sqrt(2 / np.pi) * u**2 * np.exp(-(u**2) / 2)
    return found
