"""Every command says in clear words that a run's journal is damaged, empty, missing or locked."""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from hilcell.commands.cli import main
from hilcell.journal.runs import JOURNAL
from tests.hilcell.report.journals import validated_run

READERS = [
    ("show", "r"), ("show", "r", "--json"), ("watch", "r"), ("watch", "r", "--json"),
    ("resume", "r", "--unattended"), ("report", "r", "-o", "out"),
    ("export", "r", "--csv", "-o", "out"), ("compare", "r", "s"), ("compare", "s", "r"),
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
    return Path(shutil.copytree(sound, tmp_path / "runs", ignore=shutil.ignore_patterns("t")))


def changed(journal: Path) -> None:
    """Change a digit of the fifth record, the first that is a frame."""
    content = journal.read_bytes()
    assert b'"matrix":[[1.0' in content
    journal.write_bytes(content.replace(b'"matrix":[[1.0', b'"matrix":[[7.0'))


def unreadable_text(journal: Path) -> None:
    content = journal.read_bytes()
    journal.write_bytes(content.replace(b'"matrix":[[1.0', b'"matrix":\xff[1.0'))


def damaged_schema(journal: Path) -> None:
    content = journal.read_bytes()
    journal.write_bytes(content.replace(b"CREATE TABLE record", b"CREATE TABL\xc5 record"))


def removed(journal: Path) -> None:
    journal.unlink()


def emptied(journal: Path) -> None:
    journal.write_bytes(b"")


def made_a_folder(journal: Path) -> None:
    journal.unlink()
    journal.mkdir()


@pytest.mark.parametrize("words", READERS, ids=" ".join)
@pytest.mark.parametrize(
    ("how", "text"),
    [
        (changed, "damaged at record 5: "),
        (unreadable_text, "damaged at record 5: "),
        (damaged_schema, "damaged at record 1: "),
        (removed, "no such file in the folder of the run; fetch the run's folder"),
        (made_a_folder, "it is a folder, wanted a file; fetch the run's folder"),
    ],
)
def test_a_reader_names_the_journal_and_the_damage(
    runs: Path,
    how: Callable[[Path], None],
    text: str,
    words: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    how(runs / "r" / JOURNAL)
    assert main([*words, "--runs", str(runs)]) == 7
    out, err = capsys.readouterr()
    assert err.startswith(f"hilcell: journal {runs / 'r' / JOURNAL}: ")
    assert text in err
    assert "Traceback" not in err
    assert out == ""
    assert not (runs.parent / "out").exists()


@pytest.mark.parametrize("words", [words for words in READERS if words[0] != "watch"], ids=" ".join)
def test_an_empty_journal_is_named(
    runs: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    emptied(runs / "r" / JOURNAL)
    assert main([*words, "--runs", str(runs)]) == 7
    assert "it is empty: the run died before its first record" in capsys.readouterr().err


@pytest.mark.parametrize("how", [changed, unreadable_text, damaged_schema, emptied])
def test_a_list_of_runs_names_what_it_cannot_read(
    runs: Path, how: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    how(runs / "r" / JOURNAL)
    assert main(["runs", "--json", "--runs", str(runs)]) == 0
    listed = msgspec.json.decode(capsys.readouterr().out)["runs"]
    assert [each["state"] for each in listed] == ["unreadable", "finished"]
    words = "damaged at record" if how is not emptied else "died before its first record"
    assert words in listed[0]["reason"]


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
    cannot = "journal {}: cannot be read: {}"
    assert done.stderr.count(cannot.format(runs / "r" / JOURNAL, "no permission to read it")) == 2
    assert done.stderr.count(cannot.format(runs / "t" / JOURNAL, "Permission denied")) == 2
