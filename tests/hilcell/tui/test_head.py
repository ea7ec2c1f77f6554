"""The head of a finished run: when a figure is over its limit, and how it is drawn."""

from __future__ import annotations

import math

import pytest

from hilcell.tui.terminal import UNICODE
from hilcell.tui.text.finished import Figure, Head, gravest
from tests.hilcell.tui.views import view_of

NAN = math.nan


@pytest.mark.parametrize(
    ("value_mm", "limit_mm", "U_mm", "over"),
    [
        (0.110, 0.120, 0.010, False),
        (0.111, 0.120, 0.010, True),
        (0.121, 0.120, 0.0, True),
        (NAN, 0.120, 0.0, True),
        (0.110, 0.120, NAN, True),
        (9.0, None, 0.0, False),
    ],
)
def test_a_figure_keeps_its_limit_with_its_uncertainty(
    value_mm: float, limit_mm: float | None, U_mm: float, over: bool
) -> None:
    assert Figure("AP_p, mm", value_mm, "at P1", limit_mm, U_mm).over is over


def test_what_is_no_length_is_graver_than_any() -> None:
    assert max((0.2, NAN, 5.0), key=gravest) is NAN
    assert max((-math.inf, 5.0), key=gravest) == -math.inf
    assert max((0.2, 5.0), key=gravest) == 5.0


@pytest.mark.parametrize(
    ("width", "rows", "small"), [(78, 14, False), (77, 14, True), (78, 13, True)]
)
def test_the_large_head_needs_its_width_and_its_rows(width: int, rows: int, small: bool) -> None:
    assert Head.is_small(width, rows) is small


@pytest.mark.parametrize(
    ("value_mm", "limit_mm", "filled", "sign", "role"),
    [
        (0.06, 0.12, Figure.TO_LIMIT / 2, "●", "$passed"),
        (0.12, 0.12, Figure.TO_LIMIT, "●", "$passed"),
        (0.50, 0.12, Figure.BAR, "▲", "$fault"),
        (0.06, None, 0.0, "○", "$label"),
    ],
)
def test_the_bar_reaches_the_limit_where_the_figure_does(
    value_mm: float, limit_mm: float | None, filled: float, sign: str, role: str
) -> None:
    figure = Figure("mean, mm", value_mm, "at S300", limit_mm)
    other = Figure("max, mm", 0.2, "at S1100", 0.3)
    head = Head(("PASS",), "in tolerance", "passed", (figure, other))
    lines = head.lines(view_of("done"), UNICODE, 79, 16)
    bar = lines[5].plain[26 : 26 + Figure.BAR].replace("│", "█" if filled > Figure.TO_LIMIT else "")
    assert bar.count("█") + bar.count("▌") / 2 == filled
    [at] = [line for line in lines if "at S300" in line.plain]
    signs = {at.plain[span.start : span.end]: span.style for span in at.spans if span.start == 26}
    assert (at.plain[26], signs[sign]) == (sign, role)
