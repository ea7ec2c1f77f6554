"""`revoke`, and `compensate` with calibrations that are not current."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hilcell.commands.cli import main
from hilcell.journal.index import find_run, read_index, row_of
from hilcell.journal.log import RunJournal
from hilcell.journal.runs import CALIBRATION, JOURNAL, read_log
from hilcell.run.cell_lock import lock_of_name, locked
from tests.hilcell.commands.finished_runs import FIT, MADE, REDO, finished
from tests.hilcell.commands.workplace import read_corrected
from tests.hilcell.lists import write_targets
from tests.hilcell.verdicts import REJECTED, UNDECIDED
from tests.whole.bench import command


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Return a folder of runs with one calibration, and targets beside it."""
    targets = np.array([[0.0, 0, 1200, 0, 75, 0], [0.0, 50, 1250, 0, 75, 0]])
    write_targets(tmp_path / "targets.csv", ["H1", "H2"], targets)
    finished(tmp_path / "runs", "1-made", MADE)
    return tmp_path / "runs"


def compensate(runs: Path, run: str | Path, *words: str) -> subprocess.CompletedProcess[str]:
    targets, out = runs.parent / "targets.csv", runs.parent / "out.csv"
    where = ("--station", "S1100", "-o", out, "--runs", runs)
    return command("compensate", run, targets, *where, *words)


def refused(runs: Path, run: str | Path) -> str:
    """Return why nothing is corrected."""
    done = compensate(runs, run)
    assert (done.returncode, (runs.parent / "out.csv").exists()) == (2, False)
    return done.stderr


def revoke(runs: Path, run: str, *words: str) -> subprocess.CompletedProcess[str]:
    return command("revoke", run, "--runs", runs, *words)


def stamp_of(runs: Path) -> str:
    _, _, (stamp,) = read_corrected(runs.parent / "out.csv")
    return stamp


def listed(runs: Path) -> dict[str, dict[str, str]]:
    """Return how the calibration of each run stands."""
    found = json.loads(command("runs", "--json", "--runs", runs).stdout)["runs"]
    return {each["run"]: each["standing"] or {} for each in found}


def test_a_revoked_one_is_refused_and_the_current_one_named(runs: Path) -> None:
    finished(runs, "2-made", MADE)
    done = revoke(runs, "2-made", "--reason", "wrong reflector", "--json")
    assert json.loads(done.stdout) == {
        "run": "2-made", "reason": "wrong reflector", "current": "1-made",
    }  # fmt: skip
    refusal = refused(runs, "2-made")
    assert "wrong reflector" in refusal
    assert "1-made" in refusal
    assert compensate(runs, "2-made", "--accept-not-current").returncode == 0
    assert stamp_of(runs).endswith("; REVOKED (accepted)")
    assert compensate(runs, "1-made").returncode == 0
    assert read_log(runs / "2-made").state == "finished"


def test_one_whose_journal_cannot_be_read_may_have_been_revoked(runs: Path) -> None:
    assert revoke(runs, "1-made", "--reason", "bumped tracker").returncode == 0
    with closing(sqlite3.connect(runs / "1-made" / JOURNAL)) as base, base:
        base.execute("UPDATE meta SET value = '1' WHERE name = 'form'")
    for named in ("1-made", runs / "1-made" / CALIBRATION):
        refusal = refused(runs, named)
        assert "form 1, expected" in refusal
        assert "--accept-not-current" in refusal
        assert "calibrate again" not in refusal
    assert compensate(runs, "1-made", "--accept-not-current").returncode == 0
    assert stamp_of(runs).endswith("; IN DOUBT (accepted)")
    assert "form 1, expected" in command("runs", "--runs", runs).stderr


def test_a_copied_folder_is_revoked_with_its_run(runs: Path) -> None:
    shutil.copytree(runs / "1-made", runs / "2-copy")
    assert revoke(runs, "1-made", "--reason", "a crash").returncode == 0
    assert "a crash" in refused(runs, "2-copy")
    (runs / "2-copy").rename(runs.parent / "renamed")
    assert compensate(runs, runs.parent / "renamed" / CALIBRATION).returncode == 0


def test_a_superseded_one_is_refused(runs: Path) -> None:
    finished(runs, "2-made", MADE)
    copied = runs.parent / "copied.json"
    copied.write_bytes((runs / "1-made" / CALIBRATION).read_bytes())
    for run in ("1-made", runs / "1-made" / CALIBRATION, copied):
        assert "2-made" in refused(runs, run)
    assert compensate(runs, "1-made", "--accept-not-current").returncode == 0
    assert stamp_of(runs).endswith("; SUPERSEDED by 2-made (accepted)")


def test_a_re_check_with_redo_leaves_none(runs: Path) -> None:
    finished(runs, "2-recheck", REDO, used="1-made", code=1)
    assert "2-recheck" in refused(runs, "1-made")


def test_a_redo_is_revoked_where_the_reflector_was_at_fault(runs: Path) -> None:
    finished(runs, "2-recheck", REDO, used="1-made", code=1)
    (runs / "2-recheck" / CALIBRATION).unlink()
    done = revoke(runs, "2-recheck", "--reason", "loose reflector", "--json")
    assert json.loads(done.stdout)["current"] == "1-made"
    assert compensate(runs, "1-made").returncode == 0
    again = revoke(runs, "2-recheck", "--reason", "loose reflector")
    assert (again.returncode, "loose reflector" in again.stderr) == (2, True)


