"""A plot in characters: half blocks, limits, names at their lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hilcell.tui.plots import (
    BELOW,
    FARTHEST,
    Canvas,
    Ink,
    Mark,
    Plot,
    PlotStyle,
    Scale,
    Series,
    draw,
    place,
)

RED, BLUE = Ink("red", "o", "red"), Ink("blue", "x", "blue")
EVEN = Scale(0.0, 10.0, 1.0)
ROWS = 21  # two rows for each step
PLAIN = PlotStyle(letters=True, plain=True)
TICKS = ((0.0, "0 %"), (0.5, "50 %"))


def plot_of(*series: Series, limits: tuple[float, ...] = (), marks: tuple[Mark, ...] = ()) -> Plot:
    return Plot("errors", "share", TICKS, series, limits, "limit", marks)


def line(name: str, y: list[float], ink: Ink = RED, *, joined: bool = False) -> Series:
    return Series(name, ink, np.arange(len(y)) / len(y), np.array(y), joined)


def drawn(plot: Plot, width: int = 43, scale: Scale = EVEN, style: PlotStyle = PlotStyle(), *,  # noqa: B008 - frozen
          named: bool = False) -> list[str]:  # fmt: skip
    return [each.plain for each in draw(plot, scale, width, ROWS + BELOW, style, named=named)]


def test_two_steps_a_row_and_a_colour_for_each_half() -> None:
    canvas = Canvas(4, 1)
    red, blue = canvas.ink(RED), canvas.ink(BLUE)
    for half, column, ink in ((0, 0, red), (1, 1, red), (0, 2, red), (1, 2, red), (0, 3, red)):
        canvas.mark(half, column, ink)
    canvas.mark(1, 3, blue)
    (content,) = canvas.lines()
    assert content.plain == "▀▄█▀"
    assert [str(span.style) for span in content.spans] == ["red", "red on blue"]


def test_letters_tell_series_apart_without_colours() -> None:
    canvas = Canvas(2, 1, letters=True)
    red, blue = canvas.ink(RED), canvas.ink(BLUE)
    canvas.mark(0, 0, red)
    canvas.mark(1, 0, blue)
    canvas.mark(1, 1, red)
    assert canvas.lines()[0].plain == "xo"


def test_what_lies_outside_is_left_out() -> None:
    canvas = Canvas(2, 1)
    canvas.mark(-1, 0, canvas.ink(RED))
    canvas.mark(0, 5, 0)
    canvas.text(3, 0, "far")
    canvas.text(0, 1, "wide")
    assert canvas.lines()[0].plain == " w"


def test_a_value_stands_at_its_tick() -> None:
    lines = drawn(plot_of(line("a", [10.0, 7.0, 0.0])))
    for value, text in ((10, lines[0]), (7, lines[6]), (0, lines[20])):
        assert text.startswith(f"{value:>2}┤")
        assert "▄" in text


@pytest.mark.parametrize("limit", [0.1, 0.3, 0.31, 0.7, 1.0])
def test_a_value_is_seen_on_its_side_of_the_limit(limit: float) -> None:
    """A row is coarse: without care a value over the limit could be drawn on or under its line."""
    scale = Scale.log(np.array([0.02]), [limit])
    over = drawn(plot_of(line("a", [limit * 1.001]), limits=(limit,)), scale=scale)
    under = drawn(plot_of(line("a", [limit]), limits=(limit,)), scale=scale)
    at = next(n for n, text in enumerate(over) if "┤──" in text or "┤▀" in text)
    assert "▀" in over[at] or any("▄" in text or "▀" in text for text in over[:at])
    assert "▄" in under[at] or any("▄" in text or "▀" in text for text in under[at + 1 : ROWS])
    assert "▀" not in under[at]
    assert "▄" not in over[at]


def test_a_letter_never_stands_on_the_limits_line() -> None:
    scale = Scale.log(np.array([0.02]), [0.3])
    for value in (0.2999, 0.3, 0.3001):
        lines = drawn(plot_of(line("a", [value]), limits=(0.3,)), scale=scale, style=PLAIN)
        at = next(n for n, text in enumerate(lines) if text.startswith("0.30┤"))
        beside = lines[at - 1] if value > 0.3 else lines[at + 1]
        assert "o" in beside


def test_the_limit_has_a_tick_of_its_own_off_the_frame() -> None:
    lines = drawn(plot_of(line("a", [0.05]), limits=(0.3,)), scale=Scale.log(np.zeros(1), [0.3]))
    (at,) = [n for n, text in enumerate(lines) if text.startswith("0.30┤─")]
    assert 0 < at < ROWS - 1


def test_a_line_has_no_gaps_and_points_are_not_joined() -> None:
    steep = [0.0, 9.9]
    joined, apart = (drawn(plot_of(line("a", steep, joined=j)), width=5) for j in (True, False))
    marked = [sum("█" in t or "▀" in t or "▄" in t for t in lines) for lines in (joined, apart)]
    assert marked == [ROWS, 2]


def test_names_stand_at_their_lines() -> None:
    high, low = line("as sent", [8.0] * 40), line("corrected", [2.0] * 40, BLUE)
    lines = drawn(plot_of(high, low, limits=(5.0,)), named=True)
    rows = {name: next(n for n, text in enumerate(lines) if name in text)
            for name in ("as sent", "corrected", "limit")}  # fmt: skip
    for name, at in (("as sent", 4), ("corrected", 16), ("limit", 10)):
        assert 1 <= abs(rows[name] - at) <= FARTHEST


def test_a_name_without_room_is_left_out_rather_than_put_at_another_line() -> None:
    cells = [np.zeros((3, 20), bool) for _ in range(2)]
    cells[0][0], cells[1][2] = True, True
    busy = np.zeros((3, 20), bool)
    busy[1] = True
    assert place(["upper", "lower"], [*cells, busy], [0.0, 0.5]) == [None, None]
    one, other = place(["upper", "lower"], cells, [0.0, 0.5])
    assert one is None  # as near to the other line as to its own
    assert other is None


def test_a_mark_stands_over_its_value() -> None:
    lines = drawn(plot_of(line("a", [0.0] * 20), marks=(Mark("78.0", 0.5, 6.0),)))
    assert "78.0" in lines[7]
    lines = drawn(plot_of(line("a", [8.0] * 20), marks=(Mark("78.0", 0.5, 6.0),)))
    assert "78.0" in lines[3]  # not behind a higher series


@pytest.mark.parametrize("size", [(20, 5), (12, 4), (80, 20), (200, 60)])
@pytest.mark.parametrize("style", [PlotStyle(), PLAIN])
def test_a_plot_has_its_size_always(size: tuple[int, int], style: PlotStyle) -> None:
    odd = line("a", [math.nan, 1.0, math.inf, -5.0])
    for plot in (plot_of(odd, line("b", []), limits=(5.0,)), plot_of()):
        lines = draw(plot, EVEN, *size, style)
        assert len(lines) == size[1]
        assert all(each.cell_length == size[0] for each in lines)


def test_dots_are_ascii_where_only_that_is_shown() -> None:
    lines = drawn(plot_of(line("a", [3.0])), style=PLAIN)
    assert "·" not in "".join(lines)
    assert "o" in "".join(lines)
