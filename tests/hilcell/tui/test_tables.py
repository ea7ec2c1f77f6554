"""The event log's words: every kind of record, in one line."""

from __future__ import annotations

from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from hilcell.journal.calibration_facts import CalibrationFacts
from hilcell.journal.journal import Record
from hilcell.model.outcome import Outcome
from hilcell.model.records import Kind
from hilcell.tui.screens.history import COLUMNS as COMPARED
from hilcell.tui.screens.history import change_row
from hilcell.tui.text.tables import (
    columns_for,
    history_row,
    log_columns,
    record_row,
    record_words,
)
from tests.hilcell.journal.test_curve_record import FOUND, body_of
from tests.hilcell.tui.all_screens import COMPARISON, RUNS

T = "2026-03-04T08:00:01.250+00:00"
TOLD: list[tuple[Kind, str, dict[str, Any], str]] = [
    ("plan", "", {"procedure": "home", "points": 3, "seed": 1}, "home, 3 points, seed 1"),
    ("state", "", {"machine": "run", "to": "paused"}, "run is paused"),
    ("state", "", {"machine": "run", "to": "faulted", "reason": "a\nb"}, "run is faulted: a b"),
    ("point", "grid/0", {"station": "S1100"}, "grid/0 at S1100"),
    ("point", "world/F1", {"station": ""}, "world/F1"),
    ("point", "grid/0", {"station": "", "retaken": True}, "grid/0, re-measured"),
    ("intent", "grid/0", {"action": "robot.move", "joints_deg": [0.0]}, "robot.move grid/0"),
    ("intent", "", {"action": "rail.move", "to_mm": 5.0}, "rail.move to_mm 5.000"),
    ("frame", "world", {"matrix": [[1.0]], "rms_mm": 0.01234}, "world rms_mm 0.012"),
    ("verdict", "v", {"holds": False, "mean_mm": 0.3}, "v holds False, mean_mm 0.300"),
    ("event", "", {"what": "closed", "problems": {}}, "closed"),
    ("event", "", {"what": "closed", "problems": {"Rail": "gone"}}, "closed problems Rail gone"),
    (
        "event",
        "",
        {"what": "connected", "devices": [{"device": "Rail", "serial": "1"}, {"device": "Robot"}]},
        "connected devices device Rail serial 1; device Robot",
    ),
    ("event", "", {"what": "step", "name": "fit", "number": 6}, "step name fit, number 6"),
    (
        "event",
        "",
        body_of(FOUND),
        "curve of A2: 31.6 urad at 40.0, 20.0 urad at 203.5; lag 12.3 ms",
    ),
    ("end", "", {"state": "finished", "exit": 0, "result": {}}, "finished, exit 0"),
]


@pytest.mark.parametrize(("kind", "key", "body", "wanted"), TOLD)
def test_each_kind_has_its_words(kind: Kind, key: str, body: dict[str, Any], wanted: str) -> None:
    assert record_words(Record(1, T, kind, key, body)) == wanted


def test_no_kind_is_left_out() -> None:
    assert {kind for kind, *_ in TOLD} == set(get_args(Kind))


@pytest.mark.parametrize("kind", get_args(Kind))
@given(body=st.dictionaries(st.text(), st.none() | st.floats() | st.text() | st.lists(st.text())))
def test_any_record_becomes_one_line(kind: Kind, body: dict[str, Any]) -> None:
    row = record_row(Record(1, T, kind, "key", body))
    assert len(row.cells) == len(log_columns(T))


def test_a_row_tells_number_time_and_kind() -> None:
    row = record_row(Record(17, T, "state", "", {"machine": "run", "to": "faulted"}))
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
    rows = [change_row(each) for each in COMPARISON["changes"]]
    widths = [column.width for column in COMPARED]
    shown = [tuple(c[:w] for c, w in zip(row.cells[:2], widths, strict=False)) for row in rows]
    assert len(set(shown)) == len(rows)
    assert rows[0].cells[:2] == ("S1100 targets", "corrected: mean, mm")
    assert len(rows[0].cells[1]) <= widths[1]
    assert sum(widths) + len(widths) <= 79
