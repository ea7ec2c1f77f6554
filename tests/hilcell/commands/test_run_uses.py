"""A run that uses a calibration judges it as `compensate` does, and keeps what was accepted."""

from pathlib import Path
from typing import Any

import pytest

from hilcell.calibration.decision import Guard, judged
from hilcell.calibration.form import Update
from hilcell.commands import run as command
from hilcell.commands.cli import main
from hilcell.journal.runs import CALIBRATION, read_log
from tests.hilcell.calibration.calibrations import LIMITS, calibration
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.report.journals import Writer

WRONG = judged(0.9, 2.0, LIMITS, Guard(0.04, 0.05))


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of runs in which a run ends as soon as its plan is journalled."""
    monkeypatch.setattr(command, "_perform", lambda *given: 0)
    finished(tmp_path, "1-made", MADE)
    return tmp_path


def recheck(runs: Path, used: str, *words: str, procedure: str = "recheck") -> int:
    named = f"{procedure}.calibration={used}"
    return main(["run", procedure, "--name", "r", "--runs", str(runs), "--set", named, *words])


@pytest.mark.parametrize("procedure", ["recheck", "touch"])
def test_one_that_is_not_current_is_refused(
    runs: Path, capsys: pytest.CaptureFixture[str], procedure: str
) -> None:
    finished(runs, "2-made", MADE)
    assert recheck(runs, "1-made", procedure=procedure) == 2
    refusal = capsys.readouterr().err
    assert "it is superseded by 2-made" in refusal
    assert "--accept-not-current uses it all the same" in refusal
    assert not (runs / "r").exists()
    assert recheck(runs, "1-made", "--accept-not-current", procedure=procedure) == 0
    said = "it is superseded by 2-made"
    assert f"accepted although {said}" in capsys.readouterr().err
    assert read_log(runs / "r").inputs.accepted == [said]


def test_a_revoked_one_is_refused(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["revoke", "1-made", "--runs", str(runs), "--reason", "loose nest"]) == 0
    assert recheck(runs, "1-made") == 2
    assert "it is revoked: loose nest" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"verdicts": {"S1100": WRONG}}, "validation at S1100: out of tolerance"),
        ({"verdicts": {}}, "never validated"),
        ({"failed": {"suspicions": "suspected"}}, "suspicions did not hold"),
    ],
)
def test_one_out_of_tolerance_is_refused(
    runs: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], says: str
) -> None:
    finished(runs, "2-made", MADE, **changes)
    assert recheck(runs, "2-made") == 2
    refusal = capsys.readouterr().err
    assert says in refusal
    assert "--accept-out-of-tolerance uses it all the same" in refusal
    assert recheck(runs, "2-made", "--accept-out-of-tolerance") == 0
    (accepted,) = read_log(runs / "r").inputs.accepted
    assert says in accepted


def test_another_tolerance_is_refused(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert recheck(runs, "1-made", "--set", "validation.mean_tolerance_mm=0.1") == 2
    assert "another tolerance than the cell given" in capsys.readouterr().err


def test_the_current_one_is_taken_and_named(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A later one that failed is not it, nor is a base that was touched on a visit."""
    finished(runs, "2-made", {"fit": {}, "validation.S1100": {"holds": False}}, code=1)
    touch = Update("3-touch", "touch", "2026-11-22T10:00:00Z", 8)
    made = calibration(run="1-made", simulated=True, updates=[touch]).provenance
    finished(runs, "3-touch", {"touch": {"station": "S300"}}, used="1-made", provenance=made)
    assert recheck(runs, "") == 0
    assert "the calibration of run 1-made is used: current" in capsys.readouterr().err
    used = read_log(runs / "r").cell.recheck.calibration
    assert used == str(runs / "1-made" / CALIBRATION)


def test_a_touched_base_alone_is_not_taken(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    touch = Update("3-touch", "touch", "2026-11-22T10:00:00Z", 8)
    made = calibration(run="1-made", simulated=True, updates=[touch]).provenance
    finished(runs, "3-touch", {"touch": {"station": "S300"}}, used="1-made", provenance=made)
    (runs / "1-made" / CALIBRATION).unlink()
    assert recheck(runs, "") == 2
    assert "run 3-touch has a base that was touched on a visit" in capsys.readouterr().err


def test_what_was_accepted_is_shown(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Writer(runs / "2-recheck", accepted=["it is revoked: loose nest"]).began().ended()
    assert main(["show", "2-recheck", "--runs", str(runs)]) == 0
    assert "it is revoked: loose nest" in capsys.readouterr().out
    page = runs / "page.html"
    assert main(["report", "2-recheck", "--runs", str(runs), "-o", str(page)]) == 0
    assert "a calibration was used although it is revoked: loose nest" in page.read_text()
