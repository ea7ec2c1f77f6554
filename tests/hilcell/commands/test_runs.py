"""The list of runs: when, by whom, with which verdict; and those that were asked for."""

import json
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from hilcell.commands import console
from hilcell.commands import runs as runs_command
from hilcell.journal.calibration_status import statuses
from hilcell.journal.index import RunRow, row_of
from hilcell.model.verdicts import Suspected, Verdict
from tests.hilcell import verdicts
from tests.hilcell.commands.finished_runs import FIT, MADE, REDO, finished
from tests.whole.bench import command

UNDECIDED = {"validation.S1100": verdicts.UNDECIDED}
REJECTED = {"validation.S1100": verdicts.REJECTED}
SUSPECTED = {"suspicions": verdicts.SUSPECTED}


@pytest.mark.parametrize(
    ("judged", "code", "said", "stands"),
    [
        (MADE, 0, "in tolerance", "current"),
        (MADE | REJECTED, 1, "out of tolerance", "not validated"),
        (MADE | UNDECIDED, 1, "undecided", "undecided"),
        (MADE | UNDECIDED | {"validation.S300": verdicts.REJECTED}, 1, "out of tolerance",
         "not validated"),
        (MADE | SUSPECTED, 1, "suspected", "suspected"),
        (MADE | REJECTED | SUSPECTED, 1, "out of tolerance; suspected", "not validated"),
        (MADE | {"suspicions": Suspected(holds=True, suspected=[])}, 0, "in tolerance", "current"),
        (FIT, 0, "not validated", "not validated"),
        (REDO, 1, "calibrate again", ""),
        ({"recheck": verdicts.RECHECKED}, 0, "still valid", ""),
        ({"backlash": replace(verdicts.BACKLASH, holds=False)}, 1, "out of tolerance", ""),
        ({"backlash": verdicts.BACKLASH}, 0, "done", ""),  # a check that holds judges no robot
        ({"iso9283": verdicts.POSE_TESTED}, 0, "in tolerance", ""),
        ({"iso9283": verdicts.POSE_TESTED}, 1, "out of tolerance", ""),  # not by its limits
        ({"targets": verdicts.JUDGED}, 0, "in tolerance", "current"),
        ({"targets": verdicts.REJECTED}, 1, "out of tolerance", ""),  # nothing was folded in
        ({}, 0, "done", ""),
        ({}, 1, "out of tolerance", ""),
    ],
)  # fmt: skip
def test_a_verdict_in_words(
    tmp_path: Path, judged: dict[str, Verdict], code: int, said: str, stands: str
) -> None:
    """A suspected calibration was validated: "not validated" would be wrong."""
    finished(tmp_path, "r", judged, code=code)
    row = row_of(tmp_path / "r")
    found = statuses([row]).get("r")
    assert (row.verdict, found.text if found else "") == (said, stands)


@pytest.mark.parametrize(
    ("state", "code", "said"),
    [("aborted", 4, "aborted"), ("faulted", 3, "faulted"), ("idle", 2, "refused"),
     ("running", None, "")],
)  # fmt: skip
def test_a_run_that_did_not_finish(state: str, code: int | None, said: str) -> None:
    assert RunRow(name="r", begun="2026-11-22T10:00:00Z", state=state, exit=code).verdict == said


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    for name in ("1-made", "2-made"):
        finished(tmp_path, name, MADE)
    return tmp_path


def listed(runs: Path, *words: str) -> list[dict[str, Any]]:
    done = command("runs", "--json", "--runs", runs, *words)
    assert done.returncode == 0
    found: list[dict[str, Any]] = json.loads(done.stdout)["runs"]
    return found


def test_the_table_has_the_time_the_operator_and_the_verdict(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hilcell.commands.runs.read_index", lambda _: [
        RunRow(
            name="r", begun="2026-11-22T22:30:00Z", state="finished", exit=0, operator="Ann\x1b[0m",
            procedure="home", cell="paper",
        )
    ])  # fmt: skip
    out = command("runs", "--runs", runs).stdout
    assert all(word in out for word in ("Ann", "2026-11-2", "done", "home"))
    assert "\x1b" not in out


