"""The end of a run as it is printed: the fault, and where its steps are found."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from hilcell.calibration.suspicions import Suspicion
from hilcell.cell.devices import ConnectFailed, load_entry
from hilcell.commands.cli import main
from hilcell.commands.run_output import ProgressOutput, RunOutput, failed_words, print_end
from hilcell.errors import DeviceError
from hilcell.journal.curve_record import CurveRecord
from hilcell.journal.journal import Record
from hilcell.journal.runs import read_log
from tests.hilcell.report.journals import Writer

LOST = DeviceError("HC-T02", "Tracker", "measure", "no answer")
REFUSED = DeviceError("HC-R01", "Rail", "connect", "no gateway")
LISTS = ("cycles", "amplitude_rad", "covariance_rad2", "shown", "spectrum")
STRANGE = DeviceError("XY-1", "Tracker", "measure", "no answer")


def printed(tmp_path: Path, fault: Exception, *, as_json: bool = False) -> None:
    folder = Writer(tmp_path / "r1").began().ended()
    procedure = load_entry("procedures", "home")
    print_end(folder, read_log(folder), procedure, RunOutput(as_json=as_json), fault)


def test_a_result_without_rows_has_no_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Writer(tmp_path / "r1").began().ended()
    home = load_entry("procedures", "home")
    print_end(folder, read_log(folder), home, RunOutput(as_json=False), None)
    assert capsys.readouterr().out == ""
    assert main(["show", "r1", "--runs", str(tmp_path)]) == 0
    assert "group" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("fault", "codes"),
    [
        (LOST, ["HC-T02"]),
        (ConnectFailed({"Rail": REFUSED, "Tracker": LOST}), ["HC-R01", "HC-T02"]),
        (STRANGE, []),
    ],
)
def test_a_fault_names_the_alarms_that_say_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fault: DeviceError, codes: list[str]
) -> None:
    printed(tmp_path, fault)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"hilcell: {fault}".splitlines()[0]
    said = [line for line in lines if "explain" in line]
    assert said == [f"what to do: hilcell explain {code}" for code in codes]


def test_the_cause_that_ended_a_run_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a fault suspects is no table of a finished run."""
    writer = Writer(tmp_path / "r1").began()
    writer.state("run", "faulted")
    suspected = {"suspicions": [msgspec.to_builtins(Suspicion("strip", 1.0, "mm", "slide nest"))]}
    end = {"state": "faulted", "exit": 3, "result": suspected}
    writer.journal.append("end", "", end)
    folder = writer.left()
    procedure = load_entry("procedures", "calibrate")
    print_end(folder, read_log(folder), procedure, RunOutput(as_json=False), LOST)
    assert main(["show", "r1", "--runs", str(tmp_path)]) == 0
    assert capsys.readouterr().err.count("Suspected: strip (1 mm), noticed by slide nest") == 2
    assert main(["show", "r1", "--json", "--runs", str(tmp_path)]) == 0
    assert msgspec.json.decode(capsys.readouterr().out)["result"] == suspected


def test_programs_get_the_fault_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed(tmp_path, LOST, as_json=True)
    assert capsys.readouterr().err == f"hilcell: {LOST}\n"


def test_an_error_that_nobody_expected_is_printed_with_its_trace(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        float("4394.2 245.2")
    except ValueError as error:
        printed(tmp_path, error)
    trace, _, reason = capsys.readouterr().err.partition("\nhilcell: ")
    assert "test_run_end.py" in trace
    assert reason.startswith(
        "ValueError: could not convert string to float: '4394.2 245.2'; a defect"
    )


POSITION = {
    "holds": False, "mean_mm": 0.0311, "mean_tolerance_mm": 0.12, "mean_U_mm": 0.04,
    "max_mm": 0.1, "max_tolerance_mm": 0.3, "max_U_mm": 0.05,
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "more", "words"),
    [
        (
            "validation.S1100",
            POSITION
            | {"outcome": "undecided", "max_deg": 0.022, "max_tolerance_deg": 0.03}
            | {"max_U_deg": 0.015},
            (
                "undecided: validation at S1100: largest error of orientation 0.0220 + U 0.0150 "
                "deg is not shown to keep its limit of 0.03 deg"
            ),
        ),
        (
            "validation.S1100",
            POSITION | {"outcome": "rejected", "mean_mm": 0.2},
            (
                "out of tolerance: validation at S1100: mean 0.2000 + U 0.0400 mm is above its "
                "limit of 0.12 mm"
            ),
        ),
        (
            "validation.S1100",
            POSITION | {"outcome": "undecided", "decision": "too few targets"},
            "undecided: validation at S1100: too few targets",
        ),
        (
            "backlash",
            {"holds": False, "found_mm": 0.5, "limit_mm": 0.4},
            "out of tolerance: backlash of the rail: backlash 0.5000 mm, wanted <= 0.4 mm",
        ),
    ],
)
def test_a_verdict_that_does_not_hold_is_printed_in_words(
    key: str, more: dict[str, Any], words: str
) -> None:
    assert failed_words(key, more) == words


def test_a_broken_promise_is_shown_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    body = {"what": "promise", "port": "tracker", "promise": "late", "verdict": "broken"}
    with ProgressOutput("r", 0) as output:
        output.print_record(Record(1, "", "event", "", body | {"why": "3 mm off"}))
        output.print_record(Record(2, "", "event", "", body | {"why": "", "verdict": "held"}))
    said = capsys.readouterr().err
    assert said.count("tracker late: broken: 3 mm off\n") == 1
    assert said.splitlines()[-1].startswith("tracker late ")


@pytest.mark.parametrize("reason", ["", "the axis paused; sweep again"])
def test_an_axis_whose_sweeps_are_not_used_is_shown(
    reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = (each for each in CurveRecord.__struct_fields__ if each not in ("axis", "reason"))
    body: dict[str, Any] = {
        each: [] if each in LISTS else 0 if each == "lost" else 0.0 for each in figures
    }
    with ProgressOutput("r", 0) as output:
        facts = {"what": "curve", "axis": 2, "reason": reason}
        output.print_record(Record(1, "", "event", "", body | facts))
    assert capsys.readouterr().err.count(f"A2 not used: {reason}\n") == bool(reason)


def test_watch_states_the_fault_that_ended_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Writer(tmp_path / "r1").began().ended("faulted", 3, "Tracker: measure: no answer")
    assert main(["watch", "r1", "--runs", str(tmp_path)]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.endswith("r1: faulted: Tracker: measure: no answer")
