"""Large figures: three rows of half blocks, as drawn on the design sheet."""

from __future__ import annotations

import math

import pytest

from hilcell.tui.layout import figure, large, large_rows
from hilcell.tui.terminal import ASCII, UNICODE

SHEET = """
█▀█ ▄█  ▀▀█ ▀▀█ █ █ █▀▀ █▀▀ ▀▀█ █▀█ █▀█
█ █  █  █▀▀  ▀█ ▀▀█ ▀▀█ █▀█   █ █▀█ ▀▀█
▀▀▀ ▀▀▀ ▀▀▀ ▀▀▀   ▀ ▀▀▀ ▀▀▀   ▀ ▀▀▀ ▀▀▀
"""


def test_digits_are_as_drawn() -> None:
    assert [row.rstrip() for row in large_rows("0123456789")] == SHEET.strip().splitlines()


@pytest.mark.parametrize("text", ["0.189", "-1.234", "+0.5", "PASS", "FAIL", "-.---", "−0.1"])
def test_rows_are_of_equal_length(text: str) -> None:
    rows = large_rows(text)
    assert len(rows) == 3
    assert len({len(row) for row in rows}) == 1
    assert [len(line) for line in large(text, "", UNICODE)] == [len(rows[0])] * 3


def test_no_two_signs_look_alike() -> None:
    signs = "012346789+-.PASFIL"
    assert len({large_rows(sign) for sign in signs}) == len(signs)


def test_a_letter_without_a_shape_is_refused() -> None:
    with pytest.raises(KeyError):
        large_rows("0,1")


def test_in_ascii_it_is_one_bold_line() -> None:
    lines = [line.plain for line in large("0.189", "$passed", ASCII)]
    assert lines == ["     ", "0.189", "     "]


@pytest.mark.parametrize("value_mm", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_shown_as_none(value_mm: float) -> None:
    assert large_rows(figure(value_mm)) == large_rows("-.---")


def test_a_length_has_three_decimals() -> None:
    assert figure(0.1886) == "0.189"
