"""Keys of other layouts: Cyrillic, Greek, accents and signs, as a terminal sends them."""

from __future__ import annotations

import asyncio
from itertools import product
from pathlib import Path

import pytest
from textual._xterm_parser import XTermParser
from textual.events import Key

from hilcell.tui.keys import load_keys
from hilcell.tui.terminal.capabilities import ASCII
from hilcell.tui.text.help import help_lines
from tests.hilcell.tui.recording_app import SIZE, RecordingApp, options, press, settle, text_of
from tests.hilcell.tui.sample_runs import fresh
from tests.hilcell.tui.test_terminal import NAME, write
from tests.whole.terminal import Terminal

LETTERS = ("Д", "é", "字", "[", ",", "\\")
KITTY = "\x1b[{0};;{0}u"


def keys_file(folder: Path, letters: tuple[str, ...]) -> Path:
    """Write a file that gives the log to letters."""
    file = folder / "keys.toml"
    keys = ", ".join(f"'{letter}'" for letter in letters)
    file.write_text(f"[keys]\nlog = [{keys}]\n", encoding="utf-8")
    return file


def test_a_letter_of_any_layout_acts_and_is_shown(tmp_path: Path) -> None:
    async def press_letters() -> None:
        app = RecordingApp(options(Path("/runs"), keymap=load_keys(file)), "done")
        async with app.run_test(size=SIZE) as pilot:
            await settle(pilot)
            for letter, sent in product(LETTERS, ("{1}", KITTY)):
                for event in XTermParser().feed(sent.format(ord(letter), letter)):
                    assert isinstance(event, Key)
                    app.post_message(event)
                await settle(pilot)
                assert "Event log" in text_of(app), (letter, sent)
                await press(pilot, "q")
                assert "Event log" not in text_of(app)

    file = keys_file(tmp_path, LETTERS)
    asyncio.run(press_letters())
    for letter in LETTERS:
        keymap = load_keys(keys_file(tmp_path, (letter,)))
        lines = help_lines(keymap, ASCII, {}, 79).plain.splitlines()
        assert any(line.startswith(f"{letter} ") and "journal" in line for line in lines)


@pytest.mark.parametrize("letter", ["д", "["])
def test_such_a_key_in_a_real_terminal(tmp_path: Path, letter: str) -> None:
    write(tmp_path / "runs" / NAME, fresh("done").records)
    words = ["tui", "last", "--runs", str(tmp_path / "runs")]
    words += ["--keys", str(keys_file(tmp_path, (letter,)))]
    with Terminal(words, columns=160) as terminal:
        terminal.shows(f"{letter} log")
        terminal.press(letter)
        terminal.shows("Event log")
        terminal.press("q?")
        terminal.shows(f"{letter:<10}log          every record of the journal")
