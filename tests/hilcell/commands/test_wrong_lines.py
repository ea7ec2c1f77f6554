"""Wrong command lines in several terminals and locales: no trace, exit code 2."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilcell.commands.cli import main
from tests.hilcell.commands.terminal import Terminal
from tests.hilcell.commands.wrong_lines import wrong_lines
from tests.whole.bench import command

SEED, ALL, DAILY = 7, 300, 40
Change = tuple[str, dict[str, str], list[str]]  # the encoding, variables that are set, and unset
PLACES: dict[str, Change] = {
    "C": ("ascii", {"LC_ALL": "C", "PYTHONUTF8": "0"}, []),
    "ISO-8859-1": ("iso-8859-1", {"PYTHONIOENCODING": "iso-8859-1"}, []),
    "UTF-8": ("utf-8", {"LC_ALL": "C.UTF-8"}, []),
    "dumb": ("utf-8", {"TERM": "dumb"}, []),
    "no home": ("utf-8", {}, ["HOME", "XDG_CONFIG_HOME", "TERM"]),
    "narrow": ("utf-8", {"COLUMNS": "12", "LINES": "3"}, []),
}


def enter(place: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Change this process's environment; return the encoding of its terminal."""
    encoding, given, taken = PLACES[place]
    monkeypatch.chdir(folder)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    for name in taken:
        monkeypatch.delenv(name, raising=False)
    return encoding


def check_refused(line: list[str], encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal(encoding, monkeypatch)
    try:
        code = main(line)
    except SystemExit as ended:
        code = int(ended.code or 0)
    printed = terminal.read("stderr")
    assert "Traceback" not in printed, (line, printed)
    assert (code, bool(printed)) == (2, True), (line, code, printed)
    assert "\x1b" not in printed


@pytest.mark.parametrize("place", PLACES)
def test_a_wrong_line_is_refused_in_words(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoding = enter(place, tmp_path, monkeypatch)
    begin = list(PLACES).index(place)
    for line in wrong_lines(DAILY * len(PLACES), SEED)[begin :: 6 * len(PLACES)]:
        check_refused(line, encoding, monkeypatch)


def test_digits_of_other_scripts_are_no_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    check_refused(["run", "--dry-run", "--seed=\N{ARABIC-INDIC DIGIT THREE}"], "utf-8", monkeypatch)


@pytest.mark.nightly
@pytest.mark.parametrize("place", PLACES)
def test_all_wrong_lines_are_refused_in_words(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoding = enter(place, tmp_path, monkeypatch)
    lines = wrong_lines(ALL, SEED)
    assert len(lines) == ALL
    for line in lines:
        check_refused(line, encoding, monkeypatch)


NEAREST = [
    ("rn", '"run"'),
    ("calibrate", "hilcell run calibrate"),
    ("zzz", "zzz"),
    ("--verison", '"--version"'),
    ("compensate --stationn x", '"--station"'),
    ("run --oprator=Ann", '"--operator"'),
    ("run home --dry", '"--dry-run"'),
    ("show last --cel", '"--check"'),
    ("completion --sel", "--sel"),
    ("show", "RUN"),
    ("run calibrat", '"calibrate"'),
    ("check papr", '"paper"'),
]


@pytest.mark.parametrize(("words", "nearest"), NEAREST)
def test_the_nearest_word_is_named(words: str, nearest: str) -> None:
    done = command(*words.split())
    assert (done.returncode, done.stdout) == (2, "")
    assert nearest in done.stderr


def test_words_after_two_dashes_are_no_options() -> None:
    done = command("explain", "--", "--HC-R31")
    assert done.returncode == 2
    assert "'--HC-R31'" in done.stderr


def test_without_words_the_first_steps_are_shown() -> None:
    done = command()
    assert (done.returncode, done.stdout) == (2, "")
    for step in ("hilcell run", "hilcell show last", "hilcell check", "hilcell tui"):
        assert step in done.stderr
