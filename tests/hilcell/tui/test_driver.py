"""The terminal's driver: Esc in the bytes that come in, colours in the bytes that go out."""

from __future__ import annotations

import re

import pyte
import pytest
from hypothesis import given
from hypothesis import strategies as st
from textual.color import Color

from hilcell.tui.terminal.driver import StopDriver, has_escape, without_colours
from hilcell.tui.terminal.themes import NAMES, PALETTES, ROLES, Palette
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


SGR = re.compile(r"\x1b\[[\d;:]*m")
by_palette = pytest.mark.parametrize("palette", PALETTES, ids=lambda palette: palette.name)
themes = st.sampled_from(NAMES)
numbers = st.integers(0, 120).map(str)
rgb = st.lists(st.integers(0, 255).map(str), min_size=3, max_size=3)
kinds = st.sampled_from("345")
short = (*range(30, 38), 39, *range(40, 48), 49, 59, *range(90, 98), *range(100, 108))
colours = st.one_of(
    st.builds("{}8;2;{}".format, kinds, rgb.map(";".join)),
    st.builds("{}8:2::{}".format, kinds, rgb.map(":".join)),
    st.builds("{}8;5;{}".format, kinds, st.integers(0, 255)),
    st.sampled_from(short).map(str),
)
attributes = st.sampled_from(["0", "1", "2", "3", "4", "4:3", "5", "7", "9", "22", "27"])
words = st.text(st.characters(exclude_characters="\x1b", exclude_categories=["Cs"]))
codes = st.lists(colours | attributes | numbers).map(lambda each: f"\x1b[{';'.join(each)}m")
others = st.sampled_from(["\x1b[4;1H", "\x1b[?25l", "\x1b[>9u", "\x1b[>4;38m", "\x1b[?38m"])
written = st.lists(words | codes | others).map("".join)


def grey(colour: str) -> str:
    """Return a colour as Textual sends it where there are to be none."""
    return ";".join(map(str, Color.parse(colour).monochrome.rgb))


def styled(ground: str, *, bold: bool = False, text: str = "#123456") -> str:
    start = "1;" if bold else ""
    return f"\x1b[{start}38;2;{grey(text)};48;2;{grey(ground)}mX\x1b[0m"


@by_palette
def test_what_stands_on_a_fill_is_reversed(palette: Palette) -> None:
    for ground in map(palette.fill, (*ROLES, "text", "badge")):
        assert without_colours(styled(ground), palette.name) == "\x1b[7mX\x1b[0m"
        assert without_colours(styled(ground, bold=True), palette.name) == "\x1b[1;7mX\x1b[0m"


@by_palette
def test_the_cursor_row_is_reversed_and_a_text_box_is_a_line_to_write_on(palette: Palette) -> None:
    assert without_colours(styled(palette.cursor, bold=True), palette.name) == "\x1b[1;7mX\x1b[0m"
    assert without_colours(styled(palette.cursor), palette.name) == "\x1b[4mX\x1b[0m"


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
        assert without_colours(styled(ground), palette.name) == "X\x1b[0m"
        assert without_colours(styled(ground, bold=True), palette.name) == "\x1b[1mX\x1b[0m"


@pytest.mark.parametrize(
    ("code", "wanted"),
    [
        ("\x1b[m", "\x1b[m"),
        ("\x1b[0m", "\x1b[0m"),
        ("\x1b[0;31m", "\x1b[0m"),
        ("\x1b[31m", ""),
        ("\x1b[1;31;4m", "\x1b[1;4m"),
        ("\x1b[7;38;2;1;2;3;48;2;4;5;6m", "\x1b[7m"),
        ("\x1b[38;5;4;1m", "\x1b[1m"),
        ("\x1b[38:2::1:2:3;1m", "\x1b[1m"),
        ("\x1b[58:2::1:2:3;4:3m", "\x1b[4:3m"),
        ("\x1b[38;2;1m", ""),
        ("\x1b[;1m", "\x1b[;1m"),
    ],
)
def test_attributes_stay_and_colours_go(code: str, wanted: str) -> None:
    assert without_colours(code, NAMES[0]) == wanted


@given(written, themes)
def test_no_colour_is_left(text: str, theme: str) -> None:
    assert colours_of(without_colours(text, theme).encode()) == set()


@given(written, themes)
def test_everything_else_is_left(text: str, theme: str) -> None:
    assert SGR.sub("", without_colours(text, theme)) == SGR.sub("", text)


@given(written, themes)
def test_what_is_bare_stays_as_it_is(text: str, theme: str) -> None:
    once = without_colours(text, theme)
    assert without_colours(once, theme) == once


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
