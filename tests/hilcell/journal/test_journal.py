"""The journal keeps what it acknowledged, in order, and notices every change."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hilcell.journal.journal import Journal, NotFinite, OpenFile, StorageError, read_journal
from hilcell.model.records import Kind


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


def filled(path: Path) -> Path:
    journal = Journal(path, "r", create=True)
    for number in range(5):
        journal.append("point", f"p/{number}", {"xyz_mm": np.arange(3.0) + number, "ok": True})
    journal.close()
    return path


def test_records_come_back_as_written(path: Path) -> None:
    records = read_journal(filled(path))
    assert [record.key for record in records] == [f"p/{n}" for n in range(5)]
    assert records[2].body == {"xyz_mm": [2.0, 3.0, 4.0], "ok": True}
    assert [r.seq for r in read_journal(path, after=3)] == [4, 5]


@pytest.mark.parametrize("value", [np.nan, -np.inf])
@pytest.mark.parametrize(
    ("kind", "where", "body"),
    [
        ("point", "std_mm[1]", lambda value: {"std_mm": np.array([0.1, value, 0.1])}),
        ("frame", "matrix[3][3]", lambda value: {"matrix": np.diag([1.0, 1.0, 1.0, value])}),
        (
            "event",
            "facts.age_s",
            lambda value: {"facts": {"age_s": np.float64(value)}},
        ),
        ("verdict", "off_mm", lambda value: {"holds": False, "off_mm": value}),
    ],
)
def test_what_is_not_finite_is_refused_before_it_is_written(
    path: Path, kind: Kind, where: str, body: Callable[[float], dict[str, Any]], value: float
) -> None:
    journal = Journal(filled(path), "r", create=False)
    with pytest.raises(NotFinite) as caught:
        journal.append(kind, "p/9", body(value))
    assert all(word in str(caught.value) for word in ("record 6", f"{kind} p/9", where, f"{value}"))
    assert journal.append("event", "", {"what": "goes on"}).seq == 6
    journal.close()
    assert [record.kind for record in read_journal(path)][5:] == ["event"]


def test_a_listener_hears_only_what_is_durable(path: Path) -> None:
    journal = Journal(path, "r", create=True)
    heard = []
    journal.listen(lambda record: heard.append([r.seq for r in read_journal(path)]))
    journal.append("event", "", {"what": "a"})
    journal.append("event", "", {"what": "b"})
    assert heard == [[1], [1, 2]]
    journal.close()


SETTINGS = """
import pathlib, sys
from hilcell.journal.journal import Journal
journal = Journal(pathlib.Path(sys.argv[1]), "r", create=True)
for name in ("journal_mode", "synchronous"):
    print(*journal._base.execute(f"PRAGMA {name}").fetchone())
"""


@pytest.mark.process
def test_what_is_acknowledged_is_on_the_disk(path: Path) -> None:
    """The settings of SQLite by which a loss of power undoes no commit; no test can pull a plug.

    They are read in a process of its own: journals of this one are written faster.
    """
    words = [sys.executable, "-c", SETTINGS, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["wal", "2"]  # 2: FULL


@pytest.mark.parametrize("statement", ["DELETE FROM record", "UPDATE record SET body = '{}'"])
def test_sql_cannot_change_it(path: Path, statement: str) -> None:
    base = sqlite3.connect(filled(path))
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        base.execute(statement)
    base.close()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE record SET body = replace(body, '3.0', '3.1') WHERE seq = 3",
        "UPDATE record SET t = 'x' WHERE seq = 2",
        "DELETE FROM record WHERE seq = 2",
    ],
)
def test_a_changed_file_is_refused(path: Path, statement: str) -> None:
    base = sqlite3.connect(filled(path))
    base.execute("DROP TRIGGER record_is_never_changed")
    base.execute("DROP TRIGGER record_is_never_deleted")
    base.execute(statement)
    base.commit()
    base.close()
    with pytest.raises(StorageError) as caught:
        read_journal(path)
    assert caught.value.code == "HC-J02"


def test_another_version_is_refused(path: Path) -> None:
    base = sqlite3.connect(filled(path))
    base.execute("UPDATE meta SET value = '99' WHERE name = 'form'")
    base.commit()
    base.close()
    with pytest.raises(StorageError, match="99"):
        read_journal(path)


def test_something_else_is_refused(path: Path) -> None:
    path.write_bytes(b"not a database, but long enough to look like one " * 10)
    for file in (path, path.with_name("nowhere")):
        with pytest.raises(StorageError, match=file.name):
            read_journal(file)


def test_a_full_disk_is_told_and_nothing_half_written(path: Path) -> None:
    journal = Journal(filled(path), "r", create=False)
    pages = journal._base.execute("PRAGMA page_count").fetchone()[0]
    journal._base.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StorageError, match="full"):
        append_many(journal)
    journal.close()
    assert all(r.seq == n for n, r in enumerate(read_journal(path), start=1))


def append_many(journal: Journal) -> None:
    for _ in range(100):
        journal.append("event", "", {"what": "x" * 1000})


WRITER = """
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from hilcell.journal.journal import Journal
journal = Journal(Path(sys.argv[1]), "r", create=True)
journal.listen(lambda record: print(record.seq, flush=True))
while True:
    journal.append("event", "", {"what": "tick"})
"""


def test_one_that_was_killed_while_it_was_made_is_empty(path: Path) -> None:
    base = sqlite3.connect(path)
    base.execute("PRAGMA journal_mode=WAL")
    base.close()
    assert path.stat().st_size
    assert read_journal(path) == []


@pytest.mark.parametrize("how", ["removed", "replaced", "moved"])
def test_a_journal_taken_away_acknowledges_nothing_more(path: Path, how: str) -> None:
    journal = Journal(path, "r", create=True)
    journal.append("point", "p/0", {})
    if how == "moved":
        path.rename(path.with_name("elsewhere"))
    else:
        path.unlink()
    if how == "replaced":
        path.write_bytes(b"another")
    heard: list[object] = []
    journal.listen(heard.append)
    with pytest.raises(StorageError, match=path.name):
        journal.append("point", "p/1", {})
    assert heard == []
    journal.close()


@pytest.mark.process
def test_kill_9_loses_nothing_acknowledged(path: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    for line in writer.stdout:
        if int(line) >= 200:
            break
    os.kill(writer.pid, signal.SIGKILL)
    rest = writer.stdout.read().splitlines()
    writer.stdout.close()
    writer.wait()
    acknowledged = int(rest[-1]) if rest and rest[-1].isdigit() else 200
    assert len(read_journal(path)) >= acknowledged


# -- A file that others damage between a check and the note of how far it was written --------------


def replace(path: Path) -> None:
    path.rename(path.with_suffix(".old"))
    path.write_bytes(b"x" * 100)


def cut(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("harm", [replace, Path.unlink, cut])
def test_harm_right_before_a_note_is_noticed_by_the_next_check(
    tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    path = tmp_path / "journal"
    path.write_bytes(b"x")
    file = OpenFile(path)
    assert file.lost() == ""
    harm(path)
    file.note()
    assert file.lost()


def test_a_file_may_come_and_grow(tmp_path: Path) -> None:
    file = OpenFile(tmp_path / "journal")
    for size in (1, 2):
        file.path.write_bytes(b"x" * size)
        file.note()
        assert file.lost() == ""
    cut(file.path)
    assert file.lost()
