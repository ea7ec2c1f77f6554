"""A run is resumed on a PC that lacks a package which it began with."""

import json
from pathlib import Path

import msgspec
import pytest

from hilcell.cell.file import load_cell
from hilcell.commands.cli import main
from hilcell.journal.journal import Journal, read_journal
from hilcell.journal.runs import JOURNAL
from tests.hilcell.commands.test_resume import left

Said = pytest.CaptureFixture[str]


def listed(runs: Path, capsys: Said) -> dict[str, object]:
    """Return what `runs` says of the only run there."""
    capsys.readouterr()
    assert main(["runs", "--runs", str(runs), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["runs"]
    return {key: found[key] for key in ("state", "verdict", "exit")}


@pytest.mark.parametrize("driver", ["robot", "tracker", "rail"])
def test_a_driver_that_is_not_installed_is_to_be_installed(
    driver: str, tmp_path: Path, capsys: Said
) -> None:
    cell = msgspec.to_builtins(load_cell("paper"))
    cell[driver]["driver"] = "mine"
    folder = left(tmp_path / "r", cell=cell)
    before, state = read_journal(folder / JOURNAL), listed(tmp_path, capsys)
    assert main(["resume", "r", "--unattended", "--runs", str(tmp_path)]) == 2
    words = capsys.readouterr().err
    assert "run r cannot go on here; it is as it was" in words
    assert f"{driver}.driver: 'mine' is not installed; installed: " in words
    assert "install here what is missing, then `hilcell resume r" in words
    assert read_journal(folder / JOURNAL) == before
    assert listed(tmp_path, capsys) == state
    assert state == {"state": "running, engine gone", "verdict": "", "exit": None}


def test_a_resume_that_was_refused_is_no_verdict(tmp_path: Path, capsys: Said) -> None:
    """Journals of before say so by an end."""
    folder = left(tmp_path / "r")
    journal = Journal(folder / JOURNAL, "r", create=False)
    journal.append("end", "", {"state": "running", "exit": 2, "result": {}})
    journal.close()
    wanted = {"state": "running, engine gone", "verdict": "", "exit": 2}
    assert listed(tmp_path, capsys) == wanted
