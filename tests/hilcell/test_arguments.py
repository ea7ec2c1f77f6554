"""Numbers on a command line: within their range, and never NaN."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import pytest

from hilcell.arguments import (
    parse_days,
    parse_finite,
    parse_speed,
    parse_standoff_mm,
    parse_stroke_mm,
    parse_stroke_tolerance_mm,
)

RANGES: dict[Callable[[str], float], tuple[list[str], list[str]]] = {
    parse_finite: (["-1e300", "0"], ["inf", "-inf", "1e999"]),
    parse_days: (["0", "36500"], ["-0.1", "36500.1", "inf"]),
    parse_stroke_mm: (["1e-9", "200"], ["0", "-1", "200.1", "inf"]),
    parse_stroke_tolerance_mm: (["1e-9", "5"], ["0", "-1", "5.1", "inf"]),
    parse_standoff_mm: (["1e-9", "1000"], ["0", "-1", "1000.1", "inf"]),
    parse_speed: (["1", "1e6", "max"], ["0.99", "1000001", "inf"]),
}


@pytest.mark.parametrize("read", RANGES)
def test_a_number_is_within_its_range(read: Callable[[str], float]) -> None:
    good, bad = RANGES[read]
    for text in good:
        assert read(text) == (math.inf if text == "max" else float(text))
    for text in (*bad, "nan", "NaN", "", "much", "1 mm"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"expected .*, got "):
            read(text)
