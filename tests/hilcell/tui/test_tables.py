"""The event log's words: every kind of record, in one line."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from hilcell.decoding import typed
from hilcell.identity import Identity
from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.journal import Record
from hilcell.model import events
from hilcell.model.outcome import Outcome
from hilcell.model.plan import PlanRecord
from hilcell.model.point import Point
from hilcell.model.records import Ended, Fact, Intended, StateChanged
from hilcell.tui.screens.pages import (
    Compared,
    ComparePage,
    columns_for,
    history_row,
    log_columns,
    record_row,
    record_text,
)
from tests.hilcell.identification.test_curve_record import FOUND
from tests.hilcell.tui.all_screens import COMPARISON, RUNS
from tests.hilcell.tui.sample_runs import measuring, sample_runs
from tests.hilcell.verdicts import BACKLASH, WORLD

T = "2026-03-04T08:00:01.250+00:00"
SAMPLES = {record.kind: record for record in measuring().records}
PLAN, POINT = SAMPLES["plan"].fact, SAMPLES["point"].fact
assert isinstance(PLAN, PlanRecord)
assert isinstance(POINT, Point)
DRIVE = Identity(device="Rail", model="drive", serial="1")
SAID: list[tuple[str, Fact, str]] = [
    ("", PLAN, "calibrate, 21 points, seed 1"),
    ("", replace(PLAN, machine_seed=7), "calibrate, 21 points, seed 1, machine 7"),
    ("", StateChanged(machine="run", to="paused"), "run is paused"),
    ("", StateChanged(machine="run", to="faulted", reason="a"), "run is faulted: a"),
    ("grid/0", POINT, "grid/0 at S1100"),
    ("world/F1", replace(POINT, station=""), "world/F1"),
    ("grid/0", replace(POINT, station="", retaken=True), "grid/0, re-measured"),
    ("grid/0", Intended(action="robot.move", joints_deg=(0.0,)), "robot.move grid/0"),
    ("", Intended(action="rail.move", position_mm=5.0), "rail.move to 5.000 mm"),
    ("", Intended(action="rail.approach", station="S1"), "rail.approach S1"),
    ("sweep/A1/up", Intended(action="robot.sweep", axis=1), "robot.sweep sweep/A1/up axis 1"),
    ("world", replace(WORLD, points=["world/F1", "world/F2"]), "world by 2 points"),
    ("world", replace(WORLD, calibration="1-made"), "world of calibration 1-made"),
    ("backlash", BACKLASH, f"backlash in tolerance: {BACKLASH.text}"),
    ("", events.Closed(problems={}), "devices closed"),
    (
        "",
        events.SafeStopSent(problems={"Tracker": "gone"}),
        "a stop was sent to all devices, but look at Tracker: gone",
    ),
    ("", events.Connected(devices=[DRIVE]), "devices connected: drive, serial 1"),
    ("", events.DeviceBack(device="Rail"), "device back: Rail answers again"),
    (
        "",
        events.CommandRefused(command="pause", state="paused"),
        "command refused: pause is not possible while paused",
    ),
    ("", events.ChangesAccepted(changes=["a", "b"], by="Ann"), "changes accepted by Ann: a; b"),
    ("", events.StepBegun(name="fit", number=6, of=7), "step 6 of 7 begins: fit"),
    (
        "",
        events.LinkCounted(frames=9, bad_lines=0, refused=0, malformed=0),
        "rail's wire: 9 frames, 0 bad lines, 0 refused, 0 malformed (0.00 % lost)",
    ),
    ("", events.OtherEvent("drift", {"off_mm": 0.1, "axis": 2}), "drift off_mm 0.1, axis 2"),
    ("", events.OtherEvent("drift seen", {}), "drift seen"),
    (
        "",
        FOUND,
        "curve of A2: 31.6 urad at 40.0, 20.0 urad at 203.5; lag 12.3 ms",
    ),
    ("", Ended(state="finished", exit=0), "finished, exit 0"),
]


@pytest.mark.parametrize(("key", "fact", "wanted"), SAID)
def test_each_kind_has_its_words(key: str, fact: Fact, wanted: str) -> None:
    assert record_text(key, fact) == wanted


def test_every_record_of_a_run_becomes_one_line() -> None:
    for run in sample_runs().values():
        for record in run.records:
            row = record_row(record)
            assert len(row.cells) == len(log_columns(T))
            assert row.cells[-1]
            assert "\n" not in row.cells[-1]


def test_a_row_tells_number_time_and_kind() -> None:
    row = record_row(
        Record(17, T, "state", "", {"machine": "run", "to": "faulted", "reason": "a\nb"})
    )
    assert row.cells[3] == "run is faulted: a b"
    assert row.cells[:3] == ("17", "08:00:01.250", "state")
    assert row.tone == "fault"


# -- the history -----------------------------------------------------------------------------------


WIDTHS = (58, 79, 80, 119, 138, 200)


def test_what_is_marked_is_seen() -> None:
    assert history_row(RUNS[0], [RUNS[0].name], 80).cells[0] == "*"
    assert history_row(RUNS[0], [RUNS[1].name], 80).cells[0] == ""


def test_the_history_says_how_a_run_out_of_tolerance_came_out() -> None:
    suspected = CalibrationFacts(suspected=True)
    both = CalibrationFacts(suspected=True, outcome=Outcome.REJECTED)
    runs = [replace(RUNS[1], facts=facts) for facts in (suspected, both)]
    assert [history_row(run, (), 200).cells[3] for run in runs] == ["suspected", "out of tolerance"]


def test_the_history_tells_how_a_run_ended() -> None:
    reported = [history_row(run, (), 200).cells[3] for run in RUNS]
    assert reported == ["in tolerance", "out of tolerance", "engine gone", "unreadable"]
    assert [history_row(run, (), 200).tone for run in RUNS[:2]] == ["", "fault"]


@pytest.mark.parametrize("width", WIDTHS)
def test_the_history_always_has_date_procedure_verdict_and_operator(width: int) -> None:
    columns = columns_for(width)
    assert all(len(history_row(run, (), width).cells) == len(columns) for run in RUNS)
    assert sum(column.width + 1 for column in columns) <= width - 1, "beside the simulation's edge"
    found = dict(
        zip([each.title for each in columns], history_row(RUNS[0], (), width).cells, strict=True)
    )
    date = found.get("begun UTC") or found["begun"]
    assert date.startswith("2026-03-04")
    assert found["procedure"] == "calibrate"
    assert found["verdict or state"] == "in tolerance"
    assert found["operator"] == "Ann"
    if width >= 79:
        assert (found["cell"], found["kind"]) == ("paper", "SIM")
    if width >= 119:
        assert found["after"] == "0.110"


def test_a_comparison_tells_stations_apart_in_80_columns() -> None:
    rows = typed(COMPARISON, Compared).rows
    widths = [column.width for column in ComparePage.COLUMNS]
    shown = [tuple(c[:w] for c, w in zip(row.cells[:2], widths, strict=False)) for row in rows]
    assert len(set(shown)) == len(rows)
    assert rows[0].cells[:2] == ("S1100 targets", "corrected: mean, mm")
    assert len(rows[0].cells[1]) <= widths[1]
    assert sum(widths) + len(widths) <= 79
