"""The answers of a study as one HTML page: no script, prints on A4."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from typing import NamedTuple, Self

from hilcell import __version__
from hilcell.present.renderers import environment
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
    wide_mm,
)
from hilcell.study.analysis import Answers, Design, Effect, Interval, Share
from hilcell.study.case import RESULTS
from hilcell.study.study_file import Study
from hilcell.study.tables import Summary


def page(summary: Summary) -> str:
    """Return the page, the same from the same rows."""
    study, found = summary.study, summary.found
    return (
        environment("hilcell.study", "hilcell.report")
        .get_template("study.html.j2")
        .render(
            study=study,
            version=__version__,
            counts=summary.counts(),
            meaning=RESULTS[study.accuracy][0],
            settings=[f"{key} = {value}" for key, value in study.settings.items()],
            **summary.tables(),
            front_plot=front_plot(study, found),
            effects_plot=effects_plot(study, found),
            coverage_plot=coverage_plot(found),
        )
    )


# -- the answers of a study drawn: the Pareto front, main effects, coverage of bounds --------------

WIDTH_MM, TOP_MM, BOTTOM_MM = 178.0, 8.0, 10.0
BESIDE_MM, ROW_MM, GAP_MM = 4.0, 5.2, 2.4


class Bar(NamedTuple):
    """A figure with the ends of its interval."""

    mean: float
    low: float
    high: float
    shown: str

    @classmethod
    def of_accuracy(cls, each: Interval) -> Self:
        half = f" ± {each.half:.4f}" if each.half > 0.0 else ""
        return cls(each.mean, *each.ends, f"{each.mean:.4f}{half}")

    @classmethod
    def in_percent(cls, each: Share) -> Self:
        mean, low, high = (100.0 * share for share in (each.mean, *each.ends))
        return cls(mean, low, high, f"{mean:.1f}" + (f" ({low:.1f} .. {high:.1f})" * (low < high)))

    def drawn(self, scale: Scale, y: float) -> Iterator[str]:
        x = scale.one(self.mean)
        if self.low < self.high:
            yield path([(scale.one(self.low), y), (scale.one(self.high), y)], AFTER, 0.5)
        yield circle(x, y, 1.1, AFTER, AFTER)
        yield text(WIDTH_MM, y + 1.0, self.shown, "end", AFTER)


def front_plot(study: Study, found: Answers) -> str:
    """Return accuracy over minutes of all designs, the front as steps; "" without any."""
    if not found.designs:
        return ""
    minutes = [each.minutes for each in found.designs]
    spread = max(max(minutes) - min(minutes), 0.02 * max(minutes), 1.0)
    low, high = min(minutes) - 0.06 * spread, max(minutes) + 0.06 * spread
    tops = [each.accuracy.ends[1] for each in found.designs]
    height_mm, left_mm, right_mm = 92.0, 14.0, 4.0
    frame = Frame(
        Scale(max(0.0, low), high, left_mm, WIDTH_MM - right_mm),
        Scale(0.0, round_up(1.05 * max(tops), ENDS), height_mm - BOTTOM_MM, TOP_MM),
    )
    parts = [frame.drawn("minutes of a calibration", f"{study.accuracy[:-3]} error, mm")]
    front = found.front
    if len(front) > 1 and not study.has_costs:
        parts.append(path(_steps(frame, front), AFTER, 0.4))
    for each in sorted(found.designs, key=lambda each: each.on_front):
        parts += _mark(frame, each)
    for each in front if len(front) <= 20 else ():
        x, y = frame.x.one(each.minutes), frame.y.one(each.accuracy.mean)
        parts.append(text(x + 1.8, y - 1.2, str(each.point.number), colour=AFTER, bold=True))
    return svg(WIDTH_MM, height_mm, "Accuracy over minutes of all designs", parts, True)


def effects_plot(study: Study, found: Answers) -> str:
    """Return the accuracy at each level of each factor, all else averaged; "" without any."""
    return _levels(
        found,
        lambda each: Bar.of_accuracy(each.mean),
        f"{study.accuracy[:-3]} error, mm; bars: 95 % interval over machines",
        "Accuracy at each level of each factor",
    )


def coverage_plot(found: Answers) -> str:
    """Return the share of targets within their bound at each level; "" without any."""
    return _levels(
        found,
        lambda each: Bar.in_percent(each.covered),
        "targets within their 95 % bound, %; bars: 95 % interval over machines",
        "Coverage of bounds at each level of each factor",
        line=95.0,
        most=100.0,
    )


def _mark(frame: Frame, each: Design) -> Iterator[str]:
    x, (low, high) = frame.x.one(each.minutes), each.accuracy.ends
    colour = AFTER if each.on_front else HATCH
    if low < high:
        yield path([(x, frame.y.one(low)), (x, frame.y.one(high))], colour, 0.3)
    yield circle(
        x, frame.y.one(each.accuracy.mean), 1.1, colour if each.on_front else "#fff", colour
    )


def _steps(frame: Frame, front: Sequence[Design]) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    for each in front:
        x, y = frame.x.one(each.minutes), frame.y.one(each.accuracy.mean)
        found += [(x, found[-1][1]), (x, y)] if found else [(x, y)]
    return found


def _levels(
    answers: Answers,
    value: Callable[[Effect], Bar],
    name: str,
    title: str,
    *,
    line: float | None = None,
    most: float = math.inf,
) -> str:
    effects = [each for each in answers.effects if math.isfinite(each.mean.mean)]
    if not effects:
        return ""
    found = [value(each) for each in effects]
    marked = [] if line is None else [line]
    low = min([each.low for each in found] + marked)
    high = max([each.high for each in found] + marked)
    margin = 0.06 * max(high - low, 1e-4 * max(abs(high), 1e-3))
    groups = [list(own) for _, own in groupby(effects, key=lambda each: each.factor.name)]
    height = TOP_MM + ROW_MM * len(effects) + GAP_MM * len(groups)
    names_mm = _column(each.factor.title for each in effects)
    levels_mm = _column(each.word for each in effects)
    scale = Scale(low - margin, min(high + margin, most), names_mm + levels_mm, WIDTH_MM - 34.0)
    parts = [*_ticks(scale, TOP_MM - 4.0, height, name)]
    if line is not None:
        at = scale.one(line)
        parts.append(path([(at, TOP_MM - 4.0), (at, height)], INK, 0.3, "1.2 0.8"))
    y = TOP_MM
    for own in groups:
        room_mm = names_mm - BESIDE_MM
        factor = shortened(own[0].factor.title, room_mm)
        parts.append(text(0.0, y + 1.0, factor, bold=True, most_mm=room_mm))
        for n, each in enumerate(own):
            room_mm = levels_mm - BESIDE_MM
            word = shortened(each.word, room_mm)
            parts.append(text(names_mm, y + n * ROW_MM + 1.0, word, most_mm=room_mm))
            parts += value(each).drawn(scale, y + n * ROW_MM)
        y += ROW_MM * len(own) + GAP_MM
    return svg(WIDTH_MM, height + BOTTOM_MM, title, parts, True)


def _column(words: Iterable[str]) -> float:
    """Return how wide a column of words is, with the space beside it."""
    return min(40.0, max(map(wide_mm, words)) + BESIDE_MM)


def _ticks(scale: Scale, top: float, bottom: float, name: str) -> Iterator[str]:
    yield path([(scale.begin, bottom), (scale.end, bottom)])
    for tick in scale.ticks():
        at = scale.one(tick)
        yield path([(at, top), (at, bottom)], HAIR, 0.2)
        yield text(at, bottom + 4.2, f"{tick:g}", "middle", MUTED)
    yield text((scale.begin + scale.end) / 2, bottom + 8.4, name, "middle", MUTED)
