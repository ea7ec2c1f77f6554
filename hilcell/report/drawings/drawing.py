"""Small vector drawings: shapes as SVG, places in mm on paper, and a frame with two scales.

Every drawing has a title for screen readers; one of a simulated run says so behind everything.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from hilcell.ports import Array

INK, MUTED, HAIR, HATCH = "#1b2430", "#4a5663", "#c9d0d8", "#9aa5b1"
BEFORE, AFTER, BAND = "#b0561a", "#0b4a7d", "#d3e0ec"
LABEL_MM = 2.9  # height of letters on paper, 8.2 pt
NEAREST_MM = 3.4  # of two labels in a column
TICKS = (1.0, 2.0, 2.5, 5.0, 10.0)
ENDS = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)  # of a scale


def svg(width: float, height: float, title: str, parts: Iterable[str], simulated: bool) -> str:
    """Return a drawing of this size; its title says so where it is of a simulation."""
    shown = escape(f"SIMULATION: {title}" if simulated else title)
    return (
        f'<svg class="drawn" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{shown}" '
        f'style="width:{width:g}mm" font-size="{LABEL_MM}" fill="{INK}" stroke-width="0.3">'
        f"<title>{shown}</title>{''.join(parts)}</svg>"
    )


def text(
    x: float,
    y: float,
    words: str,
    anchor: str = "start",
    colour: str = INK,
    bold: bool = False,
    most_mm: float = math.inf,
) -> str:
    """Return words on a base line; a font in which they would be too wide is squeezed."""
    weight = ' font-weight="bold"' if bold else ""
    length = ""
    widest = 1.25  # letters of the widest font of `report.css` to those of Arial
    if text_width_mm(words) * widest > most_mm:
        fixed_mm = min(text_width_mm(words), most_mm)
        length = f' textLength="{fixed_mm:.2f}" lengthAdjust="spacingAndGlyphs"'
    return (
        f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}" fill="{colour}"{weight}{length}>'
        f"{escape(words)}</text>"
    )


def shortened(words: str, most_mm: float) -> str:
    """Return words that are at most so wide on paper, an ellipsis in their middle where cut."""
    if text_width_mm(words) <= most_mm:
        return words
    kept = next(
        n
        for n in range(len(words) - 1, -1, -1)
        if not n or text_width_mm(_cut(words, n)) <= most_mm
    )
    return _cut(words, kept)


def _cut(words: str, kept: int) -> str:
    return f"{words[: (kept + 1) // 2]}…{words[len(words) - kept // 2 :]}"


def text_width_mm(words: str) -> float:
    """Return how wide bold words are on paper, at most as far as letters of Arial go."""
    narrow_letters = " .,:;-|ijlt()"
    widths = (
        0.34 if each in narrow_letters else 0.74 if each.isupper() else 0.61 for each in words
    )
    return LABEL_MM * sum(widths)


def path(
    points: Array | Sequence[tuple[float, float]],
    colour: str = INK,
    wide: float = 0.3,
    dash: str = "",
    fill: str = "none",
) -> str:
    """Return a line through points (N, 2); NaN interrupts it."""
    pieces, pen = [], "M"
    for x, y in points:
        known = math.isfinite(x) and math.isfinite(y)
        if known:
            pieces.append(f"{pen}{x:.2f} {y:.2f}")
        pen = "L" if known else "M"
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<path d="{"".join(pieces)}" fill="{fill}" stroke="{colour}" stroke-width="{wide}"'
        f"{dashes}/>"
    )


def rectangle(
    x: float, y: float, width: float, height: float, fill: str, colour: str = "none"
) -> str:
    return (
        f'<rect x="{x:.2f}" y="{y:.2f}" width="{width:.2f}" height="{height:.2f}" fill="{fill}" '
        f'stroke="{colour}"/>'
    )


def circle(x: float, y: float, r: float, fill: str, colour: str) -> str:
    return f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{r}" fill="{fill}" stroke="{colour}"/>'


def hatched(x: float, y: float, width: float, height: float) -> str:
    """Return a hatched box: out of tolerance, or a time in which nothing ran."""
    strokes: list[tuple[float, float]] = []
    for c in np.arange(2.0, width + height, 2.0):
        low, high = max(0.0, c - height), min(width, c)
        strokes += [(x + low, y + c - low), (x + high, y + c - high), (math.nan, math.nan)]
    return path(strokes, HATCH, 0.15)


def apart(
    places: Sequence[float], nearest: float = NEAREST_MM, most: float = math.inf
) -> list[float]:
    """Return places, in their order, moved so that labels at them do not overlap.

    ``nearest`` is the least distance of two, ``most`` the place that none is beyond.
    """
    order = sorted(range(len(places)), key=lambda n: places[n])
    placed, last = list(places), -math.inf
    for n in order:
        placed[n] = last = max(places[n], last + nearest)
    for n in reversed(order):
        placed[n] = min(placed[n], most)
        most = placed[n] - nearest
    return placed


def round_up(value: float, steps: Sequence[float] = TICKS) -> float:
    """Return the next of ``steps`` times a power of ten that is not below ``value``, nor nought."""
    least = 1e-9  # range of a scale
    value = max(value, least)
    power = 10.0 ** math.floor(math.log10(value))
    return next(each for step in steps if (each := step * power) >= value * (1 - 1e-9))


@dataclass(frozen=True, slots=True)
class Scale:
    """A range of values on a stretch of paper; beyond its ends a value is drawn at the end."""

    low: float
    high: float
    begin: float
    end: float
    logarithmic: bool = False

    def at(self, values: Array | float) -> Array:
        shown = np.clip(np.asarray(values, dtype=float), self.low, self.high)
        low, high = self.low, self.high
        if self.logarithmic:
            shown, low, high = np.log(shown), math.log(low), math.log(high)
        places: Array = self.begin + (shown - low) / (high - low) * (self.end - self.begin)
        return places

    def one(self, value: float) -> float:
        return float(self.at(value))

    def ticks(self) -> list[float]:
        """Return 1-2-5 values, at most seven of a linear scale."""
        if self.logarithmic:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            values = [step * 10.0**n for n in powers for step in (1, 2, 5)]
        else:
            step = round_up((self.high - self.low) / 6)
            first = math.ceil(self.low / step - 1e-9)
            values = [step * n for n in range(first, math.floor(self.high / step + 1e-9) + 1)]
        return [each for each in values if self.low * 0.999 <= each <= self.high * 1.001]


@dataclass(frozen=True, slots=True)
class Frame:
    """A plot's frame: a scale each way; y goes up."""

    x: Scale
    y: Scale

    def at(self, x: Array, y: Array) -> Array:
        """Return places (N, 2) on paper."""
        return np.stack([self.x.at(x), self.y.at(y)], axis=1)

    def level(self, y: float, colour: str = INK, wide: float = 0.3, dash: str = "") -> str:
        at = self.y.one(y)
        return path([(self.x.begin, at), (self.x.end, at)], colour, wide, dash)

    def drawn(self, x_name: str, y_name: str, x_ticks: Sequence[tuple[float, str]] = ()) -> str:
        left, right, low, high = self.x.begin, self.x.end, self.y.begin, self.y.end
        parts = [path([(left, low), (right, low)])]
        for value in self.y.ticks():
            parts.append(self.level(value, HAIR, 0.2))
            parts.append(text(left - 1.2, self.y.one(value) + 1.0, f"{value:g}", "end", MUTED))
        for value, name in x_ticks or [(each, f"{each:g}") for each in self.x.ticks()]:
            at = self.x.one(value)
            parts.append(path([(at, low), (at, low + 1.0)]))
            parts.append(text(at, low + 4.2, name, "middle", MUTED))
        parts.append(text((left + right) / 2, low + 8.0, x_name, "middle", MUTED))
        parts.append(text(0.0, high - 2.2, y_name, colour=MUTED))
        return "".join(parts)


def labels(
    x: float,
    named: Sequence[tuple[float, str, str]],
    lowest: float = math.inf,
    most_mm: float = math.inf,
) -> Iterator[str]:
    """Yield labels of (height, words, colour) in a column, apart, none below ``lowest``."""
    heights = apart([each[0] for each in named], most=lowest)
    for y, (_, words, colour) in zip(heights, named, strict=True):
        yield text(x, y + 1.0, words, colour=colour, bold=True, most_mm=most_mm)
