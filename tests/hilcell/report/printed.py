"""How full the pages of a print are: where the lowest words of each stand, read from the PDF."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator

import numpy as np

from hilcell.ports import Array

PAGE_MM, TOP_MM, BOTTOM_MM = 297.0, 11.0, 14.0  # as `report.css` has them
MM = 25.4 / 72.0  # of a point
_CONTENTS = re.compile(rb"/Type\s*/Page\b.*?/Contents (\d+) 0 R", re.DOTALL)
_STREAM = rb"\n%d 0 obj\s*<<[^>]*>>\s*stream\r?\n"
_NUMBER = r"(-?[\d.]+)"
_MATRIX = re.compile(rf"^{' '.join([_NUMBER] * 6)} (cm|Tm)$")


def fills(pdf: bytes) -> list[float]:
    """Return which share of each page's height is used, between its margins."""
    found = []
    for contents in _CONTENTS.findall(pdf):
        stream = re.search(_STREAM % int(contents), pdf)
        assert stream is not None
        text = zlib.decompressobj().decompress(pdf[stream.end() :]).decode("ascii")
        inside = [y for y in _heights_mm(text) if TOP_MM <= y <= PAGE_MM - BOTTOM_MM]
        assert inside, "a page without words"
        found.append((max(inside) - TOP_MM) / (PAGE_MM - TOP_MM - BOTTOM_MM))
    return found


def _heights_mm(content: str) -> Iterator[float]:
    """Yield how far below the page's upper edge each run of words begins."""
    now, kept = np.eye(3), []
    for line in content.splitlines():
        if line == "q":
            kept.append(now)
        elif line == "Q":
            now = kept.pop()
        elif found := _MATRIX.match(line):
            placed = _matrix(*map(float, found.groups()[:6])) @ now
            if found[7] == "cm":
                now = placed
            else:
                yield PAGE_MM - float(placed[2, 1]) * MM


def _matrix(a: float, b: float, c: float, d: float, e: float, f: float) -> Array:
    return np.array([[a, b, 0.0], [c, d, 0.0], [e, f, 1.0]])
