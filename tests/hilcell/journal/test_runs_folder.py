"""The folder of runs: named, else the user's own."""

from pathlib import Path

import pytest

from hilcell.commands.cli import main
from hilcell.journal.runs_folder import OVERRIDE, usual_runs
from tests.hilcell.commands.finished_runs import MADE, finished


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty current directory, with nothing set."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(OVERRIDE)
    return tmp_path


@pytest.mark.parametrize(
    ("environment", "path"),
    [
        ({OVERRIDE: "/data/runs", "XDG_DATA_HOME": "/x", "HOME": "/h"}, "/data/runs"),
        ({OVERRIDE: "", "XDG_DATA_HOME": "/x", "HOME": "/h"}, "/x/hilcell/runs"),
        ({"XDG_DATA_HOME": "not/absolute", "HOME": "/h"}, "/h/.local/share/hilcell/runs"),
        ({"HOME": "/h"}, "/h/.local/share/hilcell/runs"),
    ],
)
def test_which_folder(here: Path, environment: dict[str, str], path: str) -> None:
    assert usual_runs(environment) == (Path(path), "")


def test_a_user_without_a_home(here: Path) -> None:
    usual, note = usual_runs({"HOME": "nowhere"})
    assert usual == Path("runs")
    assert f"{here / 'runs'}" in note


def test_commands_find_a_run_from_any_directory(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(here / "data"))
    own = here / "data" / "hilcell" / "runs"
    finished(own, "1-made", MADE)
    assert main(["runs"]) == 0
    assert "1-made" in capsys.readouterr().out
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert main(["show", "last"]) == 0
    printed = capsys.readouterr()
    assert "1-made" in printed.out
    assert printed.err == ""


def test_a_tilde_that_no_shell_has_expanded_is_the_home(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(here / "home"))
    finished(here / "home" / "kept", "1-made", MADE)
    assert usual_runs({OVERRIDE: "~/kept"})[0] == here / "home" / "kept"
    assert usual_runs({OVERRIDE: "~nobody-of-this-name/x"})[0] == Path("~nobody-of-this-name/x")
    assert main(["runs", "--runs=~/kept"]) == 0
    assert "1-made" in capsys.readouterr().out
    assert not (here / "~").exists()


def test_a_folder_of_runs_that_is_not_there_is_named(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["show", "last", "--runs", str(here / "none")]) == 2
    said = capsys.readouterr().err
    assert f"no folder of runs {here / 'none'}; " in said
    assert "--runs" in said


def test_an_empty_name_is_no_folder_of_runs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finished(here, "1-made", MADE)  # in the current folder
    for words in (["--runs", ""], ["--runs="]):
        with pytest.raises(SystemExit) as refused:
            main(["runs", *words])
        assert refused.value.code == 2
        assert "--runs: " in capsys.readouterr().err
