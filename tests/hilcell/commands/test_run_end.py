"""The end of a run as it is printed: the fault, and where its steps are found."""

import json
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import msgspec
import pytest

from hilcell.alarms.alarm import alarms_of
from hilcell.cell.devices import load_entry
from hilcell.commands import control
from hilcell.commands.cli import main
from hilcell.commands.run_output import (
    JsonOutput,
    ProgressOutput,
    RunOutput,
    failure_text,
    print_end,
)
from hilcell.errors import DeviceError
from hilcell.journal.journal import Record
from hilcell.journal.runs import read_log
from hilcell.model.events import LinkCounted
from hilcell.model.verdicts import Cause, Suspicion, decode_verdict
from hilcell.report.export import xlsx_bytes
from hilcell.report.facts import read_facts
from hilcell.report.html import report_html
from tests.hilcell.report.journals import Writer
from tests.hilcell.report.pages import Page

LOST = DeviceError("HC-T02", "Tracker", "measure", "no answer")


def end_of(folder: Path, fault: Exception | None = None, *, as_json: bool = False) -> None:
    """Print the end of a run as its command does."""
    procedure = load_entry("procedures", "home")
    output = JsonOutput(folder.name) if as_json else RunOutput()
    print_end(folder, read_log(folder), procedure, output, fault)


