"""The last word of a run: what it says of each end, and that its commands are ready to type."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from hilcell.cell.devices import ConnectFailed
from hilcell.commands.cli import whole_parser
from hilcell.errors import DeviceError, facts_of
from hilcell.geometry.frames import FrameError
from hilcell.identification.known_arm import ArmChanged
from hilcell.journal.journal import StorageError
from hilcell.journal.runs import read_log
from hilcell.model.verdicts import Verdict
from hilcell.ports import RecordingEnded
from hilcell.run.last_word import last_word
from tests.hilcell import verdicts
from tests.hilcell.report.journals import Writer

LOST = DeviceError("HC-T02", "Tracker", "measure", "no answer")
REFUSED = DeviceError("HC-R01", "Rail", "connect", "no gateway")
STRANGE = DeviceError("XY-1", "Tracker", "measure", "no answer")


FAULTS: list[tuple[int, Exception | None, list[str], list[str]]] = [  # said, next
    (3, LOST, ["FAULT HC-T02", "no answer"], ["hilcell explain HC-T02", "{resume}"]),
    (
        3,
        ConnectFailed({"Rail": REFUSED, "Tracker": LOST}),
        ["FAULT HC-R01, HC-T02", "no gateway"],
        ["hilcell explain HC-R01", "hilcell explain HC-T02", "{resume}"],
    ),
    (3, STRANGE, ["no answer"], ["{resume}"]),
    (4, None, ["STOPPED"], ["{resume}"]),
    (5, ValueError("x"), ["ValueError: x"], ["hilcell explain HC-C07", "{resume}"]),
    (
        7, StorageError("full", code="HC-J01"),
        ["FAULT HC-J01", ": full"], ["hilcell explain HC-J01", "{resume}"],
    ),
    (
        3, FrameError("a line"),
        ["FAULT HC-C20", ": a line"],
        ["hilcell explain HC-C20", "{run} (a new run is advised)", "{resume}"],
    ),
    (
        7, StorageError("damaged", code="HC-J13"),
        ["damaged"], ["hilcell explain HC-J13", "{run} (a new run is advised)"],
    ),
    (
        3, ArmChanged("another gear"),
        ["FAULT HC-C27", "another gear"],
        ["hilcell explain HC-C27", "{run} (a new run is advised)"],
    ),
    (
        3, RecordingEnded("it ends here"),
        ["ends here"], ["hilcell explain HC-C26", "{run} (a new run is advised)"],
    ),
    (
        2, REFUSED,
        ["REFUSED HC-R01", "nothing has moved"], ["hilcell explain HC-R01"],
    ),
]  # fmt: skip


@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize(("code", "fault", "said", "following"), FAULTS)
def test_the_last_word_of_a_run_that_did_not_finish_is_its_cause_and_how_it_continues(
    tmp_path: Path, code: int, fault: Exception | None, said: list[str], following: list[str],
    stored: bool,
) -> None:  # fmt: skip
    """Not stored: the journal could not take the end."""
    folder = tmp_path / "r 1"
    writer = Writer(folder, cell_file="my cell.toml").began()
    writer.state("run", "faulted" if fault is not None else "aborted")
    if stored or fault is None:
        error = {} if fault is None else facts_of(fault)
        end = {"state": "faulted", "exit": code, "result": {}, "error": error}
        writer.journal.append("end", "", end)
        fault = None
    elif not isinstance(fault, StorageError):
        return  # the journal has it
    word = last_word(read_log(writer.left()), folder, fault)
    assert [each for each in said if each not in word.sentence] == []
    resume, run = (
        f"hilcell {each} --runs {tmp_path}"
        for each in ("resume 'r 1'", "run home --cell 'my cell.toml'")
    )
    assert list(word.next) == [each.format(resume=resume, run=run) for each in following]
    assert "(simulated)" in word.sentence
    assert "\n" not in word.text


# -- a finished run --------------------------------------------------------------------------------

MADE: dict[str, Verdict] = {"fit": verdicts.FITTED}
WORSE = replace(verdicts.JUDGED, mean_mm=0.06, max_mm=0.09)
TURNED = replace(verdicts.JUDGED, max_deg=0.0123, max_tolerance_deg=0.03, max_U_deg=0.004)
UPRIGHT = replace(
    verdicts.TRACKER_AXES,
    holds=True,
    nests=[replace(verdicts.TRACKER_AXES.nests[0], across_mm=0.004, down_mm=0.0)],
)
RESTLESS = replace(verdicts.TRACKER_DRIFT, trend_mm=(0.0, 0.018, 0.0))
REPORT, PREPARE = "report r1 -o report.html", "prepare HOLES.csv --calibration {} -o FOLDER"


@pytest.mark.parametrize(
    ("judged", "code", "said", "following"),
    [
        (
            MADE | {"validation.S1100": verdicts.JUDGED}, 0,
            "IN TOLERANCE (simulated): mean 0.050 mm (limit 0.12), largest 0.100 (0.3)",
            [REPORT, PREPARE.format("r1")],
        ),
        (
            MADE | {"validation.S1100": verdicts.JUDGED, "validation.S300": WORSE,
                    "validation.others": WORSE}, 0,
            "mean 0.060 mm at S300 (limit 0.12), largest 0.100 at S1100 (0.3)",
            [REPORT, PREPARE.format("r1")],
        ),
        (
            MADE | {"validation.S1100": verdicts.JUDGED, "validation.S300": TURNED}, 0,
            "; largest of orientation 0.012 deg at S300 (limit 0.03)",
            [REPORT, PREPARE.format("r1")],
        ),
        (
            {"iso9283": verdicts.POSE_TESTED}, 0,
            "IN TOLERANCE (simulated): AP 0.050 mm (limit 0.2)", [REPORT],
        ),
        (
            MADE | {"validation.S300": verdicts.REJECTED}, 1,
            "OUT OF TOLERANCE (simulated): validation at S300: mean 0.2000 mm exceeds 0.12 mm by",
            ["explain HC-V01", REPORT],
        ),
        (
            MADE | {"validation.S300": verdicts.UNDECIDED}, 1,
            "UNDECIDED (simulated): validation at S300: mean 0.1000 mm keeps 0.12 mm, but not",
            ["explain HC-V17", REPORT],
        ),
        (
            {"backlash": replace(verdicts.BACKLASH, holds=False, found_mm=0.5)}, 1,
            "OUT OF TOLERANCE (simulated): backlash of the rail: backlash 0.5000 mm",
            ["explain HC-V15", REPORT],
        ),
        (
            MADE | {"validation.S1100": verdicts.JUDGED, "suspicions": verdicts.SUSPECTED}, 1,
            "SUSPECTED CAUSE (simulated): suspected causes: tracker moved",
            ["explain HC-V11", REPORT],
        ),
        (MADE, 0, "NOT VALIDATED (simulated): 0 points measured", []),
        ({}, 0, "DONE (simulated): 0 points measured", []),
        (
            {"recheck": verdicts.RECHECKED}, 0, "STILL VALID (simulated): drift 0.020 mm",
            [PREPARE.format("r0")],
        ),
        (
            {"recheck": replace(verdicts.UPDATED, holds=False, doubt="it may have slipped")}, 1,
            "UPDATED (simulated): drift 0.300 mm, u 0.010 mm; it may have slipped",
            [REPORT, PREPARE.format("r1")],
        ),
        (
            {"tracker-axes": UPRIGHT, "tracker-drift": verdicts.TRACKER_DRIFT}, 0,
            "is proven beyond its limit; figures within theirs: all 2",
            [REPORT],
        ),
        (
            {"tracker-axes": UPRIGHT, "tracker-drift": RESTLESS}, 0,
            "theirs: 1, undecided: 1 (trend of N1 in 10 min 0.0180 mm keeps 0.02 mm, but not with",
            [REPORT],
        ),
        (
            {"tracker-axes": verdicts.TRACKER_AXES, "tracker-drift": RESTLESS}, 1,
            "exceeds 0.015 mm by more than its U of 0.0040 mm; within theirs: 0, undecided: 1",
            ["explain HC-V23", REPORT],
        ),
        ({"recheck": verdicts.REDO}, 1, "CALIBRATE AGAIN (simulated): drift 0.9", ["run"]),
    ],
)  # fmt: skip
def test_the_last_word_of_a_finished_run_is_its_figures_and_the_next_commands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, judged: Mapping[str, Verdict], code: int,
    said: str, following: list[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("HILCELL_RUNS", str(tmp_path))
    writer = Writer(tmp_path / "r1").began()
    writer.event("calibration used", run="r0", file="", content={})
    for key, verdict in judged.items():
        writer.journal.append("verdict", key, verdict)
    word = last_word(read_log(writer.ended(code=code)), tmp_path / "r1")
    assert said in word.sentence
    assert list(word.next) == [f"hilcell {each}" for each in following]
    for each in word.next:  # as a shell and the program take them
        whole_parser().parse_args(shlex.split(each)[1:])


@pytest.mark.parametrize(
    ("states", "reason", "said"),
    [
        (
            ("stopping", "aborted"), "stopped by the operator",
            "STOPPED (simulated): by the operator; 0 of 8 points measured",
        ),
        (
            ("stopping", "aborted"), "stopped by SIGTERM",
            "STOPPED (simulated): by SIGTERM; 0 of 8 points measured",
        ),
        (
            ("aborting", "stopping", "aborted"), "aborted by the operator",
            "ABORTED (simulated): by the operator; 0 of 8 points measured",
        ),
    ],
)  # fmt: skip
def test_a_run_that_was_stopped_says_by_whom(
    tmp_path: Path, states: tuple[str, ...], reason: str, said: str
) -> None:
    writer = Writer(tmp_path / "r1").began()
    for each in states:
        writer.state("run", each)
    end: dict[str, Any] = {"state": "aborted", "exit": 4, "result": {}, "reason": reason}
    writer.journal.append("end", "", end)
    word = last_word(read_log(writer.left()), tmp_path / "r1")
    assert word.sentence.startswith(said)
    assert word.next == (f"hilcell resume r1 --runs {tmp_path}",)


def test_a_run_whose_process_died_and_a_real_one_say_so(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "r1", simulated=False).began()
    word = last_word(read_log(writer.left()), tmp_path / "r1")
    assert word.sentence.startswith("INTERRUPTED: ")
    assert "resume r1" in word.text


def test_the_last_word_is_one_clean_line(tmp_path: Path) -> None:
    """Devices and journals are untrusted."""
    writer = Writer(tmp_path / "r1").began()
    writer.state("run", "faulted")
    error = {"code": "HC-T02", "device": "Tracker", "operation": "measure", "found": "a\nb\x1b[2J"}
    end = {"state": "faulted", "exit": 3, "result": {}, "error": error}
    writer.journal.append("end", "", end)
    assert last_word(read_log(writer.left()), tmp_path / "r1").text.isprintable()
