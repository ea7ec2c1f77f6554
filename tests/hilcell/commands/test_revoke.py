"""`revoke`, and `compensate` with calibrations that are not current."""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from hilcell.commands.cli import main
from hilcell.compensation.targets import write_targets
from hilcell.journal.index import read_index, row_of
from hilcell.journal.journal import StorageError
from hilcell.journal.run_journal import RunJournal
from hilcell.journal.runs import CALIBRATION, JOURNAL, find_run, read_log
from hilcell.run.cell_lock import lock_of_name, locked
from tests.hilcell.commands.finished_runs import MADE, REDO, finished
from tests.hilcell.commands.workplace import read_corrected


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Return a folder of runs with one calibration, and targets beside it."""
    targets = np.array([[0.0, 0, 1200, 0, 75, 0], [0.0, 50, 1250, 0, 75, 0]])
    write_targets(tmp_path / "targets.csv", ["H1", "H2"], targets)
    finished(tmp_path / "runs", "1-made", MADE)
    return tmp_path / "runs"


def compensate(runs: Path, run: str, *words: str) -> int:
    out = str(runs.parent / "out.csv")
    return main(
        ["compensate", run, str(runs.parent / "targets.csv"), "--station", "S1100", "-o", out,
         "--runs", str(runs), *words]
    )  # fmt: skip


def test_the_current_one_is_taken(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert compensate(runs, "1-made") == 0
    assert "not known" not in capsys.readouterr().err


def test_a_revoked_one_is_refused_and_the_current_one_named(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finished(runs, "2-made", MADE)
    words = ("revoke", "2-made", "--runs", str(runs), "--reason", "wrong reflector", "--json")
    assert main([*words]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "run": "2-made", "reason": "wrong reflector", "current": "1-made",
    }  # fmt: skip
    assert compensate(runs, "2-made") == 2
    refusal = capsys.readouterr().err
    assert "it is revoked: wrong reflector" in refusal
    assert "the current one of the cell is that of run 1-made" in refusal
    assert not (runs.parent / "out.csv").exists()
    assert compensate(runs, "2-made", "--accept-not-current") == 0
    assert "accepted although it is revoked: wrong reflector" in capsys.readouterr().err
    _, _, (stamp,) = read_corrected(runs.parent / "out.csv")
    assert stamp.endswith("; REVOKED (accepted)")
    assert compensate(runs, "1-made") == 0
    assert read_log(runs / "2-made").state == "finished"


def test_a_copied_folder_is_revoked_with_its_run(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(runs / "1-made", runs / "2-copy")
    assert main(["revoke", "1-made", "--runs", str(runs), "--reason", "a crash"]) == 0
    assert compensate(runs, "2-copy") == 2
    assert "it is revoked: a crash" in capsys.readouterr().err
    (runs / "2-copy").rename(runs.parent / "renamed")
    assert compensate(runs, str(runs.parent / "renamed" / CALIBRATION)) == 0


def test_a_superseded_one_is_refused(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finished(runs, "2-made", MADE)
    assert compensate(runs, "1-made") == 2
    assert "it is superseded by 2-made" in capsys.readouterr().err
    assert compensate(runs, str(runs / "1-made" / CALIBRATION)) == 2
    copied = runs.parent / "copied.json"
    copied.write_bytes((runs / "1-made" / CALIBRATION).read_bytes())
    assert compensate(runs, str(copied)) == 2
    assert compensate(runs, "1-made", "--accept-not-current") == 0
    _, _, (stamp,) = read_corrected(runs.parent / "out.csv")
    assert stamp.endswith("; SUPERSEDED by 2-made (accepted)")


def test_a_re_check_with_redo_leaves_none(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finished(runs, "2-recheck", REDO, used="1-made", code=1)
    assert compensate(runs, "1-made") == 2
    refusal = capsys.readouterr().err
    assert "it is revoked by 2-recheck: its re-check says redo" in refusal
    assert "no calibration of the cell is current: calibrate again" in refusal


def test_runs_and_show_say_how_it_stands(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finished(runs, "2-made", MADE)
    finished(runs, "3-home", {})
    assert main(["runs", "--json", "--runs", str(runs)]) == 0
    listed = {each["run"]: each["standing"] for each in json.loads(capsys.readouterr().out)["runs"]}
    assert listed["1-made"]["state"] == "superseded"
    assert listed["1-made"]["by"] == listed["1-made"]["current"] == "2-made"
    assert (listed["2-made"]["state"], listed["3-home"]) == ("current", None)
    assert main(["runs", "--runs", str(runs)]) == 0
    assert "superseded by 2-made" in " ".join(capsys.readouterr().out.split())


def test_one_that_is_undecided_is_listed_so(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    undecided = {"holds": False, "outcome": "undecided"}
    finished(runs, "2-made", {"fit": {}, "validation.S1100": undecided}, code=1)
    rejected = {"validation.S300": {"holds": False, "outcome": "rejected"}}
    finished(runs, "3-made", {"fit": {}, "validation.S1100": undecided} | rejected, code=1)
    assert main(["runs", "--json", "--runs", str(runs)]) == 0
    listed = {each["run"]: each["standing"] for each in json.loads(capsys.readouterr().out)["runs"]}
    states = [listed[name]["state"] for name in ("1-made", "2-made", "3-made")]
    assert states == ["current", "undecided", "not validated"]


@pytest.mark.parametrize("words", [(), ("--reason", ""), ("--reason", " \x1b")])
def test_a_reason_is_wanted(runs: Path, words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["revoke", "1-made", "--runs", str(runs), *words])


def test_what_has_no_calibration_is_not_revoked(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finished(runs, "2-home", {})
    assert main(["revoke", "2-home", "--runs", str(runs), "--reason", "x"]) == 2
    assert "run 2-home has no calibration to revoke" in capsys.readouterr().err
    with locked(lock_of_name(runs, "paper"), "cell paper", "another"):
        assert main(["revoke", "1-made", "--runs", str(runs), "--reason", "x"]) == 6


def test_the_first_reason_is_kept(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("revoke", "1-made", "--runs", str(runs), "--reason")
    assert main([*words, "wrong reflector"]) == 0
    assert main([*words, "tidying up"]) == 2
    assert "run 1-made is revoked already: wrong reflector" in capsys.readouterr().err
    (row,) = read_index(runs)
    assert row.facts.revoked == "wrong reflector"


def test_the_index_notices_a_revoked_one(runs: Path) -> None:
    (before,) = read_index(runs)
    assert main(["revoke", "1-made", "--runs", str(runs), "--reason", "x"]) == 0
    (after,) = read_index(runs)
    assert (before.facts.revoked, after.facts.revoked) == ("", "x")
    assert (runs / "1-made" / JOURNAL).exists()


def test_last_is_the_run_last_started_or_resumed_not_last_annotated(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    finished(runs, "2-made", MADE)
    assert main(["revoke", "1-made", "--runs", str(runs), "--reason", "wrong reflector"]) == 0
    assert find_run(runs, "last").name == "2-made"
    journal = RunJournal(runs / "1-made" / JOURNAL, "1-made", create=False)
    body = {"machine": "run", "from": "finished", "to": "checking", "trigger": "reopen"}
    journal.append("state", "", body)
    try:
        assert find_run(runs, "last").name == "1-made", "resumed, its engine lives"
    finally:
        journal.close()
    assert find_run(runs, "last").name == "1-made"


REVOKE = """
import os, sys
from hilcell.cell import addresses
from hilcell.commands.cli import main
revoke = ["revoke", "2-made", "--runs", sys.argv[1], "--reason", "a crash"]
assert [main(revoke), main(revoke)] == [0, 2]  # nothing can be loaded without rights
os.chmod(sys.argv[2], 0o555)
os.getuid() or os.setuid(65534)  # root may write everywhere
revoke[1] = "1-made"
sys.exit(main(revoke))
"""


@pytest.mark.parametrize("closed", ["1-made/journal.sqlite", "1-made", "."])
def test_a_missing_permission_is_named_with_the_next_act(closed: str) -> None:
    with tempfile.TemporaryDirectory() as name:
        runs = Path(name)
        for made in ("1-made", "2-made"):
            finished(runs, made, MADE)
        for each in (runs, *runs.rglob("*")):
            each.chmod(0o777)
        place = runs / closed
        words = [sys.executable, "-c", REVOKE, str(runs), str(place)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        place.chmod(0o777)
        assert done.returncode == 7
        assert f"not revoked: no permission to write {place};" in done.stderr
        assert "then `hilcell revoke 1-made` again" in done.stderr
        assert "resume" not in done.stderr
        assert not row_of(runs / "1-made").facts.revoked


def test_a_full_disk_names_the_command_to_repeat(runs: Path) -> None:
    name = "1-made"
    journal = RunJournal(runs / name / JOURNAL, name, create=False, again=f"hilcell revoke {name}")
    journal._base.execute("PRAGMA query_only=ON")  # as a disk that takes nothing
    with pytest.raises(StorageError, match="then `hilcell revoke 1-made`"):
        journal.append("event", "", {"what": "x"})
    journal.close()
