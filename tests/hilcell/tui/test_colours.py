"""Colours and shapes in the bytes that a real terminal gets; `test_capabilities` has the matrix."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path

import pytest

from hilcell.journal.runs import CALIBRATION
from tests.hilcell.tui.sample_runs import fresh
from tests.hilcell.tui.terminal_colours import colours_of
from tests.hilcell.tui.test_terminal import NAME, write
from tests.whole.bench import sweep
from tests.whole.terminal import Terminal

TERMS = ("vt100", "linux", "screen", "xterm")
COLOURS = ("16", "256", "truecolor")


@contextmanager
def shown(runs: Path, *words: str, **environment: str) -> Iterator[Terminal]:
    """Show a run that is done."""
    write(runs / NAME, fresh("done").records)
    (runs / NAME / CALIBRATION).write_text("{}", encoding="utf-8")
    order = ["tui", "last", "--runs", str(runs), *words]
    with Terminal(order, columns=80, rows=24, **environment) as terminal:
        terminal.shows("w worst")
        terminal.press("b")
        terminal.press("b")
        terminal.until(lambda text: "\n▌►" in text or "\n|>" in text)
        yield terminal


def marked(terminal: Terminal, words: str) -> str:
    """Return what of these words, where they are first seen, is in reverse video."""
    rows = terminal.text.split("\n")
    y = next(n for n, row in enumerate(rows) if words in row)
    across = range(rows[y].index(words), rows[y].index(words) + len(words))
    row = terminal.screen.buffer[y]
    return "".join(row[x].data for x in across if row[x].reverse)


def is_bare(terminal: Terminal) -> bool:
    cells = (cell for row in terminal.screen.buffer.values() for cell in row.values())
    colours = {colour for cell in cells for colour in (cell.fg, cell.bg)}
    return colours_of(bytes(terminal.raw)) == set() and colours == {"default"}


def test_without_colours_none_is_sent_and_reverse_video_marks(tmp_path: Path) -> None:
    with shown(tmp_path, "--colors", "none") as terminal:
        chosen = next(row[1:] for row in terminal.text.split("\n") if row.startswith("▌►"))
        for words in (" ● DONE ", "HISTORIC", " SIMULATION ", chosen):
            assert marked(terminal, words) == words
        for words in ("Calibration", "Rail", "as sent 1"):
            assert marked(terminal, words) == ""
        assert marked(terminal, "r  re-measure") == "r "
        terminal.press("/x")
        terminal.until(lambda text: "no such point" in text and "▌x" in text)
        (box,) = (row for row in terminal.screen.buffer.values() if row[1].data == "x")
        assert [box[x].underscore for x in range(1, 5)] == [True, False, True, True]
        assert [box[x].reverse for x in range(1, 5)] == [False, True, False, False]
        assert is_bare(terminal)


def test_without_colours_the_command_that_is_chosen_is_reversed(tmp_path: Path) -> None:
    with shown(tmp_path, "--theme", "daylight", NO_COLOR="1") as terminal:
        terminal.press("\x10")
        terminal.shows("bad only: show")
        terminal.press("\x1b[B")
        terminal.until(lambda _: marked(terminal, "bad only: show") == "bad only: show", 5.0)
        assert marked(terminal, "re-measure: re-measure") == ""
        assert is_bare(terminal)


def test_what_is_asked_for_outweighs_the_environment(tmp_path: Path) -> None:
    with shown(tmp_path, "--colors", "256", NO_COLOR="1", TERM="vt100") as terminal:
        assert colours_of(bytes(terminal.raw)) == {"256"}
        red, green, blue = re.findall("..", terminal.screen.buffer[0][3].bg)
        assert not red == green == blue  # the state's block


@pytest.mark.parametrize(
    ("colours", "term"),
    [("16", "vt100"), ("truecolor", "screen"), *sweep(*product(COLOURS, TERMS))],
)
def test_only_the_colours_asked_for_are_sent(tmp_path: Path, term: str, colours: str) -> None:
    with shown(tmp_path, "--colors", colours, TERM=term) as terminal:
        terminal.press("h")
        terminal.shows("History")
        assert colours_of(bytes(terminal.raw)) == {colours}


@pytest.mark.parametrize("said", [{"LC_ALL": "C"}, {"TERM": "linux"}], ids=["C", "linux"])
def test_nothing_beyond_ascii_where_it_may_not_be_shown(
    tmp_path: Path, said: dict[str, str]
) -> None:
    with shown(tmp_path, **said) as terminal:
        terminal.shows("* DONE")
        assert terminal.raw.isascii()


def test_shapes_where_the_locale_says_nothing(tmp_path: Path) -> None:
    with shown(tmp_path, LC_ALL="", LC_CTYPE="", LANG="") as terminal:
        terminal.shows("● DONE")


def test_no_shapes_where_they_are_refused(tmp_path: Path) -> None:
    with shown(tmp_path, "--ascii") as terminal:
        terminal.shows("* DONE")
        assert terminal.raw.isascii()


def test_sixteen_colours_have_their_own_theme(tmp_path: Path) -> None:
    with shown(tmp_path, "--colors", "16") as terminal:
        state, simulation = terminal.screen.buffer[0][1], terminal.text.index("SIMULATION")
        assert (state.fg, state.bg) == ("black", "brightgreen")  # passed
        assert terminal.screen.buffer[0][simulation].bg.endswith("magenta")
        assert terminal.screen.buffer[2][0].bg == "black"
