"""The numeric strip of the first page: limit, before, after with U, on one logarithmic scale."""

from __future__ import annotations

from collections.abc import Iterator

from hilcell.report.drawings.drawing import (
    AFTER,
    BEFORE,
    INK,
    MUTED,
    Scale,
    apart,
    circle,
    hatched,
    path,
    shortened,
    svg,
    text,
)
from hilcell.report.first_page import Result

WIDTH_MM, ROW_MM, LEFT_MM, TOP_MM = 120.0, 8.6, 26.0, 4.2


def strip(results: list[tuple[str, Result]], simulated: bool) -> str:
    """Return the strip of named results, "" where there are none."""
    if not results:
        return ""
    largest = max(max(each.before_mm or 0.0, 1.6 * each.limit_mm) for _, each in results)
    least_mm = 0.005  # the scale begins here
    scale = Scale(least_mm, 1.3 * largest, LEFT_MM, WIDTH_MM - 2.0, logarithmic=True)
    bottom = TOP_MM + ROW_MM * len(results)
    parts = [
        part
        for n, (name, each) in enumerate(results)
        for part in _row(name, each, scale, TOP_MM + ROW_MM * (n + 0.5))
    ]
    parts.append(path([(scale.begin, bottom), (scale.end, bottom)]))
    for tick in scale.ticks():
        at = scale.one(tick)
        parts += [path([(at, bottom), (at, bottom + 0.8)]),
                  text(at, bottom + 3.8, f"{tick:g}", "middle", MUTED)]  # fmt: skip
    middle = (scale.begin + scale.end) / 2
    parts.append(text(middle, bottom + 7.2, "3-D error, mm (logarithmic)", "middle", MUTED))
    title = "Limit, before, and after with its uncertainty"
    return svg(WIDTH_MM, bottom + 8.4, title, parts, simulated)


def _row(name: str, result: Result, scale: Scale, y: float) -> Iterator[str]:
    limit, after = scale.one(result.limit_mm), scale.one(result.after_mm)
    named = [(after, f"after {result.after_mm:.3f}", AFTER)]
    room_mm = LEFT_MM - 1.0
    yield text(0.0, y + 1.0, shortened(name, room_mm), bold=True, most_mm=room_mm)
    yield hatched(limit, y - 2.4, scale.end - limit, 5.0)
    yield path([(scale.begin, y), (scale.end, y)], "#c9d0d8", 0.2)
    yield path([(limit, y - 2.6), (limit, y + 2.8)], INK, 0.8)
    yield text(limit + 1.0, y + 3.2, f"limit {result.limit_mm:g}")
    if result.before_mm is not None:
        before = scale.one(result.before_mm)
        yield circle(before, y, 1.2, "#fff", BEFORE)
        named.append((before, f"before {result.before_mm:.2f}", BEFORE))
    if result.U_mm is not None:
        ends = [scale.one(result.after_mm + sign * result.U_mm) for sign in (-1, 1)]
        yield path([(ends[0], y), (ends[1], y)], AFTER, 0.5)
        for end in ends:
            yield path([(end, y - 0.9), (end, y + 0.9)], AFTER, 0.4)
    yield circle(after, y, 1.2, AFTER, AFTER)
    label_mm = 18.6  # the widest: "before 1.20"
    places = apart([at for at, _, _ in named], label_mm, scale.end - label_mm / 2)
    for at, (_, words, colour) in zip(places, named, strict=True):
        yield text(at, y - 1.9, words, "middle", colour, bold=True)
