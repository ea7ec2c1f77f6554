"""A run that uses a calibration judges it as `compensate` does, and keeps what was accepted."""

import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.calibration.decision_rule import Guard, decide
from hilcell.cell.file import load_cell
from hilcell.journal.index import RunRow
from hilcell.journal.runs import CALIBRATION, read_log
from hilcell.model.calibration import Update
from hilcell.run import engine
from tests.hilcell.calibration.calibrations import LIMITS, calibration
from tests.hilcell.commands.finished_runs import FIT, MADE, finished
from tests.hilcell.report.journals import Writer
from tests.hilcell.verdicts import REJECTED, TOUCHED
from tests.whole.bench import command

WRONG = decide(0.9, 2.0, LIMITS, Guard(0.04, 0.05))


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of runs in which a run ends as soon as its plan is journalled."""
    monkeypatch.setattr(engine.Engine, "_perform", lambda *given: engine.Ending(0, None))
    finished(tmp_path, "1-made", MADE)
    return tmp_path


def recheck(
    runs: Path, used: str, *words: str, procedure: str = "recheck"
) -> subprocess.CompletedProcess[str]:
    named = f"{procedure}.calibration={used}"
    return command("run", procedure, "--name", "r", "--runs", runs, "--set", named, *words)


def refused(runs: Path, used: str, *words: str, procedure: str = "recheck") -> str:
    done = recheck(runs, used, *words, procedure=procedure)
    assert (done.returncode, (runs / "r").exists()) == (2, False)
    return done.stderr


@pytest.mark.parametrize("procedure", ["recheck", "touch"])
def test_one_that_is_not_current_is_refused(runs: Path, procedure: str) -> None:
    finished(runs, "2-made", MADE)
    refusal = refused(runs, "1-made", procedure=procedure)
    assert "2-made" in refusal
    assert "--accept-not-current" in refusal
    assert recheck(runs, "1-made", "--accept-not-current", procedure=procedure).returncode == 0
    (accepted,) = read_log(runs / "r").inputs.accepted
    assert "2-made" in accepted


def test_one_of_another_tolerance_or_revoked_is_refused(runs: Path) -> None:
    assert "tolerance" in refused(runs, "1-made", "--set", "validation.mean_tolerance_mm=0.1")
    assert command("revoke", "1-made", "--runs", runs, "--reason", "loose nest").returncode == 0
    assert "loose nest" in refused(runs, "1-made")


@pytest.mark.parametrize(
    "changes",
    [
        {"verdicts": {"S1100": WRONG}},
        {"verdicts": {}},  # never validated
        {"failed": {"suspicions": "suspected"}},
    ],
)
def test_one_out_of_tolerance_is_refused(runs: Path, changes: dict[str, Any]) -> None:
    finished(runs, "2-made", MADE, **changes)
    assert "--accept-out-of-tolerance" in refused(runs, "2-made")
    assert recheck(runs, "2-made", "--accept-out-of-tolerance").returncode == 0
    assert len(read_log(runs / "r").inputs.accepted) == 1


def touched(runs: Path) -> None:
    """Finish a run that touched the base of the first on a visit."""
    touch = Update("3-touch", "touch", "2026-11-22T10:00:00Z", 8)
    made = calibration(run="1-made", simulated=True, updates=[touch]).provenance
    finished(runs, "3-touch", {"touch": TOUCHED}, used="1-made", provenance=made)


def test_the_current_one_is_taken_and_named(runs: Path) -> None:
    """A later one that failed is not it, nor is a base that was touched on a visit."""
    finished(runs, "2-made", FIT | {"validation.S1100": REJECTED}, code=1)
    touched(runs)
    done = recheck(runs, "")
    assert done.returncode == 0
    assert "1-made" in done.stderr
    used = read_log(runs / "r").cell.recheck.calibration
    assert used == str(runs / "1-made" / CALIBRATION)


def test_a_touched_base_alone_is_not_taken(runs: Path) -> None:
    touched(runs)
    (runs / "1-made" / CALIBRATION).unlink()
    assert "3-touch" in refused(runs, "")


def test_an_accepted_refusal_is_shown(runs: Path) -> None:
    accepted = "it is revoked: loose nest"
    Writer(runs / "2-recheck", accepted=[accepted]).began().ended()
    assert accepted in command("show", "2-recheck", "--runs", runs).stdout
    page = runs / "page.html"
    assert command("report", "2-recheck", "--runs", runs, "-o", page).returncode == 0
    assert accepted in page.read_text()


CELL = load_cell("paper")
ROW = RunRow(
    name="", begun="", state="finished", cell=CELL.name, serial=CELL.serial, simulated=True
)


def test_poses_of_finished_runs_of_the_same_cell_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds: list[dict[str, Any]] = [
        {"state": "faulted"},
        {"cell": "other"},
        {"serial": "other"},
        {"replayed": True},
        {"simulated": False},
        *[{"state": "finished"}] * 9,
    ]
    rows = [msgspec.structs.replace(ROW, name=f"{n}", **changes) for n, changes in enumerate(kinds)]
    monkeypatch.setattr(engine, "read_index", lambda runs: rows)
    assert engine.finished_runs(Path(), CELL) == ["5", "6", "7", "8", "9"]
    real = msgspec.structs.replace(CELL, simulation=None)
    assert engine.finished_runs(Path(), real) == ["4"]
    bare = msgspec.structs.replace(
        CELL, robot=msgspec.structs.replace(CELL.robot, envelope=None), keep_out=[]
    )
    assert engine.finished_runs(Path(), bare) == []
