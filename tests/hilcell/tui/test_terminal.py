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
from hilcell.journal.runs import JOURNAL
from hilcell.run.protocol import Status
from hilcell.tui.engine.run_view import EngineState
from tests.hilcell.tui.engine_peer import STATUS, Peer, says
from tests.hilcell.tui.sample_runs import fresh, sample_runs, status
from tests.hilcell.tui.untrusted_text import NASTY, poisoned
from tests.whole.terminal import Terminal

NAME = "20260304-080000-calibrate-ab12"
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
    write(folder, sample_runs()[name].records)
    with (
        Peer(folder, lambda _: says(reported(status(name)))) as peer,
        Terminal(["tui", folder.name, "--runs", str(folder.parent)]) as terminal,
    ):
        terminal.shows("LIVE")
        terminal.shows("Tracker 1.")
        yield terminal, peer


# -- hostile words ---------------------------------------------------------------------------------


def harmless(raw: bytes) -> None:
    for piece in PIECES:
        before, found, after = raw.partition(piece)
        assert not found, (piece, before[-60:], after[:60])
    assert not C1.search(raw)


def gone(terminal: Terminal, title: str) -> None:
    terminal.until(lambda shown: title not in shown)


WALK = (
    ("e", "Alarms"),
    ("i", "Interlocks"),
    ("l", "Event log"),
    ("p", "3 repeatability"),
    ("?", "Help"),
    ("h", "History: 2 of 2"),
)


@pytest.mark.parametrize("state", ["suspended", "fault"])
def test_no_hostile_byte_reaches_the_terminal(tmp_path: Path, state: str) -> None:
    text = "".join(text[:200] for text in NASTY.values())
    found = poisoned(state, text)
    folder = tmp_path / "runs" / NAME
    write(folder, found.records)
    named = os.fsencode(tmp_path / "runs") + b"/r\x1b[31mPWNED\xc2\x9b\x07\xe2\x80\xae\xff\xfe"
    write(Path(os.fsdecode(named)), fresh("done").records)
    words = ["tui", NAME, "--runs", str(folder.parent)]
    with Peer(folder, lambda _: says(reported(found.status))) as peer, Terminal(words) as terminal:
        if found.engine is EngineState.NONE:
            peer.hang_up()
            (folder / "engine.json").unlink()
        terminal.shows("PWNED")
        for key, title in WALK:
            terminal.press(key)
            terminal.shows(title)
            terminal.press("q")
            gone(terminal, title)
        terminal.press("\x1b[200~" + "a\x07\u202eb" + "\x1b[201~/")
        harmless(bytes(terminal.raw))
        assert not terminal.ended


def test_a_run_whose_name_is_hostile_is_shown_by_it(tmp_path: Path) -> None:
    folder = tmp_path / "r\x1b[31mPWNED\x9b[@click=app.quit][nope]\u202e"
    write(folder, sample_runs()["done"].records)
    with Terminal(["tui", "last", "--runs", str(tmp_path)], columns=200) as terminal:
        terminal.shows("DONE")
        terminal.press("h")
        terminal.shows("[@click=app.quit][nope]")
        harmless(bytes(terminal.raw))


# -- stop ------------------------------------------------------------------------------------------


def test_every_esc_reaches_the_engine_wherever_it_is_pressed(tmp_path: Path) -> None:
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


def look_at_another(terminal: Terminal) -> None:
    """Open the run before the live one."""
    terminal.press("h")
    terminal.shows("2 of 2 runs")
    terminal.press(f"\x1b[B{ENTER}")
    terminal.shows("Esc still stops it")
    terminal.answer(ENTER)


def test_esc_stops_the_live_run_from_which_one_looked_at_another(tmp_path: Path) -> None:
    write(tmp_path / "20260303-080000-calibrate-cd34", sample_runs()["done"].records)
    with live(tmp_path / NAME, "running") as (terminal, peer):
        look_at_another(terminal)
        terminal.shows("behind: RUNNING; q goes back, Esc stops")
        stops = peer.commands.count("stop") + 2
        terminal.press(ESC)
        peer.until_stops(stops)
        terminal.shows("STOP sent")
        assert "leave" not in peer.commands  # a lost screen would be reported
        terminal.press("q")
        terminal.shows("LIVE")
        terminal.press(ENTER)


def test_a_background_run_that_ends_is_reported(tmp_path: Path) -> None:
    write(tmp_path / "20260303-080000-calibrate-cd34", sample_runs()["done"].records)
    with live(tmp_path / NAME, "running") as (terminal, peer):
        look_at_another(terminal)
        terminal.shows("behind: RUNNING")
        (tmp_path / NAME / "engine.json").unlink()
        peer.hang_up()
        terminal.shows("the run behind,")
        terminal.shows("has ended: ENGINE GONE")
        terminal.shows("nothing is connected")


@pytest.mark.parametrize("key", [CTRL_C, CTRL_Q])
def test_leaving_with_a_live_run_behind_asks(tmp_path: Path, key: str) -> None:
    write(tmp_path / "20260303-080000-calibrate-cd34", sample_runs()["done"].records)
    with live(tmp_path / NAME, "running") as (terminal, peer):
        look_at_another(terminal)
        terminal.shows("behind: RUNNING")
        terminal.press("n")
        terminal.shows("new run: a run is live: stop, abort or detach from it first")
        terminal.press(key)
        terminal.shows("A run is live.")
        assert not terminal.ended
        assert "leave" not in peer.commands
        terminal.answer("y")
        assert terminal.ends() == 0
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "leave"]


def test_esc_with_the_next_key_in_one_breath_stops(tmp_path: Path) -> None:
    with live(tmp_path / NAME, "running") as (terminal, peer):
        terminal.press(f"{ESC} ")
        peer.until(lambda: "stop" in peer.commands)


def test_arrows_and_other_sequences_do_not_stop(tmp_path: Path) -> None:
    with live(tmp_path / NAME, "suspended") as (terminal, peer):
        terminal.press("\x1b[A\x1b[B\x1bOA\x1b[5~\x1b[6~\x1b[1;5C\x1b[I\x1b[200~x\x1b[201~")
        terminal.answer(ENTER)
        peer.until(lambda: "answer" in peer.commands)
        assert set(peer.commands) == {"attend", "answer"}


# -- leaving ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", [CTRL_C, CTRL_Q])
def test_leaving_a_live_run_asks_and_is_reported_to_the_engine(tmp_path: Path, key: str) -> None:
    with live(tmp_path / NAME, "running") as (terminal, peer):
        terminal.press(key)
        terminal.shows("A run is live.")
        assert not terminal.ended
        terminal.answer("y")
        assert terminal.ends() == 0
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend", "leave"]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGHUP, signal.SIGTERM])
def test_a_lost_screen_sends_no_leave(tmp_path: Path, how: signal.Signals) -> None:
    with live(tmp_path / NAME, "running") as (terminal, peer):
        os.kill(terminal.pid, how)
        peer.until(lambda: peer.open == 0)
        assert peer.commands == ["attend"]
