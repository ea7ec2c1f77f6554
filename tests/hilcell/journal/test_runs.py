"""The folder of runs: which it is, and what is a run there."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec
import pytest

from hilcell.cell.file import Cell, load_cell
from hilcell.commands.cli import main
from hilcell.errors import HilcellError
from hilcell.journal.index import find_run, read_index
from hilcell.journal.journal import NeverBegan
from hilcell.journal.log import RunJournal
from hilcell.journal.runs import JOURNAL, make_folder, read_log, remove_unbegun, run_folders
from hilcell.journal.runs_folder import OVERRIDE, usual_runs
from hilcell.run.cell_lock import lock_of_device, locked
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.journal.test_index import written


def test_entries_that_lead_nowhere_are_no_runs(tmp_path: Path) -> None:
    runs = tmp_path
    for name in ("1", "2"):
        written(runs / name)
    rows = read_index(runs)
    (runs / "loop").symlink_to("loop")
    (runs / "broken").symlink_to("nowhere")
    (runs / "endless").symlink_to("x" * 300)
    (runs / "3").mkdir()
    (runs / "3" / JOURNAL).symlink_to(JOURNAL)
    assert read_index(runs) == rows
    assert len(run_folders(runs)) == 2
    assert find_run(runs, "last").name in ("1", "2")
    for name in ("loop", str(runs / "loop")):
        with pytest.raises(HilcellError, match="loop"):
            find_run(runs, name)
    for name in ("", "."):
        with pytest.raises(HilcellError) as caught:
            find_run(runs, name)
        assert caught.value.code == "HC-J09"


LOCKED = """
import json, os, sys
from pathlib import Path
from hilcell.journal.index import read_index
from hilcell.journal import log
from hilcell.run import control  # nothing more can be loaded once rights are given away
from hilcell.journal.index import find_run
from hilcell.journal.runs import read_log
from hilcell.tui.app import folder_to_open
folder_to_open(Path("."), "")
os.getuid() or os.setuid(65534)  # root may look everywhere
runs = Path(sys.argv[1])
print(json.dumps([[row.name, row.state, row.reason] for row in read_index(runs)]))
print(find_run(runs, "last").name)
try:
    read_log(find_run(runs, str(runs / "2")))
except Exception as error:
    print(f"{type(error).__name__}: {error}")
print(folder_to_open(runs, ""))
try:
    control.order(runs / "2", "pause")
except Exception as error:
    print(f"{type(error).__name__}: {error}")
"""


@pytest.mark.process
def test_a_run_that_must_not_be_looked_into_is_listed_with_its_reason() -> None:
    with tempfile.TemporaryDirectory() as name:
        runs = Path(name)
        runs.chmod(0o755)  # for other users
        written(runs / "1")
        locked = written(runs / "2")
        locked.chmod(0)
        done = subprocess.run(
            [sys.executable, "-c", LOCKED, runs], capture_output=True, text=True, check=False
        )
        locked.chmod(0o755)
        listed, last, told, live, refused = done.stdout.splitlines()
        assert [row[:2] for row in json.loads(listed)] == [["1", "finished"], ["2", "unreadable"]]
        assert "Permission denied" in json.loads(listed)[1][2]
        assert last == "1"
        assert told.startswith("StorageError: ")
        assert live == "None"
        assert refused.startswith("HilcellError: ")
        assert "engine.json" in refused


def test_the_newest_runs_are_the_newest_by_their_order(tmp_path: Path) -> None:
    for number, name in enumerate(("b", "a", "d", "c")):
        written(tmp_path / name, order={"folder": "f", "number": number, "after": ""})
        os.utime(tmp_path / name / JOURNAL, (1e9 - number, 1e9 - number))
    with pytest.raises(HilcellError, match=r"a, d, c$"):
        find_run(tmp_path, "nosuch")
    assert find_run(tmp_path, "last").name == "c"


def test_a_run_that_never_began_leaves_nothing_but_what_others_have_put_there(
    tmp_path: Path,
) -> None:
    for name in ("a", "b"):
        written(tmp_path / name)
    (tmp_path / "b" / "notes").touch()
    for name in ("a", "b"):
        remove_unbegun(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["b"]
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["notes"]


def test_a_run_that_dies_with_its_folder_just_made_never_began(tmp_path: Path) -> None:
    make_folder(tmp_path / "a")
    assert run_folders(tmp_path) == [tmp_path / "a"]
    with pytest.raises(NeverBegan, match="a"):
        read_log(tmp_path / "a")
    RunJournal(tmp_path / "a" / JOURNAL, "a", create=True).close()  # it may still begin


def test_a_run_that_finds_its_device_locked_leaves_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def real(*_: object) -> Cell:
        cell = load_cell("paper", {"rail.options.channel": "socket://192.0.2.1:9"})
        return msgspec.structs.replace(cell, simulation=None, name="n", serial="s")

    monkeypatch.setattr("hilcell.cell.devices.load_cell", real)
    with locked(lock_of_device("192.0.2.1:9"), "rail", "other"):
        assert main(["run", "home", "--name", "R", "--runs", str(tmp_path)]) == 6
    assert "other" in capsys.readouterr().err
    assert run_folders(tmp_path) == []
    assert not (tmp_path / "R").exists()


# -- the folder of runs: named, else the user's own -----------------------------------------------


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
    (word,) = printed.err.splitlines()  # the last word, and no note
    assert word.startswith("IN TOLERANCE")


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
