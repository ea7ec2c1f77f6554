"""Every command says in clear words that a run's journal is damaged, empty, missing or locked."""

import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import msgspec
import pytest

from hilcell.journal.journal import Journal
from hilcell.journal.runs import CALIBRATION, ENGINE, JOURNAL
from hilcell.journal.runs_folder import OVERRIDE
from tests.hilcell.report.journals import validated_run
from tests.whole.bench import command

READERS = [
    ("show", "r", "--json"), ("watch", "r"), ("resume", "r", "--unattended"),
    ("report", "r", "-o", "out"), ("export", "r", "--csv", "-o", "out"), ("compare", "s", "r"),
    ("revoke", "r", "--reason", "for tests"),
]  # fmt: skip


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with finished runs, for copies."""
    folder = tmp_path_factory.mktemp("sound")
    for name in ("r", "s", "t"):
        validated_run(folder / name).ended()
    return folder


@pytest.fixture
def runs(sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two of them; commands write beside it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(OVERRIDE, str(tmp_path / "runs"))
    return Path(shutil.copytree(sound, tmp_path / "runs", ignore=shutil.ignore_patterns("t")))


def changed(journal: Path) -> None:
    """Change a digit of the fifth record, the first that is a frame."""
    content = journal.read_bytes()
    assert b'"matrix":[[1.0' in content
    journal.write_bytes(content.replace(b'"matrix":[[1.0', b'"matrix":[[7.0'))


def unreadable_text(journal: Path) -> None:
    content = journal.read_bytes()
    journal.write_bytes(content.replace(b'"matrix":[[1.0', b'"matrix":\xff[1.0'))


def unreadable_pages(journal: Path) -> None:
    """Overwrite the middle of the page that holds the fifth record."""
    content = bytearray(journal.read_bytes())
    at = content.index(b'"matrix":[[1.0') // 4096 * 4096
    content[at : at + 64] = bytes(64)
    journal.write_bytes(content)


def damaged_schema(journal: Path) -> None:
    content = journal.read_bytes()
    journal.write_bytes(content.replace(b"CREATE TABLE record", b"CREATE TABL\xc5 record"))


def emptied(journal: Path) -> None:
    journal.write_bytes(b"")


def made_a_folder(journal: Path) -> None:
    journal.unlink()
    journal.mkdir()


@pytest.mark.parametrize(
    "how",
    [changed, unreadable_text, unreadable_pages, damaged_schema, Path.unlink, made_a_folder],
)
def test_a_reader_names_the_journal(runs: Path, how: Callable[[Path], None]) -> None:
    """And its record, where it is one that is damaged."""
    how(runs / "r" / JOURNAL)
    for words in READERS:
        done = command(*words, "--runs", runs)
        assert (done.returncode, done.stdout) == (7, ""), words
        assert done.stderr.startswith(f"hilcell: journal {runs / 'r' / JOURNAL}: ")
        assert ("record 5:" in done.stderr) is (how in (changed, unreadable_text))
        assert "Traceback" not in done.stderr
        assert done.stderr.count("\n") == 1
        assert "from the backup" in done.stderr
        assert not (runs.parent / "out").exists()


def no_tables(journal: Path) -> None:
    """Leave what a kill leaves between the file and its tables."""
    journal.unlink()
    with closing(sqlite3.connect(journal)) as base:
        base.execute("PRAGMA journal_mode=WAL")


def no_records(journal: Path) -> None:
    """Leave what a kill leaves between the tables and the first record."""
    journal.unlink()
    Journal(journal, "r", create=True).close()


def listed(runs: Path) -> dict[str, str]:
    """Return the states of a list of runs."""
    done = command("runs", "--json", "--runs", runs)
    assert done.returncode == 0
    return {each["run"]: each["state"] for each in msgspec.json.decode(done.stdout)["runs"]}


@pytest.mark.parametrize(
    ("how", "readers"),
    [
        (no_records, [words for words in READERS if words[0] != "watch"]),
        (no_records, [("show", "r", "--check")]),
        (no_tables, [("resume", "r", "--unattended")]),
        (emptied, [("resume", "r", "--unattended")]),
    ],
)
def test_a_run_that_was_killed_before_its_first_record_never_began(
    runs: Path, how: Callable[[Path], None], readers: list[tuple[str, ...]]
) -> None:
    how(runs / "r" / JOURNAL)
    for words in readers:
        done = command(*words, "--runs", runs)
        assert (done.returncode, done.stdout) == (2, ""), words
        assert "never began" in done.stderr
    assert listed(runs) == {"r": "never began", "s": "finished"}


@pytest.mark.parametrize("beside", [CALIBRATION, ENGINE])
def test_an_empty_journal_beside_files_of_its_run_has_lost_its_records(
    runs: Path, beside: str
) -> None:
    emptied(runs / "r" / JOURNAL)
    (runs / "r" / beside).write_text("{}")
    done = command("resume", "r", "--unattended", "--runs", runs)
    assert done.returncode == 7
    assert beside in done.stderr


@pytest.mark.parametrize("how", [changed, unreadable_text, unreadable_pages, damaged_schema])
def test_a_list_of_runs_names_the_unreadable(runs: Path, how: Callable[[Path], None]) -> None:
    how(runs / "r" / JOURNAL)
    assert listed(runs) == {"r": "unreadable", "s": "finished"}
    (line,) = command("runs", "--runs", runs).stderr.splitlines()
    assert line.startswith(f"journal {runs / 'r' / JOURNAL}: ")
    assert "from the backup" in line


AS_NOBODY = """
import os, sys
from hilcell.commands.cli import main
runs = ("--runs", sys.argv[1])
for words in (["show", "s"], ["resume", "s", "--unattended"]):
    main([*words, *runs])  # loads what another user may not read
os.getuid() or os.setuid(65534)
for run in ("r", "t"):
    print(main(["show", run, *runs]), main(["resume", run, "--unattended", *runs]))
"""


@pytest.mark.process
def test_missing_rights_are_named(sound: Path) -> None:
    with tempfile.TemporaryDirectory() as name:  # one that others may enter
        runs = Path(shutil.copytree(sound, Path(name) / "runs"))
        for open_to_all in (runs, runs.parent):
            open_to_all.chmod(0o755)
        for locked in (runs / "r" / JOURNAL, runs / "t"):
            locked.chmod(0)
        done = subprocess.run(
            [sys.executable, "-c", AS_NOBODY, str(runs)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        (runs / "t").chmod(0o755)
    assert done.stdout.splitlines()[-2:] == ["7 7", "7 7"], done.stderr
    for run in "rt":
        assert done.stderr.count(f"journal {runs / run / JOURNAL}: ") == 2
