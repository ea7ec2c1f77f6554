"""The end of a run as it is printed: the fault, and where its steps are found."""

from pathlib import Path

import msgspec
import pytest

from hilcell.calibration.suspicions import Suspicion
from hilcell.cell.devices import ConnectFailed, load_entry
from hilcell.commands.cli import main
from hilcell.commands.run_output import RunOutput, print_end
from hilcell.errors import DeviceError
from hilcell.journal.runs import read_log
from tests.hilcell.report.journals import Writer

LOST = DeviceError("HC-T02", "Tracker", "measure", "no answer")
REFUSED = DeviceError("HC-R01", "Rail", "connect", "no gateway")
STRANGE = DeviceError("XY-1", "Tracker", "measure", "no answer")


def printed(tmp_path: Path, fault: Exception, *, as_json: bool = False) -> None:
    folder = Writer(tmp_path / "r1").began().ended()
    procedure = load_entry("procedures", "home")
    print_end(folder, read_log(folder), procedure, RunOutput(as_json=as_json), fault)


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
