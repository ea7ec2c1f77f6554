"""A run's record follows from its journal alone, and its digest from all that a plant keeps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilcell.journal.journal import Record
from hilcell.journal.runs import read_records
from hilcell.plant.record import RunNotFinished, RunRecord, heads, rows_digest, run_record
from hilcell.plant.tables import DEVICE, FRAME, GRID, OUTCOME, POINT, STREAM
from hilcell.plant.tables import RUN as RUNS
from tests.whole.golden import GoldenRuns

RUN = "small"


@pytest.fixture(scope="module")
def records(golden: GoldenRuns) -> list[Record]:
    return read_records(golden[RUN].folder)


@pytest.fixture(scope="module")
def few(records: list[Record]) -> list[Record]:
    """Return a part of the journal: an example takes a millisecond."""
    return [
        each
        for each in records
        if each.kind in ("plan", "state", "end")
        or (each.kind == "frame" and each.key in ("world", "base"))
        or (each.kind == "point" and each.body["group"] in ("world", "slide"))
    ]


def digest(record: RunRecord) -> object:
    return record.rows[RUNS][0]["digest"]


def changed(
    records: list[Record], at: int, change: Callable[[dict[str, Any]], Any]
) -> list[Record]:
    """Return the records, one of them with another body."""
    body = msgspec.json.decode(msgspec.json.encode(records[at].body))
    change(body)
    return [*records[:at], msgspec.structs.replace(records[at], body=body), *records[at + 1 :]]


def test_the_same_journal_has_the_same_digest(golden: GoldenRuns, tmp_path: Path) -> None:
    folder = golden[RUN].copied_to(tmp_path)
    first, second = (run_record(RUN, read_records(each)) for each in (golden[RUN].folder, folder))
    assert first == second
    assert digest(first) == digest(second)


def test_a_record_holds_what_the_run_measured(records: list[Record]) -> None:
    record = run_record(RUN, records)
    points = {each.key for each in records if each.kind == "point"}
    assert {each["key"] for each in record.rows[POINT]} == points
    assert {each["key"] for each in record.rows[FRAME]} >= {"world", "base", "station.S300"}
    kinds = {each["kind"] for each in record.rows[DEVICE]}
    assert kinds == {"drive", "strip", "robot", "tracker"}
    (grid,) = record.rows[GRID]
    assert np.array(grid["errors_mm"]).shape == (27, 3)
    assert record.rows[RUNS][0]["head"] == heads(records)[-1]
    assert record.row.exit == 0


@settings(max_examples=15)
@given(data=st.data())
def test_every_measured_value_is_in_the_digest(few: list[Record], data: st.DataObject) -> None:
    at = data.draw(st.sampled_from([n for n, each in enumerate(few) if each.kind == "point"]))
    axis, by_mm = data.draw(st.integers(0, 2)), data.draw(st.sampled_from([1e-9, -1.0, 500.0]))

    def moved(body: dict[str, Any]) -> None:
        body["xyz_mm"][axis] += by_mm

    other = run_record(RUN, changed(few, at, moved))
    assert digest(other) != digest(run_record(RUN, few))
    assert other.run_key == run_record(RUN, few).run_key


def test_a_point_that_was_measured_again_is_kept_and_does_not_count(
    records: list[Record],
) -> None:
    at = next(n for n, each in enumerate(records) if each.kind == "point")
    again = changed(records, at, lambda body: body.update(retaken=True))[at]
    both = numbered([*records[: at + 1], again, *records[at + 1 :]])
    record = run_record(RUN, both)
    found = [each for each in record.rows[POINT] if each["key"] == again.key]
    assert [(each["superseded"], each["retaken"]) for each in found] == [
        (True, False), (False, True),
    ]  # fmt: skip
    assert sum(not each["superseded"] for each in record.rows[POINT]) == record.row.points
    assert run_record(RUN, records).row.points == record.row.points


def test_points_of_a_tracker_that_had_moved_do_not_count(records: list[Record]) -> None:
    at = max(n for n, each in enumerate(records) if each.key.startswith("validate/"))
    body = {"what": "tracker moved", "set_up": 1, "invalid": [records[at].key]}
    moved = msgspec.structs.replace(records[at], kind="event", key="", body=body)
    record = run_record(RUN, numbered([*records[: at + 1], moved, *records[at + 1 :]]))
    assert [each["key"] for each in record.rows[POINT] if each["superseded"]] == [records[at].key]


def numbered(records: list[Record]) -> list[Record]:
    return [msgspec.structs.replace(each, seq=n) for n, each in enumerate(records, start=1)]


def test_a_stream_is_kept_by_its_digest(records: list[Record]) -> None:
    stream = {
        "key": "sweep/A1/up", "file": "sweep-A1-up-00.stream", "sha256": "ab" * 32,
        "samples": 977, "joint_samples": 183, "first_device_s": 0.0, "last_device_s": 9.0,
        "longest_gap_s": 0.1, "form": 1,
    }  # fmt: skip
    at = len(records) - 5
    event = msgspec.structs.replace(
        records[at], kind="event", key="", body={"what": "stream"} | stream
    )
    record = run_record(RUN, numbered([*records[:at], event, *records[at:]]))
    (found,) = record.rows[STREAM]
    assert {
        name: each for name, each in found.items() if name != "digest"
    }.items() <= stream.items()


def test_a_run_of_another_name_or_another_plan_is_another_run(records: list[Record]) -> None:
    record = run_record(RUN, records)
    (run,) = record.rows[RUNS]
    renamed = {**record.rows, RUNS: [{**run, "cell": "other"}]}
    assert rows_digest(record.rows) == digest(record)
    assert rows_digest(renamed) != digest(record)
    assert run_record("other", records).run_key != record.run_key
    plan = changed(records, 0, lambda body: body.update(operator="Bob"))
    assert run_record(RUN, plan).run_key != record.run_key


def test_more_records_are_a_later_revision_of_the_same_run(records: list[Record]) -> None:
    last = records[-1]
    event = {"what": "calibration revoked", "reason": "bumped"}
    more = msgspec.structs.replace(last, seq=last.seq + 1, kind="event", body=event)
    before, after = run_record(RUN, records), run_record(RUN, [*records, more])
    assert after.run_key == before.run_key
    assert (before.revision, after.revision) == (last.seq, last.seq + 1)
    assert after.row.facts.revoked == "bumped"
    assert heads([*records, more])[last.seq - 1] == before.rows[RUNS][0]["head"]


def test_a_run_that_is_not_over_has_no_record(records: list[Record]) -> None:
    with pytest.raises(RunNotFinished, match="small"):
        run_record(RUN, records[:300])


def test_a_text_holds_nothing_that_a_database_refuses(records: list[Record]) -> None:
    plan = changed(records, 0, lambda body: body.update(operator="A\0nn"))
    (outcome,) = run_record(RUN, plan).rows[OUTCOME]
    assert isinstance(outcome["row"], dict)
    assert outcome["row"]["operator"] == "A\N{REPLACEMENT CHARACTER}nn"
