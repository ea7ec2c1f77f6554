"""Wrong words on the command line: a short message that names the nearest right one, exit 2."""

from __future__ import annotations

import pytest

from hilcell.commands.cli import main

NEAREST = [
    ("rn", "'rn' is no command; did you mean \"run\"?", "hilcell"),
    ("chekc paper", "'chekc' is no command; did you mean \"check\"?", "hilcell"),
    ("calibrate", "calibrate is a procedure; did you mean `hilcell run calibrate`?", "hilcell"),
    ("zzz", "'zzz' is no command", "hilcell"),
    ("--verison", "--verison is no option; did you mean \"--version\"?", "hilcell"),
    ("compensate --stationn x", "--stationn is no option; did you mean \"--station\"?",
     "hilcell compensate"),
    ("run --oprator=Ann", "--oprator is no option; did you mean \"--operator\"?", "hilcell run"),
    ("run --qqqq", "--qqqq is no option", "hilcell run"),
    ("run --cel paper", "--cel is no option; did you mean \"--cell\"?", "hilcell run"),
    ("run home --dry", "--dry is no option; did you mean \"--dry-run\"?", "hilcell run"),
    ("run --unatt", "--unatt is no option; did you mean \"--unattended\"?", "hilcell run"),
    ("--vers", "--vers is no option; did you mean \"--version\"?", "hilcell"),
    ("show last --cel", "--cel is no option; did you mean \"--check\"?", "hilcell show"),
    ("completion --sel", "--sel is no option", "hilcell completion"),
    ("runs --hel", "--hel is no option; did you mean \"--help\"?", "hilcell runs"),
    ("show", "the following arguments are required: RUN", "hilcell show"),
]  # fmt: skip


def refused(words: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    with pytest.raises(SystemExit, match="2"):
        main(words.split())
    printed = capsys.readouterr()
    assert printed.out == ""
    return printed.err.splitlines()


@pytest.mark.parametrize(("words", "message", "prog"), NEAREST)
def test_the_nearest_word_is_named(
    capsys: pytest.CaptureFixture[str], words: str, message: str, prog: str
) -> None:
    assert refused(words, capsys) == [
        f"{prog}: {message}",
        f"`{prog} --help` lists what there is",
    ]


def test_words_after_two_dashes_are_no_options(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "--", "--HC-R31"]) == 2
    assert "alarm '--HC-R31' is unknown" in capsys.readouterr().err


def test_wrong_words_do_not_act_on_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ("\x1b[31m", "--\x1b[31m", "runs \x1b[31m"):
        assert not any("\x1b" in line for line in refused(words, capsys))


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("run calibrat", "'calibrat' is not installed; did you mean \"calibrate\"?"),
        ("check papr", 'built in: fixed, hard, lab, paper, replay, six-r; did you mean "paper"?'),
    ],
)
def test_names_of_procedures_and_cells_too(
    capsys: pytest.CaptureFixture[str], words: str, hint: str
) -> None:
    assert main(words.split()) == 2
    assert hint in capsys.readouterr().err


def test_without_words_the_first_steps_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    for step in (
        "`hilcell run`",
        "`hilcell show last`",
        "`hilcell check CELL.toml`",
        "hilcell tui",
    ):
        assert step in err
    assert len(err.splitlines()) == 4
    assert max(map(len, err.splitlines())) <= 84
