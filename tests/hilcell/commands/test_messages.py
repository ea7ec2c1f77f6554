"""Names are anybody's: whatever a folder is called, a terminal obeys nothing of it."""

import json
import os
from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.commands.console import print_message
from tests.hilcell.report.journals import Writer

NAMES = ["one\x1b[31mred\x9b2J\u202e\x07", os.fsdecode(b"one\xff\xfe")]
COMMANDS = [
    ("runs", 0),
    ("runs --json", 0),
    ("show one", 0),
    ("show one --json", 0),
    ("show o", 2),
    ("compare one one", 2),
    ("resume one", 2),
    ("stop one", 2),
    ("watch one", 0),
    ("watch one --json", 0),
    ("report one -o FILE", 0),
    ("report one -o FOLDER", 2),
    ("export one --csv -o FILE", 0),
    ("compensate one x.csv --station S1100 -o FILE", 2),
]


@pytest.mark.parametrize(("words", "code"), COMMANDS)
@pytest.mark.parametrize("name", NAMES, ids=["escapes", "no text"])
def test_no_command_repeats_what_a_terminal_obeys(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], name: str, words: str, code: int
) -> None:
    runs = tmp_path / "runs"
    Writer(runs / "other").began().ended()
    Writer(tmp_path / "made").began().ended().rename(runs / name)
    places = {"FILE": str(tmp_path / "file"), "FOLDER": str(runs / name)}
    arguments = [places.get(word, word) for word in words.split()]
    assert main([*arguments, "--runs", str(runs)]) == code
    printed, reported = capfdbinary.readouterr()
    assert b"Traceback" not in reported
    for text in (printed, reported):
        assert b"\x1b" not in text
        assert b"\xff" not in text
    if "--json" not in words:  # there it is data, which nobody shows as it comes
        assert not {"\x9b", "\x07", "\u202e"} & {*(printed + reported).decode()}
    elif "export" not in words:
        assert json.loads(printed.splitlines()[-1])


def test_lines_stay_lines(capsys: pytest.CaptureFixture[str]) -> None:
    print_message("paper: 2 problems\n  a\x1b\n  b")
    assert capsys.readouterr().err == "paper: 2 problems\n  a\N{REPLACEMENT CHARACTER}\n  b\n"