def test_runs_and_show_say_how_it_stands(runs: Path) -> None:
    finished(runs, "2-made", MADE)
    for name in ("3-home", "4-file-of-no-calibration"):
        finished(runs, name, {})
    (runs / "3-home" / CALIBRATION).unlink()
    found = listed(runs)
    assert found["1-made"]["state"] == "superseded"
    assert found["1-made"]["by"] == found["1-made"]["current"] == "2-made"
    assert (found["2-made"]["state"], found["3-home"]) == ("current", {})
    assert found["4-file-of-no-calibration"]["state"] == "in doubt"
    shown = command("runs", "--runs", runs).stdout
    assert "superseded by 2-made" in " ".join(shown.split())


def test_one_that_is_undecided_is_listed_so(runs: Path) -> None:
    undecided = FIT | {"validation.S1100": UNDECIDED}
    finished(runs, "2-made", undecided, code=1)
    finished(runs, "3-made", undecided | {"validation.S300": REJECTED}, code=1)
    assert [each["state"] for each in listed(runs).values()] == [
        "current", "undecided", "not validated",
    ]  # fmt: skip


def test_the_last_run_that_wrote_none_leads_to_the_current_one(runs: Path) -> None:
    finished(runs, "2-home", {})
    (runs / "2-home" / CALIBRATION).unlink()
    assert "2-home wrote no calibration; name 1-made, the current calibration of its cell" in (
        refused(runs, "last")
    )
    assert revoke(runs, "1-made", "--reason", "a crash").returncode == 0
    assert "name a finished `hilcell run calibrate`" in refused(runs, "last")


@pytest.mark.parametrize("words", [(), ("--reason", ""), ("--reason", " \x1b")])
def test_a_reason_is_wanted(runs: Path, words: tuple[str, ...]) -> None:
    assert revoke(runs, "1-made", *words).returncode == 2


def test_a_run_without_a_calibration_or_at_work_is_not_revoked(runs: Path) -> None:
    finished(runs, "2-home", {})
    assert revoke(runs, "2-home", "--reason", "x").returncode == 2
    with locked(lock_of_name(runs, "paper"), "cell paper", "another"):
        assert revoke(runs, "1-made", "--reason", "x").returncode == 6


def test_the_index_notices_a_revoked_one_and_keeps_the_first_reason(runs: Path) -> None:
    (before,) = read_index(runs)
    assert revoke(runs, "1-made", "--reason", "wrong reflector").returncode == 0
    assert revoke(runs, "1-made", "--reason", "tidying up").returncode == 2
    (after,) = read_index(runs)
    assert (before.facts.revoked, after.facts.revoked) == ("", "wrong reflector")


def test_last_is_the_run_last_started_or_resumed_not_last_annotated(
    runs: Path,
) -> None:
    finished(runs, "2-made", MADE)
    assert revoke(runs, "1-made", "--reason", "wrong reflector").returncode == 0
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
from pathlib import Path
from types import SimpleNamespace
from hilcell.cell import devices
from hilcell.commands.cli import main
revoke = ["revoke", "2-made", "--runs", sys.argv[1], "--reason", "a crash"]
assert [main(revoke), main(revoke)] == [0, 2]  # nothing can be loaded without rights
revoke[1] = "1-made"
me = os.getuid()
for place in map(Path, sys.argv[2:]):
    place.chmod(0o555)
    os.setresuid(me or 65534, me or 65534, me)  # root may write everywhere
    print(main(revoke))
    os.setresuid(me, me, me)
    place.chmod(0o777)
"""


@pytest.mark.process
def test_a_missing_permission_is_named() -> None:
    with tempfile.TemporaryDirectory() as name:
        runs = Path(name)
        for made in ("1-made", "2-made"):
            finished(runs, made, MADE)
        for each in (runs, *runs.rglob("*")):
            each.chmod(0o777)
        places = [runs / "1-made" / JOURNAL, runs / "1-made", runs]
        words = [sys.executable, "-c", REVOKE, str(runs), *map(str, places)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.stdout.split()[-3:] == ["7"] * 3, done.stderr
        for place in places:
            assert f"{place};" in done.stderr
        assert not row_of(runs / "1-made").facts.revoked


def test_a_read_only_file_system_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The words were: no permission, ask the owner."""
    finished(tmp_path, "1-made", MADE)
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_flag=os.ST_RDONLY))
    words = ["revoke", "1-made", "--reason", "a nest", "--runs", str(tmp_path)]
    assert main(words) == 7
    said = capsys.readouterr().err
    assert "read-only file system" in said
    assert f"then `hilcell revoke 1-made --reason 'a nest' --runs {tmp_path}`\n" in said
    assert not row_of(tmp_path / "1-made").facts.revoked


def test_the_name_of_the_newest_run_is_reserved(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "home", "--name", "last"])
    assert "'last' is reserved" in capsys.readouterr().err
