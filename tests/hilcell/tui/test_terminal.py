"""The screen in a real terminal, an engine of the test's own behind it: what reaches the wires.

Nothing hostile may reach the terminal, and every Esc must reach the engine, wherever it is pressed.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from hilcell.journal.journal import Journal, Record
from hilcell.journal.runs import CALIBRATION, JOURNAL
from hilcell.run.control import Status
from tests.hilcell.tui.engine_peer import STATUS, Peer, says
from tests.hilcell.tui.sample_runs import fresh, sample_run, status
from tests.hilcell.tui.terminal_colours import colours_of
from tests.hilcell.tui.untrusted_text import NASTY, poisoned
from tests.whole.terminal import Terminal

pytestmark = pytest.mark.process

NAME = "20260304-080000-calibrate-ab12"
OTHER = "20260303-080000-calibrate-cd34"
ESC, ENTER, CTRL_C, CTRL_P, CTRL_Q = "\x1b", "\r", "\x03", "\x10", "\x11"
# Every hostile piece as bytes; what Textual itself sends is none of them.
PIECES = [
    text.encode() for text in (
        "\x1b[31mPWNED", "\x1b[31m?PWNED", "\x1bc", "\x1b[2J", "\x1b]0;", "\x1b]52", "\x7f", "\x00",
        "\u202e", "\u2066", "\u200b", "\u061c", "\ufeff", "\u2028",
    )
]  # fmt: skip
C1 = re.compile(rb"\xc2[\x80-\x9f]")


def write(folder: Path, records: list[Record]) -> None:
    """Write a journal of made-up records."""
    folder.mkdir(parents=True, exist_ok=True)
    journal = Journal(folder / JOURNAL, "made-up", create=True)
    for record in records:
        journal.append(record.kind, record.key, record.body)
    journal.close()


def reported(found: Status | None) -> dict[str, object]:
    """Return what an engine in such a state says."""
    facts: dict[str, object] = msgspec.to_builtins(found)
    return STATUS | facts


@contextmanager
def live(folder: Path, name: str) -> Iterator[tuple[Terminal, Peer]]:
    """Show a live run of a state."""
    write(folder, sample_run(name).records)
    with (
        Peer(folder, lambda _: says(reported(status(name)))) as peer,
        Terminal(["tui", folder.name, "--runs", str(folder.parent)]) as terminal,
    ):
        terminal.shows("LIVE", "Tracker 1.")
        yield terminal, peer


@contextmanager
def past(runs: Path, *words: str, **environment: str) -> Iterator[Terminal]:
    """Show the points of a run that is done."""
    write(runs / NAME, fresh("done").records)
    (runs / NAME / CALIBRATION).write_text("{}", encoding="utf-8")
    order = ["tui", "last", "--runs", str(runs), *words]
    with Terminal(order, columns=80, rows=24, **environment) as terminal:
        terminal.shows("DONE", "w worst")
        terminal.press("b")
        terminal.press("b")
        terminal.until(lambda text: "\n▌►" in text or "\n|>" in text)
        yield terminal


def gone(terminal: Terminal, title: str) -> None:
    terminal.until(lambda shown: title not in shown)


# -- hostile words ---------------------------------------------------------------------------------


WALK = (
    ("e", "Alarms"),
    ("i", "Interlocks"),
    ("l", "Event log"),
    ("p", "3 repeatability"),
    ("?", "Help"),
    ("h", "History: 2 of 2"),
)


def test_no_hostile_byte_reaches_the_terminal(tmp_path: Path) -> None:
    found = poisoned("suspended", "".join(text[:200] for text in NASTY.values()))
    folder = tmp_path / "runs" / NAME
    write(folder, found.records)
    named = os.fsencode(tmp_path / "runs") + b"/r\x1b[31mPWNED\xc2\x9b\x07\xe2\x80\xae\xff\xfe"
    write(Path(os.fsdecode(named)), fresh("done").records)
    words = ["tui", NAME, "--runs", str(folder.parent)]
    with Peer(folder, lambda _: says(reported(found.status))), Terminal(words) as terminal:
        terminal.shows("PWNED")
        for key, title in WALK:
            terminal.press(key)
            terminal.shows(title)
            terminal.press("q")
            gone(terminal, title)
        terminal.press("\x1b[200~" + "a\x07\u202eb" + "\x1b[201~/")
        raw = bytes(terminal.raw)
        assert [piece for piece in PIECES if piece in raw] == []
        assert not C1.search(raw)
        assert not terminal.ended


# -- stop ------------------------------------------------------------------------------------------


def test_every_esc_reaches_the_engine_wherever_it_is_pressed(tmp_path: Path) -> None:
    """Also together with the next key."""
    places = (
        ("", "LIVE", ""),
        ("/xyz", "no such point", "\x7f\x7f\x7f\r"),
        ("l", "Event log", "q"),
        ("p", "3 repeatability", "q"),
        ("a", "Abort this run?", ""),
        (CTRL_P, "what to do?", ""),
        (CTRL_Q, "detach", ""),
        ("?", "Help", "q"),
    )
    with live(tmp_path / NAME, "running") as (terminal, peer):
        for keys, seen, back in places:
            stops = peer.commands.count("stop") + 2  # by the byte itself, and by its action
            terminal.press(keys)
            terminal.shows(seen)
            terminal.press(ESC)
            peer.until_stops(stops)
            terminal.shows("STOP sent")
            terminal.press(back)
            if back:
                gone(terminal, seen)
            terminal.until(lambda shown: "rms  state" in shown and "? help" in shown)
        assert set(peer.commands) == {"attend", "stop"}
        stops = peer.commands.count("stop")
        terminal.press(f"{ESC} ")
        peer.until(lambda: peer.commands.count("stop") > stops)
        os.kill(terminal.pid, signal.SIGHUP)
        peer.until(lambda: peer.open == 0)
        assert set(peer.commands) == {"attend", "stop"}, "a lost screen sends no leave"


def test_a_live_run_behind_another_is_stopped_and_left_and_its_end_is_reported(
    tmp_path: Path,
) -> None:
    write(tmp_path / OTHER, sample_run("done").records)
    with live(tmp_path / NAME, "running") as (terminal, peer):
        terminal.press("h")
        terminal.shows("2 of 2 runs")
        terminal.press(f"\x1b[B{ENTER}")
        terminal.shows("Esc still stops it")
        terminal.answer(ENTER)
        terminal.shows("background: RUNNING")
        stops = peer.commands.count("stop") + 2
        terminal.press(ESC)
        peer.until_stops(stops)
        terminal.shows("STOP sent")
        terminal.answer(CTRL_C)
        terminal.shows("A run is live.")
        assert not terminal.ended
        terminal.answer("n")
        gone(terminal, "A run is live.")
        assert "leave" not in peer.commands  # a lost screen would be reported
        (tmp_path / NAME / "engine.json").unlink()
        peer.hang_up()
        terminal.shows("has ended: ENGINE LOST")


# -- leaving ---------------------------------------------------------------------------------------


def test_leaving_a_live_run_asks_and_is_reported_to_the_engine(tmp_path: Path) -> None:
    """Before it, arrows and other sequences, which begin as Esc does, stop nothing."""
    with live(tmp_path / NAME, "suspended") as (terminal, peer):
        terminal.press("\x1b[A\x1b[B\x1bOA\x1b[5~\x1b[6~\x1b[1;5C\x1b[I\x1b[200~x\x1b[201~")
        terminal.answer(ENTER)
        peer.until(lambda: "answer" in peer.commands)
        terminal.answer(CTRL_Q)
        terminal.shows("A run is live.")
        assert not terminal.ended
        terminal.answer("y")
        assert terminal.ends() == 0
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "answer", "leave"]


@pytest.mark.nightly  # SIGHUP ends the test of every Esc as well
@pytest.mark.parametrize("how", [signal.SIGHUP, signal.SIGKILL])
def test_a_lost_screen_sends_no_leave(tmp_path: Path, how: signal.Signals) -> None:
    with live(tmp_path / NAME, "running") as (terminal, peer):
        os.kill(terminal.pid, how)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend"]


# -- colours and shapes: `test_capabilities` has the matrix ---------------------------------------


def marked(terminal: Terminal, words: str) -> str:
    """Return what of these words, where they are first seen, is in reverse video."""
    rows = terminal.text.split("\n")
    y = next(n for n, row in enumerate(rows) if words in row)
    across = range(rows[y].index(words), rows[y].index(words) + len(words))
    row = terminal.screen.buffer[y]
    return "".join(row[x].data for x in across if row[x].reverse)


def test_without_colours_none_is_sent_and_reverse_video_marks(tmp_path: Path) -> None:
    unnamed = {"LC_ALL": "", "LC_CTYPE": "", "LANG": ""}  # a locale: shapes are believed to show
    with past(tmp_path, "--theme", "daylight", NO_COLOR="1", **unnamed) as terminal:
        chosen = next(row[1:] for row in terminal.text.split("\n") if row.startswith("▌►"))
        for words in (" ● DONE ", "HISTORIC", " SIMULATION ", chosen):
            assert marked(terminal, words) == words
        assert marked(terminal, "r  re-measure") == "r "
        terminal.press("/x")
        terminal.until(lambda text: "no such point" in text and "▌x" in text)
        (box,) = (row for row in terminal.screen.buffer.values() if row[1].data == "x")
        assert [box[x].underscore for x in range(1, 5)] == [True, False, True, True]
        assert [box[x].reverse for x in range(1, 5)] == [False, True, False, False]
        terminal.press("\x7f\r\x10")
        terminal.shows("bad only: show")
        terminal.press("\x1b[B")
        terminal.until(lambda _: marked(terminal, "bad only: show") == "bad only: show")
        cells = (cell for row in terminal.screen.buffer.values() for cell in row.values())
        assert {colour for cell in cells for colour in (cell.fg, cell.bg)} == {"default"}
        assert colours_of(bytes(terminal.raw)) == set()


def test_sixteen_colours_and_ascii_are_all_that_is_sent_where_they_are_asked_for(
    tmp_path: Path,
) -> None:
    with past(tmp_path, "--colors", "16", NO_COLOR="1", LC_ALL="C") as terminal:
        state, simulation = terminal.screen.buffer[0][1], terminal.text.index("SIMULATION")
        assert (state.fg, state.bg) == ("black", "brightgreen")  # passed
        assert terminal.screen.buffer[0][simulation].bg.endswith("magenta")
        assert colours_of(bytes(terminal.raw)) == {"16"}
        assert terminal.raw.isascii()
