"""Runs are in the order in which they name one another, whatever the PC's clock said."""

import json
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from hilcell.journal.calibration_status import statuses
from hilcell.journal.index import UNREADABLE, RunRow, clock_notes, in_order, next_order, row_of
from hilcell.journal.journal import Journal
from hilcell.journal.runs import JOURNAL, read_records
from hilcell.model.plan import FolderOrder
from hilcell.model.records import Kind
from hilcell.run import engine
from tests.hilcell.commands.finished_runs import MADE, finished
from tests.hilcell.journal.test_calibration_status import made, row
from tests.hilcell.report.journals import Writer
from tests.whole.bench import command


def numbered(of: RunRow, number: int, folder: str = "f") -> RunRow:
    return msgspec.structs.replace(of, order=FolderOrder(folder, number))


def names(*rows: RunRow) -> list[str]:
    return [each.name for each in in_order(rows)]


def test_the_order_of_a_folder_decides_which_calibration_is_current() -> None:
    """The first was made with the clock ahead."""
    ahead, later = numbered(made("59"), 1), numbered(made("02"), 2)
    found = statuses([later, ahead])
    assert found["02"].state == "current"
    assert (found["59"].state, found["59"].by) == ("superseded", "02")


def test_a_touched_base_is_out_of_date_by_a_run_of_an_earlier_clock() -> None:
    first, touch = numbered(made("01"), 1), numbered(row("03", kind="touch", used="01"), 2)
    assert statuses([first, touch])["03"].state == "current"
    assert statuses([first, touch, numbered(row("02"), 3)])["03"].state == "out of date"


def test_runs_of_another_folder_are_merged_by_the_clock() -> None:
    here = [numbered(made("59"), 1), numbered(made("10"), 2), numbered(made("11"), 3)]
    brought = [numbered(made("05"), 7, "other"), made("01")]
    assert names(*here, *brought) == ["01", "05", "59", "10", "11"]


def test_a_session_takes_the_next_number() -> None:
    first = next_order([made("01")])
    assert (first.number, first.after) == (1, "")
    rows = [numbered(made("59"), 1), numbered(row("02", state="aborted", code=4), 2)]
    assert next_order(rows) == FolderOrder("f", 3, "02")
    unread = RunRow(name="x", begun="2026-11-22T10:00:05Z", state=UNREADABLE)
    assert next_order([*rows, unread]).number == 4  # it may be the third
    assert next_order([]).folder != next_order([]).folder


def test_a_clock_that_runs_back_is_named() -> None:
    day = [numbered(made("01"), 1), numbered(made("59"), 2), numbered(made("58"), 3)]
    assert list(clock_notes(day)) == []  # a second is what the network corrects
    behind = msgspec.structs.replace(made("02"), begun="2026-11-21T10:00:00Z")
    (note,) = clock_notes([*day, numbered(behind, 4)])
    assert "24.02 h" in note
    assert "run 59" in note
    assert "run 02" in note
    assert list(clock_notes(day, datetime(2026, 11, 22, 10, 1, tzinfo=UTC))) == []
    (note,) = clock_notes(day, datetime(2026, 11, 22, 9, 0, tzinfo=UTC))
    assert "1.02 h" in note


def test_a_session_that_was_refused_before_it_began_takes_no_place(tmp_path: Path) -> None:
    """Else a finished run that nobody could re-measure would supersede a later one."""
    finished(tmp_path, "1", MADE)
    for place in (FolderOrder("f", 5, "9"), FolderOrder("f", 6, "9")):
        _append(tmp_path / "1", {"what": "order"} | msgspec.to_builtins(place))
        assert row_of(tmp_path / "1").order == FolderOrder()
    _append(tmp_path / "1", {"machine": "run", "to": "checking"}, "state")
    assert row_of(tmp_path / "1").order == FolderOrder("f", 6, "9")


def _append(folder: Path, body: dict[str, object], kind: Kind = "event") -> None:
    journal = Journal(folder / JOURNAL, folder.name, create=False)
    journal.append(kind, "", body)
    journal.close()


def test_a_run_names_the_one_before_and_says_that_the_clock_ran_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine.Engine, "_perform", lambda *given: engine.Ending(0, None))
    place = {"folder": "f", "number": 7, "after": ""}
    Writer(tmp_path / "1-before", order=place).began().ended()
    assert " began" not in command("run", "home", "--runs", tmp_path, "--name", "2").stderr
    (plan,) = read_records(tmp_path / "2")
    assert plan.body["order"] == {"folder": "f", "number": 8, "after": "1-before"}

    class Behind(datetime):
        @classmethod
        def now(cls, tz: object = None) -> datetime:  # type: ignore[override]  # one zone is asked
            return datetime(2020, 1, 1, tzinfo=UTC)

    monkeypatch.setattr(engine, "datetime", Behind)
    assert " began" in command("run", "home", "--runs", tmp_path, "--name", "3").stderr


def test_the_list_of_runs_names_a_clock_that_ran_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    behind = msgspec.structs.replace(made("02"), begun="2026-11-21T10:00:00Z")
    rows = [numbered(made("59"), 1), numbered(behind, 2)]
    monkeypatch.setattr("hilcell.commands.runs.read_index", lambda _: rows)
    said = command("runs", "--runs", tmp_path, "--json")
    assert "24.02 h" in said.stderr
    listed = json.loads(said.stdout)["runs"]
    stand = {each["run"]: each["standing"]["state"] for each in listed}
    assert stand == {"59": "superseded", "02": "current"}