def test_the_cause_that_ended_a_run_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cause that a fault suspects is no table of a finished run."""
    writer = Writer(tmp_path / "r1").began()
    writer.state("run", "faulted")
    suspected = {"suspicions": [Suspicion(Cause.STRIP, 1.0, "mm", "slide nest").facts]}
    end = {"state": "faulted", "exit": 3, "result": suspected}
    writer.journal.append("end", "", end)
    end_of(writer.left(), LOST)
    assert main(["show", "r1", "--runs", str(tmp_path)]) == 0
    assert capsys.readouterr().err.count("strip (1 mm)") == 2
    assert main(["show", "r1", "--json", "--runs", str(tmp_path)]) == 0
    assert msgspec.json.decode(capsys.readouterr().out)["result"] == suspected


def test_programs_get_the_fault_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    end_of(Writer(tmp_path / "r1").began().ended(), LOST, as_json=True)
    assert capsys.readouterr().err == f"hilcell: {LOST}\n"


def test_an_error_that_nobody_expected_is_printed_with_its_trace(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        float("4394.2 245.2")
    except ValueError as error:
        end_of(Writer(tmp_path / "r1").began().ended(), error)
    trace, _, reason = capsys.readouterr().err.partition("\nhilcell: ")
    assert "test_run_end.py" in trace
    assert reason.startswith("ValueError: ")


POSITION = {
    "holds": False, "mean_mm": 0.0311, "mean_tolerance_mm": 0.12, "mean_U_mm": 0.04,
    "max_mm": 0.1, "max_tolerance_mm": 0.3, "max_U_mm": 0.05,
    "decision": "not in tolerance",
}  # fmt: skip
REJECTED = POSITION | {"outcome": "rejected", "mean_mm": 0.2}
TURNED = {
    "outcome": "undecided", "max_deg": 0.022, "max_tolerance_deg": 0.03, "max_U_deg": 0.015,
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "more", "words"),
    [
        ("validation.S1100", POSITION | TURNED, "undecided S1100 0.0220 0.0150 0.03"),
        ("validation.S1100", REJECTED, "tolerance S1100 0.2000 0.0400 0.12"),
        ("backlash", {"holds": False, "found_mm": 0.5, "limit_mm": 0.4}, "backlash 0.5000 0.4"),
    ],
)
def test_a_verdict_that_does_not_hold_is_printed_with_its_figures(
    key: str, more: dict[str, Any], words: str
) -> None:
    printed = failure_text(key, decode_verdict(key, more))
    assert [word for word in words.split() if word not in printed] == []


def test_a_broken_promise_is_shown_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    body = {"what": "promise", "port": "tracker", "promise": "late", "verdict": "broken"}
    with ProgressOutput(Path("r"), 0) as output:
        output.print_record(Record(1, "", "event", "", body | {"why": "3 mm off"}))
        output.print_record(Record(2, "", "event", "", body | {"why": "", "verdict": "held"}))
    said = capsys.readouterr().err
    assert said.count("3 mm off\n") == 1


def test_a_re_calibration_does_not_say_that_it_measures_a_grid(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with ProgressOutput(Path("r"), 0) as output:
        output.print_record(Record(1, "", "event", "", {"what": "arm carried", "run": "base"}))
        for to in ("base_framed", "grid_measured", "stations_framed"):
            body = {"machine": "calibration", "to": to}
            output.print_record(Record(2, "", "state", "", body))
    said = capsys.readouterr().err
    assert "arm carried from base\nbase framed\nstations framed\n" in said


def test_watch_prints_the_fault_that_ended_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Writer(tmp_path / "r1").began().ended("faulted", 3, "Tracker: measure: no answer")
    assert main(["watch", "r1", "--runs", str(tmp_path)]) == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert "Tracker: measure: no answer" in last


PROMPT = {"title": "Seat the reflector in P1", "text": "Take it and seat it."}


@pytest.mark.parametrize(
    ("to", "facts", "words"),
    [
        ("checking", {}, ["connecting"]),
        ("paused", {}, ["paused", "`hilcell resume 'r 7' --runs {runs}`"]),
        ("paused", {"reason": "the screen was lost"}, ["the screen was lost", "hilcell resume"]),
        ("suspended", {"reason": "P1", "prompt": PROMPT}, ["suspended", *PROMPT.values()]),
    ],
)
def test_a_state_is_said_with_what_the_run_waits_for(
    tmp_path: Path, to: str, facts: dict[str, Any], words: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    body = {"machine": "run", "from": "running", "to": to} | facts
    record = Record(1, "2026-01-01T00:00:00+00:00", "state", "", body)
    ProgressOutput(tmp_path / "r 7", 3).take(record)
    said = "".join(capsys.readouterr().err.split())
    for each in words:
        assert each.format(runs=tmp_path).replace(" ", "") in said


def test_the_bar_counts_each_point_once_and_never_beyond_its_total(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with ProgressOutput(Path("r"), 2) as output:
        output.skip_measured(["base/1"])
        for key in ("grid/1", "grid/1", "grid/2"):
            at = {"xyz_mm": [0.0, 0.0, 0.0], "std_mm": [0.0, 0.0, 0.0], "samples": 1, "session": 1}
            seen = {"id": {"kind": "grid"}, "reflector": "flange", "frame": "tracker"} | at
            body = {"group": "grid", "station": "S1"} | seen
            output.take(Record(1, "2026-01-01T00:00:00+00:00", "point", key, body))
    assert "3/3" in capsys.readouterr().err


# -- a CAN link that loses frames -----------------------------------------------------------------


def link(writer: Writer, **lost: int) -> None:
    counts = {"bad_lines": 0, "refused": 0, "malformed": 0} | lost
    counts["frames"] = 1000 - sum(lost.values())
    writer.journal.append("event", "", {"what": "link"} | counts)


@pytest.mark.parametrize(("bad_lines", "warned"), [(4, False), (5, True)])
def test_a_link_that_loses_frames_is_named_at_the_end_in_show_and_in_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bad_lines: int, warned: bool
) -> None:
    writer = Writer(tmp_path / "r1").began()
    link(writer, bad_lines=bad_lines)
    folder = writer.ended()
    advice = LinkCounted(frames=0, bad_lines=1, refused=0, malformed=0).warning.partition(": ")[2]
    end_of(folder)
    assert (advice in " ".join(capsys.readouterr().err.split())) is warned
    assert main(["show", "r1", "--runs", str(tmp_path)]) == 0
    assert (advice in capsys.readouterr().out) is warned
    assert (advice in Page(report_html(read_facts(folder))).text) is warned


def test_losses_of_earlier_sessions_stay_counted_when_a_run_is_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = Writer(tmp_path / "r1").began()
    link(writer, refused=20, malformed=1)
    writer.state("run", "faulted")
    writer.began()
    link(writer, bad_lines=3)
    folder = writer.ended()
    assert main(["show", "r1", "--json", "--runs", str(tmp_path)]) == 0
    shown = json.loads(capsys.readouterr().out)
    found = shown["link"]
    assert "1.20 %" in shown["link_warning"]
    assert all(count in found for count in ("1976 ", "3 ", "20 ", "1 ", "1.20 %"))
    facts = read_facts(folder)
    assert found in Page(report_html(facts)).text
    with ZipFile(BytesIO(xlsx_bytes(facts))) as book:
        assert any(found.encode() in book.read(name) for name in book.namelist())
    assert [alarm.found for alarm in alarms_of(read_log(folder), "r1", live=False)] == [found]


def test_how_the_slide_was_held_is_of_the_last_end() -> None:
    held, not_so = (
        LinkCounted(frames=1, bad_lines=0, refused=0, malformed=0, held_by_sdo=1),
        LinkCounted(frames=1, bad_lines=0, refused=0, malformed=0),
    )
    assert held.followed_by(not_so).held_by_sdo == 0
    assert not_so.followed_by(held).held_by_sdo == 1
    assert LinkCounted(frames=1, bad_lines=0, refused=0, malformed=0).warning == ""
    assert "100.00 %" in LinkCounted(frames=0, bad_lines=1, refused=0, malformed=0).warning


@pytest.mark.parametrize(
    ("verdicts", "code", "outcome", "said"),
    [
        ({"validation.S1100": REJECTED | {"holds": True}}, 0, "in tolerance", []),
        ({"validation.S1100": REJECTED}, 1, "out of tolerance", ["S1100"]),
        (
            {f"validation.{name}": REJECTED for name in ("S1100", "others", "S300")},
            1, "out of tolerance", ["S1100", "S300"],
        ),
        ({"validation.others": REJECTED}, 1, "out of tolerance", ["the other stations"]),
    ],
)  # fmt: skip
def test_a_run_that_finished_says_its_outcome_and_each_failure_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], verdicts: dict[str, Any], code: int,
    outcome: str, said: list[str],
) -> None:  # fmt: skip
    """Success was not said, a failure once for each station and once more for all others."""
    writer = Writer(tmp_path / "r1").began()
    for key, body in verdicts.items():
        writer.journal.append("verdict", key, body)
    end_of(writer.ended(code=code))
    *failed, last = capsys.readouterr().err.splitlines()
    assert f"finished, {outcome}; " in last
    assert len(failed) == len(said)
    for line, place in zip(failed, said, strict=True):
        assert place in line
        assert line.endswith("(hilcell explain HC-V01)")


def test_ctrl_c_at_a_watched_run_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Writer(tmp_path / "r9").began().left()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(control, "_follow", interrupted)
    assert main(["watch", "r9", "--runs", str(tmp_path)]) == 4
    assert "run r9: " in capsys.readouterr().err


def test_what_was_not_seen_at_rest_is_shown_of_the_journal_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    writer = Writer(tmp_path / "r1").began()
    problem = "Robot: close: not at rest 3 s after the brake"
    writer.event("closed", problems={"Robot": problem})
    writer.ended("faulted", 3, "Rail: CAN: link lost")
    for words in (["show", "r1"], ["watch", "r1"]):
        assert main([*words, "--runs", str(tmp_path)]) == 0
        said = capsys.readouterr()
        assert "robot could not be confirmed at rest" in " ".join((said.out + said.err).split())
    assert main(["show", "r1", "--json", "--runs", str(tmp_path)]) == 0
    assert "press the E-stop" in json.loads(capsys.readouterr().out)["not_at_rest"]
    writer = Writer(tmp_path / "r2").began()
    writer.event("closed", problems={"Tracker": "no answer"})
    writer.ended("faulted", 3, "Rail: CAN: link lost")
    assert main(["show", "r2", "--json", "--runs", str(tmp_path)]) == 0
    assert json.loads(capsys.readouterr().out)["not_at_rest"] is None, "a tracker moves nothing"
