"""The terminal's driver: Esc in the bytes that come in, colours in what is painted."""

from __future__ import annotations

import pyte
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.segment import Segment
from rich.style import Style
from textual.color import Color

from hilcell.tui.driver import StopDriver, WithoutColours, has_escape
from hilcell.tui.themes import NAMES, PALETTES, ROLES, Palette
from tests.hilcell.tui.terminal_colours import colours_of


@pytest.mark.parametrize(
    "read",
    [b"\x1b", b"a\x1b", b"\x1b\x1b", b"\x1b[A\x1b", b"\x1b ", b"\x1bq", b"\x1b\r", b"\x1b\x1b[A",
     b"\x1b\x03", b"\x1b[27u", b"\x1b[27;1u", b"\x1b[27;1:1u", b"\x1b[27;5:2u", b"xx\x1b[27uyy",
     "\x1bé".encode()],
)  # fmt: skip
def test_esc_is_seen(read: bytes) -> None:
    assert has_escape(read)


@pytest.mark.parametrize(
    "read",
    [b"", b"a", b"27u", b"\x1b[A", b"\x1bOP", b"\x1b[1;5C", b"\x1b[15~", b"\x1b[<0;10;5M",
     b"\x1b[M !!", b"\x1b[200~pasted\x1b[201~", b"\x1b[I", b"\x1b[?2026;2$y", b"\x1b[27;1:3u",
     b"\x1b[27;2;13~", b"\x1b[127u", b"\x1b[2727u", b"\x1bP>|XTerm(390)\x1b\\",
     b"\x1b]11;rgb:0000/0000/0000\x1b\\", b"\x1b_Gi=1;OK\x1b\\"],
)  # fmt: skip
def test_other_keys_and_answers_of_terminals_are_no_esc(read: bytes) -> None:
    assert not has_escape(read)


@given(st.binary(), st.binary())
def test_esc_is_seen_wherever_it_ends_a_read(before: bytes, after: bytes) -> None:
    assert has_escape(before + b"\x1b")
    assert has_escape(before + b"\x1b[27u" + after)


@given(st.text(st.characters(exclude_characters="\x1b")))
def test_text_is_no_esc(text: str) -> None:
    assert not has_escape(text.encode("utf-8", "surrogatepass"))


by_palette = pytest.mark.parametrize("palette", PALETTES, ids=lambda palette: palette.name)
anything = st.builds(
    Style,
    color=st.none() | st.sampled_from(["red", "#123456", "color(17)", "default"]),
    bgcolor=st.none() | st.sampled_from(["blue", "#0e1419", "#22384a", "default"]),
    bold=st.none() | st.booleans(),
    underline=st.none() | st.booleans(),
    reverse=st.none() | st.booleans(),
)


def bare(style: Style, theme: str) -> Style:
    """Return a style as it is painted without colours."""
    (found,) = WithoutColours.of(theme).apply([Segment("X", style)], Color.parse("black"))
    assert found.text == "X"
    assert found.style is not None
    return found.style


def on(ground: str, *, bold: bool | None = None) -> Style:
    return Style(color="#123456", bgcolor=Color.parse(ground).rich_color, bold=bold)


@by_palette
def test_what_stands_on_a_fill_is_reversed(palette: Palette) -> None:
    for ground in (*map(palette.fill, ROLES), palette.text, palette.badge):
        assert bare(on(ground), palette.name) == Style(reverse=True)
        assert bare(on(ground, bold=True), palette.name) == Style(bold=True, reverse=True)


@by_palette
def test_the_cursor_row_is_reversed_and_a_text_box_is_a_line_to_write_on(palette: Palette) -> None:
    assert bare(on(palette.cursor, bold=True), palette.name) == Style(bold=True, reverse=True)
    assert bare(on(palette.cursor), palette.name) == Style(underline=True)


@by_palette
def test_what_stands_on_the_ground_or_on_its_shades_is_left_alone(palette: Palette) -> None:
    variables = palette.theme().to_color_system().generate()
    for ground in (
        palette.ground,
        palette.panel,
        palette.track,
        variables["scrollbar-background"],
        variables["surface"],
    ):
        assert bare(on(ground), palette.name) == Style()
        assert bare(on(ground, bold=True), palette.name) == Style(bold=True)


@given(anything, st.sampled_from(NAMES))
def test_no_colour_is_left_and_every_attribute_stays(style: Style, theme: str) -> None:
    found = bare(style, theme)
    assert (found.color, found.bgcolor, found.bold) == (None, None, style.bold)
    assert bool(found.reverse) >= bool(style.reverse)
    assert bool(found.underline) >= bool(style.underline)
    assert bare(found, theme) == found


class Written:
    """Takes what a driver writes to its terminal."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def write(self, text: str) -> None:
        """Take it."""
        self.texts.append(text)


def test_a_state_that_was_not_painted_for_long_is_covered_once() -> None:
    late = False
    driver, terminal = object.__new__(StopDriver), Written()
    vars(driver).update(_writer_thread=terminal, is_late=lambda: late)
    for late, written in ((False, 0), (True, 1), (True, 1), (False, 1), (True, 2)):  # noqa: B007
        driver._cover_when_late()
        assert len(terminal.texts) == written
    screen = pyte.Screen(80, 24)
    stream = pyte.Stream(screen)
    stream.feed("\x1b[H\x1b[1m. RUNNING LIVE\x1b[5;7H" + terminal.texts[0])
    assert "NOT PAINTED" in screen.display[0]
    assert "RUNNING" not in screen.display[0]
    assert screen.display[0][0] == "."  # the edge of a simulated run
    assert (screen.cursor.y, screen.cursor.x) == (4, 6)
    assert colours_of(terminal.texts[0].encode()) == set()
