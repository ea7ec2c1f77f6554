"""A newcomer's way from a clone to corrected programs, typed as docs/first-calibration.md says."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.whole.bench import SMALL, sets
from tests.whole.golden import GoldenRuns
from tests.whole.terminal import Terminal

ROOT = Path(__file__).parents[2]
STORY = (ROOT / "docs" / "first-calibration.md").read_text("utf-8")
ROW = re.compile(r"^\| (\d+) \| (?:`(.+?)`|\*\*(.+?)\*\*) \| `(.+?)` \|$", re.MULTILINE)
KEYS = {"Enter": "\r", "ctrl+q": "\x11"}
MOST_STEPS = 25
ONCE = 3  # clone, make, activate
FORM = "hilcell tui"  # two Enters later a run is done
SMALLER = "".join(f" '{word}'" for word in sets(SMALL))
PROMPT = "newcomer$"


class Step(NamedTuple):
    """``line`` for the shell, or a ``key`` in the screen, and the words that it brings."""

    line: str
    key: str
    words: str


STEPS = [Step(*found[1:]) for found in ROW.findall(STORY)]


def typed(terminal: Terminal, step: Step, more: str = "") -> None:
    """Type one step and wait for its words; ``more`` follows a line for the shell."""
    if step.key:
        terminal.answer(KEYS.get(step.key, step.key))
    else:
        # Only the answer counts: the prompt and the line itself are wiped.
        terminal.press(f"clear; {step.line}{more}\r")
        terminal.until(lambda text: "clear;" not in text)
    terminal.shows(step.words)


def shell(folder: Path, **environment: str) -> Terminal:
    """Open a shell of its own in a folder, as wide as lines of the table need."""
    places = {"HOME": str(folder), "HILCELL_RUNS": str(folder / "runs"), "PS1": PROMPT}
    program = ["env", f"--chdir={folder}", "bash"]
    words = ["--norc", "--noprofile", "-i"]
    return Terminal(words, program=program, columns=120, rows=40, **places, **environment)


def test_the_story_is_short() -> None:
    assert len(STEPS) == len(re.findall(r"^\| \d+ \|", STORY, re.MULTILINE))
    assert ONCE < len(STEPS) <= MOST_STEPS


@pytest.mark.process
def test_the_story_by_keys_only(tmp_path: Path, golden: GoldenRuns) -> None:
    """The steps after the installation; the run of the form is a finished one, and a small one."""
    folder = golden["small"].copied_to(tmp_path / "runs")
    shutil.copytree(ROOT / "docs" / "examples", tmp_path / "docs" / "examples")
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    with shell(tmp_path, PATH=path) as terminal:
        terminal.shows(PROMPT)
        for step in STEPS[ONCE:]:
            if step.line == FORM:
                typed(terminal, Step(f"{FORM} {folder.name}", "", "DONE"))
            elif step.key != "Enter":
                typed(terminal, step, SMALLER if step.line.startswith("hilcell prepare") else "")
    assert_prepared(tmp_path)


@pytest.mark.wall
@pytest.mark.nightly
def test_the_whole_story(tmp_path: Path) -> None:
    with shell(tmp_path, HILCELL=str(ROOT)) as terminal:
        terminal.shows(PROMPT)
        for step in STEPS:
            typed(terminal, step)
    assert_prepared(tmp_path / "hilcell")


def assert_prepared(folder: Path) -> None:
    for station in ("S300", "S1100", "S1900"):
        assert "DEF " + station in (folder / "programs" / f"{station}.src").read_text("cp1252")
    assert (folder / "programs" / "sheet.html").stat().st_size > 10_000
