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

from hilcell.journal import journal as module
from hilcell.journal.journal import Journal, NotFinite, OpenFile, StorageError, read_journal
from hilcell.journal.runs_folder import command_on
from hilcell.model.records import Kind
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure


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


# -- a journal that somebody damages while it is written acknowledges nothing more, and says so ---


def wal(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def truncate(file: Path) -> None:
    os.truncate(file, 0)


def halve(file: Path) -> None:
    os.truncate(file, file.stat().st_size // 2)


def replaced(file: Path) -> None:
    file.unlink()
    file.write_bytes(b"")


def tick(journal: Journal, count: int) -> None:
    for _ in range(count):
        journal.append("event", "", {"what": "tick", "filler": "x" * 500})


def overwrite(file: Path, old: bytes, new: bytes) -> None:
    """Change bytes in place, as a failing disk does; SQLite is not involved."""
    found = file.read_bytes()
    assert old in found
    with file.open("r+b") as changed:
        changed.write(found.replace(old, new))


@pytest.mark.parametrize("how", [truncate, halve, Path.unlink, replaced])
def test_records_cut_off_are_missed_before_the_next_one(
    path: Path, how: Callable[[Path], None]
) -> None:
    journal = Journal(path, "r", create=True)
    tick(journal, 20)
    how(wal(path))
    heard: list[object] = []
    journal.listen(heard.append)
    for _ in range(2):
        with pytest.raises(StorageError, match=wal(path).name) as caught:
            tick(journal, 1)
        assert (caught.value.code, caught.value.record) == ("HC-J10", 21)
    assert heard == []
    journal.close()


@pytest.mark.parametrize("how", [Path.unlink, replaced])
def test_what_was_acknowledged_before_its_file_was_taken_away_is_kept(
    path: Path, how: Callable[[Path], None]
) -> None:
    journal = Journal(path, "r", create=True)
    tick(journal, 20)
    how(wal(path))
    with pytest.raises(StorageError):
        tick(journal, 1)
    journal.close()
    assert len(read_journal(path)) == 20


def test_the_main_file_cut_short_is_missed(path: Path) -> None:
    journal = Journal(path, "r", create=True)
    tick(journal, 20)
    journal.read_back()
    tick(journal, 1)
    truncate(path)
    with pytest.raises(StorageError, match=path.name):
        tick(journal, 1)
    journal.close()


def test_what_a_disk_changes_is_noticed_when_it_is_read_back(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "READ_BACK", 40)
    journal = Journal(path, "r", create=True)
    tick(journal, 13)
    journal.append("point", "p", {"xyz_mm": [1.25]})
    tick(journal, 13)  # on other pages: the last page is written again with each record
    overwrite(wal(path), b"1.25", b"1.24")
    tick(journal, 12)
    for _ in range(2):
        with pytest.raises(StorageError) as caught:
            tick(journal, 1)
        assert caught.value.facts()["code"] == "HC-J13"
        assert caught.value.facts()["fields"] == {"record": 14}
    journal.close()


def test_what_has_vanished_is_noticed(path: Path) -> None:
    journal = Journal(path, "r", create=True)
    tick(journal, 5)
    other = sqlite3.connect(path)
    other.execute("DROP TRIGGER record_is_never_deleted")
    other.execute("DELETE FROM record WHERE seq > 3")
    other.commit()
    other.close()
    with pytest.raises(StorageError) as caught:
        journal.read_back()
    assert caught.value.record == 4
    journal.close()


def test_reading_back_finds_nothing_in_a_sound_journal(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "READ_BACK", 7)
    journal = Journal(path, "r", create=True)
    journal.read_back()
    tick(journal, 30)
    journal.read_back()
    journal.close()
    journal = Journal(path, "r", create=False)
    journal.read_back()
    tick(journal, 1)
    journal.close()
    assert len(read_journal(path)) == 31


@pytest.mark.parametrize("how", [truncate, replaced])
def test_a_run_whose_journal_is_cut_short_ends_safely_with_exit_7(
    bed: Bed, how: Callable[[Path], None]
) -> None:

    def strike(session: CellSession, number: int) -> None:
        if number == 2:
            how(wal(bed.path))

    runner = bed.runner(procedure(Points(30, strike)))
    assert runner.run() == 7
    assert isinstance(runner.fault, StorageError)
    assert bed.rail.stopped_s is not None
    assert bed.rail.closed == 1
    assert bed.tracker.measured <= 3
    bed.journal.close()


def test_a_run_whose_journal_was_changed_does_not_end_well(bed: Bed) -> None:

    def strike(session: CellSession, number: int) -> None:
        if number == 29:
            overwrite(wal(bed.path), b'"target":"2"', b'"target":"3"')

    runner = bed.runner(procedure(Points(30, strike)))
    assert runner.run() == 7
    assert isinstance(runner.fault, StorageError)
    assert bed.rail.closed == 1
    bed.journal.close()


def test_a_full_disk_is_no_damage(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file of a long run has its size: the disk is found full when it is read back."""

    def full(_: Path) -> sqlite3.Connection:
        error = sqlite3.OperationalError("database or disk is full")
        error.sqlite_errorcode = sqlite3.SQLITE_FULL
        raise error

    monkeypatch.setattr(module, "READ_BACK", 7)
    journal = Journal(path, "r", create=True)
    tick(journal, 6)
    with monkeypatch.context() as patched:
        patched.setattr(module, "_reader", full)
        with pytest.raises(StorageError) as caught:
            tick(journal, 1)
    assert caught.value.code == "HC-J01"
    assert command_on(path.parent, "resume") in str(caught.value)
    tick(journal, 1)  # there is room again
    journal.close()
    assert len(read_journal(path)) == 8


def test_an_error_of_python_s_own_has_no_code_of_sqlite(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def closed(_: Path) -> sqlite3.Connection:
        raise sqlite3.ProgrammingError("Cannot operate on a closed database.")

    monkeypatch.setattr(module, "_reader", closed)
    journal = Journal(path, "r", create=True)
    with pytest.raises(StorageError) as caught:
        journal.read_back()
    assert caught.value.code == "HC-J13"
    journal.close()
