"""A run's folder that somebody has made to harm: it is named, and stops nobody."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from hilcell.journal import journal
from hilcell.journal.index import NAME, find_run, read_index
from hilcell.journal.journal import Journal, StorageError, read_journal
from hilcell.journal.runs import ENGINE, JOURNAL, live_engine, read_log
from tests.hilcell.journal.test_index import written

ENDLESS = "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT"
NO_RECORDS = ("DROP TRIGGER record_is_never_changed", "DROP TRIGGER record_is_never_deleted",
              "DROP TABLE record")  # fmt: skip


def change(file: Path, *statements: str) -> None:
    with closing(sqlite3.connect(file, isolation_level=None)) as base:
        for statement in statements:
            base.execute(statement)


def records_without_end(file: Path) -> None:
    columns = "n AS seq, 't' AS t, 'plan' AS kind, '' AS key, '{}' AS body, x'' AS hash FROM r"
    change(file, *NO_RECORDS, f"CREATE VIEW record AS {ENDLESS} {columns}")


def form_without_end(file: Path) -> None:
    change(file, "DROP TABLE meta", f"CREATE VIEW meta AS {ENDLESS} n AS name, '2' AS value FROM r")


def computed_column(file: Path) -> None:
    columns = "seq INTEGER PRIMARY KEY, t TEXT, kind TEXT, key TEXT, hash BLOB"
    body = "body TEXT GENERATED ALWAYS AS (hex(zeroblob(2000000)))"
    change(
        file, *NO_RECORDS, f"CREATE TABLE record ({columns}, {body})",
        "INSERT INTO record VALUES (1, 't', 'plan', '', x'')",
    )  # fmt: skip


def nested(file: Path) -> None:
    text = f'{{"a": {5000 * "["}{5000 * "]"}}}'
    change(file, *NO_RECORDS[:2], f"UPDATE record SET body = '{text}' WHERE seq = 1")


def large_record(file: Path) -> None:
    size = journal.MAX_RECORD_BYTES // 2 + 1  # two digits a byte
    change(file, *NO_RECORDS[:2], f"UPDATE record SET body = hex(zeroblob({size})) WHERE seq = 1")


def large_file(file: Path) -> None:
    os.truncate(file, journal.MAX_JOURNAL_BYTES + 1)  # no block of the disk is filled


def pipe_beside(file: Path) -> None:
    os.mkfifo(file.with_name(f"{JOURNAL}-wal"))


def other_records(file: Path) -> None:
    """Let records be whole and well chained, yet none of a run."""
    with closing(Journal(file, "bad", create=False)) as base:
        base.append("event", "", {"nothing": "known"})
        base.append("event", "", {"what": "connected", "devices": 5})


HARMS = [
    records_without_end, form_without_end, computed_column, nested, large_record, large_file,
    pipe_beside, other_records,
]  # fmt: skip


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(journal, "MAX_RECORD_BYTES", 2**20)
    written(tmp_path / "good")
    written(tmp_path / "bad")
    return tmp_path


@pytest.mark.parametrize("harm", HARMS)
def test_a_harmful_run_is_listed_with_its_reason_and_stops_nobody(
    runs: Path, harm: Callable[[Path], None]
) -> None:
    harm(runs / "bad" / JOURNAL)
    rows = {row.name: row for row in read_index(runs)}
    assert (rows["good"].state, rows["bad"].state) == ("finished", "unreadable")
    assert rows["bad"].reason
    with pytest.raises(StorageError) as caught:
        read_log(runs / "bad")
    assert caught.value.code == "HC-J02"
    assert str(caught.value).endswith(journal.RESTORE_ADVICE)
    assert str(runs / "bad" / JOURNAL) in str(caught.value)
    assert find_run(runs, "last").name in ("good", "bad")
    assert read_log(runs / "good").state == "finished"


@pytest.mark.parametrize("harm", [records_without_end, nested, large_record, large_file])
def test_nothing_is_written_into_a_harmful_journal(
    runs: Path, harm: Callable[[Path], None]
) -> None:
    file = runs / "bad" / JOURNAL
    harm(file)
    with pytest.raises(StorageError):
        Journal(file, "bad", create=False)


def test_no_query_of_a_journal_takes_for_ever(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages that point at one another in a hostile file make a short file a long one."""
    monkeypatch.setattr(journal, "MAX_STEPS", 10**6)
    with (
        closing(journal._reader(runs / "bad" / JOURNAL)) as base,
        pytest.raises(sqlite3.OperationalError, match="interrupted"),
    ):
        base.execute(f"{ENDLESS} max(n) FROM r").fetchone()


def test_a_journal_is_not_written_until_nobody_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = Journal(tmp_path / JOURNAL, "r", create=True)
    begun.append("event", "", {"what": "x"})
    monkeypatch.setattr(journal, "MAX_JOURNAL_BYTES", sum(file.size for file in begun._files))
    begun.append("event", "", {"what": "x"})
    with pytest.raises(StorageError, match="new run") as caught:
        begun.append("event", "", {"what": "x"})
    assert caught.value.code == "HC-J01"
    begun.close()
    assert len(read_journal(tmp_path / JOURNAL)) == 2


def test_an_index_that_is_a_view_without_end_is_made_again(runs: Path) -> None:
    rows = read_index(runs)
    view = f"CREATE VIEW run AS {ENDLESS} n AS name, '' AS stamp, x'' AS row FROM r"
    change(runs / NAME, "DROP TABLE run", view)
    assert read_index(runs) == rows
    assert read_index(runs) == rows


@pytest.mark.parametrize(
    "content",
    [b"[" * 5000, b"{" * 10**6, b'{"pid": 1, "socket": "a\\u0000b", "folder": "\\u0000"}'],
)
def test_a_harmful_file_of_an_engine_is_none(runs: Path, content: bytes) -> None:
    (runs / "bad" / ENGINE).write_bytes(content)
    assert live_engine(runs / "bad") is None
    assert len(read_index(runs)) == 2


def test_a_pipe_in_place_of_an_engine_s_file_keeps_nobody_waiting(runs: Path) -> None:
    os.mkfifo(runs / "bad" / ENGINE)
    assert live_engine(runs / "bad") is None
