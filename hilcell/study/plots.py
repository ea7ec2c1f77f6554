"""The answers of a study drawn: the Pareto front, main effects, coverage of bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from hilcell.report.drawings.drawing import (
    AFTER,
    ENDS,
    HAIR,
    HATCH,
    INK,
    MUTED,
    Frame,
    Scale,
    circle,
    path,
    round_up,
    shortened,
    svg,
    text,
)
from hilcell.study.analysis import Answers, Design, Effect, Interval
from hilcell.study.study_file import Study

WIDTH_MM, HEIGHT_MM = 178.0, 92.0
LEFT_MM, RIGHT_MM, TOP_MM, BOTTOM_MM = 14.0, 4.0, 8.0, 10.0
NAMES_MM, LEVELS_MM, ROW_MM, GAP_MM = 34.0, 26.0, 5.2, 2.4
FIGURES_MM = 34.0
NOMINAL = 95.0  # % of targets within a bound
MOST_LABELS = 20


def front_plot(study: Study, found: Answers) -> str:
    """Return accuracy over minutes of all designs, the front as steps; "" without any."""
    if not found.designs:
        return ""
    minutes = [each.minutes for each in found.designs]
    spread = max(max(minutes) - min(minutes), 0.02 * max(minutes), 1.0)
    low, high = min(minutes) - 0.06 * spread, max(minutes) + 0.06 * spread
    tops = [each.accuracy.mean + _half(each.accuracy) for each in found.designs]
    frame = Frame(
        Scale(max(0.0, low), high, LEFT_MM, WIDTH_MM - RIGHT_MM),
        Scale(0.0, round_up(1.05 * max(tops), ENDS), HEIGHT_MM - BOTTOM_MM, TOP_MM),
    )
    parts = [frame.drawn("minutes of a calibration", f"{study.accuracy[:-3]} error, mm")]
    front = found.front
    if len(front) > 1 and not study.has_costs:
        parts.append(path(_steps(frame, front), AFTER, 0.4))
    for each in sorted(found.designs, key=lambda each: each.on_front):
        parts += _mark(frame, each)
    if len(front) <= MOST_LABELS:
        parts += _numbers(frame, front)
    return svg(WIDTH_MM, HEIGHT_MM, "Accuracy over minutes of all designs", parts, True)


def effects_plot(study: Study, found: Answers) -> str:
    """Return the accuracy at each level of each factor, all else averaged; "" without any."""
    return _levels(
        found.effects,
        lambda each: each.mean,
        f"{study.accuracy[:-3]} error, mm; bars: 95 % interval over machines",
        "Accuracy at each level of each factor",
        digits=4,
    )


def coverage_plot(found: Answers) -> str:
    """Return the share of targets within their bound at each level; "" without any."""
    return _levels(
        found.effects,
        lambda each: Interval(100.0 * each.covered.mean, 100.0 * each.covered.half),
        "targets within their 95 % bound, %; bars: 95 % interval over machines",
        "Coverage of bounds at each level of each factor",
        digits=1,
        line=NOMINAL,
        most=100.0,
    )


def _half(each: Interval) -> float:
    return 0.0 if math.isnan(each.half) else each.half


def _mark(frame: Frame, each: Design) -> Iterator[str]:
    x, mean, half = frame.x.one(each.minutes), each.accuracy.mean, _half(each.accuracy)
    colour = AFTER if each.on_front else HATCH
    if half:
        yield path([(x, frame.y.one(mean - half)), (x, frame.y.one(mean + half))], colour, 0.3)
    yield circle(x, frame.y.one(mean), 1.1, colour if each.on_front else "#fff", colour)


def _steps(frame: Frame, front: Sequence[Design]) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    for each in front:
        x, y = frame.x.one(each.minutes), frame.y.one(each.accuracy.mean)
        found += [(x, found[-1][1]), (x, y)] if found else [(x, y)]
    return found


def _numbers(frame: Frame, front: Sequence[Design]) -> Iterator[str]:
    """Yield the numbers of the front's points, beside their marks."""
    for each in front:
        x, y = frame.x.one(each.minutes), frame.y.one(each.accuracy.mean)
        yield text(x + 1.8, y - 1.2, str(each.point.number), colour=AFTER, bold=True)


def _levels(
    effects: Sequence[Effect],
    value: Callable[[Effect], Interval],
    name: str,
    title: str,
    *,
    digits: int,
    line: float | None = None,
    most: float = math.inf,
) -> str:
    if not effects:
        return ""
    found = [value(each) for each in effects]
    ends = [(each.mean - _half(each), each.mean + _half(each)) for each in found]
    ends += [] if line is None else [(line, line)]
    low, high = min(each[0] for each in ends), max(each[1] for each in ends)
    margin = 0.06 * max(high - low, 1e-4 * max(abs(high), 1e-3))
    groups = [list(own) for _, own in groupby(effects, key=lambda each: each.factor.name)]
    height = TOP_MM + ROW_MM * len(effects) + GAP_MM * len(groups)
    scale = Scale(
        low - margin, min(high + margin, most), NAMES_MM + LEVELS_MM, WIDTH_MM - FIGURES_MM
    )
    parts = [*_ticks(scale, TOP_MM - 4.0, height, name)]
    if line is not None:
        at = scale.one(line)
        parts.append(path([(at, TOP_MM - 4.0), (at, height)], INK, 0.3, "1.2 0.8"))
    y = TOP_MM
    for own in groups:
        parts.append(text(0.0, y + 1.0, shortened(own[0].factor.name, NAMES_MM - 2.0), bold=True))
        for n, each in enumerate(own):
            parts += _level(scale, each.word, value(each), y + n * ROW_MM, digits)
        y += ROW_MM * len(own) + GAP_MM
    return svg(WIDTH_MM, height + BOTTOM_MM, title, parts, True)


def _level(scale: Scale, word: str, each: Interval, y: float, digits: int) -> Iterator[str]:
    x, half = scale.one(each.mean), _half(each)
    if half:
        yield path([(scale.one(each.mean - half), y), (scale.one(each.mean + half), y)], AFTER, 0.5)
    yield circle(x, y, 1.1, AFTER, AFTER)
    yield text(NAMES_MM, y + 1.0, shortened(word, LEVELS_MM - 2.0))
    shown = f"{each.mean:.{digits}f}" + (f" ± {half:.{digits}f}" if half else "")
    yield text(WIDTH_MM, y + 1.0, shown, "end", AFTER)


def _ticks(scale: Scale, top: float, bottom: float, name: str) -> Iterator[str]:
    yield path([(scale.begin, bottom), (scale.end, bottom)])
    for tick in scale.ticks():
        at = scale.one(tick)
        yield path([(at, top), (at, bottom)], HAIR, 0.2)
        yield text(at, bottom + 4.2, f"{tick:g}", "middle", MUTED)
    yield text((scale.begin + scale.end) / 2, bottom + 8.4, name, "middle", MUTED)
