"""A journal that somebody damages while it is written acknowledges nothing more, and says so."""

import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from hilcell.journal import journal as module
from hilcell.journal.journal import Journal, StorageError, read_journal
from hilcell.journal.runs_folder import command_on
from hilcell.run.cell_session import CellSession
from tests.hilcell.run.bed import Bed
from tests.hilcell.run.rig import Points, procedure


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


def wal(path: Path) -> Path:
    return path.with_name(f"{path.name}-wal")


def truncate(file: Path) -> None:
    os.truncate(file, 0)


def halve(file: Path) -> None:
    os.truncate(file, file.stat().st_size // 2)


def replace(file: Path) -> None:
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


@pytest.mark.parametrize("how", [truncate, halve, Path.unlink, replace])
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


@pytest.mark.parametrize("how", [Path.unlink, replace])
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


@pytest.mark.parametrize("how", [truncate, replace])
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
