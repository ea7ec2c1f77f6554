"""Words in drawings as a browser shows them, by the metrics of the report's widest font."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from itertools import combinations
from pathlib import Path

import matplotlib as mpl
from PIL import ImageFont

from hilcell.report.drawings.drawing import LABEL_MM

FONTS = Path(mpl.get_data_path()) / "fonts" / "ttf"
ADJUSTED = 0.519 / 0.547  # `font-size-adjust` of the report to the font's own
ANCHORS = {"start": 0.0, "middle": 0.5, "end": 1.0}
Box = tuple[str, float, float, float, float]  # words, left, right, top, base line in mm


@cache
def _font(name: str) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(FONTS / name), 100)


def _wide_mm(words: str, *, bold: bool) -> float:
    font = _font("DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf")
    return font.getlength(words) / 100 * LABEL_MM * ADJUSTED


def boxes(drawing: str | ET.Element) -> list[Box]:
    """Return the words that are read; ticks and the watermark are not."""
    found = []
    root = ET.fromstring(drawing) if isinstance(drawing, str) else drawing
    for each in root.iter("text"):
        if each.attrib["fill"] == "none":
            continue
        words = "".join(each.itertext())
        text_width_mm = float(
            each.get("textLength", _wide_mm(words, bold="font-weight" in each.attrib))
        )
        left_mm = float(each.attrib["x"]) - ANCHORS[each.attrib["text-anchor"]] * text_width_mm
        base_mm = float(each.attrib["y"])
        found.append((words, left_mm, left_mm + text_width_mm, base_mm - 0.75 * LABEL_MM, base_mm))
    return found


def apart(one: Box, other: Box, room_mm: float = 0.0) -> bool:
    """Whether neither lies on the other; ``room_mm`` is the least between two lines."""
    _, l1, r1, t1, b1 = one
    _, l2, r2, t2, b2 = other
    return r1 <= l2 or r2 <= l1 or b1 + room_mm <= t2 or b2 + room_mm <= t1


def assert_apart(drawing: str | ET.Element, room_mm: float = 0.0) -> None:
    for one, other in combinations(boxes(drawing), 2):
        assert apart(one, other, room_mm), (one, other)