def test_json_keys_are_added_to(runs: Path) -> None:
    first, _ = listed(runs)
    assert {"run", "procedure", "cell", "state", "points", "exit", "simulated", "operator", "job",
            "live", "standing"} < set(first)  # fmt: skip
    assert first["verdict"] == "in tolerance"
    assert first["begun"].endswith("Z")
    assert first["ended"] >= first["begun"]


@pytest.mark.parametrize(
    ("words", "count"),
    [
        (["--cell", "paper"], 2),
        (["--cell", "hard"], 0),
        (["--operator", "nobody"], 0),
        (["--since", "2020-01-01T10:00+02:00"], 2),
        (["--since", "2999-01-01"], 0),
    ],
)
def test_those_that_were_asked_for(runs: Path, words: list[str], count: int) -> None:
    assert len(listed(runs, *words)) == count


@pytest.mark.parametrize(
    "words",
    [
        ("runs", "--operator"),
        ("run", "home", "--operator"),
        ("run", "home", "--job"),
        ("revoke", "last", "--reason=x", "--operator"),
    ],
)
@pytest.mark.parametrize(
    ("note", "why"),
    [
        (201 * "x", "expected at most 200 characters, got 201"),
        ("M\udcfcller", r"expected UTF-8 text, got 'M\udcfcller'"),  # Latin 1
    ],
)
def test_a_note_is_refused_that_a_journal_would_change(
    words: tuple[str, ...], note: str, why: str
) -> None:
    refused = command(*words, note)
    assert refused.returncode == 2
    assert f"{words[-1]}: {why}" in refused.stderr


@pytest.mark.parametrize("text", ["soon", "22.11.2026", "0001-01-01", ""])
def test_a_date_that_is_none_is_refused(text: str) -> None:
    assert command("runs", "--since", text).returncode == 2


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    done = command("runs", "--runs", tmp_path / "nope")
    assert done.returncode == 0
    assert str(tmp_path / "nope") in done.stderr


@pytest.mark.parametrize("columns", [80, 120])
def test_the_list_fits_the_terminal_and_keeps_what_matters(
    runs: Path, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setattr(console, "terminal_columns", lambda: columns)
    monkeypatch.setattr(runs_command, "terminal_columns", lambda: columns)
    name = "20261122-223000-calibrate-ab12"
    monkeypatch.setattr(runs_command, "read_index", lambda _: [
        RunRow(name=name, begun="2026-11-22T22:30:00Z", state="finished", exit=0, operator="Ann",
               procedure="calibrate", cell="paper", simulated=True),
    ])  # fmt: skip
    lines = command("runs", "--runs", runs).stdout.splitlines()
    assert max(map(len, lines)) <= columns
    row = next(line for line in lines if name in line)
    assert all(word in row for word in ("paper", "simulated", "done"))


def test_what_show_prints_fits_the_terminal(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "terminal_columns", lambda: 60)
    lines = command("show", "1-made", "--runs", runs).stdout.splitlines()
    assert max(map(len, lines)) <= 60
    names = [line.split("│")[1].strip() for line in lines if line.startswith("│")]
    assert "stage" in names
    assert "calibration" not in names  # that is what has been measured, not its status


@pytest.mark.parametrize(
    "words",
    ["runs", "show last", "watch last", "run home", "report last -o X", "resume last",
     "stop last", "compare last last"],
)  # fmt: skip
def test_a_file_in_place_of_the_folder_of_runs_is_refused_by_every_command(
    tmp_path: Path, words: str
) -> None:
    """It ended 0, 2 or 7, by the command."""
    file = tmp_path / "file"
    file.write_text("no folder")
    done = command(*words.split(), "--runs", file)
    assert (done.returncode, str(file) in done.stderr) == (2, True)
