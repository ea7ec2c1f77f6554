"""``resume`` judges a journal only while it holds its run's lock."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hilcell.commands import run as command
from hilcell.commands.cli import main
from hilcell.journal.journal import Journal, read_journal
from hilcell.journal.runs import JOURNAL
from hilcell.run.cell_lock import lock_of_name, locked
from tests.hilcell.report.journals import Writer


def left(folder: Path) -> Path:
    """Leave a run in the middle."""
    return Writer(folder).began().left()


def test_a_run_that_another_engine_finishes_meanwhile_is_not_begun_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = left(tmp_path / "r")

    @contextmanager
    def last(path: Path, what: str, run: str) -> Iterator[None]:
        """Lock once the other engine has ended."""
        journal = Journal(folder / JOURNAL, "r", create=False)
        journal.append("state", "", {"machine": "run", "to": "finished"})
        journal.append("end", "", {"state": "finished", "exit": 0, "result": {}})
        journal.close()
        with locked(path, what, run):
            yield

    monkeypatch.setattr(command, "locked", last)
    assert main(["resume", "r", "--unattended", "--runs", str(tmp_path)]) == 2
    assert "run r is finished" in capsys.readouterr().err
    assert read_journal(folder / JOURNAL)[-1].kind == "end"


@pytest.mark.parametrize("named", ["runs/r", "other/link", "."])
def test_a_run_has_one_lock_by_whatever_path(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    named: str,
) -> None:
    folder = left(tmp_path / "runs" / "r")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "link").symlink_to(folder)
    monkeypatch.chdir(folder if named == "." else tmp_path)
    with locked(lock_of_name(tmp_path / "runs", "paper"), "cell paper", "r"):
        assert main(["resume", named, "--unattended"]) == 6
    assert "cell paper is locked by run r" in capsys.readouterr().err
